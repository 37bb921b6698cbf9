//! The program `trestle`: arguments in, one command out. Every process of a run is this program with another
//! subcommand.

#[macro_use]
mod output;

mod build_info;
mod cli;
mod commands;
mod flags;
mod prepare;
mod reference;
mod status;
mod stored;
mod supervise;
mod sweep;

use clap::Parser;
use output::{say, words};
use std::process::ExitCode;

fn main() -> ExitCode {
    match commands::run(cli::Cli::parse()) {
        Ok(code) => code,
        Err(error) => {
            say(&format!("error: {}", words(&error)));
            ExitCode::FAILURE
        }
    }
}
