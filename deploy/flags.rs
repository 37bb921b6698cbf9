//! The values of flags. Some flags stand for settings: their values are the configuration's own types, and their help is the
//! settings' own. Every refusal names the flag, the value and the accepted values.

use clap::builder::{PossibleValue, TypedValueParser};
use clap::error::ErrorKind;
use clap::{Arg, Args, Command};
use serde::{Deserialize, Serialize};
use std::ffi::OsStr;
use std::marker::PhantomData;
use std::net::IpAddr;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use trestle_actor::env::registry;
use trestle_proto::config::{Choice, Config, Environments, Field, Setting, is_whole};

/// How long a run is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Args, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Limits {
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = setting::<u64>("run.episodes"), help = help("run.episodes"))]
    pub(crate) episodes: Option<u64>,
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = setting::<u64>("run.env_steps"), help = help("run.env_steps"))]
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
    declared(key).map_or_else(String::new, |setting| {
        let help = setting.help.strip_suffix('.').unwrap_or(&setting.help);
        format!("{help} [{key}, default {}]", setting.default)
    })
}

fn declared(key: &str) -> Option<Setting> {
    Config::declared("").into_iter().find(|setting| setting.key == key)
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
pub(crate) struct Word<T> {
    /// What to type instead of a word that is none of these.
    instead: fn(&str) -> Option<String>,
    choice: PhantomData<T>,
}

/// The parser of a flag whose values are those of `T`.
pub(crate) fn word<T: Choice>() -> Word<T> {
    word_or(|_| None)
}

/// The same, where `instead` knows what other words stand for.
pub(crate) fn word_or<T: Choice>(instead: fn(&str) -> Option<String>) -> Word<T> {
    Word { instead, choice: PhantomData }
}

impl<T: Choice> TypedValueParser for Word<T> {
    type Value = T;

    fn parse_ref(&self, command: &Command, arg: Option<&Arg>, value: &OsStr) -> Result<T, clap::Error> {
        let text = value.to_string_lossy();
        T::of_name(&text).ok_or_else(|| {
            let accepted = match (self.instead)(&text) {
                Some(instead) => format!("{}; {instead}", T::names().collect::<Vec<_>>().join(", ")),
                None => T::accepted_for(&text),
            };
            refuse(command, arg, format!("{text}; accepted: {accepted}"))
        })
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(T::ALL.iter().map(|(_, word, help)| PossibleValue::new(*word).help(help.trim()))))
    }
}

/// Reads a whole number.
#[derive(Clone)]
pub(crate) struct Whole<T> {
    range: RangeInclusive<u64>,
    /// The setting that the flag stands for, if it stands for one, and what that accepts.
    setting: Option<(&'static str, String)>,
    number: PhantomData<T>,
}

/// The parser of a flag that takes a whole number in `range`.
pub(crate) fn whole<T>(range: RangeInclusive<u64>) -> Whole<T> {
    Whole { range, setting: None, number: PhantomData }
}

/// The parser of a flag that stands for the setting `key`, a whole number. Its own range is checked with the configuration's.
pub(crate) fn setting<T>(key: &'static str) -> Whole<T> {
    let accepted = declared(key).map_or_else(String::new, |setting| setting.accepted);
    // A configuration holds no larger ones.
    Whole { range: 0..=i64::MAX as u64, setting: Some((key, accepted)), number: PhantomData }
}

impl<T: TryFrom<u64> + Clone + Send + Sync + 'static> TypedValueParser for Whole<T> {
    type Value = T;

    fn parse_ref(&self, command: &Command, arg: Option<&Arg>, value: &OsStr) -> Result<T, clap::Error> {
        let text = value.to_string_lossy();
        let number = text.parse().ok().filter(|number| self.range.contains(number));
        number.and_then(|number| T::try_from(number).ok()).ok_or_else(|| {
            let message = match &self.setting {
                Some((key, accepted)) => format!("{text}: {key} = {text}; accepted: {accepted}"),
                None => format!("{text}; accepted: {} to {}", self.range.start(), self.range.end()),
            };
            let kind = if is_whole(&text) { "" } else { ", a whole number" };
            refuse(command, arg, message + kind)
        })
    }
}

/// An address of the network.
pub(crate) fn address(text: &str) -> Result<IpAddr, String> {
    text.parse().map_err(|_| "accepted: an address, such as 127.0.0.1, 0.0.0.0 or ::1".into())
}

/// Reads the path of something that is to be written.
#[derive(Clone)]
pub(crate) struct Target;

impl TypedValueParser for Target {
    type Value = PathBuf;

    fn parse_ref(&self, command: &Command, arg: Option<&Arg>, value: &OsStr) -> Result<PathBuf, clap::Error> {
        let text = value.to_string_lossy();
        match text.as_bytes() {
            [] => Err(refuse(command, arg, "with an empty path; accepted: a path".into())),
            // Taken for a flag by whatever it is handed to next, this program included.
            [b'-', ..] => Err(refuse(command, arg, format!("{text} looks like a flag; accepted: ./{text}"))),
            _ => Ok(value.into()),
        }
    }
}

fn refuse(command: &Command, arg: Option<&Arg>, message: String) -> clap::Error {
    let flag = arg.and_then(Arg::get_long).unwrap_or_default();
    command.clone().error(ErrorKind::InvalidValue, format!("--{flag} {message}"))
}
