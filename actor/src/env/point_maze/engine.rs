//! What computes the physics: the built-in equations or MuJoCo.

use super::geometry::{Geometry, Vector};
use super::mujoco::{self, MujocoError, Simulation};
use super::physics::{Body, Physics};
use crate::env::EnvError;
use serde::Serialize;
use std::path::PathBuf;
use trestle_proto::config::{self, PhysicsBackend};

/// A simulation of one maze.
pub(super) enum Engine {
    Builtin(Physics),
    Mujoco(Simulation),
}

impl Engine {
    /// The engine of a resolved configuration.
    pub(super) fn new(point: &config::PointMaze, geometry: &Geometry) -> Result<Self, EnvError> {
        match point.backend {
            PhysicsBackend::Auto => Err(EnvError::Unresolved),
            PhysicsBackend::Builtin => {
                Ok(Self::Builtin(Physics::new(geometry.clone(), point.contact_margin)))
            }
            PhysicsBackend::Mujoco => {
                let library = mujoco::library()?;
                Ok(Self::Mujoco(Simulation::new(library, geometry, point.contact_margin)?))
            }
        }
    }

    /// A step of the environment: cuts the velocity off, then simulates `frames` steps with the same control. `body` is
    /// unchanged after an error.
    pub(super) fn advance(
        &mut self,
        body: &mut Body,
        control: Vector,
        frames: u32,
    ) -> Result<(), MujocoError> {
        let mut moving = body.limited();
        match self {
            Self::Builtin(physics) => physics.advance(&mut moving, control, frames),
            Self::Mujoco(simulation) => simulation.advance(&mut moving, control, frames)?,
        }
        *body = moving;
        Ok(())
    }
}

/// Puts what is used into the place of `auto`, and sees that MuJoCo is there where it is asked for.
pub(super) fn resolve(point: &mut config::PointMaze, geometry: &Geometry) -> Result<(), EnvError> {
    let too_large = || geometry.walls().len() > mujoco::MAX_WALLS;
    point.backend = match point.backend {
        PhysicsBackend::Builtin => PhysicsBackend::Builtin,
        PhysicsBackend::Mujoco => mujoco::library().map(|_| PhysicsBackend::Mujoco)?,
        PhysicsBackend::Auto => match mujoco::library() {
            Ok(_) if too_large() => PhysicsBackend::Builtin,
            Ok(_) => PhysicsBackend::Mujoco,
            Err(MujocoError::Missing { .. }) => PhysicsBackend::Builtin,
            // Somebody has named a library, and it does not work.
            Err(error) => return Err(error.into()),
        },
    };
    Ok(())
}

/// What a run's physics comes from, for its records.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EngineInfo {
    /// `builtin` or `mujoco`.
    pub backend: &'static str,
    /// MuJoCo's version.
    pub version: Option<String>,
    /// MuJoCo's file.
    pub library: Option<PathBuf>,
    /// Distance in metres at which a wall begins to push.
    pub contact_margin: f64,
}

/// The engine that a resolved configuration's Point Maze uses; `None` where there is no Point Maze.
pub fn engine_info(env: &config::Env) -> Option<EngineInfo> {
    if env.kind != config::EnvKind::PointMaze {
        return None;
    }
    let point = &env.point_maze;
    let library = (point.backend == PhysicsBackend::Mujoco).then(|| mujoco::library().ok()).flatten();
    Some(EngineInfo {
        backend: point.backend.name(),
        version: library.map(|library| library.version().to_string()),
        library: library.map(|library| library.path().into()),
        contact_margin: point.contact_margin,
    })
}
