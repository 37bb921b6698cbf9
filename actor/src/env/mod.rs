//! The interface of an environment, shaped like Gymnasium's, and the registry of the environments to choose from.
//!
//! An environment is a folder here and a line of [`Registry::builtin`] in this file, which is all that names it; several of them
//! share `grid`. Nothing outside an environment's folder knows its settings: configurations carry them as data, and only its
//! [`Kind`] reads them.
//!
//! What differs from Gymnasium: `reset` takes a random stream instead of a seed, so that the stream can be saved
//! with the run; observations are written into the caller's buffer; an environment can be saved and restored in
//! the middle of an episode.

mod check;
mod error;
pub mod grid;
mod ground;
pub mod gym;
pub mod hazard;
mod kind;
pub mod maze;
pub mod point_maze;
mod program;
mod registry;

#[cfg(test)]
mod conformance;

pub use check::check;
pub use error::EnvError;
pub use ground::Ground;
pub use kind::{Finding, Foreign, Kind};
pub use program::{Identity, again, build, identify};
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

/// A picture of an environment: rows of pixels from the top left, three bytes each, red, green and blue.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Frame {
    /// Pixels of a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height * width * 3]`
    pub rgb: Vec<u8>,
}

/// An environment with discrete actions and a fixed number of `f32` features.
pub trait Environment: Send {
    /// Spaces, names and the best possible return. Does not change during the environment's life.
    fn spec(&self) -> &EnvSpec;

    /// Begins an episode and writes its first observation into `obs` (`[obs_dim]`). All randomness of the reset
    /// comes from `rng`.
    ///
    /// # Errors
    /// What only the environment itself knows.
    fn reset(&mut self, rng: &mut Stream, obs: &mut [f32]) -> Result<(), EnvError>;

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
    /// Bytes that are damaged, or no state of this environment: it is unchanged then. An episode that has to be played again and
    /// comes out otherwise: then none is running.
    fn restore(&mut self, bytes: &[u8]) -> Result<(), EnvError>;

    /// What the features of an observation are called, in their order; none where they have no names.
    fn features(&self) -> Vec<&str> {
        Vec::new()
    }

    /// Whether a snapshot holds the whole state. An environment that cannot promise it begins a new episode where another
    /// would be restored, and its runs do not repeat.
    fn repeats(&self) -> bool {
        true
    }

    /// What it looks like now; none where it has no pictures, or was not made for them by [`Kind::filmed`].
    ///
    /// # Errors
    /// What only the environment itself knows.
    fn frame(&mut self) -> Result<Option<Frame>, EnvError> {
        Ok(None)
    }

    /// Whether [`Environment::put`] can begin an episode in other states than the environment itself does.
    fn can_be_put(&self) -> bool {
        false
    }

    /// Begins an episode in `state` (`[obs_dim]`), as if it were the first of one, and writes what is observed into `obs`. Whether
    /// it has: not in a terminal state, nor in one that cannot be, which leaves all as it was.
    ///
    /// # Errors
    /// What only the environment itself knows.
    fn put(&mut self, _state: &[f32], _obs: &mut [f32]) -> Result<bool, EnvError> {
        Ok(false)
    }

    /// Whether the environment can ever be in the state that is observed as `state` (`[obs_dim]`): what a demonstration of
    /// it may hold. The default looks at the spaces alone.
    ///
    /// # Errors
    /// Why it cannot.
    fn can_be_in(&self, state: &[f32]) -> Result<(), Impossible> {
        within(self.spec(), state)
    }
}

/// Why an environment cannot be in a state.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Impossible {
    /// A feature that is out of its range.
    #[error("feature {feature} is {value}; accepted: {kind}{low} to {high}", kind = if *.integral { "whole numbers from " } else { "" })]
    Range {
        /// Which feature.
        feature: usize,
        /// Its value.
        value: f32,
        /// The smallest that it can have.
        low: f32,
        /// The largest.
        high: f32,
        /// Whether it is a whole number.
        integral: bool,
    },
    /// A place that is taken by a wall.
    #[error("it lies in the wall at column {column}, row {row} of the map")]
    Wall {
        /// Column of the map, from 0.
        column: isize,
        /// Row of the map, from 0.
        row: isize,
    },
}

/// Whether each feature of `state` is in its range.
fn within(spec: &EnvSpec, state: &[f32]) -> Result<(), Impossible> {
    for (feature, &value) in state.iter().enumerate() {
        let (low, high, integral) = (spec.low[feature], spec.high[feature], spec.integral);
        if !(low..=high).contains(&value) || (integral && value.fract() != 0.0) {
            return Err(Impossible::Range { feature, value, low, high, integral });
        }
    }
    Ok(())
}

impl Registry {
    /// The environments that come with Trestle: a line each.
    pub fn builtin() -> Self {
        Self::default()
            .with::<maze::Maze>("maze")
            .with::<point_maze::PointMaze>("point-maze")
            .with::<gym::Gym>("gym")
    }
}
