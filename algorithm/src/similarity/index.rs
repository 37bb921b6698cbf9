//! Which mentor states are similar to a state: KL up to `e_th`, exactly.
//!
//! Mentor states never change, so the index is built once. All states are in it, also the last of each trajectory:
//! they begin no transition, but a bridge may end there.

use super::metric::kl;
use super::tree::{Tree, WIDTH};
use std::sync::OnceLock;

/// Points of a leaf, at most: reading on costs less than another level of boxes, each of which is somewhere else.
const LEAF: usize = 32;

/// A mentor state that is similar to the state asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Number of the mentor state.
    pub state: u32,
    /// Its KL divergence, up to `e_th`.
    pub kl: f32,
}

/// The index of a demonstration's states. Memory: with `dim` features about 11 `dim` bytes and some a state, twice that once
/// [`Similarity::fine`] has been asked for.
#[derive(Clone, Debug)]
pub struct Similarity {
    dim: usize,
    e_th: f32,
    whitened: Vec<f32>,
    tree: Tree,
    /// With leaves of [`WIDTH`] points; most users of the index never need it.
    fine: OnceLock<Tree>,
}

impl Similarity {
    /// Indexes `whitened` mentor states (row-major, `dim` features, at least one).
    pub fn new(whitened: Vec<f32>, dim: usize, e_th: f32) -> Self {
        let tree = Tree::new(&whitened, dim, LEAF);
        Self { dim, e_th, whitened, tree, fine: OnceLock::new() }
    }

    /// States are similar up to this KL divergence.
    pub fn e_th(&self) -> f32 {
        self.e_th
    }

    /// A tree over the mentor states with small leaves: for walks that rule nodes out by numbers of their own.
    pub fn fine(&self) -> &Tree {
        self.fine.get_or_init(|| Tree::new(&self.whitened, self.dim, WIDTH))
    }

    /// Mentor state `m`, whitened.
    pub fn state(&self, m: usize) -> &[f32] {
        &self.whitened[m * self.dim..][..self.dim]
    }

    /// All mentor states, in an order in which near ones mostly stand together.
    pub fn near_together(&self) -> impl Iterator<Item = usize> {
        self.tree.in_order().iter().map(|&m| m as usize)
    }

    /// Fills `hits` with all mentor states similar to the whitened `state`, in ascending order. `stack` is working
    /// memory.
    pub fn states(&self, state: &[f32], stack: &mut Vec<u32>, hits: &mut Vec<Hit>) {
        hits.clear();
        self.each(state, stack, |hit| hits.push(hit));
        hits.sort_unstable_by_key(|hit| hit.state);
    }

    /// Calls `visit` with all mentor states similar to the whitened `state`, in no particular order. `stack` is working memory.
    pub fn each(&self, state: &[f32], stack: &mut Vec<u32>, mut visit: impl FnMut(Hit)) {
        self.tree.within(state, self.e_th, stack, |m, kl| visit(Hit { state: m as u32, kl }));
    }

    /// Calls `visit` with the mentor states of `among` that are similar to the whitened `state`, in their order.
    pub fn among(&self, state: &[f32], among: impl Iterator<Item = u32>, visit: impl FnMut(Hit)) {
        let each = among.map(|m| Hit { state: m, kl: kl(state, self.state(m as usize)) });
        each.filter(|hit| hit.kl <= self.e_th).for_each(visit);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::similarity::testing::{cases, points};
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(cases(256))]
        #[test]
        fn equals_a_scan(
            (dim, points) in points(2..90),
            e_th in prop_oneof![0.0f32..4.0, Just(0.0f32), Just(0.5f32), Just(1e25f32)],
        ) {
            // The last point asks.
            let (states, query) = points.split_at(points.len() - dim);
            let expected: Vec<Hit> = states
                .chunks_exact(dim)
                .enumerate()
                .map(|(m, s)| Hit { state: m as u32, kl: kl(query, s) })
                .filter(|hit| hit.kl <= e_th)
                .collect();
            let index = Similarity::new(states.to_vec(), dim, e_th);
            let (mut hits, mut stack) = (Vec::new(), Vec::new());
            index.states(query, &mut stack, &mut hits);
            prop_assert_eq!(&hits, &expected);
            hits.clear();
            index.among(query, 0..(states.len() / dim) as u32, |hit| hits.push(hit));
            prop_assert_eq!(&hits, &expected);
            // A state of the mentor's own is similar to itself.
            index.states(&states[..dim], &mut stack, &mut hits);
            let itself = Hit { state: 0, kl: 0.0 };
            prop_assert!(hits.contains(&itself));
        }
    }
}
