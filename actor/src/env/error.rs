//! What can be wrong with an environment's configuration, a step or a snapshot.

use trestle_proto::codec::CodecError;
use trestle_proto::config::ConfigError;
use trestle_proto::space::SpaceError;

/// An environment that cannot be made, stepped or restored.
#[derive(Debug, thiserror::Error)]
pub enum EnvError {
    /// A setting that is not accepted.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// What only the environment itself knows.
    #[error(transparent)]
    Own(Box<dyn std::error::Error + Send + Sync>),
    /// A planned mentor where nobody plans.
    #[error(
        "mentor.demo = plan: the environment {env} has no planner; accepted: a CSV file of states, or --algo dqn, which needs none"
    )]
    NoPlanner {
        /// Name of the environment.
        env: String,
    },
    /// Spaces that the other processes do not accept.
    #[error(transparent)]
    Space(#[from] SpaceError),
    /// An action outside the action space.
    #[error("action {action}; accepted: 0 to {last}")]
    Action {
        /// The action.
        action: u32,
        /// The largest one.
        last: usize,
    },
    /// A step where there is no episode.
    #[error("a step without an episode: the environment must be reset first")]
    Ended,
    /// What `env.hazard.kind = "error"` asks for.
    #[error("env.hazard: the error that was asked for, after {after} steps of the process")]
    Hazard {
        /// Steps that the process has taken.
        after: u64,
    },
    /// Episodes that are to begin in states of the mentor's.
    #[error(
        "rival.kind = resets: the environment {env} cannot be put into a state; accepted: another rival, or an environment that \
         can"
    )]
    CannotBePut {
        /// Name of the environment.
        env: String,
    },
    /// A snapshot that cannot be written or read.
    #[error("snapshot of an environment: {0}")]
    Snapshot(#[from] CodecError),
    /// A snapshot that is sound, but of another environment.
    #[error("snapshot of an environment: {what} does not fit {name}")]
    Foreign {
        /// Name of the environment.
        name: String,
        /// What does not fit.
        what: &'static str,
    },
}

impl EnvError {
    /// An error of an environment's own.
    pub fn own(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::Own(Box::new(error))
    }
}
