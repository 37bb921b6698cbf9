//! Gradient steps: those that are due, one after the other.

use super::{Agent, AgentError, TrainStats};
use trestle_proto::mentor::MentorTransitions;
use trestle_proto::schedule::{gradient_steps_due, guides};

impl Agent {
    /// Takes all gradient steps that are due since the last call, and renews [`Agent::acting`]. Calls `finished` after
    /// each of them: many may be due at once, and a supervisor wants signs of life meanwhile.
    ///
    /// # Errors
    /// The loss or a weight is no longer finite, or candle fails. The agent is of no use then.
    pub fn train(&mut self, mut finished: impl FnMut()) -> Result<TrainStats, AgentError> {
        let learner = &self.settings.learner;
        let (from, to) = (self.trained_to, self.counters.env_steps);
        let due = gradient_steps_due(from, to, learner.warmup, learner.train_every);
        self.trained_to = to;
        let mut stats = TrainStats::default();
        let searches = self.settings.search && self.own.as_ref().is_some_and(|own| own.steps() == 0);
        let guides = searches || guides(&self.settings.exploration, to);
        for _ in 0..due {
            self.gradient_step(&mut stats)?;
            if let Some(rival) = &mut self.rival {
                let transitions = self.mentor.as_ref().map(|mentor| &mentor.transitions);
                let labelled = rival.learn(&self.replay, transitions);
                let len = transitions.filter(|_| labelled).map_or(0, MentorTransitions::len);
                (0..len).for_each(|j| self.renew_annotated(j));
                if len > 0 {
                    self.renew_options();
                }
            }
            if let Some(hindsight) = self.hindsight.as_mut().filter(|_| guides)
                && let Some(loss) = hindsight.update(&self.replay)
            {
                stats.policy_steps += 1;
                stats.policy_loss_sum += loss;
            }
            finished();
        }
        if due > 0 {
            let weights = &mut self.acting.weights;
            self.network.with_params(|online, _| weights.copy_from_slice(online))?;
            if let Some(hindsight) = &self.hindsight {
                self.acting.policy.copy_from_slice(hindsight.params());
            }
            let grad_steps = self.counters.grad_steps;
            if !stats.loss_sum.is_finite() {
                return Err(AgentError::Diverged { what: "the loss", grad_steps });
            }
            if !stats.policy_loss_sum.is_finite() {
                return Err(AgentError::PolicyDiverged { grad_steps });
            }
            // Without a way out of the loop, so that it runs through whole registers.
            if !self.weights().iter().fold(true, |finite, w| finite & w.is_finite()) {
                return Err(AgentError::Diverged { what: "a weight", grad_steps });
            }
        }
        Ok(stats)
    }
}
