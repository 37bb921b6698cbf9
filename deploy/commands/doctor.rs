//! `trestle doctor`

use crate::TRANSPORT;
use crate::cli::Doctor;
use crate::prepare::{findings, resolve, weaknesses};
use crate::status::ExitCode;
use anyhow::{Result, ensure};
use std::path::Path;
use trestle_actor::env::registry;
use trestle_link::{Liveness, Transport};
use trestle_proto::config;

/// The preset whose needs the machine is asked for.
const USUAL: &str = "maze30";

/// This user's runs: how many live, and what dead ones have left, which goes if it is to be fixed.
fn runs(fix: bool, line: &mut impl FnMut(bool, String) -> Result<()>) -> Result<()> {
    let all = match TRANSPORT.runs() {
        Ok(all) => all,
        Err(error) => return line(false, format!("runs cannot be looked for: {error}")),
    };
    let living = all.iter().filter(|&&run| TRANSPORT.liveness(run) == Liveness::Alive).count();
    line(true, format!("runs in progress: {living}"))?;
    for run in all {
        let left = TRANSPORT.remains(run)?;
        let what = format!("run {run:08x}: {} files, {} KiB", left.files, left.bytes >> 10);
        match TRANSPORT.liveness(run) {
            Liveness::Dead if fix => {
                TRANSPORT.remove(run)?;
                line(true, format!("left by dead {what}: removed"))?;
            }
            Liveness::Dead => line(false, format!("left by dead {what}; `trestle doctor --fix` removes it"))?,
            // A run of another version, perhaps, or one that is just being made.
            Liveness::Unknown => line(
                true,
                format!(
                    "left alone, because nothing tells whether it lives: {what}; if it does not, remove {}",
                    left.names
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
    // As for a run of one actor; a start asks again, for its own.
    let usual = resolve(config::load(registry(), USUAL, &[])?)?.needs();
    for finding in findings(&usual) {
        line(finding.enough, finding.text)?;
    }
    for weakness in weaknesses(Path::new(".")) {
        line(true, weakness)?;
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
