//! `trestle hosts`

use crate::carrier;
use crate::cli::HostsCommand;
use crate::status::ExitCode;
use anyhow::{Context, Result, ensure};

pub(super) fn run(command: &HostsCommand) -> Result<ExitCode> {
    let HostsCommand::Credentials { out, names } = command;
    let mut program = carrier::command()?;
    program.arg("credentials").arg(out).args(names);
    let status = program.status().context("cannot start trestle-relay")?;
    ensure!(status.success(), "no credentials were made, for the reason above");
    Ok(ExitCode::SUCCESS)
}
