//! Which mentor states are similar to a state: KL up to `e_th`, exactly.
//!
//! Mentor states never change, so the index is built once. All states are in it, also the last of each trajectory:
//! they begin no transition, but a bridge may end there.

use crate::demonstration::Order;
use crate::metric::kl;
use crate::tree::Tree;

/// A mentor state that is similar to the state asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Number of the mentor state.
    pub state: u32,
    /// Its KL divergence, up to `e_th`.
    pub kl: f32,
}

/// The index of a demonstration's states.
#[derive(Clone, Debug)]
pub struct Similarity {
    dim: usize,
    e_th: f32,
    whitened: Vec<f32>,
    tree: Tree,
}

impl Similarity {
    /// Indexes `whitened` mentor states (row-major, `dim` features, at least one).
    pub fn new(whitened: Vec<f32>, dim: usize, e_th: f32) -> Self {
        let tree = Tree::new(&whitened, dim);
        Self { dim, e_th, whitened, tree }
    }

    /// States are similar up to this KL divergence.
    pub fn e_th(&self) -> f32 {
        self.e_th
    }

    /// Mentor state `m`, whitened.
    pub fn state(&self, m: usize) -> &[f32] {
        &self.whitened[m * self.dim..][..self.dim]
    }

    /// Fills `hits` with all mentor states similar to the whitened `state`, in ascending order. `stack` is working
    /// memory.
    pub fn states(&self, state: &[f32], stack: &mut Vec<u32>, hits: &mut Vec<Hit>) {
        hits.clear();
        self.tree.candidates(state, self.e_th, stack, |m| {
            let kl = kl(state, self.state(m));
            if kl <= self.e_th {
                hits.push(Hit { state: m as u32, kl });
            }
        });
        hits.sort_unstable_by_key(|hit| hit.state);
    }
}

/// The transitions that begin in one of `hits`, each with the KL divergence of its first state, in the order of `hits`.
pub fn transitions<'a>(hits: &'a [Hit], order: &'a Order) -> impl Iterator<Item = (usize, f32)> + 'a {
    hits.iter().filter_map(|hit| Some((order.transition_of(hit.state as usize)?, hit.kl)))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::demonstration::Demonstration;
    use proptest::prelude::*;

    #[test]
    fn last_states_are_found_but_begin_nothing() {
        let mut demo = Demonstration::new(vec!["x".into()]).unwrap();
        demo.push_trajectory(&[0.0, 1.0], true).unwrap();
        demo.push_trajectory(&[1.0, 0.0], true).unwrap();
        let index = Similarity::new(demo.states().to_vec(), 1, 0.5);
        let (mut hits, order) = (Vec::new(), demo.order());
        index.states(&[0.25], &mut Vec::new(), &mut hits);
        assert_eq!(hits.iter().map(|h| h.state).collect::<Vec<_>>(), [0, 1, 2, 3]);
        assert_eq!(transitions(&hits, &order).collect::<Vec<_>>(), [(0, 0.03125), (1, 0.28125)]);
        index.states(&[2.5], &mut Vec::new(), &mut hits);
        assert_eq!(hits, []);
    }

    proptest! {
        #[test]
        fn equals_a_scan(
            grid in proptest::collection::vec((0u8..5, 0u8..5), 1..60),
            query in (-1.0f32..6.0, -1.0f32..6.0),
            e_th in 0.0f32..2.0,
        ) {
            let states: Vec<f32> = grid.iter().flat_map(|&(x, y)| [f32::from(x), f32::from(y)]).collect();
            let query = [query.0, query.1];
            let expected: Vec<Hit> = states
                .chunks_exact(2)
                .enumerate()
                .map(|(m, s)| Hit { state: m as u32, kl: kl(&query, s) })
                .filter(|hit| hit.kl <= e_th)
                .collect();
            let mut hits = vec![Hit { state: 9, kl: 9.0 }];
            Similarity::new(states, 2, e_th).states(&query, &mut Vec::new(), &mut hits);
            prop_assert_eq!(hits, expected);
        }
    }
}
