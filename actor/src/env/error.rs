//! What can be wrong with an environment's configuration, a step or a snapshot.

use super::maze::MapError;
use super::point_maze::mujoco::MujocoError;
use std::path::PathBuf;
use trestle_proto::codec::CodecError;
use trestle_proto::limits::{MAX_MAP_SIDE, MAX_TEXT_BYTES};
use trestle_proto::space::SpaceError;

/// An environment that cannot be made, stepped or restored.
#[derive(Debug, thiserror::Error)]
pub enum EnvError {
    /// The map's text is not a map, or its goal cannot be reached.
    #[error(transparent)]
    Map(#[from] MapError),
    /// Neither a built-in map nor a file.
    #[error(
        "env.map = {name}; accepted: {builtin}, an existing file, or random:<seed>:<columns>x<rows>",
        builtin = super::maze::builtin_names()
    )]
    UnknownMap {
        /// What was asked for.
        name: String,
    },
    /// A map file that cannot be read.
    #[error("env.map = {path}: {message}")]
    ReadMap {
        /// The file.
        path: PathBuf,
        /// The reason.
        message: String,
    },
    /// A map file that is too large to be one.
    #[error("env.map = {path}: {bytes} bytes; accepted: up to {MAX_TEXT_BYTES}")]
    MapBytes {
        /// The file.
        path: PathBuf,
        /// Its size.
        bytes: u64,
    },
    /// A description of a random map that is none.
    #[error(
        "env.map = {name}; accepted: random:<seed>:<columns>x<rows> with a whole number or `run` as the seed and \
         4 to {MAX_MAP_SIDE} columns and rows"
    )]
    RandomMap {
        /// What was asked for.
        name: String,
    },
    /// `env.layout` is given and is not the map that `env.map` names.
    #[error(
        "env.layout is given and is not the map that env.map = {name} names; leave one of the two out, or make \
         them agree"
    )]
    Layout {
        /// Name of the map.
        name: String,
    },
    /// The configuration has not been resolved.
    #[error("the configuration is not resolved: env.layout is missing, or env.point_maze.backend is auto")]
    Unresolved,
    /// An action set that nobody has defined.
    #[error("{key} = {name}; action sets: {known}")]
    ActionSet {
        /// The setting that names it.
        key: &'static str,
        /// The name.
        name: String,
        /// Those that exist.
        known: String,
    },
    /// An action set of the configuration that cannot be used.
    #[error("env.action_sets.{name}: {message}")]
    ActionSetDefinition {
        /// Name of the set.
        name: String,
        /// What is wrong, and what is accepted.
        message: String,
    },
    /// MuJoCo is not there, or fails.
    #[error("env.point_maze.backend: {0}")]
    Mujoco(#[from] MujocoError),
    /// A controller that does not get there.
    #[error(
        "mentor.demo = plan: with the action set {actions} the controller has not reached the goal after \
         env.step_limit = {steps} steps; accepted: another mentor.actions, a smaller env.point_maze.frame_skip, or a \
         demonstration"
    )]
    Plan {
        /// The mentor's action set.
        actions: String,
        /// Steps that it took.
        steps: u32,
    },
    /// Spaces that the other processes do not accept.
    #[error(transparent)]
    Space(#[from] SpaceError),
    /// An action outside the action space.
    #[error("action {action}; accepted: 0 to {last}")]
    Action {
        /// The action.
        action: u32,
        /// The largest one.
        last: usize,
    },
    /// A step where there is no episode.
    #[error("a step without an episode: the environment must be reset first")]
    Ended,
    /// What `env.hazard.kind = "error"` asks for.
    #[error("env.hazard: the error that was asked for, after {after} steps of the process")]
    Hazard {
        /// Steps that the process has taken.
        after: u64,
    },
    /// A snapshot that cannot be written or read.
    #[error("snapshot of an environment: {0}")]
    Snapshot(#[from] CodecError),
    /// A snapshot that is sound, but of another environment.
    #[error("snapshot of an environment: {what} does not fit {name}")]
    Foreign {
        /// Name of the environment.
        name: String,
        /// What does not fit.
        what: &'static str,
    },
}
