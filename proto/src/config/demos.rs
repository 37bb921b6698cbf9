//! `mentor.demo`: one demonstration, or several with a name each.

use serde::de::value::MapAccessDeserializer;
use serde::de::{self, Deserializer, MapAccess, Visitor};
use serde::{Deserialize, Serialize, Serializer};
use std::collections::BTreeMap;
use std::fmt;

/// The source that plans a path instead of reading a file.
pub const PLAN: &str = "plan";
/// The name of a demonstration that is given without one.
pub const ONLY: &str = "mentor";

/// Where the demonstrations come from: sources ([`PLAN`], or a CSV file) by name, in the order of the names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Demos(BTreeMap<String, String>);

impl Demos {
    /// A single demonstration.
    pub fn one(source: impl Into<String>) -> Self {
        Self(BTreeMap::from([(ONLY.to_string(), source.into())]))
    }

    /// Whether it is a single one without a name of its own.
    pub fn is_one(&self) -> bool {
        self.0.len() == 1 && self.0.contains_key(ONLY)
    }

    /// Names and sources, in the order of the names.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (&str, &str)> {
        self.0.iter().map(|(name, source)| (name.as_str(), source.as_str()))
    }

    /// The source called `name`.
    pub fn get(&self, name: &str) -> Option<&str> {
        self.0.get(name).map(String::as_str)
    }

    /// The same names, each file replaced by what `of` makes of it; planned ones stay planned.
    pub fn map_files(&self, mut of: impl FnMut(&str, &str) -> String) -> Self {
        let each = |(name, source): (&String, &String)| {
            let source = if source == PLAN { source.clone() } else { of(name, source) };
            (name.clone(), source)
        };
        Self(self.0.iter().map(each).collect())
    }
}

impl Serialize for Demos {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.get(ONLY) {
            Some(source) if self.is_one() && serializer.is_human_readable() => {
                serializer.serialize_str(source)
            }
            _ => self.0.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Demos {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if deserializer.is_human_readable() {
            deserializer.deserialize_any(Words)
        } else {
            Ok(Self(BTreeMap::deserialize(deserializer)?))
        }
    }
}

struct Words;

impl<'de> Visitor<'de> for Words {
    type Value = Demos;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("\"plan\", a CSV file, or a table of several by name, such as { expert = \"a.csv\", novice = \"b.csv\" }")
    }

    fn visit_str<E: de::Error>(self, source: &str) -> Result<Demos, E> {
        Ok(Demos::one(source))
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Demos, A::Error> {
        Ok(Demos(BTreeMap::deserialize(MapAccessDeserializer::new(map))?))
    }
}
