//! The environments of a program by name.

use super::grid::{ActionSet, Map};
use super::kind::{Finding, Foreign, Kind};
use super::{EnvError, Environment, Ground};
use std::marker::PhantomData;
use std::sync::OnceLock;
use trestle_proto::config::{
    self, Config, ConfigError, Environments, Field, Preset, SHARED, SelectionRule, Setting, Table, Value,
    refuse,
};
use trestle_proto::names;

/// The environments that a configuration can choose, in the order in which they were added.
#[derive(Default)]
pub struct Registry {
    entries: Vec<Entry>,
}

/// An environment and its name.
struct Entry {
    name: &'static str,
    kind: Box<dyn AnyKind>,
}

/// The registry of this process.
static REGISTRY: OnceLock<Registry> = OnceLock::new();

/// The registry of this process: the one that was [installed](install), or the built-in environments.
pub fn registry() -> &'static Registry {
    REGISTRY.get_or_init(Registry::builtin)
}

/// Makes `registry` that of this process. A program with environments of its own does this once, at its start.
///
/// # Errors
/// There is one already; `registry` comes back.
pub fn install(registry: Registry) -> Result<(), Registry> {
    REGISTRY.set(registry)
}

impl Registry {
    /// Adds an environment under `name`, which is that of its table as well.
    ///
    /// # Panics
    /// A name that is taken, or that is a setting of all environments: a mistake of the program, not of its user.
    pub fn with<K: Kind>(mut self, name: &'static str) -> Self {
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        let sound = !name.is_empty() && name.chars().all(plain) && !SHARED.contains(&name);
        assert!(
            sound,
            "{name:?} as an environment's name; accepted: letters a-z, digits and -, but not {SHARED:?}"
        );
        assert!(self.find(name).is_none(), "two environments are called {name}");
        self.entries.push(Entry { name, kind: Box::new(Typed::<K>(PhantomData)) });
        self
    }

    fn find(&self, name: &str) -> Option<&dyn AnyKind> {
        self.entries.iter().find(|entry| entry.name == name).map(|entry| entry.kind.as_ref())
    }

    fn of(&self, env: &config::Env) -> Result<&dyn AnyKind, ConfigError> {
        self.find(&env.name).ok_or_else(|| {
            let known = self.names();
            let hint = names::hint(&env.name, known.iter().copied());
            refuse("env.name", &env.name, &format!("{}{hint}", known.join(", ")))
        })
    }

    /// Completes `env` so that [`Registry::build`] needs nothing else: see [`Kind::resolve`].
    ///
    /// # Errors
    /// Settings that are not accepted, or what they name and is not there.
    pub fn resolve(&self, env: &mut config::Env, seed: u64) -> Result<(), EnvError> {
        env.own = self.of(env)?.resolve(env, seed)?;
        Ok(())
    }

    /// Whether the demonstration's states are needed to complete `env`: see [`Kind::wants_states`].
    ///
    /// # Errors
    /// Settings that are not accepted.
    pub fn wants_states(&self, env: &config::Env) -> Result<bool, EnvError> {
        self.of(env)?.wants_states(env)
    }

    /// Completes the resolved `env` with what the demonstration's states show: see [`Kind::take_states`].
    ///
    /// # Errors
    /// Settings that are not accepted, or were not resolved.
    pub fn take_states(&self, env: &mut config::Env, states: &[f32]) -> Result<(), EnvError> {
        env.own = self.of(env)?.take_states(env, states)?;
        Ok(())
    }

    /// Takes over into `typed` what was filled in when `own`, the same environment's settings, were resolved: see
    /// [`Kind::adopt`].
    ///
    /// # Errors
    /// Settings that are not accepted.
    pub fn adopt(&self, typed: &mut config::Env, own: &config::Env) -> Result<(), EnvError> {
        if typed.name == own.name {
            typed.own = self.of(own)?.adopt(&typed.own, &own.own)?;
        }
        Ok(())
    }

    /// The environment of a resolved configuration.
    ///
    /// # Errors
    /// Whatever the configuration asks for and the environment does not accept.
    pub fn build(&self, env: &config::Env) -> Result<Box<dyn Environment>, EnvError> {
        let built = self.of(env)?.build(env)?;
        built.spec().validate()?;
        Ok(built)
    }

    /// The demonstration `plan`: see [`Kind::plan`].
    ///
    /// # Errors
    /// An environment without a planner, an unknown action set, or a goal that is not reached.
    pub fn plan_states(&self, env: &config::Env, actions: &str) -> Result<Vec<Vec<f32>>, EnvError> {
        self.of(env)?.plan(env, actions)?.ok_or_else(|| EnvError::NoPlanner { env: env.name.clone() })
    }

    /// The map whose cells the states are, and a mentor's moves: see [`Kind::cells`].
    ///
    /// # Errors
    /// No map, or an action set that there is not.
    pub fn cells(&self, env: &config::Env, actions: &str) -> Result<Option<(Map, ActionSet)>, EnvError> {
        self.of(env)?.cells(env, actions)
    }

