//! `best.safetensors`: the weights that the best greedy evaluation so far was played with, and which one that was.
//!
//! It is no checkpoint that a run can go on from. One file holds both parts, so a reader never sees the one without the other.

use super::error::{CheckpointError, contents, io};
use super::tensors::{decode_params, encode_best, evaluation_of};
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::Path;
use trestle_proto::regular_file;
use trestle_proto::round::Round;
use trestle_proto::run_files::BEST_FILE;
use trestle_proto::rundir::{Durable, write_atomically};
use trestle_qnet::Layout;

/// Largest file that is read, bytes: more than the largest network has.
const MAX_BYTES: u64 = 4 << 30;

/// The evaluation that the weights were best in.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BestEvaluation {
    /// The tick after which the weights were these.
    pub tick: Round,
    /// Finished training episodes then.
    pub episode: u64,
    /// Environment steps then.
    pub env_steps: u64,
    /// Mean return of the evaluation.
    pub total_reward: f64,
}

/// Writes the weights `params` of a network of `layout` into the run directory `run_dir`, in the place of those that were best
/// before.
///
/// # Errors
/// What the system says.
pub fn write_best(
    run_dir: &Path,
    layout: &Layout,
    params: &[f32],
    evaluation: &BestEvaluation,
) -> Result<(), CheckpointError> {
    let path = run_dir.join(BEST_FILE);
    let text = serde_json::to_string(evaluation).map_err(contents(&path))?;
    let bytes = encode_best(layout, params, text).map_err(contents(&path))?;
    write_atomically(&path, Durable::Later, |file| file.write_all(&bytes)).map_err(io(&path, "write"))
}

/// The weights that were best so far in the run directory `run_dir`, of a network of `layout`, and when they were.
///
/// # Errors
/// There is no such file, or it is damaged or another network's.
pub fn load_best(run_dir: &Path, layout: &Layout) -> Result<(BestEvaluation, Vec<f32>), CheckpointError> {
    let path = run_dir.join(BEST_FILE);
    let bytes = regular_file::read(&path, MAX_BYTES)?;
    let text = evaluation_of(&bytes).map_err(contents(&path))?;
    let evaluation = serde_json::from_str(&text).map_err(contents(&path))?;
    let params = decode_params(layout, &bytes).map_err(contents(&path))?;
    Ok((evaluation, params))
}

/// The return that the next evaluation must exceed to be the best; none where there is no sound file.
pub fn best_so_far(run_dir: &Path) -> Option<f64> {
    let bytes = regular_file::read(&run_dir.join(BEST_FILE), MAX_BYTES).ok()?;
    let evaluation: BestEvaluation = serde_json::from_str(&evaluation_of(&bytes).ok()?).ok()?;
    Some(evaluation.total_reward).filter(|total_reward| total_reward.is_finite())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn weights_and_evaluation_come_back_together() {
        let dir = tempfile::tempdir().unwrap();
        let layout = Layout::new(&[2, 3, 2]).unwrap();
        let params: Vec<f32> = (0..layout.n_params()).map(|i| i as f32 / 7.0).collect();
        assert!(load_best(dir.path(), &layout).is_err() && best_so_far(dir.path()).is_none());
        let evaluation =
            BestEvaluation { tick: 3.into(), episode: 9, env_steps: 96, total_reward: -0.1 - 0.2 };
        write_best(dir.path(), &layout, &params, &evaluation).unwrap();
        assert_eq!(load_best(dir.path(), &layout).unwrap(), (evaluation, params.clone()));
        assert_eq!(best_so_far(dir.path()), Some(-0.1 - 0.2));
        let bytes = std::fs::read(dir.path().join(BEST_FILE)).unwrap();
        write_best(dir.path(), &layout, &params, &evaluation).unwrap();
        assert_eq!(std::fs::read(dir.path().join(BEST_FILE)).unwrap(), bytes, "the same bytes every time");
        let other = Layout::new(&[2, 4, 2]).unwrap();
        assert!(load_best(dir.path(), &other).unwrap_err().to_string().contains(BEST_FILE));
        std::fs::write(dir.path().join(BEST_FILE), &bytes[..20]).unwrap();
        assert!(load_best(dir.path(), &layout).is_err() && best_so_far(dir.path()).is_none());
    }
}
