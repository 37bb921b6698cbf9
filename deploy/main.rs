//! The program `trestle`: arguments in, one command out. Every process of a run is this program with another
//! subcommand.

mod bench;
#[macro_use]
mod output;

mod build_info;
mod cli;
mod commands;
mod reference;
mod status;
mod supervise;
mod sweep;

use clap::Parser;
use output::say;
use std::process::ExitCode;

fn main() -> ExitCode {
    match commands::run(cli::Cli::parse()) {
        Ok(code) => code,
        Err(error) => {
            let mut text = error.to_string();
            for cause in error.chain().skip(1).map(ToString::to_string) {
                // Many messages end with their cause's words already.
                if !text.ends_with(&cause) {
                    text += &format!(": {cause}");
                }
            }
            say(&format!("error: {text}"));
            ExitCode::FAILURE
        }
    }
}
