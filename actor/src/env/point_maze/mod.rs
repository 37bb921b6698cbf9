//! The Point Maze: a ball with inertia, pushed through a maze of walls, as in D4RL's maze2d and Gymnasium-Robotics'
//! PointMaze.
//!
//! * [`Settings`]: its table of a configuration;
//! * [`Geometry`]: which point lies in which cell of the map, in either layout;
//! * `actions`: compass directions as forces;
//! * [`Physics`]: one step of the simulation in Rust, the back end `builtin`;
//! * [`mujoco`]: the same step by MuJoCo itself, loaded at run time;
//! * [`PointMaze`]: the environment;
//! * `controller`: a mentor that follows the shortest path; `draw`: paths over the maze, as text; `ground`: the same for
//!   reports;
//! * `presets/`: configurations that are compiled in.

mod actions;
mod controller;
mod draw;
mod engine;
mod environment;
mod geometry;
mod ground;
pub mod mujoco;
mod physics;
mod settings;

pub use actions::{DIAGONAL, ORTHOGONAL};
pub use environment::{PointMaze, STEP_REWARD};
pub use geometry::{Geometry, Vector};
pub use physics::{Body, GEAR, MASS, Physics, RADIUS, SPEED_LIMIT, TIMESTEP};
pub use settings::{Backend, Layout, Reset, Settings};

use super::{EnvError, Finding, Ground, Kind, grid};
use trestle_proto::config::{self, Config, ConfigError, Preset, Table, refuse};

/// A controller that does not get there.
#[derive(Debug, thiserror::Error)]
#[error(
    "mentor.demo = plan: with the action set {actions} the controller has not reached the goal after env.step_limit = \
     {steps} steps; accepted: another mentor.actions, a smaller env.frame_skip, or a demonstration"
)]
struct PlanError {
    /// The mentor's action set.
    actions: String,
    /// Steps that it took.
    steps: u32,
}

impl Kind for PointMaze {
    type Settings = Settings;

    const ABOUT: &'static str = "A ball with inertia that motors push through a maze of walls.";

    const FILLED: &'static [&'static str] = &["map_text"];

    fn new(settings: &Settings, env: &config::Env) -> Result<Self, EnvError> {
        Self::of(settings, env.step_limit)
    }

    fn resolve(settings: &mut Settings, _env: &config::Env, seed: u64) -> Result<(), EnvError> {
        grid::resolve(&settings.map, &mut settings.map_text, seed)?;
        let geometry = settings.geometry()?;
        engine::resolve(settings, &geometry)
    }

    fn adopt(typed: &mut Settings, own: &Settings) {
        typed.map_text.clone_from(&own.map_text);
        if typed.backend == Backend::Auto {
            typed.backend = own.backend;
        }
    }

    /// No episode that is cut off may count as solved: every step costs 0.001, and such an episode has cost `step_limit` of
    /// them.
    fn check(_settings: &Settings, config: &Config) -> Result<(), ConfigError> {
        let (eval, limit) = (&config.eval, config.env.step_limit);
        let worst = -0.001 * f64::from(limit);
        match eval.threshold.filter(|threshold| threshold - eval.tolerance <= worst) {
            Some(threshold) => {
                let accepted = format!(
                    "with eval.tolerance = {} and env.step_limit = {limit}, above {:.3}: else an episode that never reaches \
                     the goal would count as solved",
                    eval.tolerance,
                    eval.tolerance + worst
                );
                Err(refuse("eval.threshold", threshold, &accepted))
            }
            None => Ok(()),
        }
    }

    fn presets() -> &'static [Preset] {
        &[
            Preset { name: "point-umaze", text: include_str!("presets/point-umaze.toml") },
            Preset { name: "point-maze", text: include_str!("presets/point-maze.toml") },
        ]
    }

    /// The states of a controller, which is careful rather than fast.
    fn plan(
        settings: &Settings,
        env: &config::Env,
        actions: &str,
    ) -> Result<Option<Vec<Vec<f32>>>, EnvError> {
        controller::plan_states(settings, env.step_limit, actions).map(Some)
    }

    fn draw(settings: &Settings, paths: &[(&[f32], char)]) -> Result<Option<String>, EnvError> {
        Ok(Some(draw::draw(&settings.geometry()?, paths)))
    }

    fn ground(settings: &Settings) -> Result<Option<Box<dyn Ground>>, EnvError> {
        Ok(Some(Box::new(ground::Plane(settings.geometry()?))))
    }

    fn engine(settings: &Settings) -> Option<Table> {
        Some(engine::engine(settings))
    }

    fn diagnose() -> Vec<Finding> {
        mujoco::diagnose()
    }
}
