//! The loop of the learner's process in lockstep, and what it has in common with that of free mode (`free.rs`).
//!
//! A tick: every actor sends exactly one batch; the learner takes them in by the actors' order, asking the
//! mentor-server about each; takes the gradient steps that are due; publishes the weights; and sends the next tick.
//! With `run.lag = 1` the next tick is sent before the gradient steps, so that actors and learner work at the same
//! time, the actors with the weights of one tick earlier.
//!
//! Weights are published only right before a tick that names them, when no actor can still be reading others. The
//! outcome is therefore a function of the plan alone.

use crate::free;
use crate::record::{Progress, RunResult};
use crate::session::{Resumed, Session, SessionError};
use std::time::Instant;
use trestle_link::{FromActor, LearnerLink, LinkError, Stop};
use trestle_link::{logging, pulse};
use trestle_proto::annotation::record_words;
use trestle_proto::batch::Batch;
use trestle_proto::codec::{self, CodecError};
use trestle_proto::config::Mode;
use trestle_proto::limits::{MAX_QUERY_ROWS, WAIT_SLICE};
use trestle_proto::mentor::{MentorTransitions, MentorTransitionsError};
use trestle_proto::observe::{OBSERVE, ObserveRequest, Observed, REBUILD, RESTORE};
use trestle_proto::plan::RunPlan;
use trestle_proto::query::{QueryRequest, TRANSITIONS};
use trestle_proto::reply::{ACTOR_STATE, EVALUATION, EVALUATION_KIND, Reply};
use trestle_proto::rundir::RunDir;

/// What ends the learner's process early.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// Learning, records or checkpoints.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The other processes.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The mentor's transitions.
    #[error(transparent)]
    Mentor(#[from] MentorTransitionsError),
    /// An evaluation that cannot be read.
    #[error(transparent)]
    Codec(#[from] CodecError),
}

/// Trains `plan`'s run over `link` until it is done or `stop` says so, and leaves its result in `dir`.
///
/// When `stop` says so the tick under way is finished and a checkpoint taken; the result says `interrupted`.
///
/// # Errors
/// A peer that is gone or sends what cannot be right, training that diverges, or a file that cannot be written.
pub fn run(
    link: &mut impl LearnerLink,
    plan: &RunPlan,
    dir: &RunDir,
    stop: Stop<'_>,
    progress: impl FnMut(&Progress),
) -> Result<RunResult, RunError> {
    let Resumed { session, behaviour } = begin(link, plan, dir, stop, progress)?;
    if plan.config.run.mode == Mode::Free {
        return free::run(link, plan, session, stop);
    }
    let actors = plan.config.run.actors as usize;
    let rollout = plan.config.run.rollout as usize;
    Lockstep {
        link,
        plan,
        session,
        batches: vec![Batch::with_capacity(rollout, plan.spec.obs_dim()); actors],
        arrived: vec![false; actors],
        awaited: 0,
        observed: Observed::default(),
        snapshots: vec![None; actors],
        snapshots_of: 0,
        behaviour,
        stop,
    }
    .run()
}

/// Lets the other processes in and makes the session, or the one that goes on from the plan's checkpoint.
fn begin<'a>(
    link: &mut impl LearnerLink,
    plan: &'a RunPlan,
    dir: &'a RunDir,
    stop: Stop<'_>,
    progress: impl FnMut(&Progress) + 'a,
) -> Result<Resumed<'a>, RunError> {
    let free = plan.config.run.mode == Mode::Free;
    let mentor = loop {
        link.welcome(stop)?;
        if plan.mentor_len() == 0 {
            break None;
        }
        match fetch_transitions(link, plan) {
            Err(RunError::Link(error)) if free && error.is_lost_peer() => {
                tracing::warn!("the mentor-server is lost: {error}");
            }
            transitions => break Some(transitions?),
        }
    };
    let resumed = match plan.resume_tick {
        None => Resumed { session: Session::new(plan, dir, mentor, progress)?, behaviour: None },
        Some(tick) => {
            let resumed = Session::resume(plan, dir, tick, mentor, progress)?;
            if plan.mentor_len() > 0 && !free {
                rebuild_mentor(link, plan, &resumed.session)?;
            }
            resumed
        }
    };
    // In free mode the actors come when they like.
    tracing::info!(tick = resumed.session.tick(), "ready to train");
    Ok(resumed)
}

struct Lockstep<'a, L> {
    link: &'a mut L,
    plan: &'a RunPlan,
    session: Session<'a>,
    /// Each actor's batch of the tick, and whether it has come.
    batches: Vec<Batch>,
    arrived: Vec<bool>,
    /// The tick whose batches may come.
    awaited: u64,
    observed: Observed,
    /// The snapshots that have come since they were asked for, and the tick that they were asked for after.
    snapshots: Vec<Option<Vec<u8>>>,
    snapshots_of: u64,
    /// What the actors act with where it is not the agent's newest: until the first publication of a resumed run, and
    /// for the checkpoint that is being taken.
    behaviour: Option<Vec<f32>>,
    stop: Stop<'a>,
}

