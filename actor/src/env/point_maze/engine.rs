//! What computes the physics: the built-in equations or MuJoCo.

use super::geometry::{Geometry, Vector};
use super::mujoco::{self, MujocoError, Simulation};
use super::physics::{Body, Physics};
use super::{Backend, Settings};
use crate::env::EnvError;
use trestle_proto::config::Table;

/// Settings that still say `auto`.
#[derive(Debug, thiserror::Error)]
#[error("the configuration is not resolved: env.backend is auto")]
struct Unresolved;

/// A simulation of one maze.
pub(super) enum Engine {
    Builtin(Physics),
    Mujoco(Simulation),
}

impl Engine {
    /// The engine of resolved settings.
    pub(super) fn new(settings: &Settings, geometry: &Geometry) -> Result<Self, EnvError> {
        match settings.backend {
            Backend::Auto => Err(EnvError::own(Unresolved)),
            Backend::Builtin => Ok(Self::Builtin(Physics::new(geometry.clone(), settings.contact_margin))),
            Backend::Mujoco => {
                let library = mujoco::library()?;
                Ok(Self::Mujoco(library.simulation(geometry, settings.contact_margin)?))
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
pub(super) fn resolve(settings: &mut Settings, geometry: &Geometry) -> Result<(), EnvError> {
    let too_large = || geometry.walls().len() > mujoco::MAX_WALLS;
    settings.backend = match settings.backend {
        Backend::Builtin => Backend::Builtin,
        Backend::Mujoco => mujoco::library().map(|_| Backend::Mujoco)?,
        Backend::Auto => match mujoco::library() {
            Ok(_) if too_large() => Backend::Builtin,
            Ok(_) => Backend::Mujoco,
            Err(MujocoError::Missing { .. }) => Backend::Builtin,
            // Somebody has named a library, and it does not work.
            Err(error) => return Err(error.into()),
        },
    };
    Ok(())
}

/// What computes the physics of resolved settings: back end, margin, and of MuJoCo the version and the file.
pub(super) fn engine(settings: &Settings) -> Table {
    let library = (settings.backend == Backend::Mujoco).then(|| mujoco::library().ok()).flatten();
    let mut engine = Table::new();
    engine.insert("backend".into(), settings.backend.name().into());
    engine.insert("contact_margin".into(), settings.contact_margin.into());
    if let Some(library) = library {
        engine.insert("version".into(), library.version().to_string().into());
        engine.insert("library".into(), library.path().display().to_string().into());
    }
    engine
}
