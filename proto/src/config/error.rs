//! Configurations that cannot be used, in words.

use crate::names;
use std::fmt::Display;
use std::path::PathBuf;

/// Longest value that a message shows whole, characters.
const MAX_SHOWN: usize = 160;

/// A configuration that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// Neither a preset nor a file.
    #[error("`{name}` is neither a preset nor a file; presets: {presets}{hint}")]
    Unknown {
        /// What was asked for.
        name: String,
        /// All presets.
        presets: String,
        /// The nearest preset, if one is near.
        hint: String,
    },
    /// A file that cannot be read.
    #[error("cannot read {path}: {message}")]
    Read {
        /// The file.
        path: PathBuf,
        /// The reason.
        message: String,
    },
    /// Not TOML.
    #[error("{origin} is not valid TOML: {message}")]
    Syntax {
        /// File, preset or override.
        origin: String,
        /// The parser's words, with line and column.
        message: String,
    },
    /// An override that is not `key=value`.
    #[error("--set {text}: accepted: key=value with a dotted key, such as learner.lr=0.001")]
    Override {
        /// As typed.
        text: String,
    },
    /// A key that no setting has.
    #[error("{key}: there is no such setting{instead}")]
    Key {
        /// Dotted key.
        key: String,
        /// The nearest right one, or all that there are beside it.
        instead: String,
    },
    /// A value of another type or out of range.
    #[error("{key} = {value}; accepted: {accepted}")]
    Value {
        /// Dotted key.
        key: String,
        /// Its value.
        value: String,
        /// What is accepted.
        accepted: String,
    },
}

/// Refuses `value` of the setting `key`.
pub fn refuse(key: &str, value: impl Display, accepted: &str) -> ConfigError {
    let mut value = value.to_string();
    if let Some((end, _)) = value.char_indices().nth(MAX_SHOWN) {
        value.truncate(end);
        value.push_str("...");
    }
    ConfigError::Value { key: key.into(), value, accepted: accepted.into() }
}

/// Refuses `name`, which is neither one of `presets` nor a file.
pub(super) fn unknown_source(name: &str, presets: &[&str]) -> ConfigError {
    let hint = names::hint(name, presets.iter().copied());
    ConfigError::Unknown { name: name.into(), presets: presets.join(", "), hint }
}

/// Refuses the key `name` in the table `table`, whose settings are `known`. `all` are the keys of every table: one of them
/// may be meant whose table was left out or confused.
pub(super) fn unknown_key(table: &str, name: &str, known: &[&str], all: &[String]) -> ConfigError {
    let below = |name: &str| if table.is_empty() { name.into() } else { format!("{table}.{name}") };
    let last = |key: &str| key.rsplit('.').next() == Some(name);
    let elsewhere = || all.iter().find(|key| last(key)).cloned();
    let instead = match names::nearest(name, known.iter().copied()).map(below).or_else(elsewhere) {
        Some(meant) => format!("; did you mean `{meant}`?"),
        None if table.is_empty() => format!("; tables: {}", known.join(", ")),
        None => format!("; accepted in [{table}]: {}", known.join(", ")),
    };
    ConfigError::Key { key: below(name), instead }
}
