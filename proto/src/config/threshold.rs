//! A threshold on the KL divergence: a number, or `auto`, which becomes a number when the configuration meets its
//! demonstration.

use serde::de::{self, Deserializer, Visitor};
use serde::{Deserialize, Serialize, Serializer};
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

impl Serialize for Threshold {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            // A format without types on its own, such as a plan's, gets a form that it can read back.
            _ if !serializer.is_human_readable() => self.known().serialize(serializer),
            Self::Auto => serializer.serialize_str(AUTO),
            Self::Kl(kl) => serializer.serialize_f64(*kl),
        }
    }
}

impl<'de> Deserialize<'de> for Threshold {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if !deserializer.is_human_readable() {
            return Ok(Option::deserialize(deserializer)?.map_or(Self::Auto, Self::Kl));
        }
        deserializer.deserialize_any(Words)
    }
}

struct Words;

impl Visitor<'_> for Words {
    type Value = Threshold;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number above 0, or \"auto\"")
    }

    fn visit_f64<E: de::Error>(self, kl: f64) -> Result<Threshold, E> {
        Ok(Threshold::Kl(kl))
    }

    fn visit_i64<E: de::Error>(self, kl: i64) -> Result<Threshold, E> {
        Ok(Threshold::Kl(kl as f64))
    }

    fn visit_u64<E: de::Error>(self, kl: u64) -> Result<Threshold, E> {
        Ok(Threshold::Kl(kl as f64))
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<Threshold, E> {
        if text == AUTO {
            Ok(Threshold::Auto)
        } else {
            Err(E::invalid_value(de::Unexpected::Str(text), &self))
        }
    }
}
