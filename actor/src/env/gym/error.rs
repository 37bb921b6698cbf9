//! What can be wrong with an environment of Gymnasium's interface.

use crate::env::EnvError;

/// An environment that cannot be made, or does what it must not do.
#[derive(Debug, thiserror::Error)]
pub enum GymError {
    /// Settings that have not met their environment.
    #[error("env.gym.found is not set: the configuration was never resolved")]
    Unresolved,
    /// What is no description of an environment.
    #[error("env.gym.found: {0}")]
    Found(String),
    /// A process that has no Python.
    #[error("this program has no Python; accepted: the program `trestle` of the Python package trestle-rl")]
    NoPython,
    /// A Python that cannot be started.
    #[error(
        "env.gym.python: cannot start {program}: {error}; accepted: a Python with the package trestle-rl"
    )]
    Start {
        /// What was to be started.
        program: String,
        /// Why it was not.
        error: std::io::Error,
    },
    /// A Python whose Trestle is another one.
    #[error(
        "env.gym.python: {program} has trestle {version}, build {build}, but this is {own_version}, build {own_build}; \
         accepted: a trestle-rl of the same build"
    )]
    Build {
        /// The Python.
        program: String,
        /// Version there.
        version: String,
        /// Build there.
        build: String,
        /// Version here.
        own_version: String,
        /// Build here.
        own_build: String,
    },
    /// A process that ended without an answer.
    #[error("env.gym: the Python that was to make the environment ended with {status}{said}")]
    Ended {
        /// How it ended.
        status: String,
        /// The end of what it said.
        said: String,
    },
    /// A process that gave no answer in time.
    #[error("env.gym: making the environment took more than {seconds} s (env.gym.probe_s){said}")]
    Slow {
        /// The limit.
        seconds: u64,
        /// The end of what it said.
        said: String,
    },
    /// A refusal in Python's words.
    #[error("{0}")]
    Refused(String),
    /// An environment that gives different steps for the same seed and actions.
    #[error(
        "{name} is not deterministic: {difference}; accepted: an environment that repeats its steps, or \
         env.gym.nondeterministic = true for a run that does not repeat"
    )]
    Nondeterministic {
        /// The environment.
        name: String,
        /// Where two episodes differed.
        difference: String,
    },
    /// An episode that came out differently the second time.
    #[error(
        "{name} does not repeat its episodes: with seed {seed} and the same {steps} actions it gave other observations or \
         rewards; accepted: an environment that is deterministic, or env.gym.nondeterministic = true"
    )]
    Replay {
        /// The environment.
        name: String,
        /// Seed of the reset.
        seed: u32,
        /// Actions of the episode.
        steps: usize,
    },
    /// What the environment raised, or gave in place of what it promised.
    #[error("{name}: {what}")]
    Raised {
        /// The environment.
        name: String,
        /// The exception or the mistake.
        what: String,
    },
}

impl From<GymError> for EnvError {
    fn from(error: GymError) -> Self {
        Self::own(error)
    }
}
