//! Taking transitions in: limits, counts, episodes, annotations, the replay and its first past values.

use super::samples::Sources;
use super::{Agent, AgentError, Counters, Running};
use crate::rivals::Shown;
use trestle_proto::NONE;
use trestle_proto::batch::{Batch, Checked};
use trestle_proto::episode::Episode;
use trestle_proto::observe::Observed;
use trestle_proto::space::reported;

/// An episode that ended within a batch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FinishedEpisode {
    /// The actor that played it.
    pub actor: u32,
    /// The run's counters with its last step and the episode itself counted. Gradient steps that this tick still
    /// owes are not in them.
    pub counters: Counters,
    /// Its return, length and success.
    pub episode: Episode,
}

/// What became of a batch.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ingested {
    /// Transitions that were counted and stored. Fewer than the batch has only where the run ended within it.
    pub consumed: usize,
    /// Episodes that ended, in order.
    pub finished: Vec<FinishedEpisode>,
}

impl Agent {
    /// Takes over the changed annotations of `observed` and then the batch's transitions, in order, until the run
    /// has reached its number of episodes or environment steps; what comes after is dropped.
    ///
    /// `observed` is the mentor-server's answer to the whole batch, exactly where the algorithm has a mentor.
    ///
    /// # Errors
    /// An answer to another batch, or to none. Nothing of the batch has been stored then.
    pub fn ingest(
        &mut self,
        batch: &Checked<Batch>,
        observed: Option<&Observed>,
    ) -> Result<Ingested, AgentError> {
        self.check_answer(batch, observed)?;
        if let (Some(mentor), Some(observed)) = (&mut self.mentor, observed) {
            mentor.annotations.apply(&observed.changed)?;
            mentor.searches_cut_short += u64::from(observed.cut_short);
            let words = mentor.annotations.record_words();
            for record in observed.changed.chunks_exact(words) {
                self.renew_annotated(record[0] as usize);
            }
            if !observed.changed.is_empty() {
                self.renew_options();
            }
        }
        let mut ingested = Ingested::default();
        let first = self.replay.next_index();
        for index in 0..batch.len() {
            if self.done() {
                break;
            }
            let transition = batch.transition(index);
            let picked = observed.map_or(NONE, |observed| observed.mentor[index]);
            let slot = self.replay.push(&transition, batch.header.actor, picked);
            if let Some(rival) = &mut self.rival {
                rival.store(&self.replay, slot);
            }
            if let Some(mentor) = &mut self.mentor {
                mentor.selection.stored(slot);
                if picked != NONE {
                    mentor.visited[picked as usize] += 1;
                }
            }
            self.counters.env_steps += 1;
            ingested.consumed += 1;
            let running = &mut self.running[batch.header.actor as usize];
            if running.length == 0 {
                running.first = self.replay.next_index() - 1;
            }
            let said = transition.succeeded();
            running.total_reward += reported(transition.reward, said, self.settings.goal_bonus);
            running.length += 1;
            if transition.ends_episode() {
                let Running { total_reward, length, first } = std::mem::take(running);
                let success = self.settings.success.of(said, total_reward);
                if let Some(own) = &mut self.own
                    && own.take(&self.replay, first, length, success)
                {
                    self.publish_own();
                }
                if let Some(rival) = &mut self.rival {
                    rival.finish(&self.replay, first, length);
                }
                self.counters.episodes += 1;
                ingested.finished.push(FinishedEpisode {
                    actor: batch.header.actor,
                    counters: self.counters,
                    episode: Episode { total_reward, length, success },
                });
            }
        }
        self.value_stored(first)?;
        Ok(ingested)
    }

    /// Whether `observed` is an answer to `batch`, and due.
    fn check_answer(&self, batch: &Batch, observed: Option<&Observed>) -> Result<(), AgentError> {
        let refuse = |what, found, accepted| {
            Err(AgentError::Batch { actor: batch.header.actor, what, found, accepted })
        };
        let answers = usize::from(self.mentor.is_some());
        match observed {
            _ if usize::from(observed.is_some()) != answers => {
                refuse("the number of the mentor-server's answers", usize::from(observed.is_some()), answers)
            }
            Some(observed) if observed.mentor.len() != batch.len() => {
                refuse("the number of mentor indices", observed.mentor.len(), batch.len())
            }
            _ => Ok(()),
        }
    }

    /// Shows the selection rule, if it wants them, the values of the entries from global index `first` on that have a mentor
    /// transition, under the present weights.
    fn value_stored(&mut self, first: u64) -> Result<(), AgentError> {
        let Some(mentor) = self.mentor.as_mut().filter(|mentor| mentor.selection.values_stored()) else {
            return Ok(());
        };
        // A batch may be longer than the replay; only its end is stored then.
        let Self { settings, encoding, replay, step, .. } = self;
        let mut index = first.max(replay.first_index());
        while index < replay.next_index() {
            let from =
                Sources { settings, encoding, replay, mentor: Some(&*mentor), shown: Shown::default() };
            step.samples.clear();
            while index < replay.next_index() && !step.samples.is_full() {
                let slot = replay.slot(index);
                index += 1;
                if let Some(j) = replay.get(slot).mentor {
                    step.samples.add(slot, Some(j), &from);
                }
            }
            step.samples.forward(&self.network, &mut step.workspace)?;
            step.samples.each_with_mentor(|own, candidate| mentor.selection.valued(own, candidate));
        }
        Ok(())
    }
}
