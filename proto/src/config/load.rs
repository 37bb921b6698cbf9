//! From a preset or a file and overrides to a checked [`Config`].

use super::environments::{chosen, complete, declared, expand};
use super::error::{elsewhere, unknown_key, unknown_source};
use super::setting::in_words;
use super::{Algo, Choice, Config, ConfigError, Environments, Field, SelectionRule, before, refuse};
use crate::limits::MAX_TEXT_BYTES;
use crate::names;
use crate::regular_file::{self, FileError};
use crate::run_files::{CONFIG_FILE, PLAN_FILE};
use std::path::{Path, PathBuf};
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

/// The configuration called `name` (a preset, a TOML file, or an environment's short form) with `overrides` (`key=value`, dotted
/// keys, the later one wins). Everything is checked but what the configuration names: maps and demonstrations.
///
/// # Errors
/// What cannot be read, is not a setting, or is not accepted.
pub fn load(
    environments: &dyn Environments,
    name: &str,
    overrides: &[String],
) -> Result<Config, ConfigError> {
    load_with(environments, name, overrides, |_| {})
}

/// The same with `flags`: what the command line says beyond the overrides, which wins over them.
///
/// # Errors
/// As [`load`].
pub fn load_with(
    environments: &dyn Environments,
    name: &str,
    overrides: &[String],
    flags: impl FnOnce(&mut Config),
) -> Result<Config, ConfigError> {
    let presets = Presets::of(environments);
    from_layers(environments, presets.with_bases(presets.read(name)?)?, overrides, flags)
}

/// The configuration in `table` with `overrides`, as [`load`] has it from a file.
///
/// # Errors
/// As [`load`].
pub fn from_table(
    environments: &dyn Environments,
    table: Table,
    overrides: &[String],
) -> Result<Config, ConfigError> {
    from_layers(environments, Presets::of(environments).with_bases(table)?, overrides, |_| {})
}

/// The configuration that a run keeps as `text`: complete in itself, its environment's own table taken as it is. `origin` names
/// it in messages.
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

/// Refuses the key `name` in `table`, whose settings are `known`.
pub(super) fn unknown(table: &str, name: &str, known: &[&str]) -> ConfigError {
    let all: Vec<String> = Config::declared("").into_iter().map(|setting| setting.key).collect();
    unknown_key(table, name, known, &all)
}

/// Lays `layers` and `overrides` upon each other, the later ones on top.
fn from_layers(
    environments: &dyn Environments,
    layers: Vec<Table>,
    overrides: &[String],
    flags: impl FnOnce(&mut Config),
) -> Result<Config, ConfigError> {
    let mut layers: Vec<Layer> = layers.into_iter().map(Layer::whole).collect();
    for text in overrides {
        layers.push(Layer::of_override(text)?);
    }
    let algo = layers.iter().filter_map(|layer| layer.table.get("run")?.get("algo")?.as_str()).next_back();
    if let Some(algo) = algo.and_then(Algo::of_name) {
        layers.insert(0, Layer::whole(parse("defaults of the algorithm", algo.defaults())?));
    }
    // What an environment's setting is short for depends on which environment it is in the end.
    let name = chosen(layers.iter().map(|layer| &layer.table), environments)?;
    let mut table = Table::new();
    for mut layer in layers {
        if expand(&mut layer.table, &name, environments)? {
            layer.depth = layer.depth.saturating_add(1);
        }
        merge(&mut table, layer.table, layer.depth);
    }
    complete(&mut table, &name, environments)?;
    let rules = environments.selections();
    let selection = table.get("mentor").and_then(|mentor| mentor.get("selection"));
    if let Some(value) = selection.filter(|value| !value.is_str() && !rules.is_empty()) {
        return Err(SelectionRule::refused(&rules, &in_words(value)));
    }
    let mut config = decode(table).map_err(|error| in_environments(error, environments))?;
    flags(&mut config);
    config.validate()?;
    if !rules.is_empty() {
        SelectionRule::chosen(&rules, &config.mentor)?;
    }
    environments.check(&config)?;
    Ok(config)
}

