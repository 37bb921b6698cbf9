//! The records of a run as they grow: greedy evaluations, training returns, figures of every second.

use crate::root::Dir;
use crate::table::Table;
use crate::tail::{Sink, Tail};
use serde::Deserialize;
use std::io;
use trestle_algorithm::agent::Counters;
use trestle_learner::record::{Goal, Standing};
use trestle_proto::run_files::{EVALS_FILE, METRICS_FILE};

/// Columns of greedy evaluations.
const EVALS: [&str; 7] = ["episode", "env_steps", "grad_steps", "wall_s", "return", "length", "success"];
/// Columns of training episodes.
const TRAINING: [&str; 5] = ["episode", "env_steps", "wall_s", "return", "length"];
/// Columns of the figures of every second.
const FIGURES: [&str; 21] = [
    "episode",
    "env_steps",
    "wall_s",
    "fps",
    "updates",
    "epsilon",
    "loss",
    "feasible",
    "bridged",
    "e_kl",
    "bridge_len",
    "mentor_loss",
    "replay",
    "wait",
    "wait_actors",
    "wait_mentor",
    "checkpoints",
    "memory_mb",
    "staleness_mean",
    "staleness_max",
    "return",
];

/// Everything that is kept of a run's records. `most`: rows of a table.
#[derive(Debug)]
pub(crate) struct Records {
    evals_tail: Tail,
    metrics_tail: Tail,
    pub(crate) evals: Evals,
    pub(crate) metrics: Metrics,
}

/// Greedy evaluations, and what they amount to.
#[derive(Debug)]
pub(crate) struct Evals {
    goal: Option<Goal>,
    pub(crate) table: Table<7>,
    pub(crate) standing: Standing,
}

/// Rows of `metrics.jsonl`.
#[derive(Debug)]
pub(crate) struct Metrics {
    pub(crate) training: Table<5>,
    pub(crate) figures: Table<21>,
}

impl Records {
    pub(crate) fn new(most: usize) -> Self {
        Self {
            evals_tail: Tail::default(),
            metrics_tail: Tail::default(),
            evals: Evals { goal: None, table: Table::new(EVALS, most), standing: Standing::default() },
            metrics: Metrics { training: Table::new(TRAINING, most), figures: Table::new(FIGURES, most) },
        }
    }

    /// Reads on, up to `budget` bytes of each file. Evaluations are held against `goal`. Returns whether anything is new.
    ///
    /// # Errors
    /// A file that is there and cannot be read.
    pub(crate) fn look(&mut self, dir: &Dir, goal: Option<Goal>, budget: usize) -> io::Result<bool> {
        let evals = self.look_at_evals(dir, goal, budget)?;
        let metrics = self.metrics_tail.look(dir, METRICS_FILE, budget, &mut self.metrics)?;
        Ok(evals || metrics.lines > 0 || metrics.anew)
    }

    /// The same of the evaluations alone.
    ///
    /// # Errors
    /// As [`Records::look`].
    pub(crate) fn look_at_evals(&mut self, dir: &Dir, goal: Option<Goal>, budget: usize) -> io::Result<bool> {
        if self.evals.goal != goal {
            self.evals.goal = goal;
            self.evals.restart();
            self.evals_tail = Tail::default();
        }
        let evals = self.evals_tail.look(dir, EVALS_FILE, budget, &mut self.evals)?;
        Ok(evals.lines > 0 || evals.anew)
    }

    /// Share of the files that has been read, 0 to 1.
    pub(crate) fn share(&self) -> f64 {
        self.evals_tail.share().min(self.metrics_tail.share())
    }
}

impl Sink for Evals {
    fn restart(&mut self) {
        self.table.clear();
        self.standing = Standing::default();
    }

    fn line(&mut self, line: &[u8]) {
        let Some(row) = std::str::from_utf8(line).ok().and_then(evaluation) else { return };
        let [episode, env_steps, grad_steps, .., total_reward, _, _] = row;
        let [episodes, env_steps, grad_steps] = [episode, env_steps, grad_steps].map(|count| count as u64);
        self.standing.observe(self.goal, &Counters { episodes, env_steps, grad_steps }, total_reward);
        self.table.push(row);
    }
}

/// A line of `evals.csv`; an empty success is not known. None: the heading, or no such line.
fn evaluation(line: &str) -> Option<[f64; 7]> {
    let mut row = [f64::NAN; 7];
    let mut cells = line.split(',');
    for (column, cell) in row.iter_mut().enumerate() {
        let text = cells.next()?;
        match text.parse::<f64>() {
            Ok(value) if value.is_finite() => *cell = value,
            _ if column == 6 && text.is_empty() => {}
            _ => return None,
        }
    }
    cells.next().is_none().then_some(row)
}

