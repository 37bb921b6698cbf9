//! Gradient steps: those that are due, one after the other.

use super::{Agent, AgentError, TrainStats};
use crate::rivals::{Rival, Shown};
use trestle_proto::config::TargetKind;
use trestle_proto::mentor::MentorTransitions;
use trestle_proto::schedule::{gradient_steps_due, guides};
use trestle_qnet::clip_grad_norm;

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
        let guides = guides(&self.settings.exploration, to);
        for _ in 0..due {
            self.gradient_step(&mut stats)?;
            if let Some(rival) = &mut self.rival {
                let transitions = self.mentor.as_ref().map(|mentor| &mentor.transitions);
                let labelled = rival.learn(&self.replay, transitions);
                let len = transitions.filter(|_| labelled).map_or(0, MentorTransitions::len);
                (0..len).for_each(|j| self.renew_annotated(j));
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

    /// Draw, forward, choose, backward, Adam, target.
    pub(super) fn gradient_step(&mut self, stats: &mut TrainStats) -> Result<(), AgentError> {
        let (settings, step) = (&self.settings, &mut self.step);
        step.draw(&self.replay, self.mentor.as_ref(), settings.draw, &mut self.rng, settings.learner.batch);
        step.collect(&self.replay, self.mentor.as_ref(), &settings.rule, &self.encoding);
        if let Some(rival) = &mut self.rival {
            rival.prepare(&self.replay, step.slots(), settings.learner.n_step);
        }
        let shown = self.rival.as_ref().map_or_else(Shown::default, Rival::shown);
        if let Some(view) = shown.view {
            step.look(view, &self.encoding);
        }
        step.forward_values(&self.network)?;
        step.choose(&self.replay, self.mentor.as_ref(), shown, settings, &self.encoding, stats);
        if let Some(mentor) = &mut self.mentor {
            step.count_used(&mut mentor.used);
            step.each_with_mentor(|own, candidate| mentor.selection.trained(own, candidate));
        }
        step.forward_targets(&self.network, settings)?;
        step.differentiate(&self.network, settings, stats)?;
        if let (Some(imitation), Some(own)) = (&mut self.imitation, &self.own)
            && let Some(loss) = imitation.add_gradient(&self.network, &self.encoding, own, &mut step.grad)?
        {
            stats.imitation_steps += 1;
            stats.imitation_loss_sum += loss;
        }

        let (adam, grad) = (&mut self.adam, &mut step.grad);
        let (kernels, max_norm) = (step.workspace.kernels(), settings.learner.max_grad_norm as f32);
        self.network.update(|params| {
            if max_norm > 0.0 {
                stats.grad_norm_sum += f64::from(clip_grad_norm(kernels, grad, max_norm));
            }
            adam.step(&settings.adam, kernels, params, grad);
        })?;
        self.counters.grad_steps += 1;
        match settings.learner.target {
            TargetKind::Hard if self.counters.grad_steps.is_multiple_of(settings.learner.target_every) => {
                self.network.hard_update()?;
            }
            TargetKind::Hard => {}
            TargetKind::Polyak => self.network.polyak_update(settings.tau)?,
        }
        stats.grad_steps += 1;
        Ok(())
    }
}
