//! `mentor.features`: features of a state by number or by name. Names become numbers when the configuration meets its
//! environment.

use super::setting::in_words;
use super::{ConfigError, Field, Value, refuse};
use serde::ser::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Names that a refusal shows, at most.
const MAX_SHOWN: usize = 30;

/// Some features of a state.
#[derive(Clone, Debug, PartialEq)]
pub enum Features {
    /// By number.
    Numbers(Vec<usize>),
    /// By number or name, as they were typed.
    Named(Vec<Value>),
}

impl Default for Features {
    fn default() -> Self {
        Self::Numbers(Vec::new())
    }
}

impl Features {
    /// Their numbers; none while they are still names.
    pub fn numbers(&self) -> Option<&[usize]> {
        match self {
            Self::Numbers(numbers) => Some(numbers),
            Self::Named(_) => None,
        }
    }

    /// Puts numbers in the place of names. `key` is the setting's, and `names` are those of the `dim` features, or none where they
    /// have no names. The name of a part, as `position` of `position[0]`, stands for all that is in it.
    ///
    /// # Errors
    /// A feature that there is not.
    pub fn resolve(&mut self, key: &str, names: &[&str], dim: usize) -> Result<(), ConfigError> {
        let typed = match self {
            Self::Numbers(numbers) => match numbers.iter().find(|&&number| number >= dim) {
                Some(number) => return Err(refuse(key, number, &accepted(names, dim))),
                None => return Ok(()),
            },
            Self::Named(typed) => typed,
        };
        let mut numbers: Vec<usize> = Vec::new();
        for pick in typed.iter() {
            let found = find(pick, names, dim);
            if found.is_empty() {
                return Err(refuse(key, in_words(pick), &accepted(names, dim)));
            }
            if let Some(twice) = found.iter().find(|number| numbers.contains(number)) {
                return Err(refuse(
                    key,
                    in_words(pick),
                    &format!("each feature once, and {twice} is there before"),
                ));
            }
            numbers.extend(found);
        }
        *self = Self::Numbers(numbers);
        Ok(())
    }
}

/// The features that `pick` stands for.
fn find(pick: &Value, names: &[&str], dim: usize) -> Vec<usize> {
    let with = |test: &dyn Fn(&str) -> bool| -> Vec<usize> {
        names.iter().enumerate().filter(|(_, name)| test(name)).map(|(number, _)| number).collect()
    };
    match pick {
        Value::Integer(number) => {
            usize::try_from(*number).ok().filter(|&number| number < dim).into_iter().collect()
        }
        Value::String(text) => {
            let exact = with(&|name| name == text);
            let within = |name: &str| {
                name.strip_prefix(text.as_str()).is_some_and(|rest| rest.starts_with(['.', '[']))
            };
            if exact.is_empty() { with(&within) } else { exact }
        }
        _ => Vec::new(),
    }
}

fn accepted(names: &[&str], dim: usize) -> String {
    let last = dim.saturating_sub(1);
    if names.is_empty() {
        return format!("numbers from 0 to {last}");
    }
    let more = if names.len() > MAX_SHOWN { ", ..." } else { "" };
    format!("0 to {last}, or a name: {}{more}", names[..names.len().min(MAX_SHOWN)].join(", "))
}

impl Field for Features {
    fn kind() -> String {
        "list of numbers or texts".into()
    }

    fn read(value: Value, key: &str, accepted: &str) -> Result<Self, ConfigError> {
        let typed = match value {
            Value::Array(typed) => typed,
            text @ Value::String(_) => vec![text],
            other => return Err(refuse(key, other, accepted)),
        };
        let number = |pick: &Value| pick.as_integer().and_then(|number| usize::try_from(number).ok());
        let numbers: Option<Vec<usize>> = typed.iter().map(number).collect();
        match numbers {
            Some(numbers) => Ok(Self::Numbers(numbers)),
            None if typed.iter().all(|pick| number(pick).is_some() || pick.is_str()) => {
                Ok(Self::Named(typed))
            }
            None => Err(refuse(key, Value::Array(typed), accepted)),
        }
    }
}

impl Serialize for Features {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Numbers(numbers) => numbers.serialize(serializer),
            Self::Named(typed) if serializer.is_human_readable() => typed.serialize(serializer),
            // A plan's features have met their environment.
            Self::Named(_) => Err(S::Error::custom("features by name have no form in a plan")),
        }
    }
}

impl<'de> Deserialize<'de> for Features {
    /// From a plan; a configuration is read by [`Field::read`].
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(Self::Numbers(Vec::deserialize(deserializer)?))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::config::testing::with;
    use crate::config::{parse_toml, to_toml};

    const NAMES: [&str; 4] = ["battery", "position[0]", "position[1]", "heading"];

    fn resolved(set: &str) -> Result<Vec<usize>, String> {
        let config = with("maze30", &[set]).map_err(|error| error.to_string())?;
        // Names survive a file.
        assert_eq!(parse_toml("again", &to_toml(&config)).unwrap(), config);
        let mut features = config.mentor.features;
        features.resolve("mentor.features", &NAMES, 4).map_err(|error| error.to_string())?;
        Ok(features.numbers().unwrap().to_vec())
    }

    #[test]
    fn names_stand_for_numbers_and_parts_for_all_that_is_in_them() {
        let resolved = |set| resolved(set).unwrap();
        assert_eq!(resolved("mentor.features=[3, 0]"), [3, 0]);
        assert_eq!(resolved("mentor.features=[\"position\", 3]"), [1, 2, 3]);
        assert_eq!(resolved("mentor.features=[\"heading\", \"position[1]\"]"), [3, 2]);
        assert_eq!(resolved("mentor.features=position"), [1, 2]);
        assert_eq!(resolved("mentor.features=[]"), [] as [usize; 0]);
    }

    #[test]
    fn what_is_no_feature_is_refused_with_those_that_are() {
        let refused = |set| resolved(set).unwrap_err();
        let all = "accepted: 0 to 3, or a name: battery, position[0], position[1], heading";
        assert_eq!(refused("mentor.features=[9]"), format!("mentor.features = 9; {all}"));
        assert_eq!(refused("mentor.features=[\"posit\"]"), format!("mentor.features = posit; {all}"));
        assert_eq!(
            refused("mentor.features=[1, \"position\"]"),
            "mentor.features = position; accepted: each feature once, and 1 is there before"
        );
        assert!(refused("mentor.features=[-1]").contains("numbers or names of features"));
        assert!(refused("mentor.features=[0.5]").contains("numbers or names of features"));
        let mut unnamed = Features::Numbers(vec![2]);
        let error = unnamed.resolve("mentor.features", &[], 2).unwrap_err().to_string();
        assert_eq!(error, "mentor.features = 2; accepted: numbers from 0 to 1");
    }
}
