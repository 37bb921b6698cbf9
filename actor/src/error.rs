//! What can keep an actor from its work.

use crate::env::EnvError;
use std::fmt;
use trestle_algorithm::similarity::metric::MetricError;
use trestle_proto::acting::Lengths;
use trestle_proto::codec::CodecError;
use trestle_proto::limits::MAX_ROLLOUT;
use trestle_qnet::PlanError;

/// An actor that cannot be made, or cannot do what is asked of it.
#[derive(Debug, thiserror::Error)]
pub enum ActorError {
    /// The environment.
    #[error(transparent)]
    Env(#[from] EnvError),
    /// The network and its input.
    #[error(transparent)]
    Network(#[from] PlanError),
    /// The state distance of guided exploration.
    #[error(transparent)]
    Metric(#[from] MetricError),
    /// The experiment's spaces are not those of the environment that its configuration describes.
    #[error("the plan's spaces of {planned} are not those of the environment {built} of its configuration")]
    Spec {
        /// Name in the experiment.
        planned: String,
        /// Name of what was built.
        built: String,
    },
    /// No actor of the run has this index.
    #[error("actor {index}; accepted: 0 to {last}")]
    Index {
        /// The index.
        index: u32,
        /// The largest one.
        last: u32,
    },
    /// Weights of another network, or a guide of another kind.
    #[error("there are {found} to act with; this run has {expected}")]
    Acting {
        /// Their lengths.
        found: Lengths,
        /// This run's.
        expected: Lengths,
    },
    /// Too much work, or none.
    #[error("{amount} {what} are asked for; accepted: 1 to {MAX_ROLLOUT}")]
    Amount {
        /// Steps or episodes.
        what: &'static str,
        /// How many of them.
        amount: u32,
    },
    /// A number from the environment that nothing can be learnt from.
    #[error("the environment of actor {actor} gave {what} = {value} {moment}; accepted: {accepted}")]
    Number {
        /// The actor.
        actor: u32,
        /// Which number.
        what: Number,
        /// NaN, an infinity, or a value that the type of the features does not hold.
        value: f32,
        /// The accepted values.
        accepted: &'static str,
        /// When.
        moment: Moment,
    },
    /// A snapshot that cannot be written or read.
    #[error("snapshot of an actor: {0}")]
    Snapshot(#[from] CodecError),
    /// A snapshot that is sound, but of another actor.
    #[error("snapshot of actor {found}, with {features} features; this is actor {index}, with {expected}")]
    Foreign {
        /// Actor in the snapshot.
        found: u32,
        /// Features of its observation.
        features: usize,
        /// This actor.
        index: u32,
        /// Features of an observation here.
        expected: usize,
    },
    /// A snapshot that is sound, but of another guide.
    #[error("snapshot of actor {index}: what its guide has under way is none of this run's")]
    Guide {
        /// The actor.
        index: u32,
    },
}

/// A number that an environment gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Number {
    /// A feature of a state, counted from 0.
    Feature(usize),
    /// The reward of a step.
    Reward,
}

impl fmt::Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Feature(index) => write!(f, "feature {index} of its state"),
            Self::Reward => write!(f, "a reward"),
        }
    }
}

/// When something happened to an actor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moment {
    /// In training, after so many steps.
    Steps(u64),
    /// In the evaluation with this number.
    Evaluation(u64),
}

impl fmt::Display for Moment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Steps(steps) => write!(f, "after {steps} steps"),
            Self::Evaluation(number) => write!(f, "in evaluation {number}"),
        }
    }
}
