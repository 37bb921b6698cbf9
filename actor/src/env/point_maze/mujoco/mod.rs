//! The back end `mujoco`: the real engine, loaded at run time. Building Trestle needs nothing of it.
//!
//! * `library`: where libmujoco is looked for, and which of what is found is used;
//! * `api`: its functions, and what differs between its versions;
//! * `model`: the maze as a model in MuJoCo's XML;
//! * [`Simulation`]: a model with its state.

mod api;
mod library;
mod model;
mod simulation;

pub use api::Version;
pub use library::{Found, find, library};
pub use model::MAX_WALLS;
pub use simulation::Simulation;

#[cfg(test)]
mod tests;

use crate::env::{EnvError, Finding};
use std::path::PathBuf;

/// MuJoCo that cannot be had, or does not do what it is asked for.
#[derive(Clone, Debug, thiserror::Error)]
pub enum MujocoError {
    /// No library.
    #[error("libmujoco was not found; looked at: {tried}; `deploy/fetch-mujoco.sh` gets it")]
    Missing {
        /// Places, and what was wrong with them.
        tried: String,
    },
    /// A library that cannot be loaded.
    #[error("{path}: {message}")]
    Load {
        /// The file.
        path: PathBuf,
        /// What the loader says.
        message: String,
    },
    /// A version that is not known to work.
    #[error("{path} is MuJoCo {version}; accepted: 2.3.7 to 4.x")]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// Its version.
        version: Version,
    },
    /// A library that computes something else.
    #[error(
        "{path}, MuJoCo {version}, steps to {found:?} where the same model leads to {expected:?}; accepted: a version \
         that agrees with the built-in physics"
    )]
    Differs {
        /// The file.
        path: PathBuf,
        /// Its version.
        version: Version,
        /// Position and velocity that it computes.
        found: [f64; 4],
        /// Those of the built-in physics.
        expected: [f64; 4],
    },
    /// A maze with too many walls for one model.
    #[error("the map has {walls} walls beside free cells; accepted with the back end mujoco: up to {most}")]
    Walls {
        /// Their number.
        walls: usize,
        /// The most.
        most: usize,
    },
    /// MuJoCo refuses the model.
    #[error("MuJoCo does not accept the model of the maze: {message}")]
    Model {
        /// Its words.
        message: String,
    },
    /// MuJoCo reports an error or a warning while it simulates.
    #[error("MuJoCo: {message}")]
    Simulation {
        /// Its words.
        message: String,
    },
}

impl From<MujocoError> for EnvError {
    fn from(error: MujocoError) -> Self {
        Self::own(BackendError(error))
    }
}

/// MuJoCo that cannot be had, as the setting that asks for it.
#[derive(Debug, thiserror::Error)]
#[error("env.backend: {0}")]
struct BackendError(MujocoError);

/// What a Point Maze would be computed by on this machine, and why.
pub(super) fn diagnose() -> Vec<Finding> {
    let finding = |sound, text: String| Finding { sound, text: format!("Point Maze: {text}") };
    match find() {
        Ok(found) => {
            let passed_over =
                found.passed_over().iter().map(|reason| finding(true, format!("passed over {reason}")));
            let used = format!("MuJoCo {}, {}", found.version(), found.path().display());
            passed_over.chain([finding(true, used)]).collect()
        }
        Err(error @ MujocoError::Missing { .. }) => {
            vec![finding(true, format!("built-in physics, because {error}"))]
        }
        Err(error) => {
            vec![finding(false, format!("MUJOCO_LIB names a library that cannot be used: {error}"))]
        }
    }
}
