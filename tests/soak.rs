//! Several runs at once, for long: `cargo test --test soak -- --minutes 60 --seed 1 --out soak.csv`. Any of the arguments may be
//! left out. Looks every ten seconds at what each run takes, and kills a process of half of them now and then; fails if a run
//! ends, if what it takes grows, or if something is left of it. Not part of `cargo test` unless it is named.

#![allow(clippy::unwrap_used)]

// It serves many tests; this one needs a part of it.
#[allow(dead_code)]
mod util;

use nix::sys::signal::Signal;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use trestle_link::iceoryx::Domain;
use trestle_proto::rng::mix;
use trestle_proto::rundir::RunDir;
use util::{Place, Process, counted, evaluations, process, processes, result, send, start, wait_until};

/// Transitions that the replay holds: full before the first half begins.
const REPLAY: u64 = 20_000;
/// Without an end, with checkpoints and evaluations on the way.
const ARGS: [&str; 11] = [
    "maze-small",
    "--env-steps",
    "1000000000000",
    "--episodes",
    "1000000000000",
    "--set",
    "learner.replay=20000", // REPLAY
    "--set",
    "checkpoint.every_env_steps=20000",
    "--set",
    "supervise.restarts=1000",
];
/// The runs: name, actors, further arguments, whether processes are killed.
const RUNS: [(&str, u64, &[&str], bool); 4] = [
    ("lockstep", 1, &["--algo", "ha-diiqn"], false),
    ("lockstep-killed", 2, &["--algo", "ha-diiqn", "--set", "run.lag=1"], true),
    ("free", 2, &["--algo", "ha-diiqn", "--mode", "free"], false),
    ("free-killed", 3, &["--algo", "ha-diiqn", "--mode", "free"], true),
];

/// Time between two looks.
const EVERY: Duration = Duration::from_secs(10);
/// Looks between two kills.
const KILL_EVERY: u64 = 3;

/// What is measured of a run, over all its processes.
const MEASURES: [Measure; 4] = [
    // A restarted process lays its memory out anew; an hour of a kilobyte a second would be twice as much.
    Measure { name: "pss_kib", bound: |first| 1024 + first / 50, of: |sample| sample.pss_kib.iter().sum() },
    // A checkpoint that is being written has a file or two open, in a thread of its own.
    Measure { name: "descriptors", bound: |_| 2, of: |sample| sample.descriptors },
    Measure { name: "threads", bound: |_| 1, of: |sample| sample.threads },
    Measure { name: "shm_bytes", bound: |_| 64 << 10, of: |sample| sample.shm_bytes },
];

struct Measure {
    name: &'static str,
    /// By how much the second half's median may exceed the first's.
    bound: fn(u64) -> u64,
    of: fn(&Sample) -> u64,
}

/// What a run took at one moment. What goes away while it is looked at counts as nothing.
#[derive(Clone, Debug, Default)]
struct Sample {
    elapsed_s: u64,
    env_steps: u64,
    processes: u64,
    /// Proportional set size, by [`ROLES`].
    pss_kib: [u64; 4],
    descriptors: u64,
    threads: u64,
    shm_bytes: u64,
}

/// The subcommands of a run's processes.
const ROLES: [&str; 4] = ["train", "learner", "mentor-server", "actor"];
const HEADER: &str = "elapsed_s,run,env_steps,processes,supervisor_pss_kib,learner_pss_kib,mentor_server_pss_kib,\
                      actors_pss_kib,descriptors,threads,shm_bytes";

impl Sample {
    fn of(dir: &RunDir, elapsed: Duration) -> Self {
        let mut sample = Self { elapsed_s: elapsed.as_secs(), env_steps: env_steps(dir), ..Self::default() };
        for (pid, args) in processes(dir.root()) {
            let Some(role) = ROLES.iter().position(|role| args.get(1).is_some_and(|arg| arg == role)) else {
                continue;
            };
            let of = PathBuf::from(format!("/proc/{pid}"));
            sample.processes += 1;
            sample.pss_kib[role] += pss_kib(&of).unwrap_or(0);
            sample.descriptors += entries(&of.join("fd"));
            sample.threads += entries(&of.join("task"));
        }
        let files = domain(dir).and_then(|domain| domain.shared_memory().ok()).unwrap_or_default();
        // In blocks of 512 bytes: what is taken, not what may be.
        let taken = files.iter().map(|file| fs::metadata(file).map_or(0, |meta| 512 * meta.blocks()));
        sample.shm_bytes = taken.sum();
        sample
    }

    fn row(&self, run: &str) -> String {
        let Self { elapsed_s, env_steps, processes, pss_kib, descriptors, threads, shm_bytes } = self;
        let pss = pss_kib.map(|kib| kib.to_string()).join(",");
        format!("{elapsed_s},{run},{env_steps},{processes},{pss},{descriptors},{threads},{shm_bytes}")
    }
}

/// The run's place by its newest plan, which is replaced at each restart.
fn domain(dir: &RunDir) -> Option<Domain> {
    dir.read_plan().ok().map(|plan| Domain::of(plan.life.run))
}

fn pss_kib(process: &Path) -> Option<u64> {
    let text = fs::read_to_string(process.join("smaps_rollup")).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("Pss:"))?;
    line.split_whitespace().next()?.parse().ok()
}

fn entries(dir: &Path) -> u64 {
    fs::read_dir(dir).map_or(0, |entries| entries.filter(Result::is_ok).count() as u64)
}

/// Environment steps by the newest evaluation.
fn env_steps(dir: &RunDir) -> u64 {
    let text = fs::read_to_string(dir.evals()).unwrap_or_default();
    let steps = |line: &str| line.split(',').nth(1).and_then(|steps| steps.parse().ok());
    text.lines().last().and_then(steps).unwrap_or(0)
}

