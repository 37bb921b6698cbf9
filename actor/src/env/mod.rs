//! The interface of an environment, shaped like Gymnasium's, and what makes one from a configuration.
//!
//! What differs from Gymnasium: `reset` takes a random stream instead of a seed, so that the stream can be saved
//! with the run; observations are written into the caller's buffer; an environment can be saved and restored in
//! the middle of an episode.

mod error;
mod ground;
pub mod hazard;
pub mod maze;
pub mod point_maze;

#[cfg(test)]
mod conformance;

pub use error::EnvError;
pub use ground::Ground;

use trestle_proto::config::{self, EnvKind};
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

/// Completes `env` so that [`build`] needs nothing but `env` itself: reads or generates the map that `env.map`
/// names and writes it to `env.layout`, and decides what computes the physics. `seed` is the run's seed, for maps that are random by it.
///
/// # Errors
/// A map that does not exist or cannot be used, or a layout that is given and is another map than the one that
/// `env.map` names.
pub fn resolve(env: &mut config::Env, seed: u64) -> Result<(), EnvError> {
    match env.kind {
        EnvKind::Maze => maze::resolve(env, seed),
        EnvKind::PointMaze => {
            maze::resolve(env, seed)?;
            point_maze::resolve(env)
        }
    }
}

/// The environment of a resolved configuration (see [`resolve`]).
///
/// # Errors
/// Whatever the configuration asks for and the environment does not accept.
pub fn build(env: &config::Env) -> Result<Box<dyn Environment>, EnvError> {
    match env.kind {
        EnvKind::Maze => Ok(Box::new(maze::Maze::new(env)?)),
        EnvKind::PointMaze => Ok(Box::new(point_maze::PointMaze::new(env)?)),
    }
}

/// The demonstration `plan`: states of a mentor, optimal in a maze of cells and careful in the Point Maze, that acts with the action set `mentor_actions`, from the
/// start to the goal, `[obs_dim]` features each. The last state is terminal.
///
/// # Errors
/// An unknown action set, or a goal that it does not reach.
pub fn plan_states(env: &config::Env, mentor_actions: &str) -> Result<Vec<Vec<f32>>, EnvError> {
    match env.kind {
        EnvKind::Maze => maze::plan_states(env, mentor_actions),
        EnvKind::PointMaze => point_maze::plan_states(env, mentor_actions),
    }
}

/// The environment of a resolved configuration as text for a terminal, with paths of states and the mark of each
/// laid over it; where two meet, the later one is seen.
///
/// # Errors
/// There is no map.
pub fn draw(env: &config::Env, paths: &[(&[f32], char)]) -> Result<String, EnvError> {
    let map = maze::map_of(env)?;
    Ok(match env.kind {
        EnvKind::Maze => {
            let cells: Vec<_> = paths.iter().map(|(states, mark)| (maze::cells(states), *mark)).collect();
            let paths: Vec<_> = cells.iter().map(|(cells, mark)| (cells.as_slice(), *mark)).collect();
            maze::draw(&map, &paths)
        }
        EnvKind::PointMaze => point_maze::draw(&point_maze::Geometry::new(map, env.point_maze.layout), paths),
    })
}
