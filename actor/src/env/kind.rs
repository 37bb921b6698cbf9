//! What makes a type an environment that a configuration can choose: its settings, and what it offers besides steps.

use super::grid::{ActionSet, Map};
use super::{EnvError, Environment, Ground};
use trestle_proto::config::{self, Config, ConfigError, Field, Preset, Table};

/// An environment that a configuration can choose by a name. [`Registry::with`](super::Registry::with) gives it one.
///
/// Only the settings and [`Kind::new`] are needed. All else has a default: no preset, no planned mentor, no picture.
#[allow(unused_variables, reason = "the defaults need none of their arguments")]
pub trait Kind: Environment + Sized + 'static {
    /// Its table `[env.<name>]`: [`trestle_proto::settings!`] declares one.
    type Settings: Field + Default;

    /// What it is, in one line.
    const ABOUT: &'static str;

    /// How messages call its table. `env`, which is short for `env.<name>`, fits where people type that.
    const TABLE: &'static str = "env";

    /// Settings that nobody chooses: [`Kind::resolve`] fills them in, or they say by what and not what is simulated. Runs that
    /// differ in them alone have one task.
    const FILLED: &'static [&'static str] = &[];

    /// The environment of resolved settings, not yet reset. `env` has what all environments share.
    ///
    /// # Errors
    /// Whatever the settings ask for and the environment does not accept.
    fn new(settings: &Self::Settings, env: &config::Env) -> Result<Self, EnvError>;

    /// Completes `settings` with what a run must not depend on later: the contents of files, and what is found on this
    /// machine. `seed` is the run's, for what is random by it. To resolve them again changes nothing.
    ///
    /// # Errors
    /// What cannot be found or used.
    fn resolve(settings: &mut Self::Settings, env: &config::Env, seed: u64) -> Result<(), EnvError> {
        Ok(())
    }

    /// Whether [`Kind::take_states`] needs the states of the run's demonstration, whatever its algorithm is.
    fn wants_states(settings: &Self::Settings) -> bool {
        false
    }

    /// Completes resolved `settings` with what `states` show, those of the demonstration, row-major. To do it again with the same
    /// states changes nothing.
    ///
    /// # Errors
    /// Settings that were not resolved.
    fn take_states(settings: &mut Self::Settings, states: &[f32]) -> Result<(), EnvError> {
        Ok(())
    }

    /// Takes over into `typed`, which somebody types again to go on with a run, what [`Kind::resolve`] put into the run's
    /// own settings.
    fn adopt(typed: &mut Self::Settings, own: &Self::Settings) {}

    /// Checks `settings` together with those of all other tables.
    ///
    /// # Errors
    /// A combination that makes no sense, with what is accepted.
    fn check(settings: &Self::Settings, config: &Config) -> Result<(), ConfigError> {
        Ok(())
    }

    /// The presets that come with it.
    fn presets() -> &'static [Preset] {
        &[]
    }

    /// The configuration that `text` stands for, where it is none of a preset or a file, such as `gym:CartPole-v1`.
    fn shorthand(text: &str) -> Option<Table> {
        None
    }

    /// How the processes are started that step it, where it is other people's code.
    fn foreign(settings: &Self::Settings) -> Option<Foreign> {
        None
    }

    /// Checks, before a run starts or goes on, that what steps it is there and fits this program.
    ///
    /// # Errors
    /// It is not, or does not.
    fn ready(settings: &Self::Settings) -> Result<(), EnvError> {
        Ok(())
    }

    /// What of the resolved `settings` is likely to be a mistake, though it can be run.
    fn warnings(settings: &Self::Settings) -> Vec<String> {
        Vec::new()
    }

    /// States of a planned mentor that acts with the action set `actions`, from a start to the goal, `[obs_dim]` features
    /// each; the last one is terminal. None where the environment has no planner.
    ///
    /// # Errors
    /// An action set that there is not, or a goal that is not reached.
    fn plan(
        settings: &Self::Settings,
        env: &config::Env,
        actions: &str,
    ) -> Result<Option<Vec<Vec<f32>>>, EnvError> {
        Ok(None)
    }

    /// The map of which each state is a cell, (column, row), and a mentor's moves with the action set `actions`. None where states
    /// are something else.
    ///
    /// # Errors
    /// No map, or an action set that there is not.
    fn cells(settings: &Self::Settings, actions: &str) -> Result<Option<(Map, ActionSet)>, EnvError> {
        Ok(None)
    }

    /// The environment as text for a terminal, with paths of states and the mark of each laid over it; where two meet, the
    /// later one is seen. None where there is nothing to draw.
    ///
    /// # Errors
    /// Settings that give no environment.
    fn draw(settings: &Self::Settings, paths: &[(&[f32], char)]) -> Result<Option<String>, EnvError> {
        Ok(None)
    }

    /// The map on which reports draw the environment's states; none where there is no map.
    ///
    /// # Errors
    /// Settings that give no environment.
    fn ground(settings: &Self::Settings) -> Result<Option<Box<dyn Ground>>, EnvError> {
        Ok(None)
    }

    /// The settings of the same environment made so that it has pictures ([`Environment::frame`]); none where it never has any.
    fn filmed(settings: &Self::Settings) -> Option<Self::Settings> {
        None
    }

    /// What computes it, for a run's `build.json`; none where that is Trestle itself.
    fn engine(settings: &Self::Settings) -> Option<Table> {
        None
    }

    /// What `trestle doctor` says about the environment's needs on this machine.
    fn diagnose() -> Vec<Finding> {
        Vec::new()
    }
}

/// How a process is started that runs other people's code. It gets no standard input, what it prints goes to its log, and
/// whatever it has started ends with it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Foreign {
    /// Whether this process can step the environment itself.
    pub here: bool,
    /// The command of the Trestle that is to step the environment, where that is not this program; a subcommand is added.
    pub program: Option<Vec<String>>,
    /// Variables of its environment.
    pub variables: Vec<(&'static str, &'static str)>,
}

/// A line of `trestle doctor`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Whether it needs no attention.
    pub sound: bool,
    /// What was found.
    pub text: String,
}
