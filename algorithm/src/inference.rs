//! Action inference: for every mentor transition, the observer transition that came closest so far (paper, Fig. 1;
//! the scan of all pairs is replaced by an exact index).
//!
//! The error of an observer transition (s, s') for a mentor transition (s_m, s'_m) is, by metric:
//!
//! - `kl` (the paper's): e = KL(s, s_m) + KL(s', s'_m);
//! - `delta` (our choice): where KL(s, s_m) is up to `e_th`, the KL divergence of the changes s' - s and s'_m - s_m,
//!   taken after whitening; no comparison elsewhere.
//!
//! Which transitions are compared at all, and what becomes of equal errors, is `mentor.inference`:
//!
//! - `similar` (our choice, the default): only those whose s is similar to s_m. At exactly the same error the one that begins
//!   nearer to s_m wins, and between two that begin in s_m itself the one with the higher reward. A step beside s_m can look
//!   as much like the mentor's as a bump against a wall at s_m does. Its reward must not decide: it would say that the bump
//!   costs nothing.
//! - `any` (the papers' letter): all of them, and at exactly the same error the higher reward wins.
//!
//! A smaller error replaces action, error, start and reward. What is left is a function of the observer transitions in their
//! order.
//!
//! For `similar` and for `delta` the mentor states similar to s, which are known anyway, are gone through. For `any` with `kl`
//! the pairs (s_m, s'_m) are points of a [`Tree`], and each of its nodes knows the largest error below it: a
//! node whose box is farther away than that cannot improve anywhere. So the search gets cheaper as errors fall.

use crate::demonstration::Order;
use crate::demonstration::transitions;
use crate::similarity::Hit;
use crate::similarity::metric::{kl, square};
use crate::similarity::tree::{Tree, WIDTH};
use trestle_proto::annotation::{AnnotationTable, Estimate};
use trestle_proto::config::{InferenceKind, MetricKind};

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
    ties: InferenceKind,
    /// Working memory: nodes to visit, and the observer's states side by side.
    stack: Vec<u32>,
    pair: Vec<f32>,
}

#[derive(Clone, Debug)]
enum Rule {
    Any {
        /// Over s_m and s'_m side by side.
        tree: Tree,
        /// The largest error below each node.
        worst: Vec<f32>,
    },
    Similar {
        /// s'_m of each transition.
        next: Vec<f32>,
    },
    Delta {
        /// s'_m - s_m of each transition.
        changes: Vec<f32>,
    },
}

impl Inference {
    /// Indexes the transitions of `order` over `whitened` mentor states (row-major, `dim` features). `metric` is not
    /// `auto`, which only an environment can tell ([`MetricKind::of`]); it would be taken for `kl`.
    pub fn new(
        metric: MetricKind,
        inference: InferenceKind,
        whitened: &[f32],
        dim: usize,
        order: &Order,
    ) -> Self {
        let ends = |j: usize| whitened[order.state_of(j) * dim..][..2 * dim].split_at(dim);
        let rule = match (metric, inference) {
            (MetricKind::Kl | MetricKind::Auto, InferenceKind::Any) => {
                let pairs: Vec<f32> =
                    (0..order.n_transitions()).flat_map(|j| [ends(j).0, ends(j).1].concat()).collect();
                // Small leaves: the largest error of a leaf rules it out, and falls with all of its points alone.
                let tree = Tree::new(&pairs, 2 * dim, WIDTH);
                let worst = vec![f32::INFINITY; tree.n_nodes()];
                Rule::Any { tree, worst }
            }
            (MetricKind::Kl | MetricKind::Auto, InferenceKind::Similar) => {
                Rule::Similar { next: (0..order.n_transitions()).flat_map(|j| ends(j).1).copied().collect() }
            }
            (MetricKind::Delta, _) => {
                let change = |j| ends(j).1.iter().zip(ends(j).0).map(|(b, a)| b - a).collect::<Vec<_>>();
                Rule::Delta { changes: (0..order.n_transitions()).flat_map(change).collect() }
            }
        };
        Self { dim, rule, ties: inference, stack: Vec::new(), pair: Vec::new() }
    }

