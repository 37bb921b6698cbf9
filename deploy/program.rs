//! The program: arguments in, one command out. Every process of a run is this program with another subcommand.

use crate::cli::Cli;
use crate::commands;
use crate::output::{say, words};
use crate::prepare;
use anyhow::{Context, Result};
use clap::Parser;
use std::env::args_os;
use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::process::{Command, ExitCode};
use std::sync::OnceLock;
use trestle_actor::env::{self, Identity, Kind, Registry, identify, install, registry};
use trestle_proto::config;

/// The program `trestle` with the environments that a configuration can choose.
pub struct Program {
    environments: Registry,
    again: Vec<String>,
}

/// The arguments of this process.
static ARGS: OnceLock<Vec<OsString>> = OnceLock::new();

/// What tells the sources that this was built from: 16 digits that another source would hardly have.
pub const BUILD: &str = env!("TRESTLE_SOURCES");

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
        if ARGS.set(args).is_err() || identify(identity).is_err() || install(environments).is_err() {
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
        Err(error) => {
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

/// The arguments of this process, its name first.
pub(crate) fn args() -> &'static [OsString] {
    ARGS.get().map_or(&[], Vec::as_slice)
}

/// The command that starts this program again; a subcommand is to be added.
pub(crate) fn again() -> Command {
    let mut command = command(&env::again());
    if env::again().len() == 1 {
        command.arg0(args().first().cloned().unwrap_or_default());
    }
    command
}

/// Goes on as the Trestle that can step the environment `env`, with the same arguments, where this one cannot.
///
/// # Errors
/// It cannot be started.
pub(crate) fn hand_over(env: &config::Env) -> Result<()> {
    let foreign = registry().foreign(env).filter(|foreign| !foreign.here);
    let Some(words) = foreign.and_then(|foreign| foreign.program) else { return Ok(()) };
    let error = command(&words).args(args().iter().skip(1)).exec();
    Err(error).with_context(|| format!("cannot start {}", words.join(" ")))
}

/// The program and the first arguments in `words`, of which there is one at least.
pub(crate) fn command(words: &[String]) -> Command {
    let mut words = words.iter();
    let mut command = Command::new(words.next().map_or("", String::as_str));
    command.args(words);
    command
}
