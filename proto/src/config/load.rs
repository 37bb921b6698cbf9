//! From a preset or a file and overrides to a checked [`Config`].

use super::error::{unknown_key, unknown_source};
use super::{Config, ConfigError, Field};
use crate::limits::MAX_TEXT_BYTES;
use crate::names;
use std::fs;
use std::path::Path;
use toml::{Table, Value};

/// A configuration that is compiled in.
#[derive(Clone, Copy, Debug)]
pub struct Preset {
    /// Its name.
    pub name: &'static str,
    /// TOML. It begins with a comment, whose first line says what the preset is.
    pub text: &'static str,
}

impl Preset {
    /// What it is, in one line.
    pub fn about(&self) -> &'static str {
        self.text.lines().next().unwrap_or_default().trim_start_matches('#').trim()
    }
}

/// The presets that are compiled in.
pub const PRESETS: [Preset; 5] = [
    Preset { name: "maze-small", text: include_str!("../../presets/maze-small.toml") },
    Preset { name: "maze30", text: include_str!("../../presets/maze30.toml") },
    Preset { name: "maze30-tuned", text: include_str!("../../presets/maze30-tuned.toml") },
    Preset { name: "point-umaze", text: include_str!("../../presets/point-umaze.toml") },
    Preset { name: "point-maze", text: include_str!("../../presets/point-maze.toml") },
];

/// Names of all presets.
pub(super) fn preset_names() -> Vec<String> {
    PRESETS.iter().map(|preset| preset.name.into()).collect()
}

/// The configuration called `name` (a preset, or a TOML file) with `overrides` (`key=value`, dotted keys, the later
/// one wins). Everything is checked but what needs the environment (maps, demonstrations).
///
/// # Errors
/// What cannot be read, is not a setting, or is not accepted.
pub fn load(name: &str, overrides: &[String]) -> Result<Config, ConfigError> {
    load_with(name, overrides, |_| {})
}

/// The same with `flags`: what the command line says beyond the overrides, which wins over them.
///
/// # Errors
/// As [`load`].
pub fn load_with(
    name: &str,
    overrides: &[String],
    flags: impl FnOnce(&mut Config),
) -> Result<Config, ConfigError> {
    let mut table = read(name)?;
    // Presets, too, may have one; none refers to itself.
    while let Some(base) = table.remove("base") {
        let base = base.as_str().map_or_else(|| base.to_string(), String::from);
        let mut merged = preset(&base).ok_or_else(|| unknown_base(&base))??;
        merge(&mut merged, table);
        table = merged;
    }
    for text in overrides {
        set(&mut table, text)?;
    }
    let mut config = decode(table)?;
    flags(&mut config);
    config.validate()?;
    Ok(config)
}

/// The configuration written in `text`, which must be complete in itself; `origin` names it in messages.
///
/// # Errors
/// As [`load`].
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

fn unknown_base(name: &str) -> ConfigError {
    let presets = preset_names();
    let hint = names::hint(name, presets.iter().map(String::as_str));
    super::refuse("base", name, &format!("a preset: {}{hint}", presets.join(", ")))
}

/// Refuses the key `name` in `table`, whose settings are `known`.
pub(super) fn unknown(table: &str, name: &str, known: &[&str]) -> ConfigError {
    let all: Vec<String> = Config::declared("").into_iter().map(|setting| setting.key).collect();
    unknown_key(table, name, known, &all)
}

fn preset(name: &str) -> Option<Result<Table, ConfigError>> {
    let preset = PRESETS.iter().find(|preset| preset.name == name)?;
    Some(parse(&format!("preset {name}"), preset.text))
}

