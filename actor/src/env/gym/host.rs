//! Who steps an environment: the Python of this process. A program without Python has none.

use super::{Found, GymError, Settings};
use crate::env::Frame;
use std::sync::OnceLock;

/// What a step gives, besides the observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// Reward.
    pub reward: f32,
    /// As Gymnasium means it: the state is terminal.
    pub terminated: bool,
    /// As Gymnasium means it: the episode is over for another reason.
    pub truncated: bool,
    /// The episode has succeeded so far, if the environment says so: `info["is_success"]`.
    pub success: bool,
}

/// An environment of Gymnasium's interface.
pub trait Simulator: Send {
    /// Begins an episode whose randomness comes from `seed`, and writes the features of its first observation.
    ///
    /// # Errors
    /// What the environment raises, or an observation that does not fit its space.
    fn reset(&mut self, seed: u32, obs: &mut [f32]) -> Result<(), GymError>;

    /// Takes `action`, an index into the found actions, and writes the features of the observation.
    ///
    /// # Errors
    /// As [`Simulator::reset`].
    fn step(&mut self, action: usize, obs: &mut [f32]) -> Result<Outcome, GymError>;

    /// What it looks like now; none where it is not made for pictures.
    ///
    /// # Errors
    /// As [`Simulator::reset`].
    fn frame(&mut self) -> Result<Option<Frame>, GymError> {
        Ok(None)
    }
}

/// An environment, or why there is none.
pub type Made = Result<Box<dyn Simulator>, GymError>;

/// Makes environments.
#[derive(Clone, Copy)]
pub struct Host {
    /// The environment of these settings, as it was found.
    pub make: fn(&Settings, &Found) -> Made,
}

static HOST: OnceLock<Host> = OnceLock::new();

/// Makes `host` that of this process, once and before anything else.
///
/// # Errors
/// There is one already; `host` comes back.
pub fn install_host(host: Host) -> Result<(), Host> {
    HOST.set(host)
}

/// The host of this process.
pub(super) fn host() -> Option<Host> {
    #[cfg(test)]
    return Some(super::tests::HOST);
    #[cfg(not(test))]
    HOST.get().copied()
}
