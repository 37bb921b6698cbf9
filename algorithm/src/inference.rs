//! Action inference: for every mentor transition, the observer transition that came closest so far (paper, Fig. 1;
//! the scan of all pairs is replaced by an exact index).
//!
//! The error of an observer transition (s, s') for a mentor transition (s_m, s'_m) is, by metric:
//!
//! - `kl` (the paper's): e = KL(s, s_m) + KL(s', s'_m);
//! - `delta` (our choice): where KL(s, s_m) is up to `e_th`, the KL divergence of the changes s' - s and s'_m - s_m,
//!   taken after whitening; no comparison elsewhere.
//!
//! A smaller error replaces action, error and reward. At exactly the same error the higher reward replaces action and
//! reward (our choice). What is left is a function of the observer transitions in their order.
//!
//! For `kl` the pairs (s_m, s'_m) are points of a [`Tree`], and each of its nodes knows the largest error below it: a
//! node whose box is farther away than that cannot improve anywhere. So the search gets cheaper as errors fall.

use crate::demonstration::Order;
use crate::demonstration::transitions;
use crate::similarity::Hit;
use crate::similarity::tree::{Tree, WIDTH};
use trestle_proto::annotation::{AnnotationTable, Estimate};
use trestle_proto::config::MetricKind;

/// An observer transition, as inference sees it.
#[derive(Clone, Copy, Debug)]
pub struct Observation<'a> {
    /// s, whitened.
    pub state: &'a [f32],
    /// s', whitened.
    pub next: &'a [f32],
    /// The mentor states similar to s.
    pub similar: &'a [Hit],
    /// The action.
    pub action: u32,
    /// The reward.
    pub reward: f32,
}

/// The index of a demonstration's transitions.
#[derive(Clone, Debug)]
pub struct Inference {
    dim: usize,
    rule: Rule,
    /// Working memory: nodes to visit, and the observer's states side by side.
    stack: Vec<u32>,
    pair: Vec<f32>,
}

#[derive(Clone, Debug)]
enum Rule {
    Kl {
        /// Over s_m and s'_m side by side.
        tree: Tree,
        /// The largest error below each node.
        worst: Vec<f32>,
    },
    Delta {
        /// s'_m - s_m of each transition.
        changes: Vec<f32>,
    },
}

impl Inference {
    /// Indexes the transitions of `order` over `whitened` mentor states (row-major, `dim` features).
    pub fn new(metric: MetricKind, whitened: &[f32], dim: usize, order: &Order) -> Self {
        let ends = |j: usize| whitened[order.state_of(j) * dim..][..2 * dim].split_at(dim);
        let rule = match metric {
            MetricKind::Kl => {
                let pairs: Vec<f32> =
                    (0..order.n_transitions()).flat_map(|j| [ends(j).0, ends(j).1].concat()).collect();
                // Small leaves: the largest error of a leaf rules it out, and falls with all of its points alone.
                let tree = Tree::new(&pairs, 2 * dim, WIDTH);
                let worst = vec![f32::INFINITY; tree.n_nodes()];
                Rule::Kl { tree, worst }
            }
            MetricKind::Delta => {
                let change = |j| ends(j).1.iter().zip(ends(j).0).map(|(b, a)| b - a).collect::<Vec<_>>();
                Rule::Delta { changes: (0..order.n_transitions()).flat_map(change).collect() }
            }
        };
        Self { dim, rule, stack: Vec::new(), pair: Vec::new() }
    }

    /// Takes over errors that were found elsewhere: one for each mentor transition.
    pub fn restore(&mut self, errors: &[f32]) {
        let Rule::Kl { tree, worst, .. } = &mut self.rule else { return };
        // Parents come before their children.
        for at in (0..worst.len()).rev() {
            worst[at] = worst_of(tree, worst, errors, at);
        }
    }

    /// Compares an observer transition with every mentor transition and improves `table`. `improved` is called with
    /// the number of each estimate that was replaced, its former error and its new one.
    pub fn observe(
        &mut self,
        seen: &Observation<'_>,
        order: &Order,
        table: &mut AnnotationTable,
        mut improved: impl FnMut(usize, f32, f32),
    ) {
        let dim = self.dim;
        match &mut self.rule {
            Rule::Kl { tree, worst } => {
                self.pair.clear();
                self.pair.extend_from_slice(seen.state);
                self.pair.extend_from_slice(seen.next);
                self.stack.clear();
                self.stack.push(0);
                while let Some(at) = self.stack.pop() {
                    let at = at as usize;
                    let children = tree.children(at);
                    if !children.is_empty() {
                        for (child, bound) in children.zip(tree.lower_bounds(at, &self.pair)) {
                            if bound <= worst[child] {
                                self.stack.push(child as u32);
                            }
                        }
                        continue;
                    }
                    let mut has_fallen = false;
                    for (group, numbers) in tree.numbers(at).chunks(WIDTH).enumerate() {
                        let errors = tree.kl(at, group, 0, seen.state).into_iter();
                        let errors = errors.zip(tree.kl(at, group, dim, seen.next));
                        for (&j, (first, second)) in numbers.iter().zip(errors) {
                            let (j, error) = (j as usize, first + second);
                            let before = table.errors()[j];
                            if improve(table, j, error, seen) {
                                improved(j, before, error);
                                has_fallen |= before == worst[at];
                            }
                        }
                    }
                    if has_fallen {
                        let largest = worst_of(tree, worst, table.errors(), at);
                        tree.lower(worst, at, largest);
                    }
                }
            }
            Rule::Delta { changes } => {
                for (j, _) in transitions(seen.similar, order) {
                    let error = kl_of_changes(seen.state, seen.next, &changes[j * dim..][..dim]);
                    let before = table.errors()[j];
                    if improve(table, j, error, seen) {
                        improved(j, before, error);
                    }
                }
            }
        }
    }
}