/// The presets that a configuration may name.
struct Presets<'a> {
    all: Vec<Preset>,
    environments: &'a dyn Environments,
}

impl<'a> Presets<'a> {
    fn of(environments: &'a dyn Environments) -> Self {
        Self { all: environments.presets(), environments }
    }

    fn names(&self) -> Vec<&str> {
        self.all.iter().map(|preset| preset.name).collect()
    }

    /// The preset called `name`, if there is one, or what `name` is short for.
    fn find(&self, name: &str) -> Option<Result<Table, ConfigError>> {
        let Some(preset) = self.all.iter().find(|preset| preset.name == name) else {
            return self.environments.shorthand(name).map(Ok);
        };
        Some(parse(&format!("preset {name}"), preset.text))
    }

    /// The preset or the file called `name`.
    fn read(&self, name: &str) -> Result<Table, ConfigError> {
        if let Some(table) = self.find(name) {
            return table;
        }
        let path = Path::new(name);
        let fault = |message: String| ConfigError::Read { path: path.into(), message };
        let text = regular_file::read_to_string(path, MAX_TEXT_BYTES).map_err(|error| match error {
            error if error.is_not_found() => {
                let short = |text: &str| self.environments.shorthand(text).is_some();
                unknown_source(name, &self.names(), &short, &self.environments.names())
            }
            FileError::Io { error, .. } => fault(error.to_string()),
            FileError::Kind { kind, .. } => {
                let hint = of_run(path).map_or_else(String::new, |config| {
                    format!("; did you mean `{}`, the configuration of the run there?", config.display())
                });
                fault(format!("{kind}, not a file; accepted: a preset or a TOML file{hint}"))
            }
            FileError::Large { bytes, limit, .. } => fault(format!("{bytes} bytes; accepted: up to {limit}")),
            FileError::NotText { error, .. } => fault(format!("line {} is not UTF-8 text", error.line)),
        })?;
        parse(&path.display().to_string(), &text)
    }

    /// `table` upon its base, the base's base, and so on. No preset is its own base.
    fn with_bases(&self, table: Table) -> Result<Vec<Table>, ConfigError> {
        let mut layers = vec![table];
        while let Some(base) = layers[0].remove("base") {
            let name = in_words(&base);
            let accepted =
                || format!("a preset: {}{}", self.names().join(", "), names::hint(&name, self.names()));
            layers.insert(0, self.find(&name).ok_or_else(|| refuse("base", &name, &accepted()))??);
        }
        Ok(layers)
    }
}

/// The configuration of the run in the directory `path`, or of the one that it is a checkpoint of.
fn of_run(path: &Path) -> Option<PathBuf> {
    let run = path.ancestors().take(3).find(|dir| dir.join(PLAN_FILE).is_file())?;
    Some(run.join(CONFIG_FILE)).filter(|config| config.is_file())
}

/// `text` as a table of today's form.
fn parse(origin: &str, text: &str) -> Result<Table, ConfigError> {
    let mut table = text
        .parse::<Table>()
        .map_err(|e| ConfigError::Syntax { origin: origin.into(), message: e.to_string().trim().into() })?;
    before::translate(&mut table);
    Ok(table)
}

fn decode(table: Table) -> Result<Config, ConfigError> {
    Config::read(Value::Table(table), "", "")
}

/// `error`, where a key that is no setting may be one of an environment's.
fn in_environments(error: ConfigError, environments: &dyn Environments) -> ConfigError {
    let ConfigError::Key { key, instead } = error else { return error };
    if instead.contains("did you mean") {
        return ConfigError::Key { key, instead };
    }
    let all: Vec<String> = declared(environments).into_iter().map(|setting| setting.key).collect();
    let meant = elsewhere(&key, &all).map(|meant| format!("; did you mean `{meant}`?"));
    ConfigError::Key { key, instead: meant.unwrap_or(instead) }
}

/// A part of a configuration.
struct Layer {
    table: Table,
    /// Tables at this depth take the place of those below instead of being laid upon them.
    depth: usize,
}

