//! Learned bridges (ours, not the paper's): a small policy π(a | s, g) that leads from any state to one nearby, learnt in
//! hindsight from the observer's own steps. It explores along the mentor's path, and leads back onto the observer's own.
//!
//! [`crate::bridge`] finds bridges that the observer has walked. π generalises over them, and needs no threshold at which
//! the bodies of mentor and observer count as similar. Its parts, in reading order:
//!
//! 1. [`goal`]: what π sees of a state and a goal, and its softmax;
//! 2. [`hindsight`]: how it is learnt, as in goal-conditioned supervised learning (Ghosh et al. 2021): the action a_t that
//!    was taken in s_t is a good one for reaching s_(t+h), whatever was wanted at the time;
//! 3. [`path`]: the mentor's path as points and lengths, and the state to aim at;
//! 4. [`tracker`]: how far along the path an episode is, in which episodes the guide is used, and where it lets go;
//! 5. [`own`]: how the observer itself once came to success, which takes the mentor's place;
//! 6. [`correction`]: what π would do where the observer has left such a path by a little;
//! 7. [`imitation`]: how the Q-network imitates both;
//! 8. [`setup`]: all of these for a run.
//!
//! Q-learning trains on the real rewards of what was done, and knows nothing of the mentor's path. π draws an exploring step's action,
//! with a probability that falls with ε; drawing rather than taking the likeliest keeps it from repeating a mistake for
//! ever.

pub mod correction;
pub mod goal;
pub mod hindsight;
pub mod imitation;
pub mod own;
pub mod path;
pub mod setup;
pub mod tracker;

#[cfg(test)]
mod tests;

pub use correction::{Correction, CorrectionConfig};
pub use goal::{Goal, draw, softmax};
pub use hindsight::{Hindsight, HindsightConfig, HindsightState};
pub use imitation::{Imitation, ImitationConfig};
pub use own::{OwnPath, OwnPaths};
pub use path::{Path, Paths, Place};
pub use setup::{LearnedError, hindsight_of, imitation_of, own_of, path_of, paths_of, policy_of, resolve};
pub use tracker::{Pace, Tracker};
