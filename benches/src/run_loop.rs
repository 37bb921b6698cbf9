//! `loop`: whole runs on maze30, each in a directory of its own that is removed afterwards.

use super::Effort;
use super::clock::median;
use super::program::{RUN, Scratch, training, trestle};
use super::report::Row;
use anyhow::{Context, Result, ensure};
use serde_json::Value;
use std::fs;
use std::path::Path;
use trestle_proto::rundir::RunDir;

const ALGOS: [&str; 2] = ["dqn", "ha-diiqn"];
const MODES: [&str; 3] = ["reference", "lockstep", "free"];
/// Environment steps of a run: what figures need, and for a quick look.
const ENV_STEPS: [u64; 2] = [100_000, 2_000];
/// Runs of each combination; they take turns.
const ROUNDS: [usize; 2] = [3, 1];

pub(super) fn run(effort: Effort) -> Result<Vec<Row>> {
    let (env_steps, rounds) = (effort.pick(ENV_STEPS[0], ENV_STEPS[1]), effort.pick(ROUNDS[0], ROUNDS[1]));
    let pairs: Vec<_> = ALGOS.iter().flat_map(|algo| MODES.iter().map(move |mode| (*algo, *mode))).collect();
    let program = trestle()?;
    let mut samples = vec![Vec::new(); pairs.len()];
    for _ in 0..rounds {
        for ((algo, mode), samples) in pairs.iter().zip(&mut samples) {
            samples.push(steps_per_s(&program, algo, mode, env_steps)?);
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

/// Environment steps a second from the first tick to the end of training, as the run itself reports them.
fn steps_per_s(program: &Path, algo: &str, mode: &str, env_steps: u64) -> Result<f64> {
    let dir = Scratch::new("loop")?;
    let status = training(program, algo, mode, env_steps, &dir.0).status().context("cannot start a run")?;
    ensure!(status.success(), "trestle train --algo {algo} --mode {mode} has failed: {status}");
    let path = RunDir::new(dir.0.join(RUN)).result();
    let text = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let result: Value = serde_json::from_str(&text)?;
    let number = |key: &str| result[key].as_f64().with_context(|| format!("{} has no {key}", path.display()));
    Ok(number("env_steps")? / number("wall_s")?)
}
