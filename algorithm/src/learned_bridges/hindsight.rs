//! How π is learnt: from what the observer did, taken for what it wanted.
//!
//! A sample is a stored transition (s_t, a_t), drawn uniformly, and the state h steps later in the same episode as its
//! goal, h uniform in 1 to the horizon, or to what is stored of the episode. The loss is the cross-entropy
//! -ln π(a_t | s_t, s_(t+h)), the mean of a batch. A short horizon matters: over many steps the first action says little
//! about where a walk ends.

use super::goal::{Goal, softmax};
use crate::replay::Replay;
use rand::Rng;
use serde::{Deserialize, Serialize};
use trestle_proto::rng::Stream;
use trestle_qnet::{
    Adam, AdamConfig, AlignedBuffer, Kernels, Layout, Workspace, backward_outputs, forward_train,
};

/// How π is learnt.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HindsightConfig {
    /// Samples of an update, 1 or more.
    pub batch: usize,
    /// Most steps between a state and its goal, 1 or more.
    pub horizon: usize,
    /// The optimiser.
    pub adam: AdamConfig,
}

/// All that a checkpoint has to keep of [`Hindsight`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HindsightState {
    /// The parameters of π's network.
    pub params: Vec<f32>,
    /// The optimiser.
    pub adam: Adam,
    /// The stream that draws samples.
    pub rng: Stream,
}

/// π, and all that learns it. Memory is allocated once.
#[derive(Debug)]
pub struct Hindsight {
    goal: Goal,
    layout: Layout,
    config: HindsightConfig,
    state: HindsightState,
    slots: Vec<u32>,
    /// Slot of each sample's state, and of the transition that ends in its goal.
    pairs: Vec<(usize, usize)>,
    path: Vec<usize>,
    place: Vec<f32>,
    wide: Vec<f32>,
    workspace: Workspace,
    x: Vec<f32>,
    /// Outputs of the network, then the loss's derivatives by them.
    outputs: Vec<f32>,
    grad: AlignedBuffer,
}

impl Hindsight {
    /// A policy with the parameters `params` over `layout`, whose input must be the goal's. `rng` draws samples.
    pub fn new(
        goal: Goal,
        layout: Layout,
        params: Vec<f32>,
        config: HindsightConfig,
        rng: Stream,
        kernels: Kernels,
    ) -> Self {
        debug_assert_eq!((goal.input_dim(), params.len()), (layout.input(), layout.n_params()));
        Self {
            slots: Vec::with_capacity(config.batch),
            pairs: Vec::with_capacity(config.batch),
            path: Vec::with_capacity(config.horizon),
            place: Vec::with_capacity(goal.dim()),
            wide: Vec::new(),
            workspace: Workspace::with_kernels(&layout, config.batch, kernels),
            x: vec![0.0; config.batch * layout.input()],
            outputs: vec![0.0; config.batch * layout.output()],
            grad: AlignedBuffer::new(layout.n_params()),
            state: HindsightState { adam: Adam::new(layout.n_params()), params, rng },
            goal,
            layout,
            config,
        }
    }

    /// The parameters of π's network, flat in the order of its layout.
    pub fn params(&self) -> &[f32] {
        &self.state.params
    }

    /// The network.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// What a checkpoint keeps.
    pub fn state(&self) -> &HindsightState {
        &self.state
    }

    /// Goes on as another one of the same layout did. Whether the state is one of this layout.
    #[must_use]
    pub fn restore(&mut self, state: &HindsightState) -> bool {
        let n = self.layout.n_params();
        let fits = [state.params.len(), state.adam.m.len(), state.adam.v.len()].iter().all(|&len| len == n);
        if fits {
            self.state.clone_from(state);
        }
        fits
    }

    /// One update from what `replay` holds. Returns the mean loss, in nats; none where nothing is stored.
    pub fn update(&mut self, replay: &Replay) -> Option<f64> {
        self.sample(replay);
        let loss = self.differentiate(replay)?;
        let (config, kernels, threads) =
            (&self.config.adam, self.workspace.kernels(), self.workspace.threads());
        self.state.adam.step(config, kernels, threads, &mut self.state.params, &self.grad);
        Some(loss)
    }

    /// Draws a batch of states and goals.
    fn sample(&mut self, replay: &Replay) {
        let Self { slots, pairs, path, config, state, .. } = self;
        replay.sample(&mut state.rng, config.batch, slots);
        pairs.clear();
        for &slot in &*slots {
            path.clear();
            path.extend(replay.path(slot as usize, config.horizon));
            let last = path[state.rng.random_range(0..path.len())];
            pairs.push((slot as usize, last));
        }
    }

    /// The gradient of the mean loss of the samples, and the loss itself.
    fn differentiate(&mut self, replay: &Replay) -> Option<f64> {
        let rows = self.pairs.len();
        if rows == 0 {
            return None;
        }
        let (width, n_actions) = (self.layout.input(), self.layout.output());
        for (&(slot, last), x) in self.pairs.iter().zip(self.x.chunks_exact_mut(width)) {
            self.place.clear();
            self.goal.place(replay.next_obs(last).wide(&mut self.wide), &mut self.place);
            self.goal.encode(replay.obs(slot).wide(&mut self.wide), &self.place, x);
        }
        let (params, x) = (&self.state.params, &self.x[..rows * width]);
        let outputs = &mut self.outputs[..rows * n_actions];
        forward_train(&self.layout, params, x, rows, &mut self.workspace, outputs);
        let (mut loss, scale) = (0.0, 1.0 / rows as f32);
        for (&(slot, _), row) in self.pairs.iter().zip(outputs.chunks_exact_mut(n_actions)) {
            softmax(row);
            let action = replay.get(slot).action as usize;
            // Below the smallest normal number the loss is capped; its derivative is exact.
            loss -= libm::log(f64::from(row[action].max(f32::MIN_POSITIVE)));
            row[action] -= 1.0;
            row.iter_mut().for_each(|x| *x *= scale);
        }
        backward_outputs(&self.layout, params, &mut self.workspace, outputs, &mut self.grad);
        Some(loss / rows as f64)
    }

    /// States and goals of the last batch, as slots.
    #[cfg(test)]
    pub(super) fn pairs(&self) -> &[(usize, usize)] {
        &self.pairs
    }

    /// The gradient of a batch that is drawn now, and its loss.
    #[cfg(test)]
    pub(super) fn gradient(&mut self, replay: &Replay) -> (f64, Vec<f32>) {
        self.sample(replay);
        (self.differentiate(replay).unwrap_or(f64::NAN), self.grad.to_vec())
    }
}
