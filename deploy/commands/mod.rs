//! One file a subcommand.

mod config;
mod demo;
mod doctor;
mod eval;
mod report;
mod role;
mod sweep;
mod train;

use crate::cli::{Cli, Command};
use anyhow::{Context, Result};
use signal_hook::consts::SIGPIPE;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Carries out what was typed.
pub(crate) fn run(cli: Cli) -> Result<ExitCode> {
    if let Command::Eval(_)
    | Command::Report(_)
    | Command::Demo(_)
    | Command::Config(_)
    | Command::Doctor(_) = &cli.command
    {
        // What only prints ends when its reader has seen enough, as in `trestle config show maze30 | head`.
        signal_hook::flag::register_conditional_default(SIGPIPE, Arc::new(AtomicBool::new(true)))
            .context("cannot handle signals")?;
    }
    match cli.command {
        Command::Train(args) => train::run(&args),
        Command::Sweep(args) => sweep::run(&args),
        Command::Report(args) => report::run(&args),
        Command::Eval(args) => eval::run(&args),
        Command::Demo(args) => demo::run(&args),
        Command::Config(args) => config::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Actor(args) => role::actor(&args),
        Command::Learner(args) => role::learner(&args),
        Command::MentorServer(args) => role::mentor_server(&args),
        Command::Orphaned { run } => role::orphaned(run),
    }
}
