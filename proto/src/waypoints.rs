//! The mentor's states as actors with guided exploration and a rival need them, beside the
//! mentor-server. They go with the plan: neither has to ask for them, and after a restart they are the same.

use crate::NONE;
use serde::{Deserialize, Serialize};

/// The states of all demonstrations, one entry a state, in order.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Waypoints {
    /// The states, row-major.
    pub states: Vec<f32>,
    /// The mentor transition that begins in each; [`NONE`] for the last of a trajectory.
    pub transition_of: Vec<u32>,
    /// How far along its trajectory each is, from 0, the first, to 1, the last.
    pub progress: Vec<f32>,
}

impl Waypoints {
    /// How many states each trajectory has, in order.
    pub fn lengths(&self) -> impl Iterator<Item = usize> {
        self.transition_of.split_inclusive(|&transition| transition == NONE).map(<[u32]>::len)
    }

    /// The same where each state, of `dim` features, is followed by the goal that it has in D-Shape: the next state of its
    /// trajectory, or for the last one itself.
    pub fn with_goals(&self, dim: usize) -> Self {
        let count = self.transition_of.len();
        let state = |m: usize| &self.states[m * dim..][..dim];
        let goal = |m: usize| if self.transition_of[m] == NONE { m } else { m + 1 };
        let states = (0..count).flat_map(|m| [state(m), state(goal(m))]).flatten().copied().collect();
        Self { states, ..self.clone() }
    }
}
