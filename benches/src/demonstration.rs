//! `demonstration`: whole runs of `ha-diiqn` with demonstrations of 10 to 100,000 transitions.
//!
//! Bridges have up to 8 steps and lead up to 8 mentor steps ahead, in the largest Point Maze, whose states have velocities and never
//! come twice. The mentor begins anywhere; a demonstration is the beginning of the longest one. A run is the whole algorithm in one
//! process, whose CPU time is what counts: other processes on the machine hardly change it.

use super::Effort;
use super::program::{RUN, Scratch, trestle};
use super::report::Row;
use anyhow::{Context, Result, ensure};
use nix::sys::resource::{UsageWho, getrusage};
use nix::sys::time::TimeVal;
use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

/// Mentor transitions, for figures and for a quick look.
const MENTOR: [&[usize]; 2] = [&[10, 100, 1_000, 10_000, 100_000], &[10, 100]];
/// Environment steps of a run.
const ENV_STEPS: [u64; 2] = [30_000, 1_000];
/// Trajectories that have as many transitions, and some more. A plan has no more than a thousand: these are of two.
const TRAJECTORIES: [[u32; 2]; 2] = [[1_000, 200], [2, 1]];
/// States up to this KL are similar, half a stride of the mentor's: more than `auto` gives, and so dearer.
const E_TH: f64 = 0.3;

pub(super) fn run(effort: Effort) -> Result<Vec<Row>> {
    let program = trestle()?;
    let dir = Scratch::new("demonstration")?;
    let [first_part, second_part] = effort.pick(TRAJECTORIES[0], TRAJECTORIES[1]);
    let whole = [plan(&program, &dir.0, first_part, 0)?, plan(&program, &dir.0, second_part, 1)?];
    let env_steps = effort.pick(ENV_STEPS[0], ENV_STEPS[1]);
    let (mut rows, mut first) = (Vec::new(), None);
    for &mentor in effort.pick(MENTOR[0], MENTOR[1]) {
        let demonstration = dir.0.join(format!("{mentor}.csv"));
        fs::write(&demonstration, beginning(&whole, mentor)?)?;
        let rate = train(&program, &demonstration, env_steps)?;
        let relative = rate / *first.get_or_insert(rate);
        let row = Row::new().with("mentor", mentor).with("env_steps", env_steps);
        rows.push(row.measured("steps_per_cpu_s", rate).measured("relative", relative));
    }
    Ok(rows)
}

/// The text of a demonstration with so many trajectories, whose beginnings `seed` decides.
fn plan(program: &Path, dir: &Path, trajectories: u32, seed: u32) -> Result<String> {
    let file = dir.join(format!("plan-{seed}.csv"));
    let mut command = Command::new(program);
    command.args(["demo", "plan", "point-maze", "--set", "env.map=large", "--set", "env.backend=builtin"]);
    command.args(["--trajectories", &trajectories.to_string(), "--mentor-seed", &seed.to_string()]);
    command.arg("--out").arg(&file).stdout(Stdio::null());
    let status = command.status().context("cannot plan a demonstration")?;
    ensure!(status.success(), "trestle demo plan has failed: {status}");
    fs::read_to_string(&file).with_context(|| format!("cannot read {}", file.display()))
}

/// The first `transitions` transitions of demonstrations with the same features, as one.
fn beginning(parts: &[String], transitions: usize) -> Result<String> {
    let heading =
        parts.first().and_then(|part| part.lines().next()).context("a demonstration without a heading")?;
    let mut text = format!("{heading}\n");
    let (mut taken, mut trajectory) = (0, 0);
    for part in parts {
        let mut last = None;
        for line in part.lines().skip(1) {
            let (number, rest) = line.split_once(',').context("a line of a demonstration without a comma")?;
            let follows = last.replace(number).is_some_and(|last| last == number);
            if taken == transitions {
                return Ok(text);
            }
            (taken, trajectory) = if follows { (taken + 1, trajectory) } else { (taken, trajectory + 1) };
            writeln!(text, "{trajectory},{rest}")?;
        }
    }
    ensure!(
        taken == transitions,
        "the planned demonstrations have {taken} transitions, {transitions} are needed"
    );
    Ok(text)
}

/// Environment steps for each second of CPU time of a run with this demonstration.
fn train(program: &Path, demonstration: &Path, env_steps: u64) -> Result<f64> {
    let dir = Scratch::new("run")?;
    let mut command = Command::new(program);
    command.args([
        "train",
        "point-maze",
        "--algo",
        "ha-diiqn",
        "--mode",
        "reference",
        "--seed",
        "1",
        "--quiet",
    ]);
    command.args(["--set", "env.map=large", "--set", "env.backend=builtin"]);
    command.args(["--set", "mentor.k=8", "--set", "mentor.n=8", "--set", &format!("mentor.e_th={E_TH}")]);
    command.arg("--set").arg(format!("mentor.demo={:?}", demonstration.display().to_string()));
    command.args(["--episodes", "1000000000", "--env-steps", &env_steps.to_string()]);
    command
        .arg("--out")
        .arg(dir.0.join(RUN))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    let before = children_s()?;
    let status = command.status().context("cannot start a run")?;
    ensure!(status.success(), "trestle train with {} has failed: {status}", demonstration.display());
    Ok(env_steps as f64 / (children_s()? - before))
}

/// CPU seconds of all child processes that have ended.
fn children_s() -> Result<f64> {
    let usage =
        getrusage(UsageWho::RUSAGE_CHILDREN).context("cannot read the CPU time of child processes")?;
    let seconds = |time: TimeVal| time.tv_sec() as f64 + time.tv_usec() as f64 * 1e-6;
    Ok(seconds(usage.user_time()) + seconds(usage.system_time()))
}
