//! `trestle bench`

use crate::bench::{self, Effort, peer};
use crate::cli::{Bench, BenchPeer, Benchmark};
use anyhow::Result;
use clap::ValueEnum;
use std::io::{Write, stdout};
use std::process::ExitCode;

/// Measures what was asked for, or everything; each outcome is printed when it is there.
pub(super) fn run(args: &Bench) -> Result<ExitCode> {
    if cfg!(debug_assertions) {
        crate::output::say("warning: this is no release build; its figures say little");
    }
    let effort = if args.quick { Effort::Quick } else { Effort::Full };
    let all = args.name.map_or_else(|| Benchmark::value_variants().to_vec(), |name| vec![name]);
    for benchmark in all {
        let report = bench::run(benchmark, effort)?;
        let text = if args.json { serde_json::to_string(&report)? + "\n" } else { report.table() + "\n" };
        stdout().lock().write_all(text.as_bytes())?;
    }
    Ok(ExitCode::SUCCESS)
}

pub(super) fn peer(args: &BenchPeer) -> Result<ExitCode> {
    peer::run(&args.role, &args.dir, args.index, args.burst)?;
    Ok(ExitCode::SUCCESS)
}
