//! What can keep an agent from being made, fed or trained.

use crate::replay::ReplayMemoryError;
use crate::rivals::RivalError;
use crate::selection::SelectionError;
use trestle_proto::annotation::AnnotationError;
use trestle_qnet::{AdamError, LossError, NetworkError, PlanError};

/// Why an agent cannot be made or cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum AgentError {
    /// A rival that cannot be made.
    #[error(transparent)]
    Rival(#[from] RivalError),
    /// The network's sizes or its input's encoding.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// A setting of the optimiser.
    #[error(transparent)]
    Adam(#[from] AdamError),
    /// A setting of the loss.
    #[error(transparent)]
    Loss(#[from] LossError),
    /// The parameters.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// candle's automatic differentiation (`learner.backend = "candle"`).
    #[error("candle failed: {0}")]
    Candle(#[from] candle_core::Error),
    /// The replay.
    #[error(transparent)]
    Replay(#[from] ReplayMemoryError),
    /// The rule that weighs the mentor's loss.
    #[error(transparent)]
    Selection(#[from] SelectionError),
    /// An annotation of the mentor-server.
    #[error(transparent)]
    Annotation(#[from] AnnotationError),
    /// The demonstration is not the experiment's.
    #[error("run.algo = {algo}: {what} is {found}; accepted: {accepted}")]
    Mentor {
        /// The algorithm.
        algo: &'static str,
        /// What does not fit.
        what: &'static str,
        /// Its value.
        found: usize,
        /// What is accepted.
        accepted: usize,
    },
    /// An answer of the mentor-server that does not belong to the batch.
    #[error("batch of actor {actor}: {what} is {found}; accepted: {accepted}")]
    Batch {
        /// The batch's actor.
        actor: u32,
        /// What does not fit.
        what: &'static str,
        /// Its value.
        found: usize,
        /// What is accepted.
        accepted: usize,
    },
    /// A saved state that is not of this run, or whose parts do not belong together.
    #[error("saved state: {what} is {found}; accepted: {accepted}")]
    Restore {
        /// What does not fit.
        what: &'static str,
        /// Its value.
        found: u64,
        /// What is accepted.
        accepted: u64,
    },
    /// What a rival is to remember is not of this run.
    #[error(
        "saved state: what the rival remembers is of another rival, network or replay; accepted: that of this run"
    )]
    RivalState,
    /// Training has diverged.
    #[error(
        "{what} is no longer finite after {grad_steps} gradient steps: training has diverged; a smaller learner.lr \
         or a learner.max_grad_norm above 0 may help"
    )]
    Diverged {
        /// The loss, or the weights.
        what: &'static str,
        /// Gradient steps taken.
        grad_steps: u64,
    },
    /// Training of the guiding policy has diverged.
    #[error(
        "the loss of learned bridges is no longer finite after {grad_steps} gradient steps: a smaller mentor.learned.lr may \
         help"
    )]
    PolicyDiverged {
        /// Gradient steps taken.
        grad_steps: u64,
    },
}
