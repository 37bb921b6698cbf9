//! From a preset or a file and overrides to a checked [`Config`].

use super::Config;
use crate::limits::MAX_TEXT_BYTES;
use std::fs;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// The presets that are compiled in: name and TOML text.
pub const PRESETS: [(&str, &str); 5] = [
    ("maze30", include_str!("../../presets/maze30.toml")),
    ("maze30-tuned", include_str!("../../presets/maze30-tuned.toml")),
    ("maze-small", include_str!("../../presets/maze-small.toml")),
    ("point-maze", include_str!("../../presets/point-maze.toml")),
    ("point-umaze", include_str!("../../presets/point-umaze.toml")),
];

/// A configuration that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// Neither a preset nor a file.
    #[error("`{name}` is neither a preset nor a file; presets: {presets}", presets = preset_names())]
    Unknown {
        /// What was asked for.
        name: String,
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
    /// An unknown key or a value of the wrong type.
    #[error("{key}: {message}")]
    Key {
        /// Dotted key.
        key: String,
        /// What is wrong, and what is accepted.
        message: String,
    },
    /// A value out of range.
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

fn preset_names() -> String {
    PRESETS.map(|(name, _)| name).join(", ")
}

/// The configuration called `name` (a preset, or a TOML file) with `overrides` (`key=value`, dotted keys, the later
/// one wins). Ranges are checked; what needs the environment (maps, demonstrations) is not looked at.
pub fn load(name: &str, overrides: &[String]) -> Result<Config, ConfigError> {
    let mut table = read(name)?;
    // Presets, too, may have one; none refers to itself.
    while let Some(base) = table.remove("base") {
        let base = base.as_str().ok_or_else(|| ConfigError::Key {
            key: "base".into(),
            message: format!("expected the name of a preset; presets: {}", preset_names()),
        })?;
        let mut merged = preset(base).ok_or_else(|| ConfigError::Unknown { name: base.into() })??;
        merge(&mut merged, table);
        table = merged;
    }
    for text in overrides {
        set(&mut table, text)?;
    }
    let config = decode(table)?;
    config.validate()?;
    Ok(config)
}

/// The configuration written in `text`, which must be complete in itself; `origin` names it in messages.
pub fn parse_toml(origin: &str, text: &str) -> Result<Config, ConfigError> {
    let config = decode(parse(origin, text)?)?;
    config.validate()?;
    Ok(config)
}

/// `config` as TOML, every setting written out.
pub fn to_toml(config: &Config) -> String {
    // Every type of `Config` has a TOML form: failing here is a defect of ours that the tests would show.
    toml::to_string_pretty(config).unwrap_or_else(|e| format!("# not representable: {e}\n"))
}

fn preset(name: &str) -> Option<Result<Table, ConfigError>> {
    let (_, text) = PRESETS.iter().find(|(known, _)| *known == name)?;
    Some(parse(&format!("preset {name}"), text))
}

fn read(name: &str) -> Result<Table, ConfigError> {
    if let Some(table) = preset(name) {
        return table;
    }
    let path = Path::new(name);
    let fault = |message: String| ConfigError::Read { path: path.into(), message };
    let meta = fs::metadata(path).map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => ConfigError::Unknown { name: name.into() },
        _ => fault(e.to_string()),
    })?;
    if !meta.is_file() {
        return Err(fault("not a file; accepted: a preset or a TOML file".into()));
    }
    if meta.len() > MAX_TEXT_BYTES {
        return Err(fault(format!("{} bytes; accepted: up to {MAX_TEXT_BYTES}", meta.len())));
    }
    let text = fs::read_to_string(path).map_err(|e| fault(e.to_string()))?;
    parse(&path.display().to_string(), &text)
}

fn parse(origin: &str, text: &str) -> Result<Table, ConfigError> {
    text.parse::<Table>()
        .map_err(|e| ConfigError::Syntax { origin: origin.into(), message: e.to_string().trim().into() })
}

fn decode(table: Table) -> Result<Config, ConfigError> {
    serde_path_to_error::deserialize(Value::Table(table)).map_err(|e| ConfigError::Key {
        key: e.path().to_string(),
        message: e.into_inner().to_string().trim().replace('\n', " "),
    })
}