impl Layer {
    /// A preset or a file.
    fn whole(table: Table) -> Self {
        Self { table, depth: usize::MAX }
    }

    /// One `key=value`, whose value takes the place of whatever there is.
    fn of_override(text: &str) -> Result<Self, ConfigError> {
        let malformed = || ConfigError::Override { text: text.into() };
        let (key, value) = text.split_once('=').ok_or_else(malformed)?;
        let mut parts = key.trim().split('.').rev();
        let last = parts.next().unwrap_or_default();
        let within = |table: Table, part: &str| Table::from_iter([(part.to_string(), Value::Table(table))]);
        let table = parts.fold(Table::from_iter([(last.to_string(), scalar(value.trim()))]), within);
        if key.trim().split('.').any(str::is_empty) {
            return Err(malformed());
        }
        Ok(Self { table, depth: key.matches('.').count() })
    }
}

/// Lays `over` upon `table`, table by table, `depth` tables deep.
pub(super) fn merge(table: &mut Table, over: Table, depth: usize) {
    for (key, value) in over {
        match (table.get_mut(&key), value) {
            (Some(Value::Table(below)), Value::Table(above)) if depth > 0 => merge(below, above, depth - 1),
            (_, value) => _ = table.insert(key, value),
        }
    }
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
    use crate::config::setting::as_toml;
    use crate::config::testing::{Two, with};
    use crate::config::{Algo, EncodingKind, Threshold};

    fn refused(overrides: &[&str]) -> String {
        with("maze30", overrides).unwrap_err().to_string()
    }

    #[test]
    fn presets_are_valid_and_survive_toml() {
        for preset in Two.presets() {
            let config = with(preset.name, &[]).unwrap();
            let again = parse_toml("again", &to_toml(&config)).unwrap();
            assert_eq!(again, config);
        }
        assert_eq!(Two.presets()[0].about(), "A maze.");
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
        let config = with("maze30", &sets).unwrap();
        assert_eq!(config.run.algo, Algo::Dqn);
        assert_eq!(config.learner.hidden, [16, 8]);
        assert_eq!(config.learner.lr, 2e-2);
        assert_eq!(config.env.own["map"], Value::from("some/path.txt"));
        assert_eq!(config.mentor.selection, "confidence");
    }

    #[test]
    fn thresholds_and_demonstrations_have_two_forms_each() {
        let sets = ["mentor.e_th=auto", "mentor.e_infeas=1", "mentor.demo={ b = \"b.csv\", a = \"plan\" }"];
        let config = with("maze30", &sets).unwrap();
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
        for (typed, meant) in [
            ("gama", "learner.gamma"),
            ("learner_gamma", "learner.gamma"),
            ("hazard.kind", "env.hazard"),
            ("hazzard.kind", "env.hazard"),
            ("env.step-limt", "env.step_limit"),
            ("eval.epsilon_strat", "exploration.epsilon_start"),
        ] {
            let said = refused(&[&format!("{typed}=1")]);
            assert!(said.ends_with(&format!("did you mean `{meant}`?")), "{typed}: {said}");
        }
        assert!(refused(&["lerner.gamma=0.9"]).ends_with("did you mean `learner`?"));
        assert!(refused(&["nonsense=1"]).ends_with(
            "tables: run, env, exploration, learner, mentor, shaping, rival, eval, checkpoint, supervise"
        ));
        assert!(
            refused(&["checkpoint.often=1"]).ends_with("accepted in [checkpoint]: every_env_steps, keep")
        );
        assert_eq!(
            refused(&["learner.batch=many"]),
            "learner.batch = many; accepted: 1 to 1024, a whole number"
        );
        assert_eq!(
            refused(&["learner.batch=3.5"]),
            "learner.batch = 3.5; accepted: 1 to 1024, a whole number"
        );
        assert!(refused(&["learner.hidden=64"]).ends_with("1 to 4096 units, a list of whole numbers"));
        assert_eq!(refused(&["learner.batch=-1"]), "learner.batch = -1; accepted: 1 to 1024");
        assert_eq!(refused(&["learner=1"]), "learner = 1; accepted: a table of settings");
        assert_eq!(
            refused(&["run.seed=9223372036854775808"]),
            "run.seed = 9223372036854775808; accepted: 0 to 2^63 - 1"
        );
        assert_eq!(
            refused(&["run.algo=ha-diqn"]),
            "run.algo = ha-diqn; accepted: dqn, diiqn, ha-diiqn, trestle; did you mean `ha-diiqn`?"
        );
        assert!(refused(&["learner"]).contains("key=value"));
        assert!(refused(&["learner.lr.x=1"]).ends_with("accepted: a number above 0"));
        assert!(refused(&["learner.adam_eps.x=1"]).ends_with("accepted: a number above 0"));
        let long = format!("learner.hidden={:?}", vec![0; 1000]);
        assert!(refused(&[&long]).len() < 300);
        assert!(refused(&["learner.lr=nan"]).contains("above 0"));
        assert!(refused(&["eval.tolerance=nan"]).contains("0 or more"));
        let unknown = |name| with(name, &[]).unwrap_err().to_string();
        assert!(unknown("no-such").ends_with("presets: maze30, maze30-tuned, cart"));
        assert!(unknown("maze31").ends_with("; did you mean `maze30`?"));
    }

    #[test]
    fn flags_win_over_overrides_and_are_checked_as_they_are() {
        let seed = |seed| load_with(&Two, "maze30", &["run.seed=1".into()], |config| config.run.seed = seed);
        assert_eq!(seed(7).unwrap().run.seed, 7);
        let error = seed(u64::MAX).unwrap_err().to_string();
        assert_eq!(error, "run.seed = 18446744073709551615; accepted: 0 to 2^63 - 1");
        let endless = load_with(&Two, "maze30", &[], |config| config.run.episodes = Some(u64::MAX));
        assert!(
            endless.unwrap_err().to_string().starts_with("run.episodes = 18446744073709551615; accepted")
        );
    }

    #[test]
    fn every_setting_is_declared_with_its_default() {
        let all = declared(&Two);
        assert!(all.iter().all(|s| !s.help.is_empty() && !s.accepted.is_empty() && !s.kind.is_empty()));
        // The table of defaults has each of them, but for those that are not set.
        let shown = |name: &str| {
            to_toml(&with(name, &["learner.hidden=[128, 128]"]).unwrap()).parse::<Table>().unwrap()
        };
        let default = from_table(&Two, Table::new(), &["run.env_steps=1".into()]).unwrap();
        let written: Table = to_toml(&default).parse().unwrap();
        assert!(shown("cart")["env"]["cart-pole"].get("force").is_some());
        for setting in
            all.iter().filter(|setting| setting.table() != "env.cart-pole" && setting.name() != "env_steps")
        {
            let found = setting
                .key
                .split('.')
                .try_fold(&Value::Table(written.clone()), |at, key| at.get(key))
                .cloned();
            let found = found.map_or_else(|| "none".into(), |value| as_toml(&value));
            assert_eq!(found, setting.default, "{}", setting.key);
        }
    }

    #[test]
    fn a_file_may_build_on_a_preset() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mine.toml");
        std::fs::write(&path, "base = \"maze30\"\n[learner]\nlr = 0.5\n").unwrap();
        let config = load(&Two, path.to_str().unwrap(), &[]).unwrap();
        assert_eq!(config.learner.lr, 0.5);
        assert_eq!(config.env.own["map"], Value::from("maze30"));
        std::fs::write(&path, "base = \"maze30-tuned\"\n[learner]\ntau = 0.01\n").unwrap();
        let config = load(&Two, path.to_str().unwrap(), &[]).unwrap();
        assert_eq!((config.learner.tau, config.learner.train_every), (0.01, 1));
        assert_eq!((&config.env.own["map"], config.env.encoding), (&"maze30".into(), EncodingKind::OneHot));
        std::fs::write(&path, "[learner\n").unwrap();
        assert!(load(&Two, path.to_str().unwrap(), &[]).unwrap_err().to_string().contains("not valid TOML"));
    }

    #[test]
    fn an_environment_s_settings_have_a_short_form() {
        let own = |sets: &[&str]| with("maze30", sets).unwrap().env;
        assert_eq!(own(&["env.map=a.txt"]).own["map"], Value::from("a.txt"));
        assert_eq!(own(&["env.maze.map=a.txt", "env.map=b.txt"]).own["map"], Value::from("b.txt"));
        assert_eq!(own(&["env.map=a.txt", "env.maze.map=b.txt"]).own["map"], Value::from("b.txt"));
        let sets =
            own(&["env.action_sets.a=[\"N\"]", "env.action_sets.b=[\"S\"]"]).own["action_sets"].clone();
        assert_eq!(sets.as_table().unwrap().len(), 2);
        // A table that is given whole takes the place of the one before.
        let sets =
            own(&["env.action_sets.a=[\"N\"]", "env.action_sets={ b = [\"S\"] }"]).own["action_sets"].clone();
        assert_eq!(sets.as_table().unwrap().keys().collect::<Vec<_>>(), ["b"]);
        // Which environment it is in the end decides, and the others' tables are of no account.
        let cart = own(&["env.force=3", "env.name=cart-pole", "env.maze.map=x"]);
        assert_eq!(
            (cart.name.as_str(), &cart.own),
            ("cart-pole", &Table::from_iter([("force".into(), 3.0.into())]))
        );
        assert_eq!(refused(&["env.name=cart-pole", "env.force=-1"]), "env.force = -1.0; accepted: 0 to 100");
        let both = ["env.name=cart-pole", "env.force=9", "env.step_limit=5"];
        assert_eq!(refused(&both), "env.force = 9; accepted: up to env.step_limit");
        assert_eq!(
            refused(&["env.name=cartpole", "env.force=3"]),
            "env.name = cartpole; accepted: maze, cart-pole; did you mean `cart-pole`?"
        );
        let forgotten =
            |table: &str| from_table(&Two, table.parse().unwrap(), &[]).map(|config| config.env.name);
        let error = forgotten("[run]\nepisodes = 1\n[env.cart-pole]\nforce = 3\n").unwrap_err().to_string();
        assert_eq!(
            error,
            "env.name = maze, its default; accepted: with settings in [env.cart-pole]: env.name = \"cart-pole\""
        );
        let both = "[run]\nepisodes = 1\n[env.maze]\nmap = \"m\"\n[env.cart-pole]\nforce = 3\n";
        assert_eq!(forgotten(both).unwrap(), "maze");
        assert!(refused(&["env.mapp=x"]).ends_with("did you mean `env.map`?"));
        assert!(refused(&["env.cart_pole.force=1"]).ends_with("did you mean `env.cart-pole`?"));
        assert!(refused(&["env.stepp_limit=1"]).ends_with("did you mean `env.step_limit`?"));
        assert!(refused(&["env.maze.mapp=x"]).ends_with("did you mean `env.map`?"));
        assert_eq!(refused(&["env.maze=5"]), "env.maze = 5; accepted: a table of settings");
        assert_eq!(refused(&["env=5"]), "env = 5; accepted: a table of settings");
    }

    #[test]
    fn configurations_of_version_0_1_0_are_read() {
        let text = "[run]\nepisodes = 4\n[env]\nkind = \"cart-pole\"\nmap = \"m\"\nlayout = \"S.G\"\nstep_limit = 7\n\
            [env.action_sets]\nup = [\"N\"]\n[env.cart_pole]\nlayout = \"wide\"\n[env.other]\nx = 1\n[env.hazard]\nafter = 0\n";
        let env = parse_toml("config.toml", text).unwrap().env;
        let own: Table = "map = \"m\"\nmap_text = \"S.G\"\nlayout = \"wide\"\n[action_sets]\nup = [\"N\"]"
            .parse()
            .unwrap();
        assert_eq!((env.name.as_str(), env.step_limit, env.own), ("cart-pole", 7, own));
    }
}