/// What is looked at in a row of `metrics.jsonl`.
#[derive(Deserialize)]
struct Row {
    #[serde(rename = "time/episodes")]
    episodes: f64,
    #[serde(rename = "time/total_timesteps")]
    env_steps: f64,
    #[serde(rename = "time/time_elapsed")]
    wall_s: f64,
    #[serde(rename = "rollout/ep_rew_mean")]
    ep_rew_mean: Option<f64>,
    #[serde(rename = "rollout/ep_len_mean")]
    ep_len_mean: Option<f64>,
    #[serde(rename = "time/fps")]
    fps: Option<f64>,
    #[serde(rename = "train/n_updates")]
    updates: Option<f64>,
    #[serde(rename = "rollout/exploration_rate")]
    epsilon: Option<f64>,
    #[serde(rename = "train/loss")]
    loss: Option<f64>,
    #[serde(rename = "mentor/feasible_frac")]
    feasible: Option<f64>,
    #[serde(rename = "mentor/bridged_frac")]
    bridged: Option<f64>,
    #[serde(rename = "mentor/e_kl_mean")]
    e_kl: Option<f64>,
    #[serde(rename = "bridge/len_mean")]
    bridge_len: Option<f64>,
    #[serde(rename = "loss/mentor_frac")]
    mentor_loss: Option<f64>,
    #[serde(rename = "replay/size")]
    replay: Option<f64>,
    #[serde(rename = "ipc/wait_frac")]
    wait: Option<f64>,
    #[serde(rename = "ipc/wait_actors_frac")]
    wait_actors: Option<f64>,
    #[serde(rename = "ipc/wait_mentor_frac")]
    wait_mentor: Option<f64>,
    #[serde(rename = "time/checkpoint_frac")]
    checkpoints: Option<f64>,
    #[serde(rename = "memory/learner_mb")]
    memory_mb: Option<f64>,
    #[serde(rename = "free/staleness_mean")]
    staleness_mean: Option<f64>,
    #[serde(rename = "free/staleness_max")]
    staleness_max: Option<f64>,
}

impl Sink for Metrics {
    fn restart(&mut self) {
        self.training.clear();
        self.figures.clear();
    }

    fn line(&mut self, line: &[u8]) {
        let Ok(row) = serde_json::from_slice::<Row>(line) else { return };
        let known = |value: Option<f64>| value.unwrap_or(f64::NAN);
        let Row { episodes, env_steps, wall_s, .. } = row;
        let mean = known(row.ep_rew_mean);
        if row.updates.is_none() {
            self.training.push([episodes, env_steps, wall_s, mean, known(row.ep_len_mean)]);
            return;
        }
        self.figures.push([
            episodes,
            env_steps,
            wall_s,
            known(row.fps),
            known(row.updates),
            known(row.epsilon),
            known(row.loss),
            known(row.feasible),
            known(row.bridged),
            known(row.e_kl),
            known(row.bridge_len),
            known(row.mentor_loss),
            known(row.replay),
            known(row.wait),
            known(row.wait_actors),
            known(row.wait_mentor),
            known(row.checkpoints),
            known(row.memory_mb),
            known(row.staleness_mean),
            known(row.staleness_max),
            mean,
        ]);
    }
}

impl Metrics {
    /// The newest counts: episodes, environment steps, seconds.
    pub(crate) fn newest(&self) -> Option<[f64; 3]> {
        let figures = self.figures.last().map(|row| [row[0], row[1], row[2]]);
        let training = self.training.last().map(|row| [row[0], row[1], row[2]]);
        match (figures, training) {
            (Some(a), Some(b)) => Some(if a[1] >= b[1] { a } else { b }),
            (a, b) => a.or(b),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::root::{Below, Root};
    use std::fs;

    #[test]
    fn sound_lines_count_and_others_do_not() {
        let place = tempfile::tempdir().unwrap();
        let dir = Root::new(place.path()).unwrap().dir(&Below::default()).unwrap();
        let evals = "episode,env_steps,grad_steps,wall_s,return,length,success\n0,0,0,0.1,-9,9,0\n\
            1,5,1,0.2,-1,9,1\nrubbish\n2,6,2,0.3,-1,9,\n3,7,3,0.4,NaN,9,1\n4,8,3,0.4,-1,9,1,7\n5,9,4,0.5,-1,9,1\n6,1";
        fs::write(place.path().join("evals.csv"), evals).unwrap();
        let metrics = "{\"time/episodes\":1,\"time/total_timesteps\":5,\"time/time_elapsed\":1.5,\"rollout/ep_rew_mean\":-3}\n\
            {\"time/episodes\":\"<script>\"}\n[]\n\
            {\"time/episodes\":2,\"time/total_timesteps\":9,\"time/time_elapsed\":2.5,\"train/n_updates\":4,\"x\":[{}]}\n{\"ti";
        fs::write(place.path().join("metrics.jsonl"), metrics).unwrap();
        let mut records = Records::new(8);
        let goal = Some(Goal { threshold: -1.0, tolerance: 0.0 });
        assert!(records.look(&dir, goal, 1 << 20).unwrap());
        assert!(!records.look(&dir, goal, 1 << 20).unwrap());
        assert_eq!(records.evals.table.rows().count(), 4);
        assert_eq!(records.evals.standing.solved().unwrap().episode, 1);
        assert_eq!((records.metrics.training.rows().count(), records.metrics.figures.rows().count()), (1, 1));
        assert_eq!(records.metrics.newest(), Some([2.0, 9.0, 2.5]));
        // Without a goal the same lines solve nothing.
        assert!(records.look(&dir, None, 1 << 20).unwrap());
        assert_eq!(records.evals.standing.solved(), None);
    }
}
