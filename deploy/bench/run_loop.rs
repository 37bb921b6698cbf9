//! `loop`: whole runs on maze30, each in a directory of its own that is removed afterwards.

use super::Effort;
use super::clock::median;
use super::exchange::scratch;
use super::report::Row;
use anyhow::{Context, Result, ensure};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

const ALGOS: [&str; 2] = ["dqn", "ha-diiqn"];
const MODES: [&str; 3] = ["reference", "lockstep", "free"];
const RUN: &str = "run";
/// Environment steps of a run: what figures need, and for a quick look.
const ENV_STEPS: [u64; 2] = [100_000, 2_000];
/// Runs of each combination; they take turns.
const ROUNDS: [usize; 2] = [3, 1];

pub(super) fn run(effort: Effort) -> Result<Vec<Row>> {
    let (env_steps, rounds) = (effort.pick(ENV_STEPS[0], ENV_STEPS[1]), effort.pick(ROUNDS[0], ROUNDS[1]));
    let pairs: Vec<_> = ALGOS.iter().flat_map(|algo| MODES.iter().map(move |mode| (*algo, *mode))).collect();
    let mut samples = vec![Vec::new(); pairs.len()];
    for round in 0..rounds {
        for ((algo, mode), samples) in pairs.iter().zip(&mut samples) {
            let dir = scratch(&format!("{algo}-{mode}-{round}"))?;
            let measured = steps_per_s(algo, mode, env_steps, &dir);
            fs::remove_dir_all(&dir).with_context(|| format!("cannot remove {}", dir.display()))?;
            samples.push(measured?);
        }
    }
    let row = |((algo, mode), samples): ((&str, &str), Vec<f64>)| {
        Row::new()
            .with("algo", algo)
            .with("mode", mode)
            .with("env_steps", env_steps)
            .measured("steps_per_s", median(samples))
    };
    Ok(pairs.into_iter().zip(samples).map(row).collect())
}

/// The command that trains on maze30 in a subdirectory of `dir`.
pub(super) fn training(algo: &str, mode: &str, env_steps: u64, dir: &Path) -> Result<Command> {
    let mut command = Command::new(std::env::current_exe().context("cannot find the program itself")?);
    command.args(["train", "maze30", "--algo", algo, "--mode", mode, "--seed", "1", "--quiet"]);
    command.args(["--episodes", "1000000000", "--env-steps", &env_steps.to_string(), "--out"]);
    command.arg(dir.join(RUN));
    Ok(command)
}

/// Environment steps a second from the first tick to the end of training, as the run itself reports them.
fn steps_per_s(algo: &str, mode: &str, env_steps: u64, dir: &Path) -> Result<f64> {
    let mut command = training(algo, mode, env_steps, dir)?;
    let status = command.stdin(Stdio::null()).stdout(Stdio::null()).status().context("cannot start a run")?;
    ensure!(status.success(), "trestle train --algo {algo} --mode {mode} has failed: {status}");
    let path = dir.join(RUN).join("result.json");
    let text = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let result: Value = serde_json::from_str(&text)?;
    let number = |key: &str| result[key].as_f64().with_context(|| format!("{} has no {key}", path.display()));
    Ok(number("env_steps")? / number("wall_s")?)
}
