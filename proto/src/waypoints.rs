//! The mentor's states as actors with guided exploration and a learner with shaping need them, beside the
//! mentor-server. They go with the plan: neither has to ask for them, and after a restart they are the same.

use serde::{Deserialize, Serialize};

/// The states of all demonstrations, one entry a state, in order.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Waypoints {
    /// The states, row-major.
    pub states: Vec<f32>,
    /// The mentor transition that begins in each; [`crate::NONE`] for the last of a trajectory.
    pub transition_of: Vec<u32>,
    /// How far along its trajectory each is, from 0, the first, to 1, the last.
    pub progress: Vec<f32>,
}
