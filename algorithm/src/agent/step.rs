//! One gradient step, in the order of the equations. [`Samples`] and [`Terms`] are its vocabulary.

use super::samples::{Samples, Sources};
use super::terms::Terms;
use super::{Agent, AgentError, TrainStats};
use crate::learned_bridges::Hindsight;
use crate::rivals::Shown;
use trestle_proto::config::{Backend, TargetKind};
use trestle_qnet::{AlignedBuffer, Kernels, Layout, Threads, Workspace, backward, clip_grad_norm};

/// The memory of a gradient step, allocated once.
#[derive(Debug)]
pub(super) struct Step {
    pub(super) samples: Samples,
    pub(super) terms: Terms,
    /// What a forward pass leaves for the gradient.
    pub(super) workspace: Workspace,
    /// g.
    pub(super) gradient: AlignedBuffer,
}

impl Step {
    /// Memory for batches of up to `batch` samples, which `threads` share.
    pub(super) fn new(layout: &Layout, batch: usize, kernels: Kernels, threads: Threads) -> Self {
        Self {
            samples: Samples::new(layout, batch),
            terms: Terms::new(layout, batch),
            workspace: Workspace::with_kernels(layout, 2 * batch, kernels).with_threads(threads),
            gradient: AlignedBuffer::new(layout.n_params()),
        }
    }
}

impl Agent {
    /// One gradient step.
    pub(super) fn gradient_step(&mut self, stats: &mut TrainStats) -> Result<(), AgentError> {
        self.differentiate(stats)?;
        self.descend()?;
        self.follow()?;
        stats.grad_steps += 1;
        Ok(())
    }

    /// g = ∂/∂θ of the mean over the samples of w_o L_o + w_m L_m.
    pub(super) fn differentiate(&mut self, stats: &mut TrainStats) -> Result<(), AgentError> {
        let Self { settings, encoding, replay, network, mentor, rival, rng, .. } = self;
        let Step { samples, terms, workspace, gradient } = &mut self.step;
        let (shown, mentors) = (Shown::default(), mentor.as_ref());
        let mut from = Sources { settings, encoding, replay, mentor: mentors, shown };

        // (s_o, a_o, r_o, s'_o) from the replay, and the mentor transition that belongs to each.
        samples.draw(&from, rng);
        samples.count(stats);
        // A rival of ours may add to rewards, or put other states in the place of these.
        if let Some(rival) = rival {
            rival.prepare(replay, samples.slots(), settings.learner.n_step);
            from.shown = rival.shown();
        }
        if let Some(view) = from.shown.view {
            samples.look(view, encoding);
        }
        // Q(s_o, a; θ) and Q(s_m, a; θ).
        samples.forward(network, workspace)?;
        // L_o of (2) and L_m of (3) or (6), with the weights that the selection rule gives them.
        terms.choose(samples, &from);
        if let Some(mentor) = mentor {
            terms.count_used(&mut mentor.used);
            samples.each_with_mentor(|own, candidate| mentor.selection.trained(own, candidate));
        }
        // y = r + γ max_a' Q(s', a'; θ⁻).
        terms.targets(samples, network, settings, workspace)?;
        // w ∂ℓ(Q, y)/∂Q, and from there back to θ.
        let dq = terms.row_gradients(samples, settings, stats);
        match settings.learner.backend {
            Backend::Kernels => {
                network.with_params(|theta, _| backward(network.layout(), theta, workspace, dq, gradient))?;
            }
            Backend::Candle => gradient.copy_from_slice(&terms.autodiff(samples, network, settings)?),
        }
        // Imitation of own paths (ours) adds its share.
        let policy = self.hindsight.as_ref().map_or(&[][..], Hindsight::params);
        if let (Some(imitation), Some(own)) = (&mut self.imitation, &self.own)
            && let Some(loss) =
                imitation.add_gradient((network, encoding), own, (replay, policy), gradient)?
        {
            stats.imitation_steps += 1;
            stats.imitation_loss_sum += loss;
        }
        Ok(())
    }

    /// θ by one step of Adam against g, whose norm may be clipped.
    fn descend(&mut self) -> Result<(), AgentError> {
        let (adam, settings, gradient) = (&mut self.adam, &self.settings, &mut self.step.gradient);
        let (kernels, threads) = (self.step.workspace.kernels(), self.step.workspace.threads());
        let max_norm = settings.learner.max_grad_norm as f32;
        self.network.update(|theta| {
            if max_norm > 0.0 {
                clip_grad_norm(kernels, gradient, max_norm);
            }
            adam.step(&settings.adam, kernels, threads, theta, gradient);
        })?;
        self.counters.grad_steps += 1;
        Ok(())
    }

    /// θ⁻ follows θ: by a share τ, or all at once every so many steps.
    fn follow(&mut self) -> Result<(), AgentError> {
        let learner = &self.settings.learner;
        match learner.target {
            TargetKind::Polyak => {
                self.network.polyak_update(self.settings.tau, self.step.workspace.threads())?
            }
            TargetKind::Hard if self.counters.grad_steps.is_multiple_of(learner.target_every) => {
                self.network.hard_update()?;
            }
            TargetKind::Hard => {}
        }
        Ok(())
    }
}
