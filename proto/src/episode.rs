//! What an episode came to.

use serde::{Deserialize, Serialize};

/// A finished episode, of training or of an evaluation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// Undiscounted sum of the rewards, finite.
    pub total_reward: f64,
    /// Steps.
    pub length: u64,
    /// Whether it succeeded; none where neither the environment nor a threshold says so.
    pub success: Option<bool>,
}
