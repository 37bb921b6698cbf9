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
mod screen;
mod status;
mod stored;
mod supervise;
mod sweep;

use clap::Parser;
use output::{say, words};
use std::process::ExitCode;

fn main() -> ExitCode {
    if let Err(limit) = prepare::check_stack() {
        say(&format!("error: {limit}"));
        return ExitCode::FAILURE;
    }
    carry_out()
}

/// Apart from `main`, which must take little of the stack before it knows that there is enough.
#[inline(never)]
fn carry_out() -> ExitCode {
    match commands::run(cli::Cli::parse()) {
        Ok(code) => code,
        Err(error) => {
            say(&format!("error: {}", words(&error)));
            ExitCode::FAILURE
        }
    }
}
