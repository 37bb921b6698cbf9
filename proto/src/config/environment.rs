//! `[env]`: what all environments have in common, and the table of the one that is chosen.

use super::accepts::{any, between};
use super::{ConfigError, Field, Hazard, Setting, Value, expansion};
use crate::{choices, settings};
use serde::de::Error as _;
use serde::ser::{Error as _, SerializeMap};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use toml::Table;

settings! {
    /// The settings of `[env]` that all environments have.
    pub(super) struct Shared {
        /// Which environment. Its own settings are in the table of its name, such as `[env.maze]`. `env.<key>` is short for
        /// `env.<name>.<key>`.
        name: String = "maze".into(), any("the name of an environment");
        /// Steps after which an episode is cut off.
        step_limit: u32 = 4000, between(1, u32::MAX);
        /// What the network sees of a state.
        encoding: EncodingKind = EncodingKind::Coordinates;
        /// How the environment fails on purpose, if it does.
        hazard: Hazard = Hazard::default();
    }
}

/// The keys that all environments share in `[env]`, which no environment can have as its name or as a setting.
pub const SHARED: [&str; 4] = ["name", "step_limit", "encoding", "hazard"];

/// `[env]`
#[derive(Clone, Debug, PartialEq)]
pub struct Env {
    /// Which environment.
    pub name: String,
    /// Steps after which an episode is cut off, 1 or more.
    pub step_limit: u32,
    /// What the network sees of a state.
    pub encoding: EncodingKind,
    /// How the environment fails on purpose, if it does.
    pub hazard: Hazard,
    /// The table `[env.<name>]`, which only the environment itself understands.
    pub own: Table,
}

impl Default for Env {
    fn default() -> Self {
        Self::of(Shared::default(), Table::new())
    }
}

impl Env {
    fn of(shared: Shared, own: Table) -> Self {
        let Shared { name, step_limit, encoding, hazard } = shared;
        Self { name, step_limit, encoding, hazard, own }
    }

    fn shared(&self) -> Shared {
        let Self { name, step_limit, encoding, hazard, .. } = self.clone();
        Shared { name, step_limit, encoding, hazard }
    }
}

impl Field for Env {
    fn kind() -> String {
        Shared::kind()
    }

    fn read(value: Value, key: &str, accepted: &str) -> Result<Self, ConfigError> {
        let mut values = expansion::table(value, key)?;
        let name =
            values.get("name").and_then(Value::as_str).map_or_else(|| Shared::default().name, String::from);
        let own = match values.remove(&name) {
            Some(own) => expansion::table(own, &expansion::below(key, &name))?,
            None => Table::new(),
        };
        Ok(Self::of(Shared::read(Value::Table(values), key, accepted)?, own))
    }

    fn check(&self, key: &str) -> Result<(), ConfigError> {
        self.shared().check(key)
    }

    fn declare(table: Setting, all: &mut Vec<Setting>) {
        Shared::declare(table, all);
    }
}

impl Serialize for Env {
    /// For people the environment's own table stands under its name. A plan, whose format has no types of its own, gets it
    /// as TOML.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if !serializer.is_human_readable() {
            let own = toml::to_string(&self.own).map_err(S::Error::custom)?;
            return (self.shared(), own).serialize(serializer);
        }
        let mut map = serializer.serialize_map(Some(SHARED.len() + 1))?;
        map.serialize_entry("name", &self.name)?;
        map.serialize_entry("step_limit", &self.step_limit)?;
        map.serialize_entry("encoding", &self.encoding)?;
        map.serialize_entry("hazard", &self.hazard)?;
        map.serialize_entry(&self.name, &self.own)?;
        map.end()
    }
}

impl<'de> Deserialize<'de> for Env {
    /// From a plan; a configuration is read by [`Field::read`].
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (shared, own) = <(Shared, String)>::deserialize(deserializer)?;
        Ok(Self::of(shared, own.parse().map_err(D::Error::custom)?))
    }
}

choices! {
    /// How a state becomes the network's input.
    pub enum EncodingKind {
        /// Each feature scaled to [-1, 1].
        Coordinates = "coordinates",
        /// Each feature, all of which must be whole numbers, as a one-hot vector; 4096 inputs at most.
        OneHot = "one-hot",
    }
}
