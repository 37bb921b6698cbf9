//! `trestle config`

use crate::cli::{Config, Typed};
use crate::prepare;
use crate::status::ExitCode;
use anyhow::{Result, bail};
use trestle_actor::env::registry;
use trestle_proto::config::{self, Environments, Field};
use trestle_proto::names;
use trestle_proto::space::EnvSpec;

/// Features that are shown by their names, at most.
const MAX_SHOWN: usize = 24;

pub(super) fn run(args: &Config) -> Result<ExitCode> {
    match args {
        Config::List { key } => list(key.as_deref())?,
        Config::Show(typed) => show(&load(typed)?)?,
        Config::Check(typed) => {
            let resolved = prepare::resolve(load(typed)?)?;
            let spec = &resolved.spec;
            outln!("{}: a run could start", typed.source.config);
            outln!(
                "  environment    {}, {} features, actions {}",
                spec.name,
                spec.obs_dim(),
                spec.actions.join(" ")
            );
            let env = registry().build(&resolved.config.env)?;
            if !env.features().is_empty() {
                outln!("  features       {}", numbered(&env.features(), spec));
            }
            if let Some(best) = spec.best_return {
                outln!("  best return    {best:.2}");
            }
            outln!("  step limit     {} (env.step_limit)", resolved.config.env.step_limit);
            if let Some(threshold) = resolved.config.eval.threshold.or(resolved.spec.threshold) {
                outln!("  threshold      {threshold:.3}");
            }
            if spec.defines_success {
                outln!("  success        the environment tells which episodes succeed");
            }
            if let Some(mentors) = &resolved.mentors {
                outln!("  demonstration  {} transitions", mentors.all.n_transitions());
            }
            for warning in resolved.warnings() {
                outln!("warning: {warning}");
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// The features called `names` with their numbers, and which are categories; the first [`MAX_SHOWN`] of them.
fn numbered(names: &[&str], spec: &EnvSpec) -> String {
    let name = |(number, name): (usize, &&str)| match spec.categories.contains(&number) {
        true => format!("{number} {name} (of {})", spec.high[number] - spec.low[number] + 1.0),
        false => format!("{number} {name}"),
    };
    let shown: Vec<String> = names.iter().enumerate().take(MAX_SHOWN).map(name).collect();
    shown.join(", ") + if names.len() > MAX_SHOWN { ", ..." } else { "" }
}

/// Prints the setting `key`, the settings of the table `key`, those that the preset `key` changes, or all.
fn list(key: Option<&str>) -> Result<()> {
    let all = config::declared(registry());
    let below = |key: &str, of: &str| {
        of.strip_prefix(key).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
    };
    let asked: Vec<_> = all.iter().filter(|setting| key.is_none_or(|key| below(key, &setting.key))).collect();
    if let Some(key) = key.filter(|_| asked.is_empty()) {
        if is_preset(key) {
            return list_changed(key, &all);
        }
        let keys: Vec<String> = all.iter().map(|setting| setting.key.clone()).collect();
        let presets = registry().presets().into_iter().map(|preset| preset.name);
        let short = registry().names().into_iter().filter(|name| is_preset(name));
        let known = all.iter().flat_map(|setting| [setting.key.as_str(), setting.table()]);
        let meant = names::nearest(key, known.chain(presets).chain(short)).map(String::from);
        let meant = meant.or_else(|| config::elsewhere(key, &keys));
        let hint = meant.map_or_else(String::new, |meant| format!("; did you mean `{meant}`?"));
        bail!("{key}: there is no such setting, table or preset{hint}");
    }
    for setting in asked {
        let config::Setting { key: name, kind, default, accepted, help, choices } = setting;
        outln!("{name}: {kind}, default {default}, accepted: {accepted}");
        outln!("    {help}");
        for (word, meaning) in choices.iter().filter(|_| key.is_some()) {
            outln!("    {word}: {meaning}");
        }
    }
    Ok(())
}

/// Whether `name` is a preset, or an environment that is one, such as `gym`.
fn is_preset(name: &str) -> bool {
    registry().presets().iter().any(|preset| preset.name == name) || registry().shorthand(name).is_some()
}

/// Prints those of `all` settings that the preset `name` changes.
fn list_changed(name: &str, all: &[config::Setting]) -> Result<()> {
    let table: config::Table = config::to_toml(&config::load(registry(), name, &[])?).parse()?;
    for config::Setting { key, kind, default, accepted, help, .. } in all {
        let default_is = |own: &config::Value| {
            format!("value = {default}").parse::<config::Table>().is_ok_and(|table| table["value"] == *own)
        };
        let Some(own) = find(&table, key).filter(|own| !default_is(own)) else { continue };
        outln!("{key}: {kind}, {own} with {name}, elsewhere default {default}, accepted: {accepted}");
        outln!("    {help}");
    }
    Ok(())
}

/// Every setting; what is not set, which TOML cannot say, as comments.
fn show(config: &config::Config) -> Result<()> {
    let text = config::to_toml(config);
    outln!("{}", text.trim_end());
    let table: config::Table = text.parse()?;
    let all = config::Config::declared("").into_iter().chain(registry().declared(&config.env.name));
    for setting in all.filter(|setting| find(&table, &setting.key).is_none()) {
        outln!("# {} is not set", setting.key);
    }
    Ok(())
}

/// The value of a dotted key.
fn find<'a>(table: &'a config::Table, key: &str) -> Option<&'a config::Value> {
    match key.split_once('.') {
        Some((first, rest)) => find(table.get(first)?.as_table()?, rest),
        None => table.get(key),
    }
}

fn load(typed: &Typed) -> Result<config::Config> {
    Ok(config::load_with(registry(), &typed.source.config, &typed.sets(), |config| typed.apply(config))?)
}
