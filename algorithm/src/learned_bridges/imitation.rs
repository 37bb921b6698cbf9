//! How the Q-network imitates own paths: the large-margin loss of DQfD (Hester et al. 2018), on what the observer has itself walked
//! to success and on nothing of the mentor's.
//!
//! For n steps (s, a) drawn uniformly from all own paths, and for the states that a [`Correction`] adds, the loss is
//!
//! ```text
//! λ / n sum( w [ max_b ( Q(s, b) + margin [b != a] ) - Q(s, a) ] )
//! ```
//!
//! w is 1 for a step of an own path, and the correction's weight otherwise.

use super::correction::Correction;
use super::own::OwnPaths;
use crate::replay::Replay;
use rand::Rng;
use trestle_proto::acting::OwnPlaces;
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
    correction: Option<Correction>,
    layout: Layout,
    rng: Stream,
    /// Action and weight w of each state of a step.
    imitated: Vec<(usize, f32)>,
    workspace: Workspace,
    x: Vec<f32>,
    /// Outputs of the network, then the loss's derivatives by them.
    outputs: Vec<f32>,
    grad: AlignedBuffer,
}

impl Imitation {
    /// For a Q-network of `layout`. `rng` draws steps. A `correction` may add up to as many states as there are steps.
    pub fn new(
        layout: Layout,
        config: ImitationConfig,
        correction: Option<Correction>,
        rng: Stream,
        kernels: Kernels,
    ) -> Self {
        let rows = config.batch * if correction.is_some() { 2 } else { 1 };
        Self {
            rng,
            imitated: Vec::with_capacity(rows),
            workspace: Workspace::with_kernels(&layout, rows, kernels),
            x: vec![0.0; rows * layout.input()],
            outputs: vec![0.0; rows * layout.output()],
            grad: AlignedBuffer::new(layout.n_params()),
            correction,
            layout,
            config,
        }
    }

    /// Own paths are these from now on.
    pub fn renew(&mut self, own: &OwnPlaces) {
        if let Some(correction) = &mut self.correction {
            correction.renew(own);
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

    /// Adds the gradient of the loss of a batch of steps of `own` under the online parameters of `network` to `grad`. A correction
    /// draws from `replay` and asks the guide's policy, whose parameters are `policy`. Returns the loss; none without an own path,
    /// when nothing is drawn.
    ///
    /// # Errors
    /// The parameters cannot be had.
    pub fn add_gradient(
        &mut self,
        (network, encoding): (&QNetwork, &Encoding),
        own: &OwnPaths,
        (replay, policy): (&Replay, &[f32]),
        grad: &mut [f32],
    ) -> Result<Option<f64>, NetworkError> {
        let steps = own.steps();
        if steps == 0 {
            return Ok(None);
        }
        let Self { config, correction, layout, rng, imitated, workspace, x, outputs, grad: added } = self;
        imitated.clear();
        let mut rows = x.chunks_exact_mut(layout.input());
        for row in rows.by_ref().take(config.batch) {
            // Below the number of steps.
            let Some((state, action)) = own.step(rng.random_range(0..steps)) else { continue };
            encoding.encode(state, row);
            imitated.push((action as usize, 1.0));
        }
        if let Some(correction) = correction {
            let weight = correction.config().weight;
            let corrected = correction.draw(config.batch, replay, policy, rng);
            for (&(slot, action), row) in corrected.iter().zip(rows) {
                encoding.encode_row(replay.obs(slot), row);
                imitated.push((action as usize, weight));
            }
        }
        let rows = imitated.len();
        let (x, outputs) = (&x[..rows * layout.input()], &mut outputs[..rows * layout.output()]);
        let loss = network.with_params(|online, _| {
            forward_train(layout, online, x, rows, workspace, outputs);
            let scale = config.weight / config.batch as f32;
            let mut sum = 0.0;
            for (q, &(action, weight)) in outputs.chunks_exact_mut(layout.output()).zip(&*imitated) {
                sum += f64::from(weight * differentiate(q, action, config.margin, scale * weight));
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
    use super::*;
    use proptest::prelude::*;

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
}
