//! `[env.gym]`

use serde::{Deserialize, Serialize};
use trestle_proto::config::accepts::{any, at_least, between};
use trestle_proto::config::{ConfigError, Field, Table, Value, refuse};
use trestle_proto::limits::MAX_ACTIONS;
use trestle_proto::{names, settings};

/// Most random steps of a warm-up.
const MAX_WARMUP: u32 = 1_000_000;

settings! {
    /// `[env.gym]`
    pub struct Settings {
        /// The environment as `gymnasium.make` takes it, such as `CartPole-v1`, or `package:Name-v0` for one that a package
        /// registers.
        id: String = String::new(), any("an id of Gymnasium's, such as CartPole-v1 or package:Name-v0");
        /// In place of an id: a class, or a function that makes the environment, as `module:name`. Modules are looked for in the
        /// working directory, and later in that where the run was started.
        make: Option<String> = None, any::<String>("module:name");
        /// Arguments by name that the environment is made with.
        kwargs: Kwargs = Kwargs::default(), any("a table of arguments by name");
        /// Wrappers, each as `module:Class`, the innermost first.
        wrappers: Vec<String> = Vec::new(), any("a list of module:Class");
        /// The actions that the agent has, by their numbers or names. Empty: all of them. Subsets give mentor and observer
        /// different bodies.
        actions: Picks = Picks::default(), any("a list of numbers or names of actions");
        /// How many values each dimension of a continuous action takes, evenly spaced from its lowest to its highest: one number
        /// for each dimension, or one for all.
        bins: Vec<usize> = Vec::new(), any(&format!("numbers from 2 to {MAX_ACTIONS}"));
        /// The features that the agent observes, by their numbers or names; the name of a part stands for all that is in it.
        /// Empty: all of them.
        features: Picks = Picks::default(), any("a list of numbers or names of features");
        /// The network sees each feature divided by its number here, one for each feature. Empty: bounds of the space where it
        /// has some, and else twice the range that the warm-up saw. `demonstration`: twice the range of the states of
        /// `mentor.demo`, whichever the algorithm is.
        scale: Scale = Scale::default(), any("a number above 0 for each feature, or demonstration");
        /// Random steps before the run that show the range of features without bounds, and how far a step goes. What they show is
        /// part of the plan: no scale changes later.
        warmup_steps: u32 = 1_000, between(10, MAX_WARMUP);
        /// The Python that runs the environment, with Gymnasium and Trestle's package. Without it, the one that runs this program,
        /// or else `python3`.
        python: Option<String> = None, any::<String>("a program");
        /// Accepts an environment that gives different steps for the same seed and actions. Its runs do not repeat, and an
        /// episode that a restart cuts off begins anew.
        nondeterministic: bool = false;
        /// Seconds that the environment has before a run, to be imported, made and looked at.
        probe_s: u64 = 600, at_least(1);
        /// What was found when the environment was made before the run, as JSON. It is filled in when the configuration is
        /// resolved, so that every process has the same spaces.
        found: Option<String> = None, any::<String>("what a run has found");
    }
}

const DEMONSTRATION: &str = "demonstration";

/// What scales the network's input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Scale {
    /// A number for each feature; none: what was found before the run.
    Each(Vec<f64>),
    /// The spread of the demonstration's states, by its name.
    Named(String),
}

impl Default for Scale {
    fn default() -> Self {
        Self::Each(Vec::new())
    }
}

impl Scale {
    /// Whether it is the spread of the demonstration's states.
    pub fn is_of_demonstration(&self) -> bool {
        matches!(self, Self::Named(_))
    }
}

impl Field for Scale {
    fn kind() -> String {
        "list of numbers, or demonstration".into()
    }

    fn read(value: Value, key: &str, accepted: &str) -> Result<Self, ConfigError> {
        match value {
            Value::String(text) if text == DEMONSTRATION => Ok(Self::Named(text)),
            Value::String(text) => {
                Err(refuse(key, &text, &format!("{accepted}{}", names::hint(&text, [DEMONSTRATION]))))
            }
            other => Vec::read(other, key, accepted).map(Self::Each),
        }
    }
}

/// Arguments by name, of any type that TOML has.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Kwargs(pub Table);

impl Field for Kwargs {
    fn kind() -> String {
        "table".into()
    }

    fn read(value: Value, key: &str, accepted: &str) -> Result<Self, ConfigError> {
        match value {
            Value::Table(table) => Ok(Self(table)),
            other => Err(refuse(key, other, accepted)),
        }
    }
}

/// Numbers and names, as they are typed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Picks(pub Vec<Value>);

impl Field for Picks {
    fn kind() -> String {
        "list of numbers or texts".into()
    }

    fn read(value: Value, key: &str, accepted: &str) -> Result<Self, ConfigError> {
        match value {
            Value::Array(all) if all.iter().all(|pick| pick.is_integer() || pick.is_str()) => Ok(Self(all)),
            other => Err(refuse(key, other, accepted)),
        }
    }
}
