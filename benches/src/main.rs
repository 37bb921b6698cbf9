//! `trestle-bench [NAME] [--json]`: what the documentation quotes, measured on this machine.
//!
//! - `step`, `infer`, `replay`, `mentor`: functions, in CPU time of this thread;
//! - `threads`: a gradient step that several threads share, in wall time;
//! - `tick` (with `message` and `weights`), `free`: messages, in wall time, with peers that are processes of this program;
//! - `idle`, `memory`: what the processes of `trestle` take while they wait, and at most;
//! - `loop`: whole runs of `trestle`; `demonstration`: such runs with demonstrations of different sizes;
//! - `slopes`: the cost of a step as parameters, batch, features, stored transitions, mentor states and actors grow by powers of ten.
//!
//! Every figure is a median after a warm-up, and what is to be compared takes turns. `clock`, `exchange` and `report`
//! hold how to measure; `peer` is the other end of `exchange`; `program` finds `trestle`.

mod clock;
mod demonstration;
mod exchange;
mod free;
mod idle;
mod infer;
mod memory;
mod mentor;
mod peer;
mod program;
mod replay;
mod report;
mod run_loop;
mod sleeps;
mod slopes;
mod step;
mod threads;
mod tick;

use anyhow::Result;
use clap::{Parser, ValueEnum};
use report::{Machine, Report};
use std::io::{Write, stdout};

/// Measure this machine: the figures that Trestle's documentation quotes
#[derive(Debug, Parser)]
#[command(version)]
struct Cli {
    /// What to measure; everything, one after the other, if not given
    #[arg(value_name = "NAME")]
    name: Option<Benchmark>,
    /// One JSON object a line for each benchmark
    #[arg(long)]
    json: bool,
    /// Little work and few samples, to see whether it works: the figures say nothing
    #[arg(long)]
    quick: bool,
    /// The other end of a benchmark's messages, as this program starts it: role, directory, index and burst
    #[arg(long, hide = true, num_args = 4)]
    peer: Option<Vec<String>>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Benchmark {
    /// A gradient step, beside the machine's limit
    Step,
    /// A gradient step that threads share
    Threads,
    /// An actor's forward pass
    Infer,
    /// Storing and drawing transitions
    Replay,
    /// Similarity, action inference, bridge search
    Mentor,
    /// A lockstep tick whose processes do nothing else
    Tick,
    /// Batches of actors that stream, without work
    Free,
    /// Batches of transitions
    Message,
    /// Publications of weights
    Weights,
    /// What processes use while they wait
    Idle,
    /// What the processes of a run hold at most
    Memory,
    /// Whole runs on maze30
    Loop,
    /// Whole runs with demonstrations of 10 to 100,000 transitions
    Demonstration,
    /// How the cost of a step grows with each quantity
    Slopes,
}

impl Benchmark {
    fn run(self, effort: Effort) -> Result<Report> {
        let machine = Machine::new();
        let rows = match self {
            Benchmark::Step => step::run(effort),
            Benchmark::Threads => threads::run(effort),
            Benchmark::Infer => infer::run(effort),
            Benchmark::Replay => replay::run(effort),
            Benchmark::Mentor => mentor::run(effort),
            Benchmark::Tick => tick::tick(effort),
            Benchmark::Free => free::run(effort),
            Benchmark::Message => tick::message(effort),
            Benchmark::Weights => tick::weights(effort),
            Benchmark::Idle => idle::run(effort),
            Benchmark::Memory => memory::run(effort),
            Benchmark::Loop => run_loop::run(effort),
            Benchmark::Demonstration => demonstration::run(effort),
            Benchmark::Slopes => slopes::run(effort),
        }?;
        let name = self.to_possible_value().map(|value| value.get_name().to_string());
        Ok(Report { name: name.unwrap_or_default(), machine, rows })
    }
}

/// How much work is done.
#[derive(Clone, Copy, Debug)]
enum Effort {
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

/// Measures what was asked for, or everything; each outcome is printed when it is there.
fn main() -> Result<()> {
    let args = Cli::parse();
    if let Some(peer) = args.peer {
        return peer::run(&peer);
    }
    if cfg!(debug_assertions) {
        eprintln!("warning: this is no release build; its figures say little");
    }
    let effort = if args.quick { Effort::Quick } else { Effort::Full };
    let all = args.name.map_or_else(|| Benchmark::value_variants().to_vec(), |name| vec![name]);
    for benchmark in all {
        let report = benchmark.run(effort)?;
        let text = if args.json { serde_json::to_string(&report)? } else { report.table() };
        writeln!(stdout().lock(), "{text}")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn arguments_are_declared_soundly() {
        Cli::command().debug_assert();
    }
}