    /// The environment as text for a terminal: see [`Kind::draw`].
    ///
    /// # Errors
    /// Settings that give no environment.
    pub fn draw(&self, env: &config::Env, paths: &[(&[f32], char)]) -> Result<Option<String>, EnvError> {
        self.of(env)?.draw(env, paths)
    }

    /// The map on which the environment's states lie: see [`Kind::ground`].
    ///
    /// # Errors
    /// Settings that give no environment.
    pub fn ground(&self, env: &config::Env) -> Result<Option<Box<dyn Ground>>, EnvError> {
        self.of(env)?.ground(env)
    }

    /// What computes the environment: see [`Kind::engine`].
    ///
    /// # Errors
    /// Settings that are not accepted.
    pub fn engine(&self, env: &config::Env) -> Result<Option<Table>, EnvError> {
        self.of(env)?.engine(env)
    }

    /// The same environment made so that it has pictures: see [`Kind::filmed`].
    ///
    /// # Errors
    /// Settings that are not accepted.
    pub fn filmed(&self, env: &config::Env) -> Result<Option<config::Env>, EnvError> {
        let own = self.of(env)?.filmed(env)?;
        Ok(own.map(|own| config::Env { own, ..env.clone() }))
    }

    /// How the processes that step it are started, where it is other people's code: see [`Kind::foreign`].
    pub fn foreign(&self, env: &config::Env) -> Option<Foreign> {
        self.of(env).ok()?.foreign(env)
    }

    /// Whether what steps it is there: see [`Kind::ready`].
    ///
    /// # Errors
    /// It is not, or is of another build.
    pub fn ready(&self, env: &config::Env) -> Result<(), EnvError> {
        self.of(env)?.ready(env)
    }

    /// What is likely to be a mistake: see [`Kind::warnings`].
    ///
    /// # Errors
    /// Settings that are not accepted.
    pub fn warnings(&self, env: &config::Env) -> Result<Vec<String>, EnvError> {
        self.of(env)?.warnings(env)
    }

    /// Settings of the table `[env.<name>]` that nobody chooses: see [`Kind::FILLED`].
    pub fn filled(&self, name: &str) -> &'static [&'static str] {
        self.find(name).map_or(&[], AnyKind::filled)
    }

    /// What all environments say about this machine: see [`Kind::diagnose`].
    pub fn diagnose(&self) -> Vec<Finding> {
        self.entries.iter().flat_map(|entry| entry.kind.diagnose()).collect()
    }
}

impl Environments for Registry {
    fn names(&self) -> Vec<&'static str> {
        self.entries.iter().map(|entry| entry.name).collect()
    }

    fn about(&self, name: &str) -> &'static str {
        self.find(name).map_or("", AnyKind::about)
    }

    fn declared(&self, name: &str) -> Vec<Setting> {
        self.find(name).map_or_else(Vec::new, |kind| kind.declared(&format!("env.{name}")))
    }

    fn complete(&self, name: &str, given: Table) -> Result<Table, ConfigError> {
        let env = config::Env { name: name.into(), own: given, ..config::Env::default() };
        self.of(&env)?.complete(&env)
    }

    fn check(&self, config: &Config) -> Result<(), ConfigError> {
        self.of(&config.env)?.check(config)
    }

    fn shorthand(&self, text: &str) -> Option<Table> {
        self.entries.iter().find_map(|entry| entry.kind.shorthand(text))
    }

    fn presets(&self) -> Vec<Preset> {
        self.entries.iter().flat_map(|entry| entry.kind.presets()).copied().collect()
    }

    fn selections(&self) -> Vec<SelectionRule> {
        trestle_algorithm::selection::rules()
    }
}

/// A [`Kind`] whose settings are data.
trait AnyKind: Send + Sync {
    fn about(&self) -> &'static str;
    fn filled(&self) -> &'static [&'static str];
    fn declared(&self, key: &str) -> Vec<Setting>;
    fn presets(&self) -> &'static [Preset];
    fn complete(&self, env: &config::Env) -> Result<Table, ConfigError>;
    fn check(&self, config: &Config) -> Result<(), ConfigError>;
    fn resolve(&self, env: &config::Env, seed: u64) -> Result<Table, EnvError>;
    fn wants_states(&self, env: &config::Env) -> Result<bool, EnvError>;
    fn take_states(&self, env: &config::Env, states: &[f32]) -> Result<Table, EnvError>;
    fn adopt(&self, typed: &Table, own: &Table) -> Result<Table, EnvError>;
    fn build(&self, env: &config::Env) -> Result<Box<dyn Environment>, EnvError>;
    fn plan(&self, env: &config::Env, actions: &str) -> Result<Option<Vec<Vec<f32>>>, EnvError>;
    fn cells(&self, env: &config::Env, actions: &str) -> Result<Option<(Map, ActionSet)>, EnvError>;
    fn draw(&self, env: &config::Env, paths: &[(&[f32], char)]) -> Result<Option<String>, EnvError>;
    fn ground(&self, env: &config::Env) -> Result<Option<Box<dyn Ground>>, EnvError>;
    fn engine(&self, env: &config::Env) -> Result<Option<Table>, EnvError>;
    fn filmed(&self, env: &config::Env) -> Result<Option<Table>, EnvError>;
    fn diagnose(&self) -> Vec<Finding>;
    fn shorthand(&self, text: &str) -> Option<Table>;
    fn foreign(&self, env: &config::Env) -> Option<Foreign>;
    fn ready(&self, env: &config::Env) -> Result<(), EnvError>;
    fn warnings(&self, env: &config::Env) -> Result<Vec<String>, EnvError>;
}

