//! `result.json`: what a run came to, in one object.

use super::error::{RecordError, io};
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::Path;
use trestle_proto::rundir::{Durable, RESULT_FILE, write_atomically};

/// What a run came to. Its fields are the keys of `result.json`, in this order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunResult {
    /// Name of the algorithm.
    pub algo: String,
    /// The run's seed.
    pub seed: u64,
    /// Name of the environment.
    pub env: String,
    /// Finished training episodes.
    pub episodes: u64,
    /// Environment steps of all actors.
    pub env_steps: u64,
    /// Gradient steps.
    pub grad_steps: u64,
    /// Seconds from the first tick to the end of training, checkpoints included; interruptions are not.
    pub wall_s: f64,
    /// Finished episodes at the first of three consecutive evaluations within the tolerance of the threshold.
    pub solved_episode: Option<u64>,
    /// Environment steps at that evaluation.
    pub solved_env_steps: Option<u64>,
    /// Finished episodes at the first of three consecutive evaluations that reach the threshold.
    pub optimal_episode: Option<u64>,
    /// Environment steps at that evaluation.
    pub optimal_env_steps: Option<u64>,
    /// Return that counts as optimal, if one is known.
    pub threshold: Option<f64>,
    /// Highest mean return of a greedy evaluation.
    pub best_return: Option<f64>,
    /// Mean return of the last greedy evaluation.
    pub final_return: Option<f64>,
    /// SHA-256 of the final weights, in hexadecimal.
    pub weights_sha256: String,
    /// How many times the run, or in free mode one of its processes, was started again after the death of a process.
    pub restarts: u64,
    /// Whether the run ended before its limits, as after a SIGINT.
    pub interrupted: bool,
    /// Share of the mentor's transitions that are taken as feasible at the end, 0 to 1; none without a mentor.
    pub mentor_feasible_frac: Option<f64>,
    /// Share of them that are infeasible and have a bridge at the end, 0 to 1.
    pub mentor_bridged_frac: Option<f64>,
    /// Share of the samples of all gradient steps that were trained with the mentor's loss, 0 to 1; none without a gradient step.
    pub mentor_loss_frac: Option<f64>,
}

/// Writes `result.json` into the run directory `dir`. A reader sees the old file or the new one, never a
/// part.
pub fn write_result(dir: &Path, result: &RunResult) -> Result<(), RecordError> {
    let path = dir.join(RESULT_FILE);
    let mut text =
        serde_json::to_string_pretty(result).map_err(std::io::Error::from).map_err(io("encode", &path))?;
    text.push('\n');
    write_atomically(&path, Durable::Now, |file| file.write_all(text.as_bytes())).map_err(io("write", &path))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn result() -> RunResult {
        RunResult {
            algo: "ha-diiqn".into(),
            seed: u64::MAX,
            env: "maze30".into(),
            episodes: 4,
            env_steps: 500,
            grad_steps: 100,
            wall_s: 1.5,
            solved_episode: Some(2),
            solved_env_steps: Some(250),
            optimal_episode: None,
            optimal_env_steps: None,
            threshold: Some(-3.4),
            best_return: Some(-3.6),
            final_return: None,
            weights_sha256: "00ff".into(),
            restarts: 0,
            interrupted: false,
            mentor_feasible_frac: Some(0.25),
            mentor_bridged_frac: Some(0.5),
            mentor_loss_frac: None,
        }
    }

    #[test]
    fn keys_are_the_documented_ones() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join(RESULT_FILE), "an older one").unwrap();
        write_result(dir.path(), &result()).unwrap();
        let text = std::fs::read_to_string(dir.path().join(RESULT_FILE)).unwrap();
        let keys: Vec<&str> = text.lines().filter_map(|line| line.trim().split('"').nth(1)).collect();
        let documented = "algo seed env episodes env_steps grad_steps wall_s solved_episode solved_env_steps \
            optimal_episode optimal_env_steps threshold best_return final_return weights_sha256 restarts interrupted mentor_feasible_frac mentor_bridged_frac \
            mentor_loss_frac";
        assert_eq!(keys, documented.split_whitespace().collect::<Vec<_>>());
        assert!(text.contains("\"optimal_episode\": null"));
        assert_eq!(serde_json::from_str::<RunResult>(&text).unwrap(), result());
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "no temporary file is left");
    }

    #[test]
    fn a_missing_directory_is_named() {
        let error = write_result(Path::new("/nonexistent/run"), &result()).unwrap_err();
        assert!(error.to_string().contains("/nonexistent/run"));
    }
}
