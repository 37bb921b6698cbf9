//! `[env.point-maze]`

use super::actions::{DIAGONAL, ORTHOGONAL};
use super::geometry::Geometry;
use crate::env::grid::{self, ActionSet, ActionSets, GridError};
use std::collections::BTreeMap;
use trestle_proto::config::accepts::{Accepts, above_up_to, any, between, list};
use trestle_proto::{choices, settings};

settings! {
    /// `[env.point-maze]`
    pub struct Settings {
        /// The map. The seed `run` of a random map is the run's own. Its sides are 4 to 1000 cells long, with other generators than `random` 5, 8 or 11 to 1000.
        map: String = "umaze".into(), any(grid::ACCEPTED);
        /// The map's text itself. It is filled in when the configuration is resolved, so that a run needs no other file.
        map_text: Option<String> = None, any::<String>("the text of the map that `map` names");
        /// The observer's action set.
        actions: String = "diagonal".into(), any("orthogonal, diagonal, or a key of `action_sets`");
        /// More action sets by name.
        action_sets: BTreeMap<String, Vec<String>> = BTreeMap::new(),
            any("name = 2 to 8 different ones of N, NE, E, SE, S, SW, W, NW");
        /// What computes the physics. A resolved configuration never says `auto`.
        backend: Backend = Backend::Auto;
        /// Whose coordinates, goal radius and random resets.
        layout: Layout = Layout::D4rl;
        /// Where episodes begin.
        reset: Reset = Reset::Start;
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

impl Settings {
    /// The map of resolved settings in the plane.
    ///
    /// # Errors
    /// There is no text, or it is no map.
    pub fn geometry(&self) -> Result<Geometry, GridError> {
        let map = grid::map_of(&self.map, self.map_text.as_deref())?;
        Ok(Geometry::new(map, self.layout))
    }

    /// The action set that the setting `key` calls `name`.
    ///
    /// # Errors
    /// No set of this name, or any set of the configuration that cannot be used.
    pub fn action_set(&self, key: &'static str, name: &str) -> Result<ActionSet, GridError> {
        let builtin = &[("orthogonal", ORTHOGONAL), ("diagonal", DIAGONAL)];
        ActionSets { builtin, own: &self.action_sets }.find(key, name)
    }
}

choices! {
    /// What computes the physics.
    pub enum Backend {
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
    pub enum Layout {
        /// D4RL's maze2d: x counts rows and y columns, goal radius 0.5.
        D4rl = "d4rl",
        /// Gymnasium-Robotics' PointMaze: the origin in the middle, x to the right, y up, goal radius 0.45.
        Gymnasium = "gymnasium",
    }
}

choices! {
    /// Where episodes begin.
    pub enum Reset {
        /// At rest on the map's `S`: every episode alike.
        Start = "start",
        /// Anywhere, drawn as the layout's original does.
        Random = "random",
    }
}