/// A run, and all that has been seen of it.
struct Run {
    name: &'static str,
    actors: u64,
    killed: bool,
    dir: RunDir,
    process: Process,
    samples: Vec<Sample>,
    /// Every place that it has had.
    domains: BTreeSet<u64>,
}

impl Run {
    fn look(&mut self, elapsed: Duration) -> String {
        let stderr = self.process.stderr_so_far();
        assert!(self.process.is_running(), "{} has ended: {stderr}", self.name);
        let sample = Sample::of(&self.dir, elapsed);
        self.domains.extend(domain(&self.dir).map(|domain| domain.run()));
        self.samples.push(sample.clone());
        sample.row(self.name)
    }

    /// Kills one of its processes, chosen by `word`. It may be on its way out or in already: then nothing happens.
    fn kill(&self, word: u64) {
        let role = match word % (2 + self.actors) {
            0 => "learner".into(),
            1 => "mentor-server".into(),
            n => format!("actor-{}", n - 2),
        };
        if let Some(pid) = process(self.dir.root(), &role) {
            send(pid, Signal::SIGKILL);
        }
    }

    /// Ends it as a user would, and looks for what it has left.
    fn end(mut self) -> (&'static str, Vec<Sample>) {
        let rows = evaluations(&self.dir);
        let dir = &self.dir;
        self.process.wait_for("the run to go on", || evaluations(dir) > rows);
        self.domains.extend(domain(dir).map(|domain| domain.run()));
        self.process.signal(Signal::SIGINT);
        self.process.finish().code(130);
        assert_eq!(processes(dir.root()), [], "{}", self.name);
        for run in self.domains {
            let domain = Domain::of(run);
            let left = (domain.root().exists(), domain.shared_memory().unwrap());
            assert_eq!(left, (false, Vec::new()), "{}", self.name);
        }
        let (result, rows) = (result(dir), counted(dir));
        assert!(result.interrupted && result.env_steps > 0, "{}: {result:?}", self.name);
        let steps: u64 = rows.iter().map(|row| row.env_steps).sum();
        assert!(rows.is_empty() || steps == result.env_steps, "{}: {steps} of {result:?}", self.name);
        // Those of the moments when it had all its processes, from when its replay was full.
        let (all, full) = (3 + self.actors, 2 * REPLAY);
        self.samples.retain(|sample| sample.processes == all && sample.env_steps > full);
        (self.name, self.samples)
    }
}

/// Compares the halves; a line for each measure, and whether it grew by more than its bound.
fn judge(name: &str, samples: &[Sample]) -> Vec<(String, bool)> {
    let (first, second) = samples.split_at(samples.len() / 2);
    let line = |measure: &Measure| {
        let median = |half: &[Sample]| {
            let mut values: Vec<u64> = half.iter().map(measure.of).collect();
            values.sort_unstable();
            values[values.len() / 2]
        };
        let (first, second) = (median(first), median(second));
        let bound = (measure.bound)(first);
        let line = format!("{name:<16}{:<12}{first:>12}{second:>12}{bound:>12}", measure.name);
        (line, second > first + bound)
    };
    MEASURES.iter().map(line).collect()
}

fn main() {
    let (mut minutes, mut seed) = (5, 1);
    let mut out = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("soak.csv");
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let value = args.next().unwrap_or_else(|| panic!("{arg} needs a value"));
        match arg.as_str() {
            "--minutes" => minutes = value.parse().unwrap(),
            "--seed" => seed = value.parse().unwrap(),
            "--out" => out = value.into(),
            _ => panic!("unknown argument {arg}; accepted: --minutes, --seed, --out"),
        }
    }
    let place = Place::new();
    let mut runs: Vec<Run> = RUNS
        .iter()
        .map(|&(name, actors, more, killed)| {
            let actors_arg = actors.to_string();
            let args = [&ARGS[..], &["--actors", &actors_arg], more].concat();
            let process = start(&place.training(name, &args));
            let (samples, domains) = (Vec::new(), BTreeSet::new());
            Run { name, actors, killed, dir: place.run(name), process, samples, domains }
        })
        .collect();
    let mut csv = format!("{HEADER}\n");
    let start = Instant::now();
    let looks = minutes * 60 / EVERY.as_secs();
    for look in 1..=looks {
        let next = EVERY * look as u32;
        wait_until(next.saturating_sub(start.elapsed()), || false);
        for (i, run) in runs.iter_mut().enumerate() {
            writeln!(csv, "{}", run.look(start.elapsed())).unwrap();
            if run.killed && look % KILL_EVERY == 0 {
                run.kill(mix(mix(seed ^ look) ^ i as u64));
            }
        }
        // What has been seen is there also if this one ends early.
        fs::write(&out, &csv).unwrap();
    }
    let all: Vec<_> = runs.into_iter().map(Run::end).collect();
    println!("{minutes} minutes, {} samples: {}", all.len() as u64 * looks, out.display());
    println!(
        "{:<16}{:<12}{:>12}{:>12}{:>12}",
        "run", "median of", "first half", "second half", "may grow by"
    );
    let mut grown = Vec::new();
    for (name, samples) in &all {
        assert!(samples.len() >= 4, "{name}: {} samples with a full replay; more minutes", samples.len());
        for (line, grew) in judge(name, samples) {
            println!("{line}");
            grown.extend(grew.then_some(line));
        }
    }
    assert!(grown.is_empty(), "grew by more than they may:\n{}", grown.join("\n"));
    println!("nothing grew, and nothing is left");
}