fn read(name: &str) -> Result<Table, ConfigError> {
    if let Some(table) = preset(name) {
        return table;
    }
    let path = Path::new(name);
    let fault = |message: String| ConfigError::Read { path: path.into(), message };
    let meta = fs::metadata(path).map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => unknown_source(name),
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
    Config::read(Value::Table(table), "", "")
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
        let shown = super::setting::in_words(inner);
        at = inner.as_table_mut().ok_or_else(|| {
            super::refuse(key.trim(), value.trim(), &format!("no key below `{part}`, whose value is {shown}"))
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
        for preset in PRESETS {
            assert!(preset.text.starts_with("# ") && preset.about().ends_with('.'), "{}", preset.name);
            let config = load(preset.name, &[]).unwrap();
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

        assert_eq!(
            refused(&["mentor.e_th=aut"]),
            "mentor.e_th = aut; accepted: a number above 0, or auto; did you mean `auto`?"
        );
        assert_eq!(refused(&["mentor.e_th=0"]), "mentor.e_th = 0.0; accepted: a number above 0, or auto");
        assert!(refused(&["mentor.e_infeas=nan"]).starts_with("mentor.e_infeas = nan"));
        assert!(refused(&["mentor.demo=[\"a.csv\"]"]).contains("a table of up to 64 of these by name"));
        assert!(
            refused(&["mentor.demo={ a = 1 }"]).starts_with("mentor.demo.a = 1; accepted: `plan` or a CSV")
        );
        assert!(refused(&["mentor.demo={}"]).contains("1 to 64 of them"));
        assert!(refused(&["mentor.demo={ \"a/b\" = \"x.csv\" }"]).contains("names of 1 to 40 letters"));
        assert!(refused(&["mentor.demo={ a = \"\" }"]).contains("`plan` or a CSV file"));
    }

    #[test]
    fn refusals_name_key_value_and_what_is_accepted() {
        assert_eq!(refused(&["learner.gamma=1.5"]), "learner.gamma = 1.5; accepted: 0 to 1");
        assert_eq!(refused(&["run.actors=0"]), "run.actors = 0; accepted: 1 to 64");
        assert_eq!(
            refused(&["learner.gama=0.9"]),
            "learner.gama: there is no such setting; did you mean `learner.gamma`?"
        );
        assert!(refused(&["gamma=0.9"]).ends_with("did you mean `learner.gamma`?"));
        assert!(refused(&["run.gamma=0.9"]).ends_with("did you mean `learner.gamma`?"));
        assert!(refused(&["lerner.gamma=0.9"]).ends_with("did you mean `learner`?"));
        assert!(refused(&["nonsense=1"]).ends_with(
            "tables: run, env, exploration, learner, mentor, shaping, eval, checkpoint, supervise"
        ));
        assert!(
            refused(&["checkpoint.often=1"]).ends_with("accepted in [checkpoint]: every_env_steps, keep")
        );
        assert_eq!(refused(&["learner.batch=many"]), "learner.batch = many; accepted: 1 to 1024");
        assert_eq!(refused(&["learner.batch=-1"]), "learner.batch = -1; accepted: 1 to 1024");
        assert_eq!(refused(&["learner=1"]), "learner = 1; accepted: a table of settings");
        assert_eq!(
            refused(&["run.seed=9223372036854775808"]),
            "run.seed = 9223372036854775808; accepted: 0 to 2^63 - 1"
        );
        assert_eq!(
            refused(&["run.algo=ha-diqn"]),
            "run.algo = ha-diqn; accepted: dqn, diiqn, ha-diiqn; did you mean `ha-diiqn`?"
        );
        assert!(refused(&["learner"]).contains("key=value"));
        assert!(refused(&["learner.lr.x=1"]).contains("no key below `lr`, whose value is 0.0005"));
        assert!(refused(&["learner.adam_eps.x=1"]).ends_with("accepted: a number above 0"));
        let long = format!("learner.hidden={:?}", vec![0; 1000]);
        assert!(refused(&[&long]).len() < 300);
        assert_eq!(
            refused(&["env.point_maze.magnitudes=[0.5, 2]"]),
            "env.point_maze.magnitudes = [0.5, 2.0]; accepted: 1 to 8 different numbers above 0, up to 1"
        );
        assert!(refused(&["env.point_maze.magnitudes=[]"]).contains("1 to 8 different numbers"));
        assert!(refused(&["env.point_maze.magnitudes=[1.0, 1.0]"]).contains("1 to 8 different numbers"));
        assert!(refused(&["env.point_maze.frame_skip=0"]).ends_with("accepted: 1 to 100"));
        assert!(refused(&["env.point_maze.backend=rapier"]).ends_with("accepted: auto, mujoco, builtin"));
        let short = ["env.kind=point-maze", "eval.threshold=-0.6", "eval.tolerance=0", "env.step_limit=600"];
        assert!(refused(&short).contains("above -0.600: else an episode that never reaches the goal"));
        assert!(refused(&["learner.lr=nan"]).contains("above 0"));
        assert!(refused(&["eval.tolerance=nan"]).contains("0 or more"));
        let unknown = |name| load(name, &[]).unwrap_err().to_string();
        assert!(
            unknown("no-such")
                .ends_with("presets: maze-small, maze30, maze30-tuned, point-umaze, point-maze")
        );
        assert!(unknown("maze31").ends_with("; did you mean `maze30`?"));
    }

    #[test]
    fn flags_win_over_overrides_and_are_checked_as_they_are() {
        let seed = |seed| load_with("maze30", &["run.seed=1".into()], |config| config.run.seed = seed);
        assert_eq!(seed(7).unwrap().run.seed, 7);
        let error = seed(u64::MAX).unwrap_err().to_string();
        assert_eq!(error, "run.seed = 18446744073709551615; accepted: 0 to 2^63 - 1");
        let endless = load_with("maze30", &[], |config| config.run.episodes = Some(u64::MAX));
        assert!(
            endless.unwrap_err().to_string().starts_with("run.episodes = 18446744073709551615; accepted")
        );
    }

    #[test]
    fn every_setting_is_declared_with_its_default() {
        let all = Config::declared("");
        assert!(all.iter().all(|s| !s.help.is_empty() && !s.accepted.is_empty() && !s.kind.is_empty()));
        // The table of defaults has each of them, but for those that are not set.
        let written: Table = to_toml(&Config::default()).parse().unwrap();
        for setting in all {
            let found = setting
                .key
                .split('.')
                .try_fold(&Value::Table(written.clone()), |at, key| at.get(key))
                .cloned();
            let found = found.map_or_else(|| "none".into(), |value| value.to_string());
            assert_eq!(found, setting.default, "{}", setting.key);
        }
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
