//! `trestle join`

use crate::carrier::{self, Joining};
use crate::cli::Join;
use crate::status::{ExitCode, INTERRUPTED};
use crate::supervise::{self, HeldSignals, Parted};
use anyhow::{Result, ensure};
use std::fs;
use trestle_link::logging;
use trestle_proto::hosts_file::{MAX_NAME, is_name, is_plain};

pub(super) fn run(args: &Join) -> Result<ExitCode> {
    logging::init(0, "join", "warn");
    carrier::check(&args.url, &args.network)?;
    let name = match &args.name {
        Some(name) => name.clone(),
        None => own_name().unwrap_or_else(|| "host".into()),
    };
    ensure!(is_name(&name), "--name {name}; accepted: 1 to {MAX_NAME} letters, digits, `-`, `_` and `.`");
    let held = HeldSignals::new()?;
    let joining = Joining {
        url: args.url.clone(),
        name,
        actors: args.actors,
        network: args.network.clone(),
        wait_s: args.wait,
        quiet: args.quiet,
    };
    match supervise::join(&joining, held)? {
        Parted::Over => Ok(ExitCode::SUCCESS),
        Parted::Interrupted => Ok(ExitCode::from(INTERRUPTED)),
    }
}

/// This machine's name, as far as it is plain; none if nothing of it is.
pub(super) fn own_name() -> Option<String> {
    let name = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let name: String = name.chars().filter(|&c| is_plain(c)).take(MAX_NAME).collect();
    Some(name).filter(|name| !name.is_empty())
}
