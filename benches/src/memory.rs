//! `memory`: what all processes of a run hold together, at most, while its replay fills up.

use super::Effort;
use super::program::{Scratch, training, trestle};
use super::report::Row;
use anyhow::{Context, Result, ensure};
use std::fs;
use std::path::Path;
use std::process::Child;
use std::thread;
use std::time::Duration;
use trestle_algorithm::replay::bytes_per_transition;

const ALGOS: [&str; 2] = ["dqn", "ha-diiqn"];
const REPLAY: usize = 100_000;
/// Environment steps of a run: the replay is full before its end; and for a quick look.
const ENV_STEPS: [u64; 2] = [150_000, 2_000];
/// Features of a state of maze30.
const DIM: usize = 2;
/// How often the processes are looked at.
const INTERVAL: Duration = Duration::from_millis(20);

pub(super) fn run(effort: Effort) -> Result<Vec<Row>> {
    let (program, env_steps) = (trestle()?, effort.pick(ENV_STEPS[0], ENV_STEPS[1]));
    ALGOS.into_iter().map(|algo| row(&program, algo, env_steps)).collect()
}

fn row(program: &Path, algo: &str, env_steps: u64) -> Result<Row> {
    let dir = Scratch::new("memory")?;
    let mut command = training(program, algo, "lockstep", env_steps, &dir.0);
    command.args(["--set", &format!("learner.replay={REPLAY}")]);
    let (processes, bytes) = peak(command.spawn().context("cannot start a run")?)?;
    Ok(Row::new()
        .with("algo", algo)
        .with("env_steps", env_steps)
        .with("replay", REPLAY)
        .with("processes", processes)
        .measured("peak_mb", bytes as f64 / 1e6)
        .with("replay_bytes_each", bytes_per_transition(DIM)))
}

/// How many processes `run` had at most, and the most that they held at any moment.
fn peak(mut run: Child) -> Result<(usize, u64)> {
    let mut most = (0, 0);
    let status = loop {
        let family = [run.id()].into_iter().chain(children(run.id()));
        let held: Vec<u64> = family.filter_map(held).collect();
        most = (most.0.max(held.len()), most.1.max(held.iter().sum()));
        match run.try_wait()? {
            Some(status) => break status,
            None => thread::sleep(INTERVAL),
        }
    };
    ensure!(status.success(), "the run has failed: {status}");
    Ok(most)
}

/// The children of a process.
fn children(parent: u32) -> Vec<u32> {
    let Ok(entries) = fs::read_dir("/proc") else { return Vec::new() };
    let ids = entries.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok());
    ids.filter(|id| parent_of(*id) == Some(parent)).collect()
}

fn parent_of(id: u32) -> Option<u32> {
    let stat = fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
    // The process's name, in brackets, may hold anything.
    stat.rsplit_once(')')?.1.split_whitespace().nth(1)?.parse().ok()
}

/// Bytes that a process holds, of what it shares with others its part; none if it has gone.
fn held(id: u32) -> Option<u64> {
    let maps = fs::read_to_string(format!("/proc/{id}/smaps_rollup")).ok()?;
    let line = maps.lines().find_map(|line| line.strip_prefix("Pss:"))?;
    Some(line.trim().strip_suffix(" kB")?.parse::<u64>().ok()? * 1024)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::process::{Command, Stdio};

    #[test]
    fn a_process_and_its_children_are_found_and_weighed() {
        assert!(held(std::process::id()).unwrap() > 100_000);
        let mut child = Command::new("cat").stdin(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
        assert!(children(std::process::id()).contains(&child.id()));
        drop(child.stdin.take());
        child.wait().unwrap();
        assert_eq!(held(child.id()), None);
    }
}
