//! Configurations that cannot be used, in words.

use crate::names;
use std::fmt::Display;
use std::path::PathBuf;

/// Longest value that a message shows whole, characters.
const MAX_SHOWN: usize = 160;
/// Letters of a name from which on those that only nearly equal it are looked for in other tables.
const MIN_LETTERS: usize = 4;

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
pub(super) fn unknown_source(
    name: &str,
    presets: &[&str],
    short: &dyn Fn(&str) -> bool,
    environments: &[&str],
) -> ConfigError {
    let environment = || {
        let (typed, rest) = name.split_once(':')?;
        let meant = format!("{}:{rest}", names::nearest(typed, environments.iter().copied())?);
        short(&meant).then(|| format!("; did you mean `{meant}`?"))
    };
    let hint = environment().unwrap_or_else(|| names::hint(name, presets.iter().copied()));
    ConfigError::Unknown { name: name.into(), presets: presets.join(", "), hint }
}

/// Which of the keys `all`, or of their tables, `key` was probably meant to be, whose table was left out or confused: one that ends
/// alike, or else one that nearly does.
pub fn elsewhere(key: &str, all: &[String]) -> Option<String> {
    let last = key.rsplit('.').next().unwrap_or_default();
    let tables = all.iter().flat_map(|key| key.match_indices('.').map(|(end, _)| &key[..end]));
    let known: Vec<&str> = all.iter().map(String::as_str).chain(tables).collect();
    let end_of = |known: &'_ &str| known.rsplit('.').next().unwrap_or_default().to_string();
    if let Some(same) = known.iter().find(|known| end_of(known) == last) {
        return Some(same.to_string());
    }
    // A few letters are near too many names.
    if last.chars().count() < MIN_LETTERS {
        return None;
    }
    let dashes = |text: &str| text.replace('.', "-");
    let ends: Vec<String> = known.iter().map(end_of).collect();
    let whole: Vec<String> = known.iter().map(|known| dashes(known)).collect();
    let found = |names: &[String], name: &str| {
        let nearest = names::nearest(name, names.iter().map(String::as_str))?;
        names.iter().position(|name| name == nearest).map(|place| known[place].to_string())
    };
    // A whole key is only meant where its points have become something else: it would be near too many others.
    let without_points = || found(&whole, key).filter(|_| key == last);
    without_points().or_else(|| found(&ends, last))
}

/// Refuses the key `name` in the table `table`, whose settings are `known`. `all` are the keys of every table: one of them
/// may be meant whose table was left out or confused.
pub(super) fn unknown_key(table: &str, name: &str, known: &[&str], all: &[String]) -> ConfigError {
    let below = |name: &str| if table.is_empty() { name.into() } else { format!("{table}.{name}") };
    let near = names::nearest(name, known.iter().copied()).map(below);
    let instead = match near.or_else(|| elsewhere(&below(name), all)) {
        Some(meant) => format!("; did you mean `{meant}`?"),
        None if table.is_empty() => format!("; tables: {}", known.join(", ")),
        None => format!("; accepted in [{table}]: {}", known.join(", ")),
    };
    ConfigError::Key { key: below(name), instead }
}
