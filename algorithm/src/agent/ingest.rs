//! Taking transitions in: limits, counts, episodes, annotations, the replay and its first past values.

use super::{Agent, AgentError, Counters, Episode, Running};
use trestle_proto::NONE;
use trestle_proto::annotation::record_words;
use trestle_proto::batch::Batch;
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
    /// A batch or an answer that does not fit the experiment. Nothing of the batch has been stored then.
    pub fn ingest(&mut self, batch: &Batch, observed: Option<&Observed>) -> Result<Ingested, AgentError> {
        self.check_batch(batch, observed)?;
        if let (Some(mentor), Some(observed)) = (&mut self.mentor, observed) {
            mentor.annotations.apply(&observed.changed)?;
            mentor.searches_cut_short += u64::from(observed.cut_short);
            for record in observed.changed.chunks_exact(record_words(self.replay.obs_dim())) {
                self.renew_annotated(record[0] as usize);
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
                    own.publish(&mut self.acting.own);
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

    fn check_batch(&self, batch: &Batch, observed: Option<&Observed>) -> Result<(), AgentError> {
        let actor = batch.header.actor;
        let refuse =
            |what, found: usize, accepted: String| Err(AgentError::Batch { actor, what, found, accepted });
        if actor as usize >= self.running.len() {
            return refuse("the actor", actor as usize, format!("below {}", self.running.len()));
        }
        if batch.obs_dim() != self.replay.obs_dim() {
            let accepted = self.replay.obs_dim().to_string();
            return refuse("the number of features", batch.obs_dim(), accepted);
        }
        let n_actions = self.settings.n_actions;
        if let Some(&action) = batch.actions().iter().find(|&&action| action as usize >= n_actions) {
            return refuse("an action", action as usize, format!("below {n_actions}"));
        }
        match (&self.mentor, observed) {
            (None, None) => Ok(()),
            (Some(mentor), Some(observed)) => {
                if observed.mentor.len() != batch.len() {
                    let accepted = batch.len().to_string();
                    return refuse("the number of mentor indices", observed.mentor.len(), accepted);
                }
                let len = mentor.transitions.len();
                match observed.mentor.iter().find(|&&j| j != NONE && j as usize >= len) {
                    Some(&j) => refuse("a mentor index", j as usize, format!("below {len}, or none")),
                    None => Ok(()),
                }
            }
            (mentor, observed) => {
                let accepted = u8::from(mentor.is_some()).to_string();
                refuse("the number of the mentor-server's answers", observed.iter().count(), accepted)
            }
        }
    }

    /// Shows the selection rule, if it wants them, the values of the entries from global index `first` on that have a mentor
    /// transition, under the present weights.
    fn value_stored(&mut self, first: u64) -> Result<(), AgentError> {
        let Some(mentor) = self.mentor.as_mut().filter(|mentor| mentor.selection.values_stored()) else {
            return Ok(());
        };
        // A batch may be longer than the replay; only its end is stored then.
        let (step, replay) = (&mut self.step, &self.replay);
        let mut index = first.max(replay.first_index());
        while index < replay.next_index() {
            step.clear();
            while index < replay.next_index() && !step.is_full() {
                let slot = replay.slot(index);
                index += 1;
                if let Some(j) = replay.get(slot).mentor {
                    step.add(slot, Some(j), replay, Some(&*mentor), &self.settings.rule, &self.encoding);
                }
            }
            step.forward_values(&self.network)?;
            step.each_with_mentor(|own, candidate| mentor.selection.valued(own, candidate));
        }
        Ok(())
    }
}
