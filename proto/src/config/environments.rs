//! What reading a configuration must know of the environments and the selection rules that it may name, and how the tables of
//! environments are found.

use super::environment::{SHARED, Shared};
use super::error::unknown_key;
use super::{Config, ConfigError, Field, Preset, SelectionRule, Setting, expansion, refuse};
use crate::names;
use toml::{Table, Value};

/// The environments that a configuration may name. A program's registry of environments is one; `()` knows none, and takes
/// every name and every table as it is.
pub trait Environments {
    /// Their names.
    fn names(&self) -> Vec<&'static str>;

    /// What the environment called `name` is, in one line; nothing for an unknown name.
    fn about(&self, name: &str) -> &'static str;

    /// The settings of the table `[env.<name>]`; none for an unknown name.
    fn declared(&self, name: &str) -> Vec<Setting>;

    /// The table `[env.<name>]` with every setting written out, from what is given of it.
    ///
    /// # Errors
    /// An unknown name, a key that is no setting, or a value that is not accepted.
    fn complete(&self, name: &str, given: Table) -> Result<Table, ConfigError>;

    /// Checks the environment's settings together with all others.
    ///
    /// # Errors
    /// A combination that makes no sense, with what is accepted.
    fn check(&self, config: &Config) -> Result<(), ConfigError>;

    /// The configuration that `text` stands for, where it is none of a preset or a file.
    fn shorthand(&self, _text: &str) -> Option<Table> {
        None
    }

    /// The presets that the environments bring.
    fn presets(&self) -> Vec<Preset>;

    /// The rules that `mentor.selection` may name, those of the program's algorithm; none if every name is taken as it is.
    fn selections(&self) -> Vec<SelectionRule>;
}

impl Environments for () {
    fn names(&self) -> Vec<&'static str> {
        Vec::new()
    }

    fn about(&self, _name: &str) -> &'static str {
        ""
    }

    fn declared(&self, _name: &str) -> Vec<Setting> {
        Vec::new()
    }

    fn complete(&self, _name: &str, given: Table) -> Result<Table, ConfigError> {
        Ok(given)
    }

    fn check(&self, _config: &Config) -> Result<(), ConfigError> {
        Ok(())
    }

    fn presets(&self) -> Vec<Preset> {
        Vec::new()
    }

    fn selections(&self) -> Vec<SelectionRule> {
        Vec::new()
    }
}

/// Every setting there is: those of all environments, and those of their own tables.
pub fn declared(environments: &dyn Environments) -> Vec<Setting> {
    let names = environments.names();
    let mut all = Config::declared("");
    for setting in all.iter_mut().filter(|setting| setting.key == "env.name") {
        setting.accepted = names.join(", ");
        setting.choices = names.iter().map(|name| (*name, environments.about(name))).collect();
    }
    SelectionRule::declare(&environments.selections(), &mut all);
    let own = names.iter().flat_map(|name| environments.declared(name));
    let after = all.iter().rposition(|setting| setting.key.starts_with("env.")).map_or(0, |last| last + 1);
    all.splice(after..after, own);
    all
}

/// The name of the environment that `layers` choose, the last of them that names one.
pub(super) fn chosen<'a>(
    layers: impl Iterator<Item = &'a Table>,
    environments: &dyn Environments,
) -> Result<String, ConfigError> {
    let all = environments.names();
    let layers: Vec<&Table> = layers.collect();
    let name = match layers.iter().filter_map(|layer| layer.get("env")?.get("name")).next_back() {
        Some(Value::String(name)) => name.clone(),
        Some(other) => return Err(refuse("env.name", other, &all.join(", "))),
        None => {
            let name = Shared::default().name;
            let has = |other: &str| {
                layers.iter().any(|layer| layer.get("env").is_some_and(|env| env.get(other).is_some()))
            };
            // A file with settings of another environment forgets to say so.
            if let Some(meant) =
                all.iter().find(|other| **other != name && has(other)).filter(|_| !has(&name))
            {
                let base =
                    environments.shorthand(meant).map_or(String::new(), |_| format!("base = {meant:?}, or "));
                let accepted = format!("with settings in [env.{meant}]: {base}env.name = {meant:?}");
                return Err(refuse("env.name", format!("{name}, its default"), &accepted));
            }
            name
        }
    };
    if all.is_empty() || all.contains(&name.as_str()) {
        return Ok(name);
    }
    let accepted = format!("{}{}", all.join(", "), names::hint(&name, all.iter().copied()));
    Err(refuse("env.name", &name, &accepted))
}

/// Moves settings of the environment `name` that stand in `[env]` itself into its own table: `env.map` is short for
/// `env.maze.map` where the environment is the maze. Says whether there were any.
pub(super) fn expand(
    layer: &mut Table,
    name: &str,
    environments: &dyn Environments,
) -> Result<bool, ConfigError> {
    let mut moved = false;
    let Some(Value::Table(env)) = layer.get_mut("env") else { return Ok(moved) };
    let (all, declared) = (environments.names(), environments.declared(name));
    let is_own = |key: &str| declared.iter().any(|setting| setting.key.split('.').nth(2) == Some(key));
    let keys: Vec<String> = env.keys().cloned().collect();
    for key in keys {
        if SHARED.contains(&key.as_str()) || all.contains(&key.as_str()) || key == name {
            continue;
        }
        if !is_own(&key) && !all.is_empty() {
            let own = declared.iter().filter_map(|setting| setting.key.split('.').nth(2));
            let known: Vec<&str> = SHARED.into_iter().chain(own).chain(all).collect();
            return Err(unknown_key("env", &key, &known, &[]));
        }
        let Some(value) = env.remove(&key) else { continue };
        match env.entry(name).or_insert_with(|| Value::Table(Table::new())) {
            Value::Table(own) => _ = own.insert(key, value),
            other => return Err(refuse(&format!("env.{name}"), &*other, "a table of settings")),
        }
        moved = true;
    }
    Ok(moved)
}

/// Completes the own table of the environment `name` in `table`, and drops those of all others.
pub(super) fn complete(
    table: &mut Table,
    name: &str,
    environments: &dyn Environments,
) -> Result<(), ConfigError> {
    let env = table.entry("env").or_insert_with(|| Value::Table(Table::new()));
    let Value::Table(env) = env else { return Ok(()) };
    let given = env.remove(name).unwrap_or_else(|| Value::Table(Table::new()));
    let given = expansion::table(given, &format!("env.{name}"))?;
    environments.names().into_iter().for_each(|other| _ = env.remove(other));
    env.insert("name".into(), name.into());
    env.insert(name.into(), Value::Table(environments.complete(name, given)?));
    Ok(())
}
