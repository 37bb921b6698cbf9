//! `idle`: what the processes of a run use while they wait for work.

use super::Effort;
use super::exchange::{Exchange, Setup, SharedMemory};
use super::report::Row;
use anyhow::{Context, Result};
use std::fs;
use std::thread;
use std::time::{Duration, Instant};

/// How long they wait: for figures, and for a quick look.
const WAIT: [Duration; 2] = [Duration::from_secs(5), Duration::from_millis(100)];

pub(super) fn run(effort: Effort) -> Result<Vec<Row>> {
    let mut exchange = SharedMemory::new(Setup { actors: 1, rollout: 32, burst: 1, mentor: true })?;
    exchange.tick(32, true)?;
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

/// CPU time of a process with one thread.
fn on_cpu(id: u32) -> Result<Duration> {
    let path = format!("/proc/{id}/schedstat");
    let text = fs::read_to_string(&path).with_context(|| format!("cannot read {path}"))?;
    let ns = text.split(' ').next().and_then(|ns| ns.parse().ok());
    Ok(Duration::from_nanos(ns.with_context(|| format!("{path} holds `{}`", text.trim()))?))
}
