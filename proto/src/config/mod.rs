//! The resolved configuration of a run.
//!
//! Every setting is declared once, in the file of its table: key, type, default, accepted values and help ([`settings!`]
//! (crate::settings)). Rules over several settings are in `combinations`. A configuration is a preset or a TOML file (which may
//! name a preset as its `base`), then `key=value` overrides, then command-line flags ([`load_with`]). Unknown keys, wrong types
//! and values that are not accepted are refused.

pub mod accepts;
mod arm;
mod before;
mod combinations;
mod conv;
mod defaults;
mod demos;
mod environment;
mod environments;
mod error;
mod features;
mod hazard;
mod learned;
mod learner;
mod load;
mod mentor;
mod rival;
mod run;
mod selection;
mod setting;
#[cfg(test)]
mod testing;
mod threshold;
mod upkeep;

pub use conv::ConvLayer;
pub use demos::{Demos, ONLY, PLAN};
pub use environment::{EncodingKind, Env, SHARED};
pub use environments::{Environments, declared};
pub use error::{ConfigError, elsewhere, refuse};
pub use features::Features;
pub use hazard::{Hazard, HazardKind, HazardScope};
pub use learned::Learned;
pub use learner::{Backend, Channels, Exploration, GuideKind, Learner, LossKind, TargetKind};
pub use load::{Preset, from_table, load, load_with, parse_toml, to_toml};
pub use mentor::{
    CombineKind, CovarianceKind, DrawKind, InferenceKind, Mentor, MetricKind, RewardKind, Shaping,
};
pub use rival::{AdversarialKind, DShape, Gaifo, Inverse, Resets, Rival, RivalKind, SquashKind, Transport};
pub use run::{Algo, IsaKind, Mode, Run};
pub use selection::{SelectionRule, listed};
pub use setting::{Choice, Field, Setting, expansion, is_whole};
pub use threshold::Threshold;
pub use toml::{Table, Value};
pub use upkeep::{Checkpoint, Eval, Supervise};

use crate::settings;
use load::unknown;

settings! {
    /// All settings of a run.
    pub struct Config {
        /// What is run, how long and over how many processes.
        run: Run = Run::default();
        /// The environment.
        env: Env = Env::default();
        /// ε-greedy exploration.
        exploration: Exploration = Exploration::default();
        /// Replay, network and gradient steps.
        learner: Learner = Learner::default();
        /// Demonstration and imitation.
        mentor: Mentor = Mentor::default();
        /// Shaping of `dqn`'s rewards.
        shaping: Shaping = Shaping::default();
        /// Other people's ways to learn from a mentor's states.
        rival: Rival = Rival::default();
        /// Greedy evaluations, and when the task counts as solved.
        eval: Eval = Eval::default();
        /// Checkpoints.
        checkpoint: Checkpoint = Checkpoint::default();
        /// What is done about processes that die or hang.
        supervise: Supervise = Supervise::default();
    }
}
