//! `trestle doctor`

use crate::cli::Doctor;
use anyhow::{Result, ensure};
use nix::sys::resource::{Resource, getrlimit};
use nix::sys::statvfs::statvfs;
use std::fs;
use std::process::ExitCode;
use trestle_actor::env::registry;
use trestle_link::iceoryx::{Domain, Liveness};

/// Shared memory below which a run of the usual size may not fit, bytes.
const LITTLE_SHARED_MEMORY: u64 = 64 << 20;
/// Open files below which a run of many actors may not fit: each holds some ten descriptors a peer.
const FEW_FILES: u64 = 1024;

/// This user's runs: how many live, and what dead ones have left, which goes if it is to be fixed.
fn runs(fix: bool, line: &mut impl FnMut(bool, String) -> Result<()>) -> Result<()> {
    let all = match Domain::all() {
        Ok(all) => all,
        Err(error) => return line(false, format!("runs cannot be looked for: {error}")),
    };
    let living = all.iter().filter(|domain| domain.is_alive()).count();
    line(true, format!("runs in progress: {living}"))?;
    for domain in &all {
        let files = domain.shared_memory()?;
        let bytes: u64 = files.iter().filter_map(|f| fs::metadata(f).ok()).map(|m| m.len()).sum();
        let what = format!("run {:08x}: {} files, {} KiB", domain.run(), files.len(), bytes >> 10);
        match domain.liveness() {
            Liveness::Dead if fix => {
                domain.remove()?;
                line(true, format!("left by dead {what}: removed"))?;
            }
            Liveness::Dead => line(false, format!("left by dead {what}; `trestle doctor --fix` removes it"))?,
            // A run of another version, perhaps, or one that is just being made.
            Liveness::Unknown => line(
                true,
                format!(
                    "left alone, because nothing tells whether it lives: {what}; if it does not, remove /dev/shm/{}*",
                    domain.prefix()
                ),
            )?,
            Liveness::Alive | Liveness::Absent => {}
        }
    }
    Ok(())
}

pub(super) fn run(args: &Doctor) -> Result<ExitCode> {
    let mut sound = true;
    let mut line = |good: bool, text: String| -> Result<()> {
        sound &= good;
        outln!("{}  {text}", if good { "ok  " } else { "BAD " });
        Ok(())
    };
    match statvfs("/dev/shm") {
        Ok(stat) => {
            let free = stat.blocks_available() * stat.fragment_size();
            let total = stat.blocks() * stat.fragment_size();
            line(
                free >= LITTLE_SHARED_MEMORY,
                format!("shared memory: {} of {} MiB free in /dev/shm", free >> 20, total >> 20),
            )?;
        }
        Err(error) => line(false, format!("shared memory: /dev/shm cannot be used: {error}"))?,
    }
    match getrlimit(Resource::RLIMIT_NOFILE) {
        Ok((soft, hard)) => {
            line(soft >= FEW_FILES, format!("open files: {soft} allowed (at most {hard}; see `ulimit -n`)"))?;
        }
        Err(error) => line(false, format!("open files: {error}"))?,
    }
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    line(true, format!("processors: {cores}, kernels for {}", trestle_qnet::Isa::detect()))?;
    for finding in registry().diagnose() {
        line(finding.sound, finding.text)?;
    }
    runs(args.fix, &mut line)?;
    ensure!(sound, "something needs attention");
    Ok(ExitCode::SUCCESS)
}
