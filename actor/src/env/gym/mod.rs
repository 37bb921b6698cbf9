//! Any environment with Gymnasium's interface, run by the Python of its process.
//!
//! - [`Settings`]: its table of a configuration;
//! - [`Found`]: its spaces, found by `probe` before the run;
//! - [`Gym`]: the environment: episodes, and their repetition where one is restored;
//! - [`Host`]: who steps it. Trestle's Python package installs one.

mod environment;
mod error;
mod found;
mod host;
mod probe;
mod settings;

#[cfg(test)]
mod tests;

pub use environment::Gym;
pub use error::GymError;
pub use found::{Actions, Features, Found};
pub use host::{Host, Made, Outcome, Simulator, install_host};
pub use settings::{Kwargs, Picks, Scale, Settings};

use super::{EnvError, Foreign, Kind};
use host::host;
use trestle_proto::config::{self, Config, ConfigError, Table, refuse};
use trestle_proto::limits::MAX_ACTIONS;

/// Begins the short form of a configuration: `gym:CartPole-v1`. Alone it is a base for configuration files.
const NAME: &str = "gym";
/// The settings that the short form stands for.
const DEFAULTS: &str = include_str!("defaults.toml");
/// Where nobody says which Python.
const PYTHON: &str = "python3";

impl Kind for Gym {
    type Settings = Settings;

    const ABOUT: &'static str = "Any environment with Gymnasium's interface, run by Python.";

    const TABLE: &'static str = "env.gym";

    const FILLED: &'static [&'static str] = &["found", "python", "probe_s"];

    fn new(settings: &Settings, env: &config::Env) -> Result<Self, EnvError> {
        Ok(Self::of(settings, env)?)
    }

    fn resolve(settings: &mut Settings, env: &config::Env, seed: u64) -> Result<(), EnvError> {
        if settings.found.is_some() {
            return Ok(());
        }
        if settings.id.is_empty() == settings.make.is_none() {
            let given = if settings.id.is_empty() { "\"\"" } else { &settings.id };
            return Err(refuse("env.gym.id", given, "an id such as CartPole-v1, or else env.gym.make").into());
        }
        if settings.python.is_none() && host().is_none() {
            settings.python = Some(PYTHON.into());
        }
        let found = probe::probe(&python(settings), settings, env.step_limit, seed)?;
        if let Some(difference) = found.difference.as_ref().filter(|_| !settings.nondeterministic) {
            return Err(GymError::Nondeterministic {
                name: found.name.clone(),
                difference: difference.clone(),
            }
            .into());
        }
        // Another Python may be found first the next time.
        settings.python.as_mut().into_iter().for_each(|python| python.clone_from(&found.executable));
        settings.found = Some(found.to_json()?);
        Ok(())
    }

    fn wants_states(settings: &Settings) -> bool {
        settings.scale.is_of_demonstration()
    }

    fn take_states(settings: &mut Settings, states: &[f32]) -> Result<(), EnvError> {
        if settings.scale.is_of_demonstration() {
            let mut found = Found::parse(settings.found.as_deref().ok_or(GymError::Unresolved)?)?;
            found.features.spread_over(states);
            settings.found = Some(found.to_json()?);
        }
        Ok(())
    }

    fn adopt(typed: &mut Settings, own: &Settings) {
        typed.found.clone_from(&own.found);
        // The run has the whole path of what was found under a bare name.
        if typed.python.as_ref().is_none_or(|python| !python.contains('/')) {
            typed.python.clone_from(&own.python);
        }
    }

    fn check(settings: &Settings, _config: &Config) -> Result<(), ConfigError> {
        let wrong = match &settings.scale {
            Scale::Each(all) => all.iter().find(|scale| !(scale.is_finite() && **scale > 0.0)),
            Scale::Named(_) => None,
        };
        if let Some(scale) = wrong {
            return Err(refuse("env.gym.scale", scale, "a number above 0 for each feature"));
        }
        if let Some(bins) = settings.bins.iter().find(|bins| !(2..=MAX_ACTIONS).contains(*bins)) {
            return Err(refuse("env.gym.bins", bins, &format!("numbers from 2 to {MAX_ACTIONS}")));
        }
        Ok(())
    }

    fn shorthand(text: &str) -> Option<Table> {
        let rest = text.strip_prefix(NAME)?;
        let id = if rest.is_empty() { Some(rest) } else { rest.strip_prefix(':') }?;
        let mut table: Table = DEFAULTS.parse().ok()?;
        let own = Table::from_iter([("id".to_string(), id.into())]);
        table.get_mut("env")?.as_table_mut()?.insert(NAME.into(), own.into());
        Some(table)
    }

    fn foreign(settings: &Settings) -> Option<Foreign> {
        let elsewhere = settings.python.is_some() || host().is_none();
        Some(Foreign {
            here: host().is_some(),
            program: elsewhere.then(|| python(settings)),
            // Otherwise sets of texts have another order in each process.
            variables: vec![("PYTHONHASHSEED", "0")],
        })
    }

    fn filmed(settings: &Settings) -> Option<Settings> {
        let mut filmed = settings.clone();
        filmed.kwargs.0.insert("render_mode".into(), "rgb_array".into());
        Some(filmed)
    }

    fn ready(settings: &Settings) -> Result<(), EnvError> {
        // What was found is of the build that found it, which may be gone.
        match &settings.python {
            Some(_) => Ok(probe::same_build(&python(settings), settings)?),
            None => Ok(()),
        }
    }

    fn warnings(settings: &Settings) -> Vec<String> {
        let found = settings.found.as_deref().and_then(|found| Found::parse(found).ok());
        found.map_or_else(Vec::new, |found| {
            let difference = found.difference.map(|difference| {
                format!("{} is not deterministic: {difference}; this run will not repeat", found.name)
            });
            difference.into_iter().chain(found.warnings).collect()
        })
    }

    fn engine(settings: &Settings) -> Option<Table> {
        let found = Found::parse(settings.found.as_deref()?).ok()?;
        let entry = |key: &str, value: String| (key.to_string(), config::Value::String(value));
        Some(Table::from_iter([
            entry("engine", "gymnasium".into()),
            entry("version", found.gymnasium),
            entry("python", found.python),
        ]))
    }
}

/// The command of Trestle in the Python of `settings`.
fn python(settings: &Settings) -> Vec<String> {
    match &settings.python {
        Some(python) => [python, "-m", "trestle"].map(String::from).to_vec(),
        // The program itself.
        None => super::again(),
    }
}
