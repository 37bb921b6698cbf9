//! `[eval]`, `[checkpoint]` and `[supervise]`: what is done beside learning.

use super::accepts::{Accepts, at_least, between, finite};
use crate::limits::{MAX_DEADLINE_S, MAX_RESTARTS, MAX_ROLLOUT, MIN_DEADLINE_S};
use crate::settings;

settings! {
    /// `[eval]`
    pub struct Eval {
        /// Finished episodes between greedy evaluations.
        every: u64 = 5, at_least(1);
        /// Greedy episodes of an evaluation.
        episodes: u32 = 1, between(1, MAX_ROLLOUT);
        /// Return that counts as the goal. Without it, the best possible return, where the environment knows it.
        threshold: Option<f64> = None, finite();
        /// How far below the threshold a return may be and count as solved.
        tolerance: f64 = 0.5, at_least(0.0);
    }
}

settings! {
    /// `[checkpoint]`
    pub struct Checkpoint {
        /// Environment steps between checkpoints. 0: one at the end alone.
        every_env_steps: u64 = 250_000;
        /// Complete checkpoints that are kept.
        keep: usize = 2, between(1, 1000);
    }
}

settings! {
    /// `[supervise]`
    pub struct Supervise {
        /// How often the run may be started again after the death of a process without getting ahead. 0: the first death ends it.
        restarts: u32 = 5, between(0, MAX_RESTARTS);
        /// Seconds without a sign of life after which a process counts as dead. 0 is for debuggers.
        silence_s: u32 = 10, deadline();
        /// Seconds without progress in its work (an environment step, a gradient step) after which a process counts as dead.
        stall_s: u32 = 300, deadline();
    }
}

/// What a time without news accepts.
fn deadline() -> Accepts<u32> {
    between(MIN_DEADLINE_S, MAX_DEADLINE_S).or(0, "for never")
}
