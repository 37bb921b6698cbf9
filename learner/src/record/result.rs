//! Writing `result.json`.

use super::error::{RecordError, io};
use std::io::Write;
use std::path::Path;
use trestle_proto::run_files::RESULT_FILE;
use trestle_proto::run_result::RunResult;
use trestle_proto::rundir::{Durable, write_atomically};

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
