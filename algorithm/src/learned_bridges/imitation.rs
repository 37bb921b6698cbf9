//! How the Q-network imitates own paths: the large-margin loss of DQfD (Hester et al. 2018), on what the observer has itself walked
//! to success and on nothing of the mentor's.
//!
//! For steps (s, a) drawn uniformly from all own paths the loss is
//!
//! ```text
//! λ mean( max_b [ Q(s, b) + margin [b != a] ] - Q(s, a) )
//! ```
//!
//! What was walked once can be done again, so an own path's return is a lower bound of what its states are worth. Once the path has been
//! learnt, a step counts only as far as no value exceeds that by more than the margin: else there is something better to be learnt,
//! and the loss would hold it down for ever.

use super::own::OwnPaths;
use rand::Rng;
use trestle_proto::rng::Stream;
use trestle_qnet::{
    AlignedBuffer, Encoding, Kernels, Layout, NetworkError, QNetwork, Workspace, backward_outputs,
    forward_train,
};

/// How own paths are imitated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImitationConfig {
    /// λ, above 0.
    pub weight: f32,
    /// The margin, 0 or more.
    pub margin: f32,
    /// Steps drawn for each gradient step, 1 or more.
    pub batch: usize,
}

/// Draws steps of own paths and computes the gradient of their loss. Memory is allocated once.
#[derive(Debug)]
pub struct Imitation {
    config: ImitationConfig,
    layout: Layout,
    rng: Stream,
    /// The action of each step of the batch, and the most that a value may be for the step to count.
    steps: Vec<(usize, f32)>,
    workspace: Workspace,
    x: Vec<f32>,
    /// Outputs of the network, then the loss's derivatives by them.
    outputs: Vec<f32>,
    grad: AlignedBuffer,
}

impl Imitation {
    /// For a Q-network of `layout`. `rng` draws steps.
    pub fn new(layout: Layout, config: ImitationConfig, rng: Stream, kernels: Kernels) -> Self {
        Self {
            rng,
            steps: Vec::with_capacity(config.batch),
            workspace: Workspace::with_kernels(&layout, config.batch, kernels),
            x: vec![0.0; config.batch * layout.input()],
            outputs: vec![0.0; config.batch * layout.output()],
            grad: AlignedBuffer::new(layout.n_params()),
            layout,
            config,
        }
    }

    /// The stream that draws steps.
    pub fn rng(&self) -> &Stream {
        &self.rng
    }

    /// Goes on drawing from `rng`.
    pub fn restore(&mut self, rng: &Stream) {
        self.rng.clone_from(rng);
    }

    /// Adds the gradient of the loss of a batch of steps of `own` under the online parameters of `network` to `grad`. `all` steps count,
    /// or only those in which no value exceeds their return by more than the margin. Returns the loss; none without an own path, when
    /// nothing is drawn.
    ///
    /// # Errors
    /// The parameters cannot be had.
    pub fn add_gradient(
        &mut self,
        network: &QNetwork,
        encoding: &Encoding,
        own: &OwnPaths,
        all: bool,
        grad: &mut [f32],
    ) -> Result<Option<f64>, NetworkError> {
        let n = own.steps();
        if n == 0 {
            return Ok(None);
        }
        let Self { config, layout, rng, steps, workspace, x, outputs, grad: added } = self;
        steps.clear();
        for row in x.chunks_exact_mut(layout.input()) {
            // Below the number of steps.
            let Some((state, action, value)) = own.step(rng.random_range(0..n)) else { continue };
            encoding.encode(state, row);
            let most = value.filter(|_| !all).map_or(f32::INFINITY, |value| value + config.margin);
            steps.push((action as usize, most));
        }
        let loss = network.with_params(|online, _| {
            forward_train(layout, online, x, config.batch, workspace, outputs);
            let scale = config.weight / config.batch as f32;
            let mut sum = 0.0;
            for (q, &(action, most)) in outputs.chunks_exact_mut(layout.output()).zip(&*steps) {
                if q.iter().any(|&value| value > most) {
                    q.fill(0.0);
                } else {
                    sum += f64::from(differentiate(q, action, config.margin, scale));
                }
            }
            backward_outputs(layout, online, workspace, outputs, added);
            sum
        })?;
        grad.iter_mut().zip(added.iter()).for_each(|(grad, added)| *grad += added);
        Ok(Some(f64::from(config.weight) * loss / config.batch as f64))
    }
}

