//! When a run counts as solved and as optimal, from its greedy evaluations.
//!
//! *Solved* is the first of three consecutive evaluations whose return is within the tolerance of the
//! threshold; *optimal* is the same with tolerance 0. Our choice: the paper reads both off its plots.
//! Evaluations before the first gradient step count for neither: what initial weights happen to do has not been learnt.

use serde::{Deserialize, Serialize};
use trestle_algorithm::agent::Counters;
use trestle_proto::space::least;

/// Evaluations in a row that must pass.
pub const CONSECUTIVE: u32 = 3;
/// Return to reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Undiscounted return that counts as optimal.
    pub threshold: f64,
    /// How far below it a return may be and count as solved, 0 or more.
    pub tolerance: f64,
}

/// A moment of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Moment {
    /// Finished training episodes.
    pub episode: u64,
    /// Environment steps of all actors.
    pub env_steps: u64,
}

/// Consecutive passes so far, and the first of [`CONSECUTIVE`] once there are as many.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Streak {
    first: Option<Moment>,
    length: u32,
}

/// What the evaluations so far amount to. Part of a checkpoint.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Standing {
    solved: Streak,
    optimal: Streak,
    best_return: Option<f64>,
    final_return: Option<f64>,
}

impl Standing {
    /// Takes in the mean return of one evaluation of the weights at `counters`; without a goal nothing ever counts as solved.
    pub fn observe(&mut self, goal: Option<Goal>, counters: &Counters, mean_return: f64) {
        if let Some(goal) = goal.filter(|_| counters.grad_steps > 0) {
            let at = Moment { episode: counters.episodes, env_steps: counters.env_steps };
            advance(&mut self.solved, mean_return >= least(goal.threshold, goal.tolerance), at);
            advance(&mut self.optimal, mean_return >= least(goal.threshold, 0.0), at);
        }
        let best = self.best_return.map_or(mean_return, |best| best.max(mean_return));
        self.best_return = Some(best);
        self.final_return = Some(mean_return);
    }

    /// When the run was solved, if it is.
    pub fn solved(&self) -> Option<Moment> {
        reached(&self.solved)
    }

    /// When the run was optimal, if it is.
    pub fn optimal(&self) -> Option<Moment> {
        reached(&self.optimal)
    }

    /// Highest mean return of an evaluation.
    pub fn best_return(&self) -> Option<f64> {
        self.best_return
    }

    /// Mean return of the newest evaluation.
    pub fn final_return(&self) -> Option<f64> {
        self.final_return
    }
}

/// Takes one more evaluation into a streak; a streak of full length stays as it is.
fn advance(streak: &mut Streak, passed: bool, at: Moment) {
    if streak.length == CONSECUTIVE {
        return;
    }
    if !passed {
        *streak = Streak::default();
        return;
    }
    streak.first.get_or_insert(at);
    streak.length += 1;
}

fn reached(streak: &Streak) -> Option<Moment> {
    streak.first.filter(|_| streak.length == CONSECUTIVE)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;
    use trestle_proto::codec::{self, Kind};

    const KIND: Kind = Kind { magic: *b"TRTEST\0\0", version: 1 };
    const GOAL: Goal = Goal { threshold: -3.4, tolerance: 0.5 };

    fn reaches(value: f64, threshold: f64, tolerance: f64) -> bool {
        value >= least(threshold, tolerance)
    }

    fn moment(i: usize) -> Moment {
        Moment { episode: 5 * i as u64, env_steps: 100 * i as u64 + 1 }
    }

    /// The counters there, after `grad_steps`.
    fn counters(i: usize, grad_steps: u64) -> Counters {
        let Moment { episode, env_steps } = moment(i);
        Counters { episodes: episode, env_steps, grad_steps }
    }

    fn standing(returns: &[f64]) -> Standing {
        let mut standing = Standing::default();
        for (i, value) in returns.iter().enumerate() {
            standing.observe(Some(GOAL), &counters(i, 1), *value);
        }
        standing
    }

    #[test]
    fn the_first_of_three_counts() {
        let s = standing(&[-3.9, -3.9, -5.0, -3.9, -3.4, -3.4, -9.0]);
        assert_eq!(s.solved(), Some(moment(3)));
        assert_eq!(s.optimal(), None);
        assert_eq!((s.best_return(), s.final_return()), (Some(-3.4), Some(-9.0)));
        assert_eq!(standing(&[-3.9, -3.9]).solved(), None);
        assert_eq!(standing(&[]).best_return(), None);
    }

    #[test]
    fn rounding_of_sums_is_forgiven_and_a_step_is_not() {
        let wide: f64 = (0..34).map(|_| -0.1f64).sum();
        let narrow: f64 = (0..34).map(|_| f64::from(-0.1f32)).sum();
        let single: f32 = (0..34).map(|_| -0.1f32).sum();
        assert!(wide != -3.4 && narrow < -3.4);
        for sum in [wide, narrow, f64::from(single)] {
            assert!(reaches(sum, -3.4, 0.0), "{sum}");
            assert!(!reaches(sum - 0.1, -3.4, 0.0));
        }
        assert!(reaches(-3.9 - 1e-9, -3.4, 0.5) && !reaches(-3.91, -3.4, 0.5));
        assert!(!reaches(f64::NAN, -3.4, 0.5));
    }

    #[test]
    fn without_a_goal_nothing_is_solved() {
        let mut s = Standing::default();
        (0..4).for_each(|i| s.observe(None, &counters(i, 1), 1.0));
        assert_eq!((s.solved(), s.optimal(), s.best_return()), (None, None, Some(1.0)));
    }

    #[test]
    fn what_initial_weights_do_is_not_solved() {
        let mut s = Standing::default();
        (0..5).for_each(|i| s.observe(Some(GOAL), &counters(i, 0), -3.4));
        assert_eq!((s.solved(), s.optimal(), s.best_return()), (None, None, Some(-3.4)));
        (5..8).for_each(|i| s.observe(Some(GOAL), &counters(i, 9), -3.4));
        assert_eq!((s.solved(), s.optimal()), (Some(moment(5)), Some(moment(5))));
    }

    proptest! {
        /// Against looking at all windows of three, with a stop and a restart on the way.
        #[test]
        fn equals_the_naive_search(steps in proptest::collection::vec(0u8..4, 0..24), cut in 0usize..24) {
            let returns: Vec<f64> = steps.iter().map(|s| -3.1 - 0.3 * f64::from(*s)).collect();
            let naive = |tolerance: f64| {
                let passed: Vec<bool> = returns.iter().map(|r| reaches(*r, GOAL.threshold, tolerance)).collect();
                passed.windows(3).position(|w| w == [true; 3]).map(moment)
            };
            let mut s = Standing::default();
            for (i, value) in returns.iter().enumerate() {
                if i == cut {
                    s = codec::decode(KIND, &codec::encode(KIND, &s).unwrap()).unwrap();
                }
                s.observe(Some(GOAL), &counters(i, 1), *value);
            }
            prop_assert_eq!(s.solved(), naive(GOAL.tolerance));
            prop_assert_eq!(s.optimal(), naive(0.0));
            prop_assert_eq!(s.final_return(), returns.last().copied());
            prop_assert_eq!(s.best_return(), returns.iter().copied().reduce(f64::max));
        }
    }
}
