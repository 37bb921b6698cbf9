//! One file a subcommand.

mod config;
mod demo;
mod doctor;
mod eval;
mod export;
mod hosts;
mod join;
mod map;
mod picture;
mod relay;
mod report;
mod resume;
mod role;
mod submit;
mod sweep;
mod sync;
mod train;
mod watch;

use crate::cli::{Cli, Command};
use crate::status::ExitCode;
use anyhow::{Context, Result, ensure};
use nix::sys::stat::{Mode, umask};
use signal_hook::consts::{SIGPIPE, SIGXFSZ};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Carries out what was typed.
pub(crate) fn run(cli: Cli) -> Result<ExitCode> {
    if let Command::Eval(_)
    | Command::Export(_)
    | Command::Report(_)
    | Command::Demo(_)
    | Command::Map(_)
    | Command::Config(_)
    | Command::Doctor(_) = &cli.command
    {
        // What only prints ends when its reader has seen enough, as in `trestle config show maze30 | head`.
        signal_hook::flag::register_conditional_default(SIGPIPE, Arc::new(AtomicBool::new(true)))
            .context("cannot handle signals")?;
    }
    if let Command::Train(_)
    | Command::Resume(_)
    | Command::Sweep(_)
    | Command::Join(_)
    | Command::Actor(_)
    | Command::Learner(_)
    | Command::MentorServer(_)
    | Command::Relay(_) = &cli.command
    {
        // What is in a run's directory is its user's alone to write, and a user who may enter the directory may read it,
        // whatever the shell's mask says. Other commands write files of the user's, and go by the mask.
        umask(Mode::from_bits_truncate(0o022));
    }
    // A file beyond its limit (`ulimit -f`) is an error of the code that writes it, with a name, and not the end of the process.
    signal_hook::flag::register(SIGXFSZ, Arc::default()).context("cannot handle signals")?;
    match cli.command {
        Command::Train(args) => train::run(&args),
        Command::Resume(args) => resume::run(&args),
        Command::Sweep(args) => sweep::run(&args),
        Command::Report(args) => report::run(&args),
        Command::Watch(args) => watch::run(&args),
        Command::Sync(args) => sync::run(&args),
        Command::Eval(args) => eval::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Demo(args) => demo::run(&args),
        Command::Map(args) => map::run(&args),
        Command::Config(args) => config::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Join(args) => join::run(&args),
        Command::Hosts(command) => hosts::run(&command),
        Command::Relay(args) => relay::run(&args),
        Command::Actor(args) => role::actor(&args),
        Command::Learner(args) => role::learner(&args),
        Command::MentorServer(args) => role::mentor_server(&args),
        Command::Orphaned { run } => role::orphaned(run),
    }
}

/// Refuses to write where something is, unless that was asked for.
fn free(out: &Path, overwrite: bool) -> Result<()> {
    ensure!(overwrite || !out.exists(), "{} exists; accepted: another file, or --overwrite", out.display());
    Ok(())
}
