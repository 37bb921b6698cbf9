//! What a training loop does besides moving messages: it feeds the agent, decides when evaluations and checkpoints
//! are due, and keeps the records. Used alike by the learner's process and by the single-process loop, so that both
//! leave the same files behind.
//!
//! Every decision depends on counts alone; the clock only paces what people look at.

use crate::checkpoint::{self, BestEvaluation, CheckpointError, Cut, Saver, Taken};
use crate::record::{
    ActorRow, Ending, Gauges, Goal, GuideGauges, HostGauges, Limits, METRICS_EVERY, MentorGauges,
    PROGRESS_EVERY, Progress, RecordError, Recorder, RecorderState, Settings, Staleness, write_actors,
    write_mentor,
};
use crate::timeline::Timeline;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::time::{Duration, Instant};
use trestle_algorithm::agent::{Agent, AgentError, Counters, TrainStats};
use trestle_algorithm::reference;
use trestle_link::pulse;
use trestle_proto::acting::Acting;
use trestle_proto::batch::{Batch, Checked, Tally};
use trestle_proto::codec::{self, CodecError, Kind};
use trestle_proto::config::{GuideKind, Mode};
use trestle_proto::episode::Episode;
use trestle_proto::experiment::Experiment;
use trestle_proto::hosts_file::{self, HostState, MAX_BYTES};
use trestle_proto::incarnation::Incarnation;
use trestle_proto::mentor::MentorTransitions;
use trestle_proto::observe::Observed;
use trestle_proto::plan::{Life, RunPlan};
use trestle_proto::regular_file;
use trestle_proto::reply::Evaluation;
use trestle_proto::round::Round;
use trestle_proto::run_result::RunResult;
use trestle_proto::rundir::RunDir;
use trestle_proto::schedule;

const KIND: Kind = Kind { magic: *b"TRSESSN\0", version: 9 };

/// What can end a session.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// Learning.
    #[error(transparent)]
    Agent(#[from] AgentError),
    /// Records.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// Checkpoints.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The session's own part of a checkpoint.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// An evaluation whose environment gave a reward that is no number.
    #[error("episode {episode} of evaluation {evaluation} has a return of {found}; accepted: finite numbers")]
    Return {
        /// Number of the evaluation.
        evaluation: u64,
        /// Which of its episodes.
        episode: usize,
        /// The return.
        found: f64,
    },
    /// An evaluation that nobody has asked for.
    #[error("evaluation {found} came; {expected} is due")]
    Evaluation {
        /// Its number.
        found: u64,
        /// The number that was asked for, or `none`.
        expected: String,
    },
}

/// A training run between its first and its last tick.
pub struct Session<'a> {
    experiment: &'a Experiment,
    life: &'a Life,
    dir: &'a RunDir,
    agent: Agent,
    recorder: Recorder,
    timeline: Timeline,
    /// The weights that the evaluation is played with that has been asked for, and their tick.
    candidate: (Round, Vec<f32>),
    /// The highest return of an evaluation whose weights have been kept.
    best: Option<f64>,
    saver: Saver,
    /// The last tick that has been trained on; in free mode the last round.
    tick: Round,
    /// Number of the next evaluation.
    evaluations: u64,
    /// The counts at which an evaluation became due. In lockstep it is played with the weights of that moment, in free mode
    /// with those of the moment in which it is asked for.
    due: Option<Counters>,
    /// The same of the evaluation that has been asked for and not yet answered.
    ordered: Option<Counters>,
    /// The counts at the last evaluation that became due, played or not.
    evaluated_at: Counters,
    /// The counts at which the evaluation became due with which the run is solved.
    solved_by: Option<Counters>,
    /// Free mode: what has been counted of each incarnation of the actors.
    actors: Vec<ActorRow>,
    /// Free mode: since the last interval row.
    staleness: Staleness,
    /// What a learned guide did, since the last interval row and since the run began.
    guide: [Tally; 2],
    /// Return of the last episode that followed it alone.
    guide_return: Option<f64>,
    /// Environment steps at the last interval row.
    interval_from: u64,
    /// Training since the last interval row.
    stats: TrainStats,
    /// Where the time since `since` went.
    spent: Spent,
    since: Instant,
    progress: Box<dyn FnMut(&Progress) + 'a>,
}

