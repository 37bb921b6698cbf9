//! This process as something that can be started again: its arguments, and the command that makes another one.

use anyhow::{Context, Result};
use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::process::Command;
use std::sync::OnceLock;
use trestle_actor::env::{self, registry};
use trestle_proto::config;

/// The arguments of this process.
static ARGS: OnceLock<Vec<OsString>> = OnceLock::new();

/// Takes note of the arguments of this process. False if that has been done before.
pub(crate) fn begin(args: Vec<OsString>) -> bool {
    ARGS.set(args).is_ok()
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