/// Lays `over` upon `table`, table by table.
fn merge(table: &mut Table, over: Table) {
    for (key, value) in over {
        match (table.get_mut(&key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => merge(below, above),
            (_, value) => _ = table.insert(key, value),
        }
    }
}

/// Carries out one `key=value`.
fn set(table: &mut Table, text: &str) -> Result<(), ConfigError> {
    let malformed = || ConfigError::Override { text: text.into() };
    let (key, value) = text.split_once('=').ok_or_else(malformed)?;
    let mut parts: Vec<&str> = key.trim().split('.').collect();
    let last = parts.pop().filter(|p| !p.is_empty()).ok_or_else(malformed)?;
    let mut at = table;
    for part in parts {
        let inner = at.entry(part).or_insert_with(|| Value::Table(Table::new()));
        at = inner.as_table_mut().ok_or_else(|| ConfigError::Key {
            key: key.trim().into(),
            message: format!("`{part}` is a value and has no keys below it"),
        })?;
    }
    at.insert(last.into(), scalar(value.trim()));
    Ok(())
}

/// A TOML value, or, where it is none (`env.map=path.txt`), the text itself.
fn scalar(text: &str) -> Value {
    let line = format!("value = {text}");
    match line.parse::<Table>() {
        Ok(mut table) if table.len() == 1 => {
            table.remove("value").unwrap_or_else(|| Value::String(text.into()))
        }
        _ => Value::String(text.into()),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::config::{Algo, EncodingKind, SelectionKind, Threshold};

    fn refused(overrides: &[&str]) -> String {
        let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
        load("maze30", &overrides).unwrap_err().to_string()
    }

    #[test]
    fn presets_are_valid_and_survive_toml() {
        for (name, _) in PRESETS {
            let config = load(name, &[]).unwrap();
            let again = parse_toml("again", &to_toml(&config)).unwrap();
            assert_eq!(again, config);
        }
    }

    #[test]
    fn overrides_win_and_the_later_one_more_so() {
        let sets = [
            "run.algo=dqn",
            "learner.hidden=[16, 8]",
            "learner.lr=1e-2",
            "learner.lr=2e-2",
            "env.map=some/path.txt",
            "mentor.selection=confidence",
        ];
        let config = load("maze30", &sets.map(String::from)).unwrap();
        assert_eq!(config.run.algo, Algo::Dqn);
        assert_eq!(config.learner.hidden, [16, 8]);
        assert_eq!(config.learner.lr, 2e-2);
        assert_eq!(config.env.map, "some/path.txt");
        assert_eq!(config.mentor.selection, SelectionKind::Confidence);
    }

    #[test]
    fn thresholds_and_demonstrations_have_two_forms_each() {
        let sets = ["mentor.e_th=auto", "mentor.e_infeas=1", "mentor.demo={ b = \"b.csv\", a = \"plan\" }"];
        let config = load("maze30", &sets.map(String::from)).unwrap();
        assert_eq!((config.mentor.e_th, config.mentor.e_infeas), (Threshold::Auto, Threshold::Kl(1.0)));
        assert_eq!(config.mentor.demo.iter().collect::<Vec<_>>(), [("a", "plan"), ("b", "b.csv")]);
        assert_eq!(parse_toml("again", &to_toml(&config)).unwrap(), config);
        let kind = crate::codec::Kind { magic: *b"TRTEST\0\0", version: 1 };
        let bytes = crate::codec::encode(kind, &config).unwrap();
        assert_eq!(crate::codec::decode::<Config>(kind, &bytes).unwrap(), config);

        assert!(refused(&["mentor.e_th=automatic"]).contains("expected a number above 0, or \"auto\""));
        assert_eq!(refused(&["mentor.e_th=0"]), "mentor.e_th = 0; accepted: a number above 0, or auto");
        assert!(refused(&["mentor.e_infeas=nan"]).starts_with("mentor.e_infeas = NaN"));
        assert!(refused(&["mentor.demo=[\"a.csv\"]"]).contains("a table of several by name"));
        assert!(refused(&["mentor.demo={}"]).contains("1 to 64 demonstrations"));
        assert!(refused(&["mentor.demo={ \"a/b\" = \"x.csv\" }"]).contains("names of 1 to 40 letters"));
        assert!(refused(&["mentor.demo={ a = \"\" }"]).contains("`plan` or a CSV file"));
    }

    #[test]
    fn refusals_name_key_value_and_what_is_accepted() {
        assert_eq!(refused(&["learner.gamma=1.5"]), "learner.gamma = 1.5; accepted: 0 to 1");
        assert_eq!(refused(&["run.actors=0"]), "run.actors = 0; accepted: 1 to 64");
        assert!(refused(&["learner.gama=0.9"]).contains("unknown field `gama`, expected one of"));
        assert!(refused(&["learner.batch=many"]).starts_with("learner.batch: "));
        assert!(refused(&["run.algo=sarsa"]).contains("ha-diiqn"));
        assert!(refused(&["learner"]).contains("key=value"));
        assert!(refused(&["learner.lr.x=1"]).contains("`lr` is a value"));
        assert_eq!(
            refused(&["env.point_maze.magnitudes=[0.5, 2]"]),
            "env.point_maze.magnitudes = 2; accepted: numbers above 0, up to 1"
        );
        assert!(refused(&["env.point_maze.magnitudes=[]"]).ends_with("accepted: 1 to 8 numbers"));
        assert!(refused(&["env.point_maze.magnitudes=[1.0, 1.0]"]).ends_with("accepted: each number once"));
        assert!(refused(&["env.point_maze.frame_skip=0"]).ends_with("accepted: 1 to 100"));
        assert!(refused(&["env.point_maze.backend=rapier"]).contains("`mujoco`"));
        let short = ["env.kind=point-maze", "eval.threshold=-0.6", "eval.tolerance=0", "env.step_limit=600"];
        assert!(refused(&short).contains("above -0.600: else an episode that never reaches the goal"));
        assert!(refused(&["learner.lr=nan"]).contains("above 0"));
        assert!(refused(&["eval.tolerance=nan"]).contains("0 or more"));
        assert!(
            load("no-such", &[])
                .unwrap_err()
                .to_string()
                .contains("presets: maze30, maze30-tuned, maze-small, point-maze, point-umaze")
        );
    }

    #[test]
    fn a_file_may_build_on_a_preset() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mine.toml");
        std::fs::write(&path, "base = \"maze30\"\n[learner]\nlr = 0.5\n").unwrap();
        let config = load(path.to_str().unwrap(), &[]).unwrap();
        assert_eq!(config.learner.lr, 0.5);
        assert_eq!(config.env.map, "maze30");
        std::fs::write(&path, "base = \"maze30-tuned\"\n[learner]\ntau = 0.01\n").unwrap();
        let config = load(path.to_str().unwrap(), &[]).unwrap();
        assert_eq!((config.learner.tau, config.learner.train_every), (0.01, 1));
        assert_eq!((config.env.map, config.env.encoding), ("maze30".into(), EncodingKind::OneHot));
        std::fs::write(&path, "[learner\n").unwrap();
        assert!(load(path.to_str().unwrap(), &[]).unwrap_err().to_string().contains("not valid TOML"));
    }
}
