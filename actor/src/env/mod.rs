//! The interface of an environment, shaped like Gymnasium's, and the registry of those that a configuration can choose.
//!
//! An environment is a folder here and a line of [`Registry::builtin`] in this file, which is all that names it; `grid` is what
//! several of them share. Nothing outside
//! an environment's folder knows its settings: configurations carry them as data, and only its [`Kind`] reads them.
//!
//! What differs from Gymnasium: `reset` takes a random stream instead of a seed, so that the stream can be saved
//! with the run; observations are written into the caller's buffer; an environment can be saved and restored in
//! the middle of an episode.

mod error;
pub mod grid;
mod ground;
pub mod hazard;
mod kind;
pub mod maze;
pub mod point_maze;
mod registry;

#[cfg(test)]
mod conformance;

pub use error::EnvError;
pub use ground::Ground;
pub use kind::{Finding, Kind};
pub use registry::{Registry, install, registry};

use trestle_proto::rng::Stream;
use trestle_proto::space::EnvSpec;

/// What a step gives besides the next observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Reward of the step.
    pub reward: f32,
    /// The state reached is terminal: the episode is over and the state's value is 0.
    pub terminated: bool,
    /// The episode is over because of a limit; the state reached still has a value. Never together with
    /// `terminated`.
    pub truncated: bool,
    /// The episode has succeeded with this step. Only where [`EnvSpec::defines_success`]; false otherwise.
    pub success: bool,
}

/// An environment with discrete actions and a fixed number of `f32` features.
pub trait Environment: Send {
    /// Spaces, names and the best possible return. Does not change during the environment's life.
    fn spec(&self) -> &EnvSpec;

    /// Begins an episode and writes its first observation into `obs` (`[obs_dim]`). All randomness of the reset
    /// comes from `rng`.
    fn reset(&mut self, rng: &mut Stream, obs: &mut [f32]);

    /// Takes `action` and writes the observation of the state reached into `obs` (`[obs_dim]`), also where the
    /// episode ends.
    ///
    /// # Errors
    /// [`EnvError::Ended`] before the first reset and after the end of an episode, [`EnvError::Action`] for an
    /// action outside the action space. Neither changes the environment or `obs`.
    fn step(&mut self, action: u32, obs: &mut [f32]) -> Result<Step, EnvError>;

    /// The whole state as bytes, for [`Environment::restore`] of an environment with the same configuration.
    /// Equal states give equal bytes.
    ///
    /// # Errors
    /// A state that the codec cannot write.
    fn snapshot(&self) -> Result<Vec<u8>, EnvError>;

    /// Takes over the state in `bytes`: from then on every step is what it would have been.
    ///
    /// # Errors
    /// Bytes that are damaged, or no state of this environment; it is unchanged then.
    fn restore(&mut self, bytes: &[u8]) -> Result<(), EnvError>;
}

impl Registry {
    /// The environments that come with Trestle: a line each.
    pub fn builtin() -> Self {
        Self::default().with::<maze::Maze>("maze").with::<point_maze::PointMaze>("point-maze")
    }
}
