//! The program: arguments in, one command out. Every process of a run is this program with another subcommand.

use crate::build_info::BUILD;
use crate::cli::Cli;
use crate::commands;
use crate::itself::{self, args};
use crate::output::{say, words};
use crate::prepare;
use clap::error::{ContextKind, ContextValue};
use clap::{CommandFactory, Parser};
use std::env::args_os;
use std::ffi::OsString;
use std::process::ExitCode;
use trestle_actor::env::{Identity, Kind, Registry, identify, install};

/// The program `trestle` with the environments that a configuration can choose.
///
/// A program with an environment of its own, which `[env.line]` sets:
///
/// ```no_run
/// use trestle::config::{self, accepts::between};
/// use trestle::env::{EnvError, Environment, Kind, Step};
/// use trestle::{EnvSpec, Stream, codec, rand::Rng, settings};
///
/// settings! {
///     /// `[env.line]`
///     pub struct Settings {
///         /// Cells of a step.
///         stride: u32 = 1, between(1, 3);
///     }
/// }
///
/// struct Line { spec: EnvSpec, stride: f32, at: f32, steps: u32, step_limit: u32 }
///
/// impl Kind for Line {
///     type Settings = Settings;
///     const ABOUT: &'static str = "A walk to the end of a line.";
///
///     fn new(settings: &Settings, env: &config::Env) -> Result<Self, EnvError> {
///         let actions: &[&str] = if settings.stride == 1 { &["back", "on"] } else { &["leap back", "leap on"] };
///         let spec = EnvSpec { threshold: Some(0.5), ..EnvSpec::of("line", &[[0.0, 20.0]], actions) };
///         let (stride, step_limit) = (settings.stride as f32, env.step_limit);
///         Ok(Self { spec, stride, at: 0.0, steps: 0, step_limit })
///     }
/// }
///
/// const SNAPSHOT: codec::Kind = codec::Kind { magic: *b"LINE\0\0\0\0", version: 1 };
///
/// impl Environment for Line {
///     fn spec(&self) -> &EnvSpec {
///         &self.spec
///     }
///
///     fn reset(&mut self, rng: &mut Stream, obs: &mut [f32]) -> Result<(), EnvError> {
///         (self.at, self.steps) = (rng.random_range(0..5) as f32, 0);
///         obs[0] = self.at;
///         Ok(())
///     }
///
///     fn step(&mut self, action: u32, obs: &mut [f32]) -> Result<Step, EnvError> {
///         let way = if action == 1 { self.stride } else { -self.stride };
///         (self.at, self.steps) = ((self.at + way).clamp(0.0, 20.0), self.steps + 1);
///         obs[0] = self.at;
///         let terminated = self.at == 20.0;
///         let truncated = !terminated && self.steps == self.step_limit;
///         Ok(Step { reward: if terminated { 1.0 } else { 0.0 }, terminated, truncated, success: false })
///     }
///
///     fn snapshot(&self) -> Result<Vec<u8>, EnvError> {
///         Ok(codec::encode(SNAPSHOT, &(self.at, self.steps))?)
///     }
///
///     fn restore(&mut self, bytes: &[u8]) -> Result<(), EnvError> {
///         (self.at, self.steps) = codec::decode(SNAPSHOT, bytes)?;
///         Ok(())
///     }
/// }
///
/// fn main() -> std::process::ExitCode {
///     trestle::Program::new().environment::<Line>("line").main()
/// }
/// ```
///
/// A test of it: `trestle::env::check::<Line>("line", &["env.stride=2"])` plays it, saves it, restores it and compares.
pub struct Program {
    environments: Registry,
    again: Vec<String>,
}

impl Default for Program {
    fn default() -> Self {
        Self::new()
    }
}

impl Program {
    /// With the environments that come with Trestle.
    pub fn new() -> Self {
        Self { environments: Registry::builtin(), again: Vec::new() }
    }

    /// Adds the environment `K`, which configurations choose by `env.name = "<name>"`; `[env.<name>]` is its table.
    ///
    /// # Panics
    /// A name that is taken, that is a setting of all environments, or that has other characters than a-z, 0-9 and `-`.
    pub fn environment<K: Kind>(self, name: &'static str) -> Self {
        Self { environments: self.environments.with::<K>(name), ..self }
    }

    /// Says that the same program is started again by `command`, to which a subcommand and its arguments are added. It is
    /// needed where the program is not its process's executable file, such as a module of Python.
    pub fn started_by(self, command: Vec<String>) -> Self {
        Self { again: command, ..self }
    }

    /// Carries out what the arguments of this process say. To be called once, first of all.
    pub fn main(self) -> ExitCode {
        self.run(args_os().collect()).into()
    }

    /// Carries out what `args` say, the first of which is the program's name, and returns the exit status. To be called once in
    /// a process.
    pub fn run(self, args: Vec<OsString>) -> u8 {
        let Self { environments, again } = self;
        if let Err(limit) = prepare::check_stack() {
            say(&format!("error: {limit}"));
            return 1;
        }
        let identity = Identity { build: BUILD, again };
        if !itself::begin(args) || identify(identity).is_err() || install(environments).is_err() {
            say("error: the program has been started in this process before");
            return 1;
        }
        carry_out()
    }
}

/// Apart from [`Program::run`], which must take little of the stack before it knows that there is enough.
#[inline(never)]
fn carry_out() -> u8 {
    let cli = match Cli::try_parse_from(args()) {
        Ok(cli) => cli,
        Err(mut error) => {
            known_alone(&mut error);
            let _ = error.print();
            return u8::try_from(error.exit_code()).unwrap_or(1);
        }
    };
    match commands::run(cli) {
        Ok(status) => status.into(),
        Err(error) => {
            say(&format!("error: {}", words(&error)));
            1
        }
    }
}

/// Takes what only the program itself types out of the subcommands that `error` suggests.
fn known_alone(error: &mut clap::Error) {
    let Some(ContextValue::Strings(names)) = error.get(ContextKind::SuggestedSubcommand) else { return };
    let command = Cli::command();
    let hidden = |name: &String| command.find_subcommand(name).is_some_and(|found| found.is_hide_set());
    let known: Vec<String> = names.iter().filter(|name| !hidden(name)).cloned().collect();
    if !known.is_empty() {
        error.insert(ContextKind::SuggestedSubcommand, ContextValue::Strings(known));
        return;
    }
    // A suggestion of nothing would be printed as an empty tip, and an empty list of other tips as an empty line.
    error.remove(ContextKind::SuggestedSubcommand);
    if matches!(error.get(ContextKind::Suggested), Some(ContextValue::StyledStrs(tips)) if tips.is_empty()) {
        error.remove(ContextKind::Suggested);
    }
}
