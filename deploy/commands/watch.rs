//! `trestle watch`, and the page beside a training.

use crate::cli::{Beside, Watch};
use crate::output::say;
use crate::prepare::{check_page, run_at};
use crate::status::ExitCode;
use anyhow::{Context, Result};
use std::net::{IpAddr, Ipv4Addr};
use std::path::Path;
use trestle_watch::Server;

pub(super) fn run(args: &Watch) -> Result<ExitCode> {
    check_page()?;
    let server = Server::bind(&run_at(&args.dir)?, args.bind, args.port)?;
    outln!("{}: {}", args.dir.display(), server.url());
    if !server.is_private() {
        say("note: everybody who can reach this machine can see the page");
    }
    server.serve()?;
    Ok(ExitCode::SUCCESS)
}

/// Shows `run`, where it is one of several in `dir`, or else `dir` itself, for as long as this process lives, if that is asked
/// for.
pub(super) fn beside(asked: Beside, dir: &Path, run: Option<&str>) -> Result<()> {
    let Some(port) = asked.watch else { return Ok(()) };
    check_page()?;
    let server = Server::bind(dir, IpAddr::V4(Ipv4Addr::LOCALHOST), port)?;
    let page = run.map(|run| format!("run/{run}")).unwrap_or_default();
    say(&format!("watch: {}{page}", server.url()));
    server.serve_beside().context("--watch")
}
