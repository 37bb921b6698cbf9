//! What a run leaves behind beside its checkpoints: `evals.csv`, `metrics.jsonl`, TensorBoard's curves,
//! `mentor.csv`, in free mode `actors.csv`, and `result.json`. Used alike by the learner's process and by the single-process loop.
//!
//! ```text
//! recorder = Recorder::create(dir, settings)         of a new run, or
//!            Recorder::resume(dir, settings, state, counters)
//! recorder.begin()                                   just before the first tick
//! each tick:
//!     each episode that ended:     recorder.episode(&counters_at_its_end, &episode)
//!     after a greedy evaluation:   recorder.evaluation(&counters, &episodes)
//!     if recorder.interval_due():  recorder.interval(&counters, &gauges)
//!     if recorder.progress_due():  print recorder.progress(&counters, &gauges)
//!     at a checkpoint:             (state, files) = recorder.checkpoint(), to be kept in it, and to be synced before
//! recorder.finish(&counters, &gauges, ending)       writes result.json
//! ```
//!
//! A resumed run cuts `evals.csv` and `metrics.jsonl` back to the lines that its checkpoint counts, so that
//! they read as those of an undisturbed run, times aside. `evals.csv` has every evaluation; all else is thinned out as the
//! run grows longer (`thinning`). TensorBoard keeps its old files and is told which
//! points are void. The clock decides only when an interval or a progress line is due, and fills `wall_s`,
//! `fps` and `time_elapsed`: nothing here flows back into training.

mod actors;
mod error;
mod lines;
mod mentor;
mod metrics;
mod progress;
mod result;
mod solved;
mod tensorboard;
mod thinning;

pub use actors::{ActorRow, Staleness, write_actors};
pub use error::RecordError;
pub use mentor::write_mentor;
pub use metrics::{Gauges, GuideGauges, HostGauges, MentorGauges, WINDOW};
pub use progress::{Limits, Progress, seconds_left};
pub use result::write_result;
pub use solved::{CONSECUTIVE, Goal, Moment, Standing};

use crate::checkpoint::Unsynced;
use lines::{Lines, Lost};
use metrics::{Row, Window, episode_row, evaluation_scalars, interval_row, means};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tensorboard::EventWriter;
use thinning::{EPISODES, EVALUATIONS, INTERVALS, is_kept, stride};
use trestle_algorithm::agent::Counters;
use trestle_proto::episode::Episode;
use trestle_proto::own_file;
use trestle_proto::run_files::{EVALS_FILE, METRICS_FILE, RESULT_FILE};
use trestle_proto::run_result::RunResult;
use trestle_proto::rundir::sync_parent;

/// Time between interval rows, as a loop that has no reason for another would set it.
pub const METRICS_EVERY: Duration = Duration::from_secs(1);
/// Time between progress lines, likewise.
pub const PROGRESS_EVERY: Duration = Duration::from_millis(250);

const EVALS_HEADER: &str = "episode,env_steps,grad_steps,wall_s,return,length,success\n";

/// What a recorder must know of its run.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Name of the algorithm.
    pub algo: String,
    /// The run's seed.
    pub seed: u64,
    /// Name of the environment.
    pub env: String,
    /// Return to reach, if one is known.
    pub goal: Option<Goal>,
    /// Where the run ends, for the estimate of the time left.
    pub limits: Limits,
    /// Time between interval rows.
    pub metrics_every: Duration,
    /// Time between progress lines.
    pub progress_every: Duration,
}

/// What a checkpoint must hold for a run to be recorded on. Opaque; to be kept in a format that preserves
/// every bit of an `f64`, such as the frames of `trestle_proto::codec` (JSON as we read it may lose the last
/// one).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RecorderState {
    wall_s: f64,
    evals_rows: u64,
    metrics_rows: u64,
    window: Window,
    standing: Standing,
}

impl RecorderState {
    /// Whether the run directory `dir` has the lines without which no run is recorded on: those of `evals.csv`.
    ///
    /// # Errors
    /// What is missing.
    pub fn check(&self, dir: &Path) -> Result<(), RecordError> {
        Lines::check(&dir.join(EVALS_FILE), EVALS_HEADER, self.evals_rows)
    }
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ending {
    /// SHA-256 of the final weights, in hexadecimal.
    pub weights_sha256: String,
    /// How many times the run was started again after a process of it had died.
    pub restarts: u64,
    /// Whether it ended before its limits.
    pub interrupted: bool,
    /// Samples of all gradient steps, and those of them that were trained with the mentor's loss; none without a mentor.
    pub mentor_samples: Option<[u64; 2]>,
}

/// The open files of a run directory and what is remembered between rows.
#[derive(Debug)]
pub struct Recorder {
    dir: PathBuf,
    settings: Settings,
    evals: Lines,
    metrics: Lines,
    events: EventWriter,
    window: Window,
    standing: Standing,
    /// Seconds of training before this process.
    wall_before_s: f64,
    /// The counters with which this process began.
    from: Counters,
    started: Instant,
    last_interval: Instant,
    last_progress: Instant,
    last_flush: Instant,
}

impl Recorder {
    /// For a run from its beginning. `dir` exists; files of an earlier run in it are replaced.
    pub fn create(dir: &Path, settings: Settings) -> Result<Self, RecordError> {
        forget_result(dir)?;
        let evals = Lines::create(&dir.join(EVALS_FILE), EVALS_HEADER)?;
        let metrics = Lines::create(&dir.join(METRICS_FILE), "")?;
        let events = EventWriter::create(dir, 0)?;
        Ok(Self::new(dir, settings, evals, metrics, events, RecorderState::default(), Counters::default()))
    }

