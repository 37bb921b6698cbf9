//! Deep k-n step repair as the paper's Algorithm 1 has it: for one mentor transition, scan the whole history at every
//! step. It costs O(|R| k n) per question. It serves the tests, and as the plainest definition of a bridge.

use super::Path;
use crate::history::{History, Stored};
use crate::similarity::metric::kl;
use std::cmp::Ordering;

/// The criteria between bridges, first to last: length, end KL, reward of the first step (higher is better).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Observer steps.
    pub length: u32,
    /// KL between the last state and the nearest mentor state ahead.
    pub end_kl: f32,
    /// Reward of the first step.
    pub reward: f32,
}

impl Quality {
    /// Whether this one is better than `other`.
    pub fn beats(&self, other: &Self) -> bool {
        (self.length, self.end_kl, -self.reward) < (other.length, other.end_kl, -other.reward)
    }
}

/// The best bridge for mentor transition `j` in the present history, with or without cross-referencing, and the number
/// of its first transition. Among equally good ones it is the one with the smaller action, then the smaller s'.
pub fn best(history: &History, j: usize, cross_reference: bool, path: &Path<'_>) -> Option<(Quality, u64)> {
    let start = path.similarity.state(path.order.state_of(j));
    let similar = |a: &[f32], b: &[f32]| kl(a, b) <= path.similarity.e_th();
    let whitened = |id| history.states.whitened(id);
    let better = |a: u64, b: u64| if first_order(history, a, b).is_le() { a } else { b };
    // Each path as its last transition and its first.
    let mut paths: Vec<(u64, u64)> = (history.oldest()..history.end())
        .filter(|&t| similar(whitened(history.get(t).from), start))
        .map(|t| (t, t))
        .collect();
    for length in 1..=path.rule.k {
        let ends = paths.iter().filter_map(|&(t, first)| {
            let (end_kl, reward) = (end_kl(history.get(t), j, history, path)?, history.get(first).reward);
            Some((Quality { length: length as u32, end_kl, reward }, first))
        });
        let best = ends.reduce(|a, b| {
            if b.0.beats(&a.0) || b.0 == a.0 && first_order(history, b.1, a.1).is_lt() { b } else { a }
        });
        if best.is_some() {
            return best;
        }
        let mut longer: Vec<(u64, u64)> = Vec::new();
        for next in history.oldest()..history.end() {
            let follows = |t: u64| {
                let before = history.get(t);
                let joined = history.predecessor(next) == Some(t)
                    || cross_reference && similar(whitened(before.to), whitened(history.get(next).from));
                joined && !before.ends_episode()
            };
            let firsts = paths.iter().filter(|&&(t, _)| follows(t)).map(|&(_, first)| first);
            longer.extend(firsts.reduce(better).map(|first| (next, first)));
        }
        paths = longer;
    }
    None
}

/// Which of two first transitions is the better one: the higher reward, the smaller action, the smaller s'.
pub(super) fn first_order(history: &History, a: u64, b: u64) -> Ordering {
    let (x, y) = (history.get(a), history.get(b));
    let features = || history.states.order(x.to, y.to);
    y.reward.total_cmp(&x.reward).then(x.action.cmp(&y.action)).then_with(features)
}

/// KL between s' of `t` and the nearest mentor state ahead of transition `j`, if one is similar.
pub(super) fn end_kl(t: &Stored, j: usize, history: &History, path: &Path<'_>) -> Option<f32> {
    let end = history.states.whitened(t.to);
    let ahead = path.order.ahead(j, path.rule.n);
    ahead.map(|m| kl(end, path.similarity.state(m))).filter(|&d| d <= path.similarity.e_th()).reduce(f32::min)
}
