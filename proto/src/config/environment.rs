//! `[env]`: the environment.

use super::accepts::{any, between};
use super::{Hazard, PointMaze};
use crate::{choices, settings};
use std::collections::BTreeMap;

settings! {
    /// `[env]`
    pub struct Env {
        /// Which environment.
        kind: EnvKind = EnvKind::Maze;
        /// The map. The seed `run` of a random map is the run's own, and its sides are 4 to 1000 cells long.
        map: String = "maze-small".into(),
            any("a built-in map, a file, or `random:<seed>:<columns>x<rows>`");
        /// The map's text itself. It is filled in when the configuration is resolved, so that a run needs no other file.
        layout: Option<String> = None, any::<String>("the text of the map that `map` names");
        /// Name of the observer's action set.
        actions: String = "irregular".into(), any("a built-in set, or a key of `action_sets`");
        /// More action sets by name. The order of a set's directions breaks ties of the planner.
        action_sets: BTreeMap<String, Vec<String>> = BTreeMap::new(),
            any("name = 2 to 8 different ones of N, NE, E, SE, S, SW, W, NW");
        /// Steps after which an episode is cut off.
        step_limit: u32 = 4000, between(1, u32::MAX);
        /// What the network sees of a state.
        encoding: EncodingKind = EncodingKind::Coordinates;
        /// What only the Point Maze has.
        point_maze: PointMaze = PointMaze::default();
        /// How the environment fails on purpose, if it does.
        hazard: Hazard = Hazard::default();
    }
}

choices! {
    /// The environments.
    pub enum EnvKind {
        /// A maze of cells.
        Maze = "maze",
        /// A ball with inertia in a maze of walls.
        PointMaze = "point-maze",
    }
}

choices! {
    /// How a state becomes the network's input.
    pub enum EncodingKind {
        /// Each feature scaled to [-1, 1].
        Coordinates = "coordinates",
        /// Each (whole-numbered) feature as a one-hot vector.
        OneHot = "one-hot",
    }
}
