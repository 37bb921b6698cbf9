//! The two-dimensional maze: an agent on a map of cells, one cell a step, a goal that ends the episode.
//!
//! * [`Settings`]: its table of a configuration;
//! * [`Maze`]: dynamics and rewards;
//! * `draw`: paths on its map, as text; `ground`: the same for reports;
//! * `presets/`: configurations that are compiled in.

mod draw;
mod environment;
mod ground;
mod settings;

pub use environment::{BLOCKED_REWARD, GOAL_REWARD, MOVE_REWARD, Maze, REVISIT_REWARD};
pub use settings::Settings;

use super::grid::{self, ActionSet, Map, mentor_path};
use super::{EnvError, Ground, Kind};
use environment::observation;
use trestle_proto::config::{self, Preset};

impl Kind for Maze {
    type Settings = Settings;

    const ABOUT: &'static str = "One agent on a map of cells, one cell a step.";

    const FILLED: &'static [&'static str] = &["map_text"];

    fn new(settings: &Settings, env: &config::Env) -> Result<Self, EnvError> {
        Self::of(settings, env.step_limit)
    }

    fn resolve(settings: &mut Settings, _env: &config::Env, seed: u64) -> Result<(), EnvError> {
        Ok(grid::resolve(&settings.map, &mut settings.map_text, seed)?)
    }

    fn adopt(typed: &mut Settings, own: &Settings) {
        typed.map_text.clone_from(&own.map_text);
    }

    fn presets() -> &'static [Preset] {
        &[
            Preset { name: "maze-small", text: include_str!("presets/maze-small.toml") },
            Preset { name: "maze30", text: include_str!("presets/maze30.toml") },
        ]
    }

    /// The path of an optimal mentor.
    fn plan(
        settings: &Settings,
        _env: &config::Env,
        actions: &str,
    ) -> Result<Option<Vec<Vec<f32>>>, EnvError> {
        let map = settings.map()?;
        let set = settings.action_set("mentor.actions", actions)?;
        let path = mentor_path(&settings.map, &map, &set)?;
        Ok(Some(path.into_iter().map(|cell| observation(cell).to_vec()).collect()))
    }

    fn cells(settings: &Settings, actions: &str) -> Result<Option<(Map, ActionSet)>, EnvError> {
        Ok(Some((settings.map()?, settings.action_set("mentor.actions", actions)?)))
    }

    fn draw(settings: &Settings, paths: &[(&[f32], char)]) -> Result<Option<String>, EnvError> {
        Ok(Some(draw::draw(&settings.map()?, paths)))
    }

    fn ground(settings: &Settings) -> Result<Option<Box<dyn Ground>>, EnvError> {
        Ok(Some(Box::new(ground::Cells(settings.map()?))))
    }
}