impl<L: LearnerLink> Lockstep<'_, L> {
    fn run(mut self) -> Result<RunResult, RunError> {
        let lag = u64::from(self.plan.config.run.lag);
        let mut tick = self.session.tick();
        if self.session.done() {
            // The checkpoint is the run's last one; only the result is missing.
            self.session.start()?;
            self.link.send_tick(&self.session.stop())?;
            return Ok(self.session.finish(false)?);
        }
        self.begin(tick, lag)?;
        loop {
            tick += 1;
            logging::set_tick(tick);
            self.receive()?;
            let leaving = (self.stop)();
            let steps = |ticks| ticks * self.plan.steps_per_tick();
            let saving = leaving || self.session.checkpoint_due(steps(tick - 1), steps(tick));
            if lag == 1 {
                self.dispatch(tick, saving, leaving)?;
            }
            self.learn(tick)?;
            if self.session.done() {
                return self.finish(tick, lag == 1 && !leaving);
            }
            if lag == 0 {
                self.dispatch(tick, saving, leaving)?;
            }
            if saving {
                self.save()?;
            }
            if leaving {
                tracing::info!("interrupted: the tick is finished and saved");
                self.link.send_tick(&self.session.stop())?;
                return Ok(self.session.finish(true)?);
            }
        }
    }

    /// Sends the first tick after `tick`, the last that has been trained on.
    fn begin(&mut self, tick: u64, lag: u64) -> Result<(), RunError> {
        self.session.start()?;
        let version = if self.behaviour.is_some() { tick.saturating_sub(lag) } else { tick };
        let weights = self.behaviour.take();
        let weights = weights.as_deref().unwrap_or_else(|| self.session.agent().acting());
        self.link.send_weights(version, weights)?;
        self.send_collect(tick + 1, version)
    }

    fn send_collect(&mut self, tick: u64, version: u64) -> Result<(), RunError> {
        self.awaited = tick;
        Ok(self.link.send_tick(&self.session.collect(tick, version))?)
    }

    /// Publishes the newest weights and sends all ticks that come between the batches of `tick` and the next: an
    /// evaluation that is due, snapshots if a checkpoint is taken, and, unless the run is leaving, the collection.
    fn dispatch(&mut self, tick: u64, saving: bool, leaving: bool) -> Result<(), RunError> {
        let version = self.session.tick();
        self.link.send_weights(version, self.session.agent().acting())?;
        if let Some(evaluate) = self.session.evaluate() {
            self.link.send_tick(&evaluate)?;
        }
        if saving {
            // With a lag the agent learns on before the checkpoint is written.
            let older = version < tick;
            self.behaviour = older.then(|| self.session.agent().acting().to_vec());
            self.snapshots.fill(None);
            self.snapshots_of = tick;
            self.link.send_tick(&self.session.snapshot(tick))?;
        }
        if leaving { Ok(()) } else { self.send_collect(tick + 1, version) }
    }

    /// Waits for the batches of the tick that was sent, of all actors, and for the evaluation asked for before it.
    fn receive(&mut self) -> Result<(), RunError> {
        while !self.arrived.iter().all(|arrived| *arrived) || self.session.awaits_evaluation() {
            self.next()?;
        }
        self.arrived.fill(false);
        Ok(())
    }

    /// Waits for the next message and puts it where it belongs. It is the supervisor that notices when a process dies or
    /// hangs, and then ends this one.
    fn next(&mut self) -> Result<(), RunError> {
        let start = Instant::now();
        let message = loop {
            if let Some(message) = self.link.recv(&mut self.batches, WAIT_SLICE)? {
                break message;
            }
            pulse::step();
        };
        self.session.waited(start.elapsed());
        match message {
            FromActor::Reply(reply) => self.reply(reply),
            FromActor::Batch(actor) => {
                let (found, awaited) = (self.batches[actor as usize].header.tick, self.awaited);
                if found == awaited && !std::mem::replace(&mut self.arrived[actor as usize], true) {
                    return Ok(());
                }
                let text = format!("actor {actor}'s batch of tick {found}; tick {awaited} is awaited");
                Err(LinkError::Unexpected(text).into())
            }
        }
    }

    fn reply(&mut self, reply: Reply) -> Result<(), RunError> {
        let actor = reply.header.actor;
        match reply.header.kind {
            EVALUATION => {
                let evaluation = codec::decode(EVALUATION_KIND, &reply.payload)?;
                Ok(self.session.evaluated(&evaluation)?)
            }
            ACTOR_STATE if reply.header.tick == self.snapshots_of => {
                self.snapshots[actor as usize] = Some(reply.payload);
                Ok(())
            }
            kind => {
                let tick = reply.header.tick;
                let text = format!("a reply of kind {kind} to tick {tick} from actor {actor}");
                Err(LinkError::Unexpected(text).into())
            }
        }
    }

    /// Takes the batches in, in the order of the actors, and trains.
    fn learn(&mut self, tick: u64) -> Result<(), RunError> {
        // Once the run has reached its limits, what the agent drops still counts for the mentor-server.
        let mut first_index = self.session.agent().counters().env_steps;
        for (actor, batch) in self.batches.iter().enumerate() {
            let observed = if self.plan.mentor_len() > 0 {
                let request = request(self.plan, tick, first_index, OBSERVE, actor as u32, batch.len());
                let start = Instant::now();
                self.link.observe(&request, batch.payload(), &mut self.observed)?;
                self.session.waited(start.elapsed());
                Some(&self.observed)
            } else {
                None
            };
            self.session.ingest(batch, observed)?;
            first_index += batch.len() as u64;
        }
        Ok(self.session.train(tick)?)
    }

    /// Waits for all snapshots that were asked for and writes the checkpoint. Batches of the next tick, which the
    /// actors begin as soon as they have answered, may come meanwhile.
    fn save(&mut self) -> Result<(), RunError> {
        while self.snapshots.iter().any(Option::is_none) || self.session.awaits_evaluation() {
            self.next()?;
        }
        let snapshots: Vec<Vec<u8>> = self.snapshots.iter_mut().filter_map(Option::take).collect();
        Ok(self.session.checkpoint(self.behaviour.take().as_deref(), &snapshots)?)
    }

    /// The run has reached its limits in `tick`: a last evaluation, a last checkpoint, the result. `ahead`: the actors
    /// have been sent on to the next tick, whose batches nobody needs.
    fn finish(mut self, tick: u64, ahead: bool) -> Result<RunResult, RunError> {
        if ahead {
            self.receive()?;
            self.session.cut_short();
        }
        while self.session.awaits_evaluation() {
            self.next()?;
        }
        self.session.request_final_evaluation();
        self.dispatch(tick, true, true)?;
        self.save()?;
        self.link.send_tick(&self.session.stop())?;
        Ok(self.session.finish(false)?)
    }
}

