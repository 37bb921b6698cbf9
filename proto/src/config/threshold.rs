//! A threshold on the KL divergence: a number, or `auto`, which becomes a number when the configuration meets its
//! demonstration.

use super::{ConfigError, Field, Value, refuse};
use crate::names;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;

const AUTO: &str = "auto";

/// `mentor.e_th` and `mentor.e_infeas`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Threshold {
    /// To be taken from the demonstration's own spacing before the run starts.
    Auto,
    /// This KL divergence, above 0.
    Kl(f64),
}

impl Threshold {
    /// The number; none while it is still `auto`.
    pub fn known(self) -> Option<f64> {
        match self {
            Self::Auto => None,
            Self::Kl(kl) => Some(kl),
        }
    }
}

impl fmt::Display for Threshold {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str(AUTO),
            Self::Kl(kl) => kl.fmt(f),
        }
    }
}

impl Field for Threshold {
    fn kind() -> String {
        "number, or auto".into()
    }

    fn read(value: Value, key: &str, accepted: &str) -> Result<Self, ConfigError> {
        match &value {
            Value::Float(kl) => Ok(Self::Kl(*kl)),
            Value::Integer(kl) => Ok(Self::Kl(*kl as f64)),
            Value::String(text) if text == AUTO => Ok(Self::Auto),
            Value::String(text) => {
                Err(refuse(key, text, &format!("{accepted}{}", names::hint(text, [AUTO]))))
            }
            other => Err(refuse(key, other, accepted)),
        }
    }
}

impl Serialize for Threshold {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            // A plan, whose format has no types of its own, gets a form that can be read back. Nothing else is read by serde.
            _ if !serializer.is_human_readable() => self.known().serialize(serializer),
            Self::Auto => serializer.serialize_str(AUTO),
            Self::Kl(kl) => serializer.serialize_f64(*kl),
        }
    }
}

impl<'de> Deserialize<'de> for Threshold {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(Option::deserialize(deserializer)?.map_or(Self::Auto, Self::Kl))
    }
}
