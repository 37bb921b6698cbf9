//! `[env.point_maze]`: what only the Point Maze has. Which map, actions and step limit is said in `[env]`.

use super::accepts::{Accepts, above_up_to, between, list};
use crate::{choices, settings};

settings! {
    /// `[env.point_maze]`
    pub struct PointMaze {
        /// What computes the physics. `auto` is MuJoCo where it is found; a resolved configuration names one of the other two.
        backend: PhysicsBackend = PhysicsBackend::Auto;
        /// Whose coordinates, goal radius and random resets.
        layout: PointLayout = PointLayout::D4rl;
        /// Where episodes begin.
        reset: PointReset = PointReset::Start;
        /// Control of each direction of the action set, in units of the motors' range.
        magnitudes: Vec<f64> = vec![0.5, 1.0], magnitudes();
        /// Steps of the simulation (0.01 s) for each step of the environment.
        frame_skip: u32 = 1, between(1, 100);
        /// Added to the reward of the step that reaches the goal. Only the learner sees it: returns that are reported leave it
        /// out.
        goal_reward: f64 = 1.0, between(0.0, 1e6);
        /// Distance in metres at which a wall begins to push.
        contact_margin: f64 = 0.002, between(0.0, 0.05);
    }
}

fn magnitudes() -> Accepts<Vec<f64>> {
    let each = list(1..=8, above_up_to(0.0, 1.0));
    Accepts::when("1 to 8 different numbers above 0, up to 1", move |values: &Vec<f64>| {
        each.test(values) && values.iter().enumerate().all(|(i, value)| !values[..i].contains(value))
    })
}

choices! {
    /// What computes the physics.
    pub enum PhysicsBackend {
        /// MuJoCo where it is found, else built in.
        Auto = "auto",
        /// libmujoco, loaded at run time.
        Mujoco = "mujoco",
        /// The same equations in Rust.
        Builtin = "builtin",
    }
}

choices! {
    /// Whose conventions the Point Maze follows.
    pub enum PointLayout {
        /// D4RL's maze2d: x counts rows and y columns, goal radius 0.5.
        D4rl = "d4rl",
        /// Gymnasium-Robotics' PointMaze: the origin in the middle, x to the right, y up, goal radius 0.45.
        Gymnasium = "gymnasium",
    }
}

choices! {
    /// Where episodes begin.
    pub enum PointReset {
        /// At rest on the map's `S`: every episode alike.
        Start = "start",
        /// Anywhere, drawn as the layout's original does.
        Random = "random",
    }
}
