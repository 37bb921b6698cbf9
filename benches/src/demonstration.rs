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
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

/// Mentor transitions, for figures and for a quick look.
const MENTOR: [&[usize]; 2] = [&[10, 100, 1_000, 10_000, 100_000], &[10, 100]];
/// Environment steps of a run.
const ENV_STEPS: [u64; 2] = [30_000, 1_000];
/// Trajectories that have as many transitions, and some more.
const TRAJECTORIES: [u32; 2] = [1_200, 3];
/// States up to this KL are similar, half a stride of the mentor's: more than `auto` gives, and so dearer.
const E_TH: f64 = 0.3;

pub(super) fn run(effort: Effort) -> Result<Vec<Row>> {
    let program = trestle()?;
    let dir = Scratch::new("demonstration")?;
    let whole = plan(&program, &dir.0, effort.pick(TRAJECTORIES[0], TRAJECTORIES[1]))?;
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

/// The text of a demonstration with so many trajectories.
fn plan(program: &Path, dir: &Path, trajectories: u32) -> Result<String> {
    let file = dir.join("whole.csv");
    let mut command = Command::new(program);
    command.args(["demo", "plan", "point-maze", "--set", "env.map=large", "--trajectories"]);
    command.arg(trajectories.to_string()).arg("--out").arg(&file).stdout(Stdio::null());
    let status = command.status().context("cannot plan a demonstration")?;
    ensure!(status.success(), "trestle demo plan has failed: {status}");
    fs::read_to_string(&file).with_context(|| format!("cannot read {}", file.display()))
}

/// The first `transitions` transitions of a demonstration: each trajectory has one state more.
fn beginning(whole: &str, transitions: usize) -> Result<String> {
    let mut lines = whole.lines();
    let mut text = format!("{}\n", lines.next().context("a demonstration without a heading")?);
    let (mut taken, mut last) = (0, None);
    for line in lines {
        let trajectory = line.split_once(',').map(|(trajectory, _)| trajectory);
        if last.replace(trajectory) == Some(trajectory) {
            taken += 1;
        } else if taken == transitions {
            break;
        }
        if taken > transitions {
            break;
        }
        text += line;
        text.push('\n');
    }
    ensure!(
        taken >= transitions,
        "the planned demonstration has {taken} transitions, {transitions} are needed"
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