/// The loss of the values `q` with the own `action`; they become its derivatives by them, times `scale`.
fn differentiate(q: &mut [f32], action: usize, margin: f32, scale: f32) -> f32 {
    let (mut best, mut most) = (action, q[action]);
    for (other, &value) in q.iter().enumerate() {
        if other != action && value + margin > most {
            (best, most) = (other, value + margin);
        }
    }
    let loss = most - q[action];
    q.fill(0.0);
    if best != action {
        q[best] = scale;
        q[action] = -scale;
    }
    loss
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::learned_bridges::Goal;
    use crate::replay::Replay;
    use proptest::prelude::*;
    use rand::SeedableRng;
    use trestle_proto::NONE;
    use trestle_proto::acting::Room;
    use trestle_proto::batch::{FIRST, TERMINATED, Transition};

    /// The loss from the definition.
    fn naive(q: &[f32], action: usize, margin: f32) -> f32 {
        let raised = q.iter().enumerate().map(|(b, q)| q + if b == action { 0.0 } else { margin });
        raised.fold(f32::NEG_INFINITY, f32::max) - q[action]
    }

    proptest! {
        #[test]
        fn derivatives_are_those_of_the_loss(
            q in prop::collection::vec(-2.0f32..2.0, 2..6), own in any::<prop::sample::Index>(), margin in 0.0f32..1.0,
        ) {
            let action = own.index(q.len());
            let mut row = q.clone();
            let loss = differentiate(&mut row, action, margin, 0.5);
            prop_assert!((loss - naive(&q, action, margin)).abs() < 1e-6 && loss >= 0.0);
            for at in 0..q.len() {
                let moved = |by: f32| {
                    let mut q = q.clone();
                    q[at] += by;
                    naive(&q, action, margin)
                };
                let (left, right) = ((loss - moved(-1e-3)) / 1e-3, (moved(1e-3) - loss) / 1e-3);
                // At a kink either side will do.
                let error = (row[at] / 0.5 - left).abs().min((row[at] / 0.5 - right).abs());
                prop_assert!(error < 1e-2, "{}: {} {} {}", at, row[at], left, right);
            }
        }
    }

    /// The own path is one step by action 0, with return 0.5.
    #[test]
    fn a_step_is_left_alone_where_something_is_better() {
        let layout = Layout::new(&[1, 2]).unwrap();
        let encoding = Encoding::Scale { low: vec![-1.0], high: vec![1.0] };
        let goal = Goal::new(encoding.clone(), &[0], &[1.0]);
        let room = Room { dim: 1, paths: 1, places: 5 };
        let mut own = OwnPaths::new(goal, room, 0.5, std::iter::empty());
        let mut replay = Replay::new(4, 1).unwrap();
        let (obs, next_obs, flags) = (&[0.0][..], &[1.0][..], FIRST | TERMINATED);
        replay.push(&Transition { obs, next_obs, action: 0, reward: 0.5, flags }, 0, NONE);
        assert!(own.take(&replay, 0, 1, Some(true), 0.9));
        let config = ImitationConfig { weight: 1.0, margin: 0.125, batch: 4 };
        let rng = Stream::seed_from_u64(1);
        let mut imitation = Imitation::new(layout.clone(), config, rng, Kernels::detect());
        let mut trained = |values: [f32; 2], all: bool| {
            // The only feature is 0, so that biases are values.
            let network = QNetwork::new(layout.clone(), &[0.0, 0.0, values[0], values[1]]).unwrap();
            let mut grad = vec![0.0; 4];
            let loss = imitation.add_gradient(&network, &encoding, &own, all, &mut grad).unwrap().unwrap();
            (loss, [grad[2], grad[3]])
        };
        for all in [true, false] {
            assert_eq!(trained([0.25, 0.5], all), (0.375, [-1.0, 1.0]));
        }
        assert_eq!(trained([0.25, 0.75], true), (0.625, [-1.0, 1.0]));
        assert_eq!(trained([0.25, 0.75], false), (0.0, [0.0, 0.0]));
    }
}
