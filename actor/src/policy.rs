//! The ε-greedy policy: from a flat parameter vector and one observation to an action.

use rand::RngCore;
use trestle_proto::rng::{Stream, below};
use trestle_qnet::{Encoding, Kernels, Layout, Workspace, argmax, forward};

/// The policy's network and scratch memory. The parameters are the caller's, so that new weights need no copy here.
pub struct Policy {
    layout: Layout,
    encoding: Encoding,
    workspace: Workspace,
    input: Vec<f32>,
    values: Vec<f32>,
}

impl Policy {
    /// A policy whose network has `layout` and sees observations through `encoding`; they must fit each other
    /// (`encoding.input_dim() == layout.input()`). All memory is allocated here.
    pub fn new(layout: Layout, encoding: Encoding, kernels: Kernels) -> Self {
        debug_assert_eq!(encoding.input_dim(), layout.input());
        Self {
            workspace: Workspace::with_kernels(&layout, 1, kernels),
            input: vec![0.0; layout.input()],
            values: vec![0.0; layout.output()],
            layout,
            encoding,
        }
    }

    /// Number of parameters that the network has.
    pub fn n_params(&self) -> usize {
        self.layout.n_params()
    }

    /// The action with the highest value in `obs` (`[obs_dim]`), the first one of several equal ones. `params` has
    /// [`Policy::n_params`] entries.
    ///
    /// # Panics
    /// If a slice has another length.
    pub fn greedy(&mut self, params: &[f32], obs: &[f32]) -> u32 {
        self.encoding.encode(obs, &mut self.input);
        forward(&self.layout, params, &self.input, 1, &mut self.workspace, &mut self.values);
        argmax(&self.values) as u32
    }

    /// With probability `epsilon` (0 to 1) an action drawn uniformly, otherwise the greedy one.
    ///
    /// Draws, in this order: one 64-bit word, whose upper 53 bits are a uniform number u in [0, 1); if u < ε, one
    /// 32-bit word w, and the action is ⌊w n / 2^32⌋ of n actions (uniform to within 2^-32). Nothing else is drawn,
    /// and an exploring step computes no values.
    ///
    /// # Panics
    /// As [`Policy::greedy`].
    pub fn act(&mut self, params: &[f32], obs: &[f32], epsilon: f64, rng: &mut Stream) -> u32 {
        self.act_guided(params, obs, epsilon, 0.0, rng, |_| None)
    }

    /// As [`Policy::act`], where an exploring step takes `guided`'s action with probability `guide` (0 to 1), if there
    /// is one. Between u and w it draws, where `guide` is above 0, a further word, a uniform number as u is, and
    /// then what `guided` itself draws; w is not drawn where the guide was followed.
    ///
    /// # Panics
    /// As [`Policy::greedy`].
    pub fn act_guided(
        &mut self,
        params: &[f32],
        obs: &[f32],
        epsilon: f64,
        guide: f64,
        rng: &mut Stream,
        guided: impl FnOnce(&mut Stream) -> Option<u32>,
    ) -> u32 {
        if unit(rng) >= epsilon {
            return self.greedy(params, obs);
        }
        if guide > 0.0
            && unit(rng) < guide
            && let Some(action) = guided(rng)
        {
            return action;
        }
        below(rng, self.layout.output()) as u32
    }
}

/// Uniform in [0, 1): the upper 53 bits of a word.
pub(crate) fn unit(rng: &mut Stream) -> f64 {
    (rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use trestle_proto::rng::{Purpose, stream};

    /// A policy over one feature in 0..=4 with three actions, and parameters that value action i at `bias[i]`.
    fn policy(bias: [f32; 3]) -> (Policy, Vec<f32>) {
        let encoding = Encoding::OneHot { low: vec![0.0], sizes: vec![5] };
        let policy = Policy::new(Layout::new(&[5, 3]).unwrap(), encoding, Kernels::detect());
        let mut params = vec![0.0; policy.n_params()];
        params[15..].copy_from_slice(&bias);
        (policy, params)
    }

    #[test]
    fn the_best_action_is_chosen_and_ties_go_to_the_first() {
        for (bias, best) in [([1.0, 2.0, 3.0], 2), ([2.0, 1.0, 2.0], 0), ([-1.0, 0.0, 0.0], 1)] {
            let (mut policy, params) = policy(bias);
            assert_eq!(policy.greedy(&params, &[2.0]), best);
        }
        let (mut policy, mut params) = policy([0.0; 3]);
        // Weights are [input][output]: feature 3 prefers action 1.
        params[3 * 3 + 1] = 1.0;
        assert_eq!((policy.greedy(&params, &[3.0]), policy.greedy(&params, &[2.0])), (1, 0));
    }

    #[test]
    fn draws_are_the_documented_ones() {
        let (mut policy, params) = policy([0.0, 0.0, 1.0]);
        let mut rng = stream(5, Purpose::Explore, 0);
        let mut oracle = rng.clone();
        let (mut explored, mut counts) = (0, [0; 3]);
        for i in 0..6000 {
            let epsilon = f64::from(i % 11) / 10.0;
            let mut expected = 2;
            if ((oracle.next_u64() >> 11) as f64) < epsilon * 2f64.powi(53) {
                expected = ((u64::from(oracle.next_u32()) * 3) >> 32) as u32;
                explored += 1;
                counts[expected as usize] += 1;
            }
            assert_eq!(policy.act(&params, &[1.0], epsilon, &mut rng), expected);
        }
        assert_eq!(rng, oracle);
        // ε is 1/2 in the mean: the standard deviations are about 32 and 26.
        assert!((2800..3200).contains(&explored), "{explored}");
        assert!(counts.iter().all(|&c| (840..1160).contains(&c)), "{counts:?}");
    }
}
