//! `mentor.demo`: one demonstration, or several with a name each.

use super::{ConfigError, Field, Value, refuse};
use crate::limits::MAX_MENTORS;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeMap;

/// The source that plans a path instead of reading a file.
pub const PLAN: &str = "plan";
/// The name of a demonstration that is given without one.
pub const ONLY: &str = "mentor";
/// Letters of a demonstration's name, at most.
const MAX_NAME: usize = 40;

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
    /// From a plan; a configuration is read by [`Field::read`].
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(Self(BTreeMap::deserialize(deserializer)?))
    }
}

impl Field for Demos {
    fn kind() -> String {
        "text, or table of texts".into()
    }

    fn accepted() -> String {
        format!("`plan`, a CSV file, or a table of up to {MAX_MENTORS} of these by name")
    }

    fn read(value: Value, key: &str, accepted: &str) -> Result<Self, ConfigError> {
        match value {
            Value::String(source) => Ok(Self::one(source)),
            Value::Table(sources) => {
                let source = |(name, source)| match source {
                    Value::String(source) => Ok((name, source)),
                    other => Err(refuse(&format!("{key}.{name}"), other, "`plan` or a CSV file")),
                };
                sources.into_iter().map(source).collect::<Result<_, _>>().map(Self)
            }
            other => Err(refuse(key, other, accepted)),
        }
    }

    fn check(&self, key: &str) -> Result<(), ConfigError> {
        let count = self.iter().len();
        if !(1..=MAX_MENTORS).contains(&count) {
            return Err(refuse(
                key,
                format!("{count} demonstrations"),
                &format!("1 to {MAX_MENTORS} of them"),
            ));
        }
        for (name, source) in self.iter() {
            let plain = |c: char| c.is_ascii_alphanumeric() || "-_".contains(c);
            if !(1..=MAX_NAME).contains(&name.len()) || !name.chars().all(plain) {
                let accepted = format!("names of 1 to {MAX_NAME} letters, digits, - and _");
                return Err(refuse(key, format!("{{ {name:?} = ... }}"), &accepted));
            }
            if source.is_empty() {
                return Err(refuse(key, "\"\"", "`plan` or a CSV file"));
            }
        }
        Ok(())
    }
}