/// Time that did not go into learning.
#[derive(Clone, Copy, Debug, Default)]
struct Spent {
    /// Waiting for actors.
    actors: Duration,
    /// Waiting for the mentor-server.
    mentor: Duration,
    /// Taking checkpoints, as far as training waits for it.
    checkpoints: Duration,
}

/// What a checkpoint keeps of a session beside the agent.
#[derive(Serialize, Deserialize)]
struct State {
    recorder: RecorderState,
    evaluations: u64,
    due: Option<Counters>,
    evaluated_at: Counters,
    solved_by: Option<Counters>,
    actors: Vec<ActorRow>,
    /// What the actors act with in the next tick, where it is not the agent's newest.
    behaviour: Option<Acting>,
    /// What a learned guide has done.
    guide: Tally,
}

/// A session that goes on from a checkpoint, and what the rest of the run needs from there.
pub struct Resumed<'a> {
    /// The session after the checkpoint's tick.
    pub session: Session<'a>,
    /// What the actors act with in the next tick, where it is not the agent's newest.
    pub behaviour: Option<Acting>,
    /// The batches of the next tick, if they have come.
    pub pending: Vec<Checked<Batch>>,
}

impl reference::Learner for Session<'_> {
    type Error = SessionError;

    fn agent(&self) -> &Agent {
        Self::agent(self)
    }

    fn done(&self) -> bool {
        Self::done(self)
    }

    fn ingest(&mut self, batch: &Checked<Batch>, observed: Option<&Observed>) -> Result<(), SessionError> {
        Self::ingest(self, batch, observed).map(|_| ())
    }

    fn train(&mut self, tick: Round) -> Result<(), SessionError> {
        Self::train(self, tick)
    }

    fn evaluation_due(&mut self) -> Option<(u64, u32)> {
        if Self::done(self) {
            self.request_final_evaluation();
        }
        self.evaluate()
    }

    fn evaluated(&mut self, evaluation: &Evaluation) -> Result<(), SessionError> {
        Self::evaluated(self, evaluation)
    }
}

/// Whether the run in `dir` still has the records without which it does not go on after checkpoint `tick`, for a caller that wants to
/// know before anything is started.
///
/// # Errors
/// What is missing, or a checkpoint that cannot be read.
pub fn check_records(dir: &RunDir, tick: Round) -> Result<(), SessionError> {
    let state: State = codec::decode(KIND, &checkpoint::load_run(&checkpoint::directory(dir.root(), tick))?)?;
    Ok(state.recorder.check(dir.root())?)
}

impl<'a> Session<'a> {
    /// The beginning of `plan`'s run. `progress` is called a few times a second.
    pub fn new(
        plan: &'a RunPlan,
        dir: &'a RunDir,
        mentor: Option<MentorTransitions>,
        progress: Box<dyn FnMut(&Progress) + 'a>,
    ) -> Result<Self, SessionError> {
        let RunPlan { experiment, life } = plan;
        let timeline = Timeline::create(experiment, dir, mentor.as_ref());
        Ok(Self {
            experiment,
            life,
            dir,
            agent: Agent::new(experiment, mentor)?,
            timeline,
            candidate: (Round::default(), Vec::new()),
            best: None,
            recorder: Recorder::create(dir.root(), settings(experiment))?,
            saver: Saver::new(dir.root()),
            tick: Round::default(),
            evaluations: 0,
            due: None,
            ordered: None,
            evaluated_at: Counters::default(),
            solved_by: None,
            actors: Vec::new(),
            staleness: Staleness::default(),
            guide: [Tally::default(); 2],
            guide_return: None,
            interval_from: 0,
            stats: TrainStats::default(),
            spent: Spent::default(),
            since: Instant::now(),
            progress,
        })
    }