/// Half the squared distance between s' - s and `change`, summed in the order of the features.
fn kl_of_changes(state: &[f32], next: &[f32], change: &[f32]) -> f32 {
    let square = |((a, b), c): ((&f32, &f32), &f32)| ((b - a) - c) * ((b - a) - c);
    0.5 * state.iter().zip(next).zip(change).map(square).sum::<f32>()
}

/// Replaces the estimate of `j` if `error` is smaller, or equal with a higher reward.
fn improve(table: &mut AnnotationTable, j: usize, error: f32, seen: &Observation<'_>) -> bool {
    let better = match table.estimate(j) {
        Some(known) => error < known.e_kl || (error == known.e_kl && seen.reward > known.reward),
        None => error < f32::INFINITY,
    };
    if better {
        table.set_estimate(j, &Estimate { action: seen.action, e_kl: error, reward: seen.reward });
    }
    better
}

fn worst_of(tree: &Tree, worst: &[f32], errors: &[f32], at: usize) -> f32 {
    let below = tree.numbers(at).iter().map(|&j| errors[j as usize]);
    below.chain(worst[tree.children(at)].iter().copied()).fold(0.0, f32::max)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::demonstration::Demonstration;
    use crate::similarity::Similarity;
    use crate::similarity::metric::kl;
    use crate::similarity::testing::{cases, points};
    use proptest::prelude::*;

    const E_TH: f32 = 0.6;

    /// Every pair, as the paper has it.
    fn naive(metric: MetricKind, demo: &Demonstration, seen: &Observation<'_>, table: &mut AnnotationTable) {
        let mentor = demo.transitions();
        for j in 0..mentor.len() {
            let (s, next) = (mentor.state(j), mentor.next_state(j));
            let error = match metric {
                MetricKind::Kl => kl(seen.state, s) + kl(seen.next, next),
                MetricKind::Delta if kl(seen.state, s) > E_TH => continue,
                MetricKind::Delta => {
                    let change =
                        |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| b - a).collect::<Vec<_>>();
                    kl(&change(seen.state, seen.next), &change(s, next))
                }
            };
            let known = table.estimate(j);
            if known.is_none_or(|k| error < k.e_kl || (error == k.e_kl && seen.reward > k.reward)) {
                table.set_estimate(j, &Estimate { action: seen.action, e_kl: error, reward: seen.reward });
            }
        }
    }

    proptest! {
        #![proptest_config(cases(256))]
        #[test]
        fn equals_the_scan_of_all_pairs(
            (dim, points) in points(8..130),
            mentor in 4usize..60,
            outcomes in proptest::collection::vec((0u32..4, -2i8..3), 130),
            delta in any::<bool>(),
            restored in 0usize..60,
        ) {
            let metric = if delta { MetricKind::Delta } else { MetricKind::Kl };
            let names = (0..dim).map(|i| format!("s{i}")).collect();
            let mut demo = Demonstration::new(names).unwrap();
            // The first points are the mentor's, in three trajectories; the observer goes through the others.
            let count = points.len() / dim;
            let mentor = mentor.min(count - 2);
            let (path, walk) = points.split_at(mentor * dim);
            let (first, second) = path.split_at(mentor / 2 * dim);
            for part in [&first[..first.len().min(2 * dim)], first, second] {
                _ = demo.push_trajectory(part, false);
            }
            prop_assume!(demo.n_transitions() > 0);
            let order = demo.order();
            let similarity = Similarity::new(demo.states().to_vec(), dim, E_TH);
            let mut inference = Inference::new(metric, demo.states(), dim, &order);
            let mut table = AnnotationTable::new(order.n_transitions(), dim, 4);
            let mut expected = table.clone();
            let mut similar = Vec::new();
            for (i, ends) in walk.windows(2 * dim).step_by(dim).enumerate() {
                if i == restored {
                    inference = Inference::new(metric, demo.states(), dim, &order);
                    inference.restore(table.errors());
                }
                let (state, next) = ends.split_at(dim);
                let (action, reward) = outcomes[i];
                similarity.states(state, &mut Vec::new(), &mut similar);
                let seen = Observation { state, next, similar: &similar, action, reward: f32::from(reward) };
                let before = table.clone();
                let mut named = Vec::new();
                inference.observe(&seen, &order, &mut table, |j, old, new| named.push((j, old, new)));
                naive(metric, &demo, &seen, &mut expected);
                prop_assert_eq!(&table, &expected);
                named.sort_by_key(|&(j, ..)| j);
                let changed: Vec<_> = (0..table.len())
                    .filter(|&j| before.estimate(j) != table.estimate(j))
                    .map(|j| (j, before.errors()[j], table.errors()[j]))
                    .collect();
                prop_assert_eq!(named, changed);
            }
        }
    }
}
