//! What an agent counts and reports: steps, episodes, and what is known of each mentor transition.

use serde::{Deserialize, Serialize};
use trestle_proto::annotation::{Bridge, Estimate};

/// What a run counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counters {
    /// Finished training episodes.
    pub episodes: u64,
    /// Environment steps of all actors.
    pub env_steps: u64,
    /// Gradient steps.
    pub grad_steps: u64,
}

/// One mentor transition.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MentorRow<'a> {
    /// s_m.
    pub state: &'a [f32],
    /// Whether it begins a trajectory.
    pub first: bool,
    /// Observer transitions that it was picked for when they were stored.
    pub visited: u64,
    /// Samples of gradient steps that were trained with its L_m.
    pub used: u64,
    /// The best estimate, if there is one.
    pub estimate: Option<Estimate>,
    /// Whether it is taken as feasible.
    pub feasible: bool,
    /// The best bridge, if there is one; it counts only where the transition is infeasible.
    pub bridge: Option<Bridge<'a>>,
}