    /// Takes over errors that were found elsewhere: one for each mentor transition.
    pub fn restore(&mut self, errors: &[f32]) {
        let Rule::Any { tree, worst } = &mut self.rule else { return };
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
        let (dim, ties) = (self.dim, self.ties);
        match &mut self.rule {
            Rule::Any { tree, worst } => {
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
                            if improve(table, j, error, first, ties, seen) {
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
            Rule::Similar { next } => {
                let error = |j: usize, start: f32| start + kl(seen.next, &next[j * dim..][..dim]);
                among_similar(seen, order, table, ties, error, improved);
            }
            Rule::Delta { changes } => {
                let error = |j: usize, _| kl_of_changes(seen.state, seen.next, &changes[j * dim..][..dim]);
                among_similar(seen, order, table, ties, error, improved);
            }
        }
    }
}

/// Compares with the mentor transitions that begin in a state similar to s. `error` is given each one's number and the KL of
/// s and its s_m.
fn among_similar(
    seen: &Observation<'_>,
    order: &Order,
    table: &mut AnnotationTable,
    ties: InferenceKind,
    error: impl Fn(usize, f32) -> f32,
    mut improved: impl FnMut(usize, f32, f32),
) {
    for (j, start) in transitions(seen.similar, order) {
        let (before, error) = (table.errors()[j], error(j, start));
        if improve(table, j, error, start, ties, seen) {
            improved(j, before, error);
        }
    }
}

/// Half the squared distance between s' - s and `change`, summed in the order of the features.
fn kl_of_changes(state: &[f32], next: &[f32], change: &[f32]) -> f32 {
    let missed = state.iter().zip(next).zip(change).map(|((a, b), c)| (b - a) - c);
    0.5 * missed.map(square).sum::<f32>()
}

/// Replaces the estimate of `j` if `error` is smaller, or equal and `ties` decides for the new one. `start` is the KL of
/// s and s_m.
fn improve(
    table: &mut AnnotationTable,
    j: usize,
    error: f32,
    start: f32,
    ties: InferenceKind,
    seen: &Observation<'_>,
) -> bool {
    let better = match table.estimate(j) {
        Some(known) if error == known.e_kl => match ties {
            InferenceKind::Any => seen.reward > known.reward,
            // The KL is 0 between equal states alone.
            InferenceKind::Similar if start == 0.0 && known.start_kl == 0.0 => seen.reward > known.reward,
            InferenceKind::Similar => start < known.start_kl,
        },
        Some(known) => error < known.e_kl,
        None => error < f32::INFINITY,
    };
    if better {
        let (action, reward) = (seen.action, seen.reward);
        table.set_estimate(j, &Estimate { action, e_kl: error, start_kl: start, reward });
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
    use crate::similarity::testing::{cases, points};
    use proptest::prelude::*;

    const E_TH: f32 = 0.6;

    /// Every pair, as the paper has it.
    fn naive(
        metric: MetricKind,
        inference: InferenceKind,
        demo: &Demonstration,
        seen: &Observation<'_>,
        table: &mut AnnotationTable,
    ) {
        let mentor = demo.transitions();
        let honest = inference == InferenceKind::Similar;
        for j in 0..mentor.len() {
            let (s, next) = (mentor.state(j), mentor.next_state(j));
            let start = kl(seen.state, s);
            let error = match metric {
                _ if honest && start > E_TH => continue,
                MetricKind::Kl | MetricKind::Auto => kl(seen.state, s) + kl(seen.next, next),
                MetricKind::Delta if start > E_TH => continue,
                MetricKind::Delta => {
                    let change =
                        |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| b - a).collect::<Vec<_>>();
                    kl(&change(seen.state, seen.next), &change(s, next))
                }
            };
            let known = table.estimate(j);
            let better = known.is_none_or(|known| {
                let (equal, higher) = (error == known.e_kl, seen.reward > known.reward);
                let from_s_m = start == 0.0 && known.start_kl == 0.0;
                let nearer = honest && start < known.start_kl;
                error < known.e_kl || (equal && (nearer || (higher && (!honest || from_s_m))))
            });
            if better {
                let (action, reward) = (seen.action, seen.reward);
                table.set_estimate(j, &Estimate { action, e_kl: error, start_kl: start, reward });
            }
        }
    }

    /// The mentor goes east along a wall. The observer's north-east is blocked at s_m, where it bumps; from the cell below it
    /// leads to where the mentor goes, and brings more.
    #[test]
    fn a_step_from_beside_never_passes_for_the_bump() {
        let mut demo = Demonstration::new(vec!["x".into(), "y".into()]).unwrap();
        demo.push_trajectory(&[0.0, 0.0, 1.0, 0.0], false).unwrap();
        let order = demo.order();
        let rewards = |kind, e_th, reversed: bool| {
            let similarity = Similarity::new(demo.states().to_vec(), 2, e_th);
            let mut inference = Inference::new(MetricKind::Kl, kind, demo.states(), 2, &order);
            let mut table = AnnotationTable::new(1, 2, 4);
            let mut steps = [([0.0, 0.0], [0.0, 0.0], -0.75), ([0.0, 1.0], [1.0, 0.0], -0.04)];
            if reversed {
                steps.reverse();
            }
            for (state, next, reward) in &steps {
                let mut similar = Vec::new();
                similarity.states(state, &mut Vec::new(), &mut similar);
                let seen = Observation { state, next, similar: &similar, action: 1, reward: *reward };
                inference.observe(&seen, &order, &mut table, |_, _, _| ());
            }
            table.estimate(0).map(|estimate| (estimate.e_kl, estimate.start_kl, estimate.reward))
        };
        for reversed in [false, true] {
            assert_eq!(rewards(InferenceKind::Any, 0.1, reversed), Some((0.5, 0.5, -0.04)));
            // Whether the other cell counts as similar or not.
            for e_th in [0.1, 0.6] {
                assert_eq!(rewards(InferenceKind::Similar, e_th, reversed), Some((0.5, 0.0, -0.75)));
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
            any in any::<bool>(),
            restored in 0usize..60,
        ) {
            let metric = if delta { MetricKind::Delta } else { MetricKind::Kl };
            let inference_kind = if any { InferenceKind::Any } else { InferenceKind::Similar };
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
            let new = || Inference::new(metric, inference_kind, demo.states(), dim, &order);
            let mut inference = new();
            let mut table = AnnotationTable::new(order.n_transitions(), dim, 4);
            let mut expected = table.clone();
            let mut similar = Vec::new();
            for (i, ends) in walk.windows(2 * dim).step_by(dim).enumerate() {
                if i == restored {
                    inference = new();
                    inference.restore(table.errors());
                }
                let (state, next) = ends.split_at(dim);
                let (action, reward) = outcomes[i];
                similarity.states(state, &mut Vec::new(), &mut similar);
                let seen = Observation { state, next, similar: &similar, action, reward: f32::from(reward) };
                let before = table.clone();
                let mut named = Vec::new();
                inference.observe(&seen, &order, &mut table, |j, old, new| named.push((j, old, new)));
                naive(metric, inference_kind, &demo, &seen, &mut expected);
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
