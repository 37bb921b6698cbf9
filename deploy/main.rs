//! The program `trestle`: arguments in, one command out. Every process of a run is this program with another
//! subcommand.

mod build_info;
mod cli;
mod commands;
mod reference;
mod supervise;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    match commands::run(cli::Cli::parse()) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
