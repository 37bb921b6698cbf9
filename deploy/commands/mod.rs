//! One file a subcommand.

mod config;
mod demo;
mod doctor;
mod eval;
mod role;
mod train;

use crate::cli::{Cli, Command};
use anyhow::Result;
use std::process::ExitCode;

/// Carries out what was typed.
pub(crate) fn run(cli: Cli) -> Result<ExitCode> {
    match cli.command {
        Command::Train(args) => train::run(&args),
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
