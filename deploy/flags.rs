//! Flags that stand for settings: their values are the configuration's own types, and their help is the settings' own.

use clap::builder::{PossibleValue, TypedValueParser};
use clap::error::ErrorKind;
use clap::{Arg, Args, Command};
use serde::{Deserialize, Serialize};
use std::ffi::OsStr;
use std::marker::PhantomData;
use trestle_actor::env::registry;
use trestle_proto::config::{Choice, Config, Environments, Field};

/// How long a run is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Args, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Limits {
    #[arg(long, value_name = "N", help = help("run.episodes"))]
    pub(crate) episodes: Option<u64>,
    #[arg(long, value_name = "N", help = help("run.env_steps"))]
    pub(crate) env_steps: Option<u64>,
}

impl Limits {
    /// Sets what was given.
    pub(crate) fn apply(self, config: &mut Config) {
        config.run.episodes = self.episodes.or(config.run.episodes);
        config.run.env_steps = self.env_steps.or(config.run.env_steps);
    }

    /// What was given, or else that of `before`.
    pub(crate) fn or(self, before: Self) -> Self {
        Self { episodes: self.episodes.or(before.episodes), env_steps: self.env_steps.or(before.env_steps) }
    }
}

/// The help of the flag that stands for the setting `key`: the setting's own.
pub(crate) fn help(key: &str) -> String {
    let setting = Config::declared("").into_iter().find(|setting| setting.key == key);
    setting.map_or_else(String::new, |setting| {
        let help = setting.help.strip_suffix('.').unwrap_or(&setting.help);
        format!("{help} [{key}, default {}]", setting.default)
    })
}

/// All presets, a line each.
pub(crate) fn presets() -> String {
    let presets = registry().presets();
    let width = presets.iter().map(|preset| preset.name.len()).max().unwrap_or(0);
    let line = |name: &str, about: &str| format!("\n  {name:width$}  {about}");
    presets.iter().fold("Presets:".into(), |text, preset| text + &line(preset.name, preset.about()))
}

/// Reads a word of `T`.
#[derive(Clone)]
pub(crate) struct Word<T>(PhantomData<T>);

/// The parser of a flag whose values are those of `T`.
pub(crate) fn word<T: Choice>() -> Word<T> {
    Word(PhantomData)
}

impl<T: Choice> TypedValueParser for Word<T> {
    type Value = T;

    fn parse_ref(&self, command: &Command, arg: Option<&Arg>, value: &OsStr) -> Result<T, clap::Error> {
        let text = value.to_string_lossy();
        T::of_name(&text).ok_or_else(|| {
            let flag = arg.and_then(Arg::get_long).unwrap_or_default();
            let message = format!("--{flag} {text}; accepted: {}", T::accepted_for(&text));
            command.clone().error(ErrorKind::InvalidValue, message)
        })
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(T::ALL.iter().map(|(_, word, help)| PossibleValue::new(*word).help(help.trim()))))
    }
}