    /// For a run that goes on from a checkpoint, which held `state` and was taken at `counters`. What was
    /// recorded after the checkpoint is removed. What was recorded in `evals.csv` before it must still be there; where
    /// `metrics.jsonl` has lost lines, the log says so, and it goes on behind those that are left.
    pub fn resume(
        dir: &Path,
        settings: Settings,
        state: RecorderState,
        counters: Counters,
    ) -> Result<Self, RecordError> {
        // A run that cannot go on stays as it is, the result included.
        state.check(dir)?;
        forget_result(dir)?;
        let evals = Lines::resume(&dir.join(EVALS_FILE), EVALS_HEADER, state.evals_rows, Lost::Refused)?;
        let metrics = Lines::resume(&dir.join(METRICS_FILE), "", state.metrics_rows, Lost::Accepted)?;
        let events = EventWriter::create(dir, counters.env_steps + 1)?;
        Ok(Self::new(dir, settings, evals, metrics, events, state, counters))
    }

    fn new(
        dir: &Path,
        settings: Settings,
        evals: Lines,
        metrics: Lines,
        events: EventWriter,
        state: RecorderState,
        from: Counters,
    ) -> Self {
        let now = Instant::now();
        Self {
            dir: dir.to_path_buf(),
            settings,
            evals,
            metrics,
            events,
            window: state.window,
            standing: state.standing,
            wall_before_s: state.wall_s,
            from,
            started: now,
            last_interval: now,
            last_progress: now,
            last_flush: now,
        }
    }

    /// Begins: call it just before the first tick, when the other processes have answered. `wall_s` counts from here, or without a
    /// call from the recorder's creation.
    pub fn begin(&mut self) {
        let now = Instant::now();
        (self.started, self.last_interval, self.last_progress) = (now, now, now);
    }

    /// Seconds of training so far, those before a resumption included.
    pub fn wall_s(&self) -> f64 {
        self.wall_before_s + self.started.elapsed().as_secs_f64()
    }

    /// What the evaluations so far amount to.
    pub fn standing(&self) -> &Standing {
        &self.standing
    }

    /// A training episode has ended; `counters` include it and its last step.
    pub fn episode(&mut self, counters: &Counters, episode: &Episode) -> Result<(), RecordError> {
        self.window.push(*episode);
        if is_kept(counters.episodes, EPISODES) {
            let row = episode_row(counters, self.wall_s(), episode, &self.window);
            self.push_metrics(&row)?;
        }
        if self.last_flush.elapsed() >= self.settings.metrics_every {
            self.last_flush = Instant::now();
            self.metrics.flush()?;
        }
        Ok(())
    }

    /// A greedy evaluation has been played; its line is the mean over its episodes. Returns that mean return.
    pub fn evaluation(&mut self, counters: &Counters, episodes: &[Episode]) -> Result<f64, RecordError> {
        let Counters { episodes: episode, env_steps, grad_steps } = *counters;
        let means = means(episodes.iter()).ok_or(RecordError::NoEpisodes { env_steps })?;
        let wall_s = self.wall_s();
        let (total_reward, length) = (means.total_reward, means.length);
        // Where success is not defined, the column is empty.
        let success = means.success.map_or_else(String::new, |share| share.to_string());
        self.evals.push(&format!(
            "{episode},{env_steps},{grad_steps},{wall_s:.3},{total_reward},{length},{success}"
        ))?;
        self.evals.flush()?;
        if is_kept(self.evals.rows(), EVALUATIONS) {
            self.events.scalars(env_steps, &evaluation_scalars(&means))?;
        }
        self.standing.observe(self.settings.goal, counters, total_reward);
        Ok(total_reward)
    }

    /// Whether it is time for [`Recorder::interval`]: the longer the run is, the rarer. Reads the clock: ask once a tick.
    pub fn interval_due(&self) -> bool {
        let every = self.settings.metrics_every;
        if self.last_interval.elapsed() < every {
            return false;
        }
        let so_far = (self.wall_s() / every.as_secs_f64()) as u64;
        let stride = u32::try_from(stride(so_far, INTERVALS)).unwrap_or(u32::MAX);
        self.last_interval.elapsed() >= every.saturating_mul(stride)
    }

