//! How often processes have fallen asleep: each time somebody must wake them up again.

use anyhow::{Context, Result};
use std::fs;

/// The sleeps of this process's first thread and of others' since a moment.
pub(super) struct Sleeps {
    processes: Vec<String>,
    before: u64,
}

impl Sleeps {
    /// Of this process and of `others`, from now on.
    pub(super) fn of(others: &[u32]) -> Result<Self> {
        let mut processes: Vec<String> = others.iter().map(u32::to_string).collect();
        processes.push("self".into());
        let before = total(&processes)?;
        Ok(Self { processes, before })
    }

    /// How many there have been since.
    pub(super) fn since(&self) -> Result<f64> {
        Ok((total(&self.processes)? - self.before) as f64)
    }
}

fn total(processes: &[String]) -> Result<u64> {
    let sleeps = |process: &String| -> Result<u64> {
        let path = format!("/proc/{process}/status");
        let status = fs::read_to_string(&path).with_context(|| format!("cannot read {path}"))?;
        let count = status.lines().find_map(|line| line.strip_prefix("voluntary_ctxt_switches:"));
        count.and_then(|count| count.trim().parse().ok()).with_context(|| format!("{path} has no count"))
    };
    processes.iter().map(sleeps).sum()
}
