//! `[env.point_maze]`: what only the Point Maze has. Which map, actions and step limit is said in `[env]`.

use serde::{Deserialize, Serialize};

/// `[env.point_maze]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PointMaze {
    /// What computes the physics.
    pub backend: PhysicsBackend,
    /// Whose coordinates, goal radius and random resets.
    pub layout: PointLayout,
    /// Where episodes begin.
    pub reset: PointReset,
    /// Control of each direction of the action set, in units of the motors' range, each above 0 to 1; one to eight of
    /// them.
    pub magnitudes: Vec<f64>,
    /// Steps of the simulation (0.01 s) for each step of the environment, 1 to 100.
    pub frame_skip: u32,
    /// Added to the reward of the step that reaches the goal, 0 or more. Only the learner sees it: returns that are
    /// reported leave it out.
    pub goal_reward: f64,
    /// Distance in metres at which a wall begins to push, 0 to 0.05.
    pub contact_margin: f64,
}

/// What computes the physics.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PhysicsBackend {
    /// MuJoCo where it is found, else built in. A resolved configuration names one of the two.
    Auto,
    /// libmujoco, loaded at run time.
    Mujoco,
    /// The same equations in Rust.
    Builtin,
}

impl PhysicsBackend {
    /// Its name in configurations.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Mujoco => "mujoco",
            Self::Builtin => "builtin",
        }
    }
}

/// Whose conventions the Point Maze follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PointLayout {
    /// D4RL's maze2d: x counts rows and y columns, goal radius 0.5.
    D4rl,
    /// Gymnasium-Robotics' PointMaze: the origin in the middle, x to the right, y up, goal radius 0.45.
    Gymnasium,
}

/// Where episodes begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PointReset {
    /// At rest on the map's `S`: every episode alike.
    Start,
    /// Anywhere, drawn as the layout's original does.
    Random,
}

impl Default for PointMaze {
    fn default() -> Self {
        Self {
            backend: PhysicsBackend::Auto,
            layout: PointLayout::D4rl,
            reset: PointReset::Start,
            magnitudes: vec![0.5, 1.0],
            frame_skip: 1,
            goal_reward: 1.0,
            contact_margin: 0.002,
        }
    }
}