    /// Writes an interval row and hands all that is buffered to the operating system.
    pub fn interval(&mut self, counters: &Counters, gauges: &Gauges) -> Result<(), RecordError> {
        self.last_interval = Instant::now();
        let row = interval_row(counters, self.wall_s(), self.fps(counters), &self.window, gauges);
        self.push_metrics(&row)?;
        self.events.scalars(counters.env_steps, &row.scalars())?;
        self.metrics.flush()?;
        self.events.flush()
    }

    /// Whether it is time for [`Recorder::progress`]. Reads the clock: ask once a tick.
    pub fn progress_due(&self) -> bool {
        self.last_progress.elapsed() >= self.settings.progress_every
    }

    /// How far the run is.
    pub fn progress(&mut self, counters: &Counters, gauges: &Gauges) -> Progress {
        self.last_progress = Instant::now();
        let elapsed_s = self.started.elapsed().as_secs_f64();
        Progress {
            episodes: counters.episodes,
            env_steps: counters.env_steps,
            grad_steps: counters.grad_steps,
            ep_rew_mean: self.window.means().map(|means| means.total_reward),
            eval_return: self.standing.final_return(),
            fps: self.fps(counters),
            feasible_frac: known(gauges.feasible_frac),
            bridged_frac: known(gauges.bridged_frac),
            seconds_left: seconds_left(&self.settings.limits, &self.from, counters, elapsed_s),
            solved: self.standing.solved().is_some(),
            optimal: self.standing.optimal().is_some(),
        }
    }

    /// Whether the evaluations so far amount to *solved*.
    pub fn solved(&self) -> bool {
        self.standing.solved().is_some()
    }

    /// What goes into the checkpoint that is being taken, and the files that must be synced before it is complete: a
    /// complete checkpoint never counts lines that a crash can take away.
    pub fn checkpoint(&mut self) -> Result<(RecorderState, Vec<Unsynced>), RecordError> {
        let files = vec![self.evals.unsynced()?, self.metrics.unsynced()?];
        self.events.flush()?;
        let state = RecorderState {
            wall_s: self.wall_s(),
            evals_rows: self.evals.rows(),
            metrics_rows: self.metrics.rows(),
            window: self.window.clone(),
            standing: self.standing.clone(),
        };
        Ok((state, files))
    }

    /// Ends the record: a last interval row, so that the shortest run has one, and `result.json`. A reader that finds that file
    /// finds all lines, too.
    pub fn finish(
        mut self,
        counters: &Counters,
        gauges: &Gauges,
        ending: Ending,
    ) -> Result<RunResult, RecordError> {
        let wall_s = self.wall_s();
        self.interval(counters, gauges)?;
        let (solved, optimal) = (self.standing.solved(), self.standing.optimal());
        let result = RunResult {
            algo: self.settings.algo,
            seed: self.settings.seed,
            env: self.settings.env,
            episodes: counters.episodes,
            env_steps: counters.env_steps,
            grad_steps: counters.grad_steps,
            wall_s,
            solved_episode: solved.map(|at| at.episode),
            solved_env_steps: solved.map(|at| at.env_steps),
            optimal_episode: optimal.map(|at| at.episode),
            optimal_env_steps: optimal.map(|at| at.env_steps),
            threshold: self.settings.goal.map(|goal| goal.threshold),
            best_return: self.standing.best_return(),
            final_return: self.standing.final_return(),
            weights_sha256: ending.weights_sha256,
            restarts: ending.restarts,
            interrupted: ending.interrupted,
            mentor_feasible_frac: known(gauges.feasible_frac),
            mentor_bridged_frac: known(gauges.bridged_frac),
            mentor_loss_frac: ending.mentor_samples.and_then(|[all, used]| known(used as f64 / all as f64)),
        };
        for Unsynced { path, file } in [self.evals.unsynced()?, self.metrics.unsynced()?] {
            own_file::synced(file.sync_all()).map_err(error::io("sync", &path))?;
        }
        write_result(&self.dir, &result)?;
        Ok(result)
    }

    /// Environment steps a second since this process began to train.
    fn fps(&self, counters: &Counters) -> f64 {
        let elapsed_s = self.started.elapsed().as_secs_f64();
        let steps = counters.env_steps.saturating_sub(self.from.env_steps);
        if elapsed_s > 0.0 { steps as f64 / elapsed_s } else { 0.0 }
    }

    fn push_metrics(&mut self, row: &Row) -> Result<(), RecordError> {
        let line = serde_json::to_string(row)
            .map_err(std::io::Error::from)
            .map_err(error::io("encode a line of", &self.dir.join(METRICS_FILE)))?;
        self.metrics.push(&line)
    }
}

/// `value`, if it is one.
fn known(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

/// Removes what an earlier start in `dir` came to, for good: a reader that finds a result takes the lines beside it for whole, and they are
/// about to be cut back.
fn forget_result(dir: &Path) -> Result<(), RecordError> {
    let former = dir.join(RESULT_FILE);
    match std::fs::remove_file(&former) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(()),
        removed => removed.and_then(|()| sync_parent(&former)).map_err(error::io("remove", &former)),
    }
}

#[cfg(test)]
mod tests;
