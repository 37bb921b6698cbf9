//! `trestle bench`: what the documentation quotes, measured on this machine.
//!
//! - `step`, `infer`, `replay`, `mentor`: functions, in CPU time of this thread;
//! - `tick` (with `message` and `weights`): messages, in wall time, with peers that are processes;
//! - `idle`, `memory`: what processes take while they wait, and at most;
//! - `run_loop`: whole runs.
//!
//! Every figure is a median after a warm-up, and what is to be compared takes turns. `cases` holds what is measured,
//! `clock`, `exchange` and `report` how; `peer` is the other end of `exchange`.

mod cases;
mod clock;
mod exchange;
mod idle;
mod infer;
mod memory;
mod mentor;
pub(crate) mod peer;
mod replay;
mod report;
mod run_loop;
mod step;
mod tick;

use crate::cli::Benchmark;
use anyhow::Result;
use report::{Machine, Report};

/// How much work is done.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Effort {
    /// As much as figures need that are to be quoted.
    Full,
    /// As little as shows that the benchmark works.
    Quick,
}

impl Effort {
    /// One of two amounts.
    fn pick<T>(self, full: T, quick: T) -> T {
        match self {
            Effort::Full => full,
            Effort::Quick => quick,
        }
    }
}

/// Runs one benchmark.
pub(crate) fn run(benchmark: Benchmark, effort: Effort) -> Result<Report> {
    let machine = Machine::new();
    let (name, rows) = match benchmark {
        Benchmark::Step => ("step", step::run(effort)?),
        Benchmark::Infer => ("infer", infer::run(effort)?),
        Benchmark::Replay => ("replay", replay::run(effort)?),
        Benchmark::Mentor => ("mentor", mentor::run(effort)?),
        Benchmark::Tick => ("tick", tick::tick(effort)?),
        Benchmark::Message => ("message", tick::message(effort)?),
        Benchmark::Weights => ("weights", tick::weights(effort)?),
        Benchmark::Idle => ("idle", idle::run(effort)?),
        Benchmark::Memory => ("memory", memory::run(effort)?),
        Benchmark::Loop => ("loop", run_loop::run(effort)?),
    };
    Ok(Report { name, machine, rows })
}