/// `K` as an [`AnyKind`].
struct Typed<K>(PhantomData<fn() -> K>);

/// The settings in `own`, which messages call as [`Kind::TABLE`] says.
fn typed<K: Kind>(own: &Table) -> Result<K::Settings, ConfigError> {
    let settings = K::Settings::read(Value::Table(own.clone()), K::TABLE, "a table of settings")?;
    settings.check(K::TABLE)?;
    Ok(settings)
}

/// `settings` as a table, every one written out.
fn written<S: Field>(settings: &S) -> Result<Table, ConfigError> {
    Table::try_from(settings).map_err(|error| refuse("env", error, "settings that TOML can hold"))
}

impl<K: Kind> AnyKind for Typed<K> {
    fn about(&self) -> &'static str {
        K::ABOUT
    }

    fn filled(&self) -> &'static [&'static str] {
        K::FILLED
    }

    fn declared(&self, key: &str) -> Vec<Setting> {
        K::Settings::declared(key)
    }

    fn presets(&self) -> &'static [Preset] {
        K::presets()
    }

    fn complete(&self, env: &config::Env) -> Result<Table, ConfigError> {
        written(&typed::<K>(&env.own)?)
    }

    fn check(&self, config: &Config) -> Result<(), ConfigError> {
        K::check(&typed::<K>(&config.env.own)?, config)
    }

    fn resolve(&self, env: &config::Env, seed: u64) -> Result<Table, EnvError> {
        let mut settings = typed::<K>(&env.own)?;
        K::resolve(&mut settings, env, seed)?;
        Ok(written(&settings)?)
    }

    fn wants_states(&self, env: &config::Env) -> Result<bool, EnvError> {
        Ok(K::wants_states(&typed::<K>(&env.own)?))
    }

    fn take_states(&self, env: &config::Env, states: &[f32]) -> Result<Table, EnvError> {
        let mut settings = typed::<K>(&env.own)?;
        K::take_states(&mut settings, states)?;
        Ok(written(&settings)?)
    }

    fn adopt(&self, again: &Table, own: &Table) -> Result<Table, EnvError> {
        let mut settings = typed::<K>(again)?;
        K::adopt(&mut settings, &typed::<K>(own)?);
        Ok(written(&settings)?)
    }

    fn build(&self, env: &config::Env) -> Result<Box<dyn Environment>, EnvError> {
        Ok(Box::new(K::new(&typed::<K>(&env.own)?, env)?))
    }

    fn plan(&self, env: &config::Env, actions: &str) -> Result<Option<Vec<Vec<f32>>>, EnvError> {
        K::plan(&typed::<K>(&env.own)?, env, actions)
    }

    fn cells(&self, env: &config::Env, actions: &str) -> Result<Option<(Map, ActionSet)>, EnvError> {
        K::cells(&typed::<K>(&env.own)?, actions)
    }

    fn draw(&self, env: &config::Env, paths: &[(&[f32], char)]) -> Result<Option<String>, EnvError> {
        K::draw(&typed::<K>(&env.own)?, paths)
    }

    fn ground(&self, env: &config::Env) -> Result<Option<Box<dyn Ground>>, EnvError> {
        K::ground(&typed::<K>(&env.own)?)
    }

    fn engine(&self, env: &config::Env) -> Result<Option<Table>, EnvError> {
        Ok(K::engine(&typed::<K>(&env.own)?))
    }

    fn filmed(&self, env: &config::Env) -> Result<Option<Table>, EnvError> {
        Ok(K::filmed(&typed::<K>(&env.own)?).map(|settings| written(&settings)).transpose()?)
    }

    fn diagnose(&self) -> Vec<Finding> {
        K::diagnose()
    }

    fn shorthand(&self, text: &str) -> Option<Table> {
        K::shorthand(text)
    }

    fn foreign(&self, env: &config::Env) -> Option<Foreign> {
        K::foreign(&typed::<K>(&env.own).ok()?)
    }

    fn ready(&self, env: &config::Env) -> Result<(), EnvError> {
        K::ready(&typed::<K>(&env.own)?)
    }

    fn warnings(&self, env: &config::Env) -> Result<Vec<String>, EnvError> {
        Ok(K::warnings(&typed::<K>(&env.own)?))
    }
}
