//! `result.json`: the outcome of a run, in one object.

use serde::{Deserialize, Serialize};

/// The outcome of a run. Its fields are the keys of `result.json`, in this order.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
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
