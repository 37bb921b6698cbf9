//! How far a run is and how long it still takes, for people.

use serde::{Deserialize, Serialize};
use trestle_algorithm::agent::Counters;

/// How far a run is: the learner prints one as a line of JSON now and then, the supervisor draws it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Finished training episodes.
    pub episodes: u64,
    /// Environment steps of all actors.
    pub env_steps: u64,
    /// Gradient steps.
    pub grad_steps: u64,
    /// Mean training return of the newest episodes, 100 at most.
    pub ep_rew_mean: Option<f64>,
    /// Mean return of the newest greedy evaluation.
    pub eval_return: Option<f64>,
    /// Environment steps a second since this process began to train.
    pub fps: f64,
    /// Share of the mentor's transitions that are taken as feasible, 0 to 1.
    pub feasible_frac: Option<f64>,
    /// Share of the mentor's transitions that have a bridge, 0 to 1.
    pub bridged_frac: Option<f64>,
    /// Seconds until the nearer of the limits, at the pace so far.
    pub seconds_left: Option<f64>,
    /// Whether the run counts as solved.
    pub solved: bool,
    /// Whether the run counts as optimal.
    pub optimal: bool,
}

/// Where a run ends, whichever comes first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Limits {
    /// Finished episodes.
    pub episodes: Option<u64>,
    /// Environment steps of all actors.
    pub env_steps: Option<u64>,
}

/// Seconds until the nearer limit at the pace of the last `elapsed_s` seconds, in which the run went from
/// `from` to `now`; none while nothing has been counted.
pub fn seconds_left(limits: &Limits, from: &Counters, now: &Counters, elapsed_s: f64) -> Option<f64> {
    let left = |limit: Option<u64>, from: u64, now: u64| {
        let remaining = limit?.saturating_sub(now);
        let done = now.saturating_sub(from);
        if remaining == 0 {
            return Some(0.0);
        }
        (done > 0).then(|| elapsed_s * remaining as f64 / done as f64)
    };
    let episodes = left(limits.episodes, from.episodes, now.episodes);
    let env_steps = left(limits.env_steps, from.env_steps, now.env_steps);
    [episodes, env_steps].into_iter().flatten().reduce(f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearer_limit_counts() {
        let from = Counters { episodes: 10, env_steps: 1_000, grad_steps: 0 };
        let now = Counters { episodes: 20, env_steps: 3_000, grad_steps: 0 };
        let left = |episodes, env_steps| seconds_left(&Limits { episodes, env_steps }, &from, &now, 5.0);
        assert_eq!(left(Some(40), None), Some(10.0));
        assert_eq!(left(None, Some(5_000)), Some(5.0));
        assert_eq!(left(Some(40), Some(5_000)), Some(5.0));
        assert_eq!(left(Some(20), Some(5_000)), Some(0.0));
        assert_eq!(left(None, None), None);
        assert_eq!(seconds_left(&Limits { episodes: Some(40), env_steps: None }, &now, &now, 5.0), None);
    }
}
