//! Deep k-n step repair as the paper's Algorithm 1 has it: for one mentor transition, scan the whole history at every
//! step. It costs O(|R| k n) a question and serves the tests, and as the plainest statement of what a bridge is.

use super::Path;
use crate::history::{History, Stored};
use crate::metric::kl;

/// What decides between bridges, best first: length, end KL, reward of the first step (higher is better).
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

/// The best bridge for mentor transition `j` in the present history, with or without cross-referencing.
pub fn best(history: &History, j: usize, cross_reference: bool, path: &Path<'_>) -> Option<Quality> {
    let start = path.similarity.state(path.order.state_of(j));
    let similar = |a: &[f32], b: &[f32]| kl(a, b) <= path.similarity.e_th();
    let whitened = |id| history.states.whitened(id);
    // Each path as its last transition and the reward of its first.
    let mut paths: Vec<(u64, f32)> = (history.oldest()..history.end())
        .filter(|&t| similar(whitened(history.get(t).from), start))
        .map(|t| (t, history.get(t).reward))
        .collect();
    for length in 1..=path.rule.k {
        let ends = paths.iter().filter_map(|&(t, reward)| {
            let end_kl = end_kl(history.get(t), j, history, path)?;
            Some(Quality { length: length as u32, end_kl, reward })
        });
        if let Some(best) = ends.reduce(|a, b| if b.beats(&a) { b } else { a }) {
            return Some(best);
        }
        let mut longer: Vec<(u64, f32)> = Vec::new();
        for next in history.oldest()..history.end() {
            let follows = |t: u64| {
                let before = history.get(t);
                let joined = history.predecessor(next) == Some(t)
                    || cross_reference && similar(whitened(before.to), whitened(history.get(next).from));
                joined && !before.ends_episode()
            };
            let rewards = paths.iter().filter(|&&(t, _)| follows(t)).map(|&(_, reward)| reward);
            longer.extend(rewards.reduce(f32::max).map(|reward| (next, reward)));
        }
        paths = longer;
    }
    None
}

/// KL between s' of `t` and the nearest mentor state ahead of transition `j`, if one is similar.
fn end_kl(t: &Stored, j: usize, history: &History, path: &Path<'_>) -> Option<f32> {
    let end = history.states.whitened(t.to);
    let ahead = path.order.ahead(j, path.rule.n);
    ahead.map(|m| kl(end, path.similarity.state(m))).filter(|&d| d <= path.similarity.e_th()).reduce(f32::min)
}