    /// Goes on after checkpoint `tick` of the run's directory.
    pub fn resume(
        plan: &'a RunPlan,
        dir: &'a RunDir,
        tick: Round,
        mentor: Option<MentorTransitions>,
        progress: Box<dyn FnMut(&Progress) + 'a>,
    ) -> Result<Resumed<'a>, SessionError> {
        let RunPlan { experiment, life } = plan;
        let transitions = mentor.clone();
        let loaded = checkpoint::load(&checkpoint::directory(dir.root(), tick), experiment, mentor)?;
        let state: State = codec::decode(KIND, &loaded.run)?;
        let counters = loaded.agent.counters();
        let session = Self {
            experiment,
            life,
            dir,
            candidate: (Round::default(), Vec::new()),
            // Also one of evaluations that the run goes back behind: its weights are there.
            best: checkpoint::best_so_far(dir.root()),
            agent: loaded.agent,
            // First of all: it removes the former result, and the time line is cut back, too.
            recorder: Recorder::resume(dir.root(), settings(experiment), state.recorder, counters)?,
            timeline: Timeline::resume(experiment, dir, transitions.as_ref(), counters),
            saver: Saver::after(dir.root(), tick)?,
            tick: loaded.tick,
            evaluations: state.evaluations,
            due: state.due,
            ordered: None,
            evaluated_at: state.evaluated_at,
            solved_by: state.solved_by,
            actors: state.actors,
            staleness: Staleness::default(),
            guide: [Tally::default(), state.guide],
            guide_return: None,
            interval_from: counters.env_steps,
            stats: TrainStats::default(),
            spent: Spent::default(),
            since: Instant::now(),
            progress,
        };
        Ok(Resumed { session, behaviour: state.behaviour, pending: loaded.pending })
    }

    /// The other processes have answered: time counts from here.
    pub fn start(&mut self) {
        self.recorder.begin();
        self.since = Instant::now();
        self.show_progress();
    }

    /// The agent.
    pub fn agent(&self) -> &Agent {
        &self.agent
    }

    /// The last tick that has been trained on.
    pub fn tick(&self) -> Round {
        self.tick
    }

    /// Number, from 0, and episodes of the evaluation that is due, if one is. It is to be asked for at once, and answered
    /// before the next one becomes due for the second time.
    pub fn evaluate(&mut self) -> Option<(u64, u32)> {
        let due = self.due.take()?;
        // In free mode it may have had to wait for the one before, and is played with the weights of now.
        self.ordered =
            Some(if self.experiment.config.run.mode == Mode::Free { self.agent.counters() } else { due });
        let (tick, weights) = &mut self.candidate;
        *tick = self.tick;
        weights.clear();
        weights.extend_from_slice(self.agent.weights());
        Some((self.evaluations, self.experiment.config.eval.episodes))
    }

    /// Takes one actor's batch in; the batches of a tick come in the order of the actors. Returns how many transitions
    /// were counted: fewer than the batch has only where the run ended within it.
    pub fn ingest(
        &mut self,
        batch: &Checked<Batch>,
        observed: Option<&Observed>,
    ) -> Result<usize, SessionError> {
        let ingested = self.agent.ingest(batch, observed)?;
        self.guide.iter_mut().for_each(|sum| sum.merge(&batch.header.guide));
        for finished in ingested.finished {
            self.recorder.episode(&finished.counters, &finished.episode)?;
        }
        Ok(ingested.consumed)
    }

    /// Free mode: incarnation `incarnation` of `actor` has come, on another `host` or on this one (empty), and begins with an episode.
    /// That of the former one, if there was one, remains unfinished.
    pub fn joined(&mut self, actor: u32, incarnation: Incarnation, host: String) {
        self.agent.abandon_episode(actor);
        self.actors.push(ActorRow { actor, incarnation, host, ..ActorRow::default() });
    }

    /// Free mode: begins a round that has no steps.
    pub fn skip_round(&mut self) {
        self.tick = self.tick.next();
    }

    /// Free mode: counts a batch of the actor that has come last under its index, `env_steps` transitions of which have
    /// been ingested.
    pub fn count_batch(&mut self, batch: &Batch, env_steps: usize) {
        let age = self.tick.since(batch.header.weights_version);
        self.staleness.add(age);
        if let Some(row) = self.actors.iter_mut().rev().find(|row| row.actor == batch.header.actor) {
            row.batches += 1;
            row.env_steps += env_steps as u64;
            row.staleness.add(age);
        }
    }

    /// Takes the gradient steps that the transitions of tick `number` make due, and decides whether an evaluation is.
    pub fn train(&mut self, number: Round) -> Result<(), SessionError> {
        self.saver.poll()?;
        self.stats.merge(&self.agent.train(pulse::step)?);
        self.tick = number;
        let now = self.agent.counters();
        let every = self.experiment.config.eval.every;
        if now.episodes / every > self.evaluated_at.episodes / every {
            self.due = Some(now);
            self.evaluated_at = now;
        }
        if self.recorder.interval_due() {
            let gauges = Gauges { hosts: self.host_gauges(), ..self.gauges() };
            self.recorder.interval(&now, &gauges)?;
            self.stats = TrainStats::default();
            self.staleness = Staleness::default();
            self.spent = Spent::default();
            self.guide[0] = Tally::default();
            self.interval_from = now.env_steps;
            self.since = Instant::now();
        }
        if self.timeline.due() {
            self.timeline.add(&self.agent, self.recorder.wall_s());
        }
        if self.recorder.progress_due() {
            self.show_progress();
        }
        Ok(())
    }

    /// Whether the run has reached its limits, or is solved and to stop then.
    pub fn done(&self) -> bool {
        self.agent.done() || self.solved(self.tick)
    }

    /// Whether the run is over with the next tick, whose batches are `batches`.
    pub fn ends_within<'b>(&self, batches: impl Iterator<Item = &'b Batch>) -> bool {
        self.agent.ends_within(batches) || self.solved(self.tick.next())
    }

    /// Whether the run stops with `tick` because it is solved. The answer to an evaluation comes while the next tick, with a
    /// lag the one after it, is under way: that tick is the last one wherever the answer came earlier, too.
    fn solved(&self, tick: Round) -> bool {
        let run = &self.experiment.config.run;
        let last = |by: Counters| {
            Round::from(by.env_steps / self.experiment.steps_per_tick()) + 1 + u64::from(run.lag)
        };
        let now = |by| run.mode == Mode::Free || tick >= last(by);
        run.stop_when_solved && self.solved_by.is_some_and(now)
    }

    /// Makes a last evaluation due unless there has been one at this very point, or the run stops because of the last
    /// ones.
    pub fn request_final_evaluation(&mut self) {
        if !self.agent.done() {
            return;
        }
        let now = self.agent.counters();
        if self.due.is_none() && self.evaluated_at.env_steps != now.env_steps {
            self.due = Some(now);
            self.evaluated_at = now;
        }
    }

    /// Records the evaluation that was asked for.
    pub fn evaluated(&mut self, evaluation: &Evaluation) -> Result<(), SessionError> {
        let Some(counters) = self.ordered.filter(|_| evaluation.evaluation == self.evaluations) else {
            let expected = self.ordered.map_or("none".into(), |_| self.evaluations.to_string());
            return Err(SessionError::Evaluation { found: evaluation.evaluation, expected });
        };
        for (episode, played) in evaluation.episodes.iter().enumerate() {
            if !played.episode.total_reward.is_finite() {
                let (evaluation, found) = (evaluation.evaluation, played.episode.total_reward);
                return Err(SessionError::Return { evaluation, episode, found });
            }
        }
        let episodes: Vec<Episode> = evaluation.episodes.iter().map(|played| played.episode).collect();
        self.guide_return = evaluation.guide_return;
        let total_reward = self.recorder.evaluation(&counters, &episodes)?;
        if self.best.is_none_or(|best| total_reward > best) {
            self.keep_best(&counters, total_reward)?;
        }
        if let Some(first) = evaluation.episodes.first() {
            self.timeline.evaluation(&first.path);
        }
        if self.recorder.solved() {
            self.solved_by.get_or_insert(counters);
        }
        self.ordered = None;
        self.evaluations += 1;
        Ok(())
    }

    /// Keeps the weights of the evaluation that was asked for at `counters`, the best so far.
    fn keep_best(&mut self, counters: &Counters, total_reward: f64) -> Result<(), SessionError> {
        let start = Instant::now();
        let Counters { episodes: episode, env_steps, .. } = *counters;
        let (tick, weights) = &self.candidate;
        let evaluation = BestEvaluation { tick: *tick, episode, env_steps, total_reward };
        let layout = self.agent.network().layout();
        checkpoint::write_best(self.dir.root(), layout, weights, &evaluation)?;
        self.best = Some(total_reward);
        self.spent.checkpoints += start.elapsed();
        Ok(())
    }

    /// Whether an evaluation has been asked for and not yet answered.
    pub fn awaits_evaluation(&self) -> bool {
        self.ordered.is_some()
    }

    /// Time spent waiting for actors.
    pub fn waited_for_actors(&mut self, time: Duration) {
        self.spent.actors += time;
    }

    /// Time spent waiting for the mentor-server.
    pub fn waited_for_mentor(&mut self, time: Duration) {
        self.spent.mentor += time;
    }

    /// Whether a checkpoint is to be taken when the count of environment steps goes from `before` to `after`.
    pub fn checkpoint_due(&self, before: u64, after: u64) -> bool {
        let every = self.experiment.config.checkpoint.every_env_steps;
        every > 0 && after / every > before / every
    }

    /// Takes a checkpoint after the last trained tick. `behaviour`: what actors act with in the next tick, where
    /// it is not the newest; `actors`: their snapshots, in order. It is written while the run goes on.
    pub fn checkpoint(
        &mut self,
        behaviour: Option<Acting>,
        actors: &[Vec<u8>],
        taken: Taken<'_>,
    ) -> Result<(), SessionError> {
        let start = Instant::now();
        let (recorder, records) = self.recorder.checkpoint()?;
        let state = State {
            recorder,
            evaluations: self.evaluations,
            // One that is being played, as may be in free mode, will be due again.
            due: self.due.or(self.ordered),
            evaluated_at: self.evaluated_at,
            solved_by: self.solved_by,
            actors: self.actors.clone(),
            behaviour,
            guide: self.guide[1],
        };
        let run = codec::encode(KIND, &state)?;
        let (experiment, life, tick, agent) = (self.experiment, self.life, self.tick, &self.agent);
        let cut = Cut { experiment, life, tick, agent, actors, run: &run, taken };
        self.saver.save(&cut, records)?;
        self.write_tables()?;
        self.spent.checkpoints += start.elapsed();
        tracing::info!(stall_us = start.elapsed().as_micros() as u64, "checkpoint is taken");
        Ok(())
    }

    /// Waits for the last checkpoint, ends the record and writes the result.
    pub fn finish(mut self, interrupted: bool) -> Result<RunResult, SessionError> {
        self.saver.wait()?;
        self.show_progress();
        self.timeline.add(&self.agent, self.recorder.wall_s());
        self.write_tables()?;
        let gauges = self.gauges();
        // In free mode the supervisor has counted since how many processes it has replaced.
        let newest =
            if self.experiment.config.run.mode == Mode::Free { self.dir.read_plan().ok() } else { None };
        let restarts = newest.map_or(self.life.restarts, |plan| plan.life.restarts);
        let counters = self.agent.counters();
        let samples = counters.grad_steps * self.experiment.config.learner.batch as u64;
        let mentor_samples =
            self.agent.mentor_summary(0..self.experiment.mentor_len()).map(|mentor| [samples, mentor.used]);
        let ending =
            Ending { weights_sha256: self.agent.weights_sha256(), restarts, interrupted, mentor_samples };
        Ok(self.recorder.finish(&counters, &gauges, ending)?)
    }

    /// Brings `mentor.csv` and `actors.csv` up to date.
    fn write_tables(&self) -> Result<(), SessionError> {
        if self.experiment.config.run.mode == Mode::Free {
            write_actors(self.dir.root(), &self.actors)?;
        }
        let Some(rows) = self.agent.mentor_rows() else { return Ok(()) };
        Ok(write_mentor(self.dir.root(), &self.experiment.mentors, self.experiment.spec.obs_dim(), rows)?)
    }

    fn show_progress(&mut self) {
        let gauges = self.gauges();
        let progress = self.recorder.progress(&self.agent.counters(), &gauges);
        (self.progress)(&progress);
    }

    fn gauges(&self) -> Gauges {
        let config = &self.experiment.config;
        let share = |time: Duration| time.as_secs_f64() / self.since.elapsed().as_secs_f64();
        let mut gauges = Gauges {
            exploration_rate: schedule::epsilon(&config.exploration, self.agent.counters().env_steps),
            loss: self.stats.loss_mean(),
            learning_rate: config.learner.lr,
            replay_size: self.agent.replay().len() as u64,
            ipc_wait_frac: share(self.spent.actors + self.spent.mentor),
            wait_actors_frac: share(self.spent.actors),
            wait_mentor_frac: share(self.spent.mentor),
            checkpoint_frac: share(self.spent.checkpoints),
            memory_mb: resident_mb(),
            ..Gauges::default()
        };
        if config.run.mode == Mode::Free {
            let counters = self.agent.counters();
            let samples = counters.grad_steps * config.learner.batch as u64;
            gauges.staleness_mean = self.staleness.mean();
            gauges.staleness_max = self.staleness.max();
            gauges.samples_per_insert = samples as f64 / counters.env_steps as f64;
        }
        if config.guide() == Some(GuideKind::Learned) {
            let [newest, all] = &self.guide;
            let steps = self.agent.counters().env_steps - self.interval_from;
            gauges.guide = Some(GuideGauges {
                steps_frac: newest.steps as f64 / steps as f64,
                progress_mean: newest.progress / newest.episodes as f64,
                guided_episodes: all.guided,
                stuck_episodes: all.stuck,
                own_paths: self.agent.own_paths() as u64,
                loss: self.stats.policy_loss_mean(),
                imitation_loss: self.stats.imitation_loss_mean(),
                total_reward: self.guide_return.unwrap_or(f64::NAN),
            });
        }
        if let Some(all) = self.mentor_gauges("", 0..self.experiment.mentor_len()) {
            gauges.feasible_frac = all.feasible_frac;
            gauges.bridged_frac = all.bridged_frac;
            gauges.e_kl_mean = all.e_kl_mean;
            gauges.bridge_len_mean = all.bridge_len_mean;
            gauges.mentor_loss_frac = self.stats.mentor_frac();
            gauges.searches_cut_short = self.agent.searches_cut_short().map_or(f64::NAN, |n| n as f64);
        }
        if self.experiment.mentors.len() > 1 {
            let mut first = 0;
            for part in &self.experiment.mentors {
                gauges.mentors.extend(self.mentor_gauges(&part.name, first..first + part.transitions));
                first += part.transitions;
            }
        }
        gauges
    }

    /// What the run's supervisor has written of other hosts, of which this process knows nothing else. Sums over all times that a
    /// host has joined, and the newest round trip.
    fn host_gauges(&self) -> Vec<HostGauges> {
        let Ok(text) = regular_file::read_to_string(&self.dir.hosts(), MAX_BYTES) else { return Vec::new() };
        let mut hosts: Vec<HostGauges> = Vec::new();
        for row in hosts_file::of_csv(&text) {
            let at = match hosts.iter().position(|host| host.name == row.host) {
                Some(at) => at,
                None => {
                    hosts.push(HostGauges { name: row.host, ..HostGauges::default() });
                    hosts.len() - 1
                }
            };
            let host = &mut hosts[at];
            host.actors += if row.state == HostState::Joined { row.actors.len() as u64 } else { 0 };
            host.round_trip_ms = row.round_trip_ms.unwrap_or(host.round_trip_ms);
            host.bytes_sent += row.bytes_sent;
            host.bytes_received += row.bytes_received;
            host.resent += row.resent;
            host.repeated += row.repeated;
        }
        hosts
    }

    fn mentor_gauges(&self, name: &str, range: Range<usize>) -> Option<MentorGauges> {
        let summary = self.agent.mentor_summary(range)?;
        let share = |n: usize| n as f64 / summary.len as f64;
        Some(MentorGauges {
            name: name.into(),
            feasible_frac: share(summary.feasible),
            bridged_frac: share(summary.bridged),
            e_kl_mean: summary.e_kl_mean,
            bridge_len_mean: summary.bridge_len_mean,
            visited_frac: share(summary.visited),
        })
    }
}

/// Memory of this process that is in use, MiB; NaN where the system does not say.
fn resident_mb() -> f64 {
    let statm = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let pages = statm.split_whitespace().nth(1).and_then(|pages| pages.parse::<f64>().ok());
    pages.map_or(f64::NAN, |pages| pages * rustix::param::page_size() as f64 / f64::from(1 << 20))
}

/// What the recorder must know of the run.
fn settings(experiment: &Experiment) -> Settings {
    let (run, eval) = (&experiment.config.run, &experiment.config.eval);
    Settings {
        algo: experiment.config.arm(),
        seed: run.seed,
        env: experiment.spec.name.clone(),
        goal: experiment.threshold().map(|threshold| Goal { threshold, tolerance: eval.tolerance }),
        limits: Limits { episodes: run.episodes, env_steps: run.env_steps },
        metrics_every: METRICS_EVERY,
        progress_every: PROGRESS_EVERY,
    }
}