pub(crate) fn request(
    plan: &RunPlan,
    tick: u64,
    first_index: u64,
    op: u32,
    actor: u32,
    count: usize,
) -> ObserveRequest {
    let (run, count, obs_dim) = (plan.run, count as u32, plan.spec.obs_dim() as u32);
    ObserveRequest { run, tick, first_index, op, actor, count, obs_dim }
}

/// Asks the mentor-server for the mentor's transitions, piece by piece.
fn fetch_transitions(link: &mut impl LearnerLink, plan: &RunPlan) -> Result<MentorTransitions, RunError> {
    let mut transitions = MentorTransitions::new(plan.spec.obs_dim());
    let mut words = Vec::new();
    while transitions.len() < plan.mentor_len() {
        let before = transitions.len();
        let request = QueryRequest {
            run: plan.run,
            op: TRANSITIONS,
            first: before as u32,
            count: ((plan.mentor_len() - before) as u32).min(MAX_QUERY_ROWS),
            obs_dim: plan.spec.obs_dim() as u32,
        };
        link.query(&request, &[], &mut words)?;
        transitions.decode(&words)?;
        if transitions.len() == before || transitions.len() > plan.mentor_len() {
            let text =
                format!("{} mentor transitions, {} are expected", transitions.len(), plan.mentor_len());
            return Err(LinkError::Unexpected(text).into());
        }
    }
    Ok(transitions)
}

/// Gives a new mentor-server the history that the replay holds, and the annotations that came of it.
pub(crate) fn rebuild_mentor(
    link: &mut impl LearnerLink,
    plan: &RunPlan,
    session: &Session<'_>,
) -> Result<(), RunError> {
    let (agent, tick) = (session.agent(), session.tick());
    let replay = agent.replay();
    let (mut batch, mut observed) = (Batch::default(), Observed::default());
    let mut index = replay.first_index();
    while index < replay.next_index() {
        let count = replay.fill_batch(index, plan.config.run.rollout as usize, &mut batch);
        let request = request(plan, tick, index, REBUILD, batch.header.actor, count);
        link.observe(&request, batch.payload(), &mut observed)?;
        pulse::step();
        index += count as u64;
    }
    let records = agent.annotation_records();
    let record = record_words(plan.spec.obs_dim());
    for chunk in records.chunks(record * MAX_QUERY_ROWS as usize) {
        let request = request(plan, tick, replay.next_index(), RESTORE, 0, chunk.len() / record);
        link.observe(&request, chunk, &mut observed)?;
    }
    Ok(())
}
