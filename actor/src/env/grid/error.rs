//! What can be wrong with a map or an action set that a configuration names.

use super::map::MapError;
use super::source::{builtin_names, generator_names};
use crate::env::EnvError;
use trestle_proto::limits::MAX_MAP_SIDE;
use trestle_proto::regular_file::FileError;

/// A map or an action set that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum GridError {
    /// The map's text is not a map, or its goal cannot be reached.
    #[error(transparent)]
    Map(#[from] MapError),
    /// Neither a built-in map nor a file.
    #[error(
        "env.map = {name}; accepted: {builtin}, an existing file, or <generator>:<seed>:<columns>x<rows> with one of the \
         generators {generators}{hint}",
        builtin = builtin_names(),
        generators = generator_names()
    )]
    UnknownMap {
        /// What was asked for.
        name: String,
        /// The nearest built-in map, if one is near.
        hint: String,
    },
    /// A map file that cannot be read, or is too large to be one.
    #[error("env.map = {0}")]
    ReadMap(FileError),
    /// A description of a random map that is none.
    #[error(
        "env.map = {name}; accepted: <generator>:<seed>:<columns>x<rows> with a whole number or `run` as the seed and \
         {least} to {MAX_MAP_SIDE} columns and rows"
    )]
    RandomMap {
        /// What was asked for.
        name: String,
        /// Fewest columns and rows of the generator.
        least: usize,
    },
    /// `env.map_text` is given and is not the map that `env.map` names.
    #[error(
        "env.map_text is given and is not the map that env.map = {name} names; leave one of the two out, or make \
         them agree"
    )]
    Text {
        /// Name of the map.
        name: String,
    },
    /// The configuration has not been resolved.
    #[error("the configuration is not resolved: env.map_text is missing")]
    Unresolved,
    /// An action set that nobody has defined.
    #[error("{key} = {name}; action sets: {known}{hint}")]
    ActionSet {
        /// The setting that names it.
        key: &'static str,
        /// The name.
        name: String,
        /// Those that exist.
        known: String,
        /// The nearest of them, if one is near.
        hint: String,
    },
    /// An action set of the configuration that cannot be used.
    #[error("env.action_sets.{name}: {message}")]
    ActionSetDefinition {
        /// Name of the set.
        name: String,
        /// What is wrong, and what is accepted.
        message: String,
    },
}

impl From<GridError> for EnvError {
    fn from(error: GridError) -> Self {
        Self::own(error)
    }
}

impl From<MapError> for EnvError {
    fn from(error: MapError) -> Self {
        Self::own(error)
    }
}
