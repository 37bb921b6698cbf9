//! `idle`: what the processes of a run use while they wait for work.

use super::Effort;
use super::exchange::{Exchange, Learner, SharedMemory};
use super::program::{RUN, Scratch, training, trestle};
use super::report::Row;
use anyhow::{Context, Result, ensure};
use std::fs;
use std::path::Path;
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};
use trestle_proto::rundir::RunDir;

/// How long they wait: for figures, and for a quick look.
const WAIT: [Duration; 2] = [Duration::from_secs(5), Duration::from_millis(100)];
/// Environment steps of the run that leaves its plan behind.
const ENV_STEPS: u64 = 64;

/// An actor and a mentor-server of `trestle`, welcomed by a learner that then asks nothing of them.
pub(super) fn run(effort: Effort) -> Result<Vec<Row>> {
    let (program, dir) = (trestle()?, Scratch::new("idle")?);
    let status = training(&program, "ha-diiqn", "lockstep", ENV_STEPS, &dir.0)
        .status()
        .context("cannot start a run")?;
    ensure!(status.success(), "a short run has failed: {status}");
    let run = RunDir::new(dir.0.join(RUN));
    let role = |role: &str| {
        let mut command = Command::new(&program);
        command.arg(role).arg("--watch-stdin").arg("--run").arg(run.root()).env("RUST_LOG", "warn");
        command
    };
    let mut actor = role("actor");
    actor.args(["--index", "0"]);
    let learner = Learner::new(run.read_plan()?, 1)?;
    let exchange = SharedMemory::new(learner, vec![actor, role("mentor-server")], dir)?;
    let ids = exchange.peers();
    let before = ids.iter().map(|id| on_cpu(*id)).collect::<Result<Vec<_>>>()?;
    let start = Instant::now();
    thread::sleep(effort.pick(WAIT[0], WAIT[1]));
    let mut rows = Vec::new();
    for ((id, role), before) in ids.into_iter().zip(["actor", "mentor-server"]).zip(before) {
        let share = (on_cpu(id)? - before).as_secs_f64() / start.elapsed().as_secs_f64();
        rows.push(Row::new().with("role", role).measured("cpu_percent", 100.0 * share));
    }
    Ok(rows)
}

/// CPU time of all threads of a process.
fn on_cpu(id: u32) -> Result<Duration> {
    let path = format!("/proc/{id}/task");
    let threads = fs::read_dir(&path).with_context(|| format!("cannot read {path}"))?;
    threads.map(|thread| of_thread(&thread?.path().join("schedstat"))).sum()
}

fn of_thread(path: &Path) -> Result<Duration> {
    let text = fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let ns = text.split(' ').next().and_then(|ns| ns.parse().ok());
    Ok(Duration::from_nanos(ns.with_context(|| format!("{} holds `{}`", path.display(), text.trim()))?))
}
