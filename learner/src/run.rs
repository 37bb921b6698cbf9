//! The loop of the learner's process, the same in lockstep and in free mode.
//!
//! A round: batches come; the learner takes them in, asking the mentor-server once about all of them; takes the gradient
//! steps that are due; publishes the weights; and gives orders, which grant each actor its next batches.
//!
//! *Lockstep* is this loop with a barrier. A round, which is called a tick there, has exactly one batch of each actor, in
//! the actors' order. Weights are published only when every actor has sent its batch, so none can be reading others, and
//! the outcome is a function of the experiment alone. With `run.lag = 1` the orders for the next tick go out before the gradient
//! steps, so that actors and learner work at the same time, the actors with the weights of one tick earlier.
//!
//! *Free mode* takes whichever batches have come. Actors and the mentor-server may be replaced meanwhile, and this process
//! may itself have taken another's place: then the actors learn of it from its first orders, and announce themselves anew.

use crate::checkpoint::Taken;
use crate::rebuild::{rebuild_mentor, request};
use crate::record::Progress;
use crate::session::{Resumed, Session, SessionError};
use std::time::{Duration, Instant};
use trestle_link::{FromActor, LearnerLink, LinkError, Stop, logging, pulse};
use trestle_proto::acting::Acting;
use trestle_proto::batch::{Batch, Checked};
use trestle_proto::codec::{self, CodecError};
use trestle_proto::config::Mode;
use trestle_proto::hosts_file::is_name;
use trestle_proto::incarnation::Incarnation;
use trestle_proto::limits::{MAX_QUERY_ROWS, WAIT_SLICE};
use trestle_proto::mentor::{MentorTransitions, MentorTransitionsError};
use trestle_proto::observe::{Answers, OBSERVE, Part};
use trestle_proto::orders::{Orders, Share};
use trestle_proto::plan::RunPlan;
use trestle_proto::query::{NOT_READY, QueryRequest, TRANSITIONS, status_text};
use trestle_proto::reply::{ACTOR_STATE, EVALUATION, EVALUATION_KIND, Evaluation, JOINED, Reply};
use trestle_proto::round::Round;
use trestle_proto::run_result::RunResult;
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
/// When `stop` says so the round under way is finished and a checkpoint taken; the result says `interrupted`.
///
/// # Errors
/// A peer that sends what cannot be right or, in lockstep, is gone; a mentor-server that does not come back; training that
/// diverges; or a file that cannot be written.
pub fn run(
    link: &mut dyn LearnerLink,
    plan: &RunPlan,
    dir: &RunDir,
    stop: Stop<'_>,
    progress: Box<dyn FnMut(&Progress) + '_>,
) -> Result<RunResult, RunError> {
    let mentor = welcome(link, plan, stop)?;
    let resumed = match plan.life.resume_tick {
        None => {
            let session = Session::new(plan, dir, mentor, progress)?;
            Resumed { session, behaviour: None, pending: Vec::new() }
        }
        Some(tick) => Session::resume(plan, dir, tick, mentor, progress)?,
    };
    tracing::info!(tick = %resumed.session.tick(), "ready to train");
    Loop::new(link, plan, resumed, stop).run()
}

/// Lets the other processes in; in free mode the actors come when they like. Returns the mentor's transitions, if the run
/// has a mentor.
fn welcome(
    link: &mut dyn LearnerLink,
    plan: &RunPlan,
    stop: Stop<'_>,
) -> Result<Option<MentorTransitions>, RunError> {
    loop {
        link.welcome(stop)?;
        if plan.experiment.mentor_len() == 0 {
            return Ok(None);
        }
        match fetch_transitions(link, plan) {
            Err(RunError::Link(error))
                if plan.experiment.config.run.mode == Mode::Free && error.is_lost_peer() =>
            {
                tracing::warn!("the mentor-server is lost: {error}");
            }
            transitions => return Ok(Some(transitions?)),
        }
    }
}

/// The present incarnation of an actor.
#[derive(Clone, Copy)]
struct Seat {
    incarnation: Incarnation,
    /// Batches that have come.
    batches: u64,
    /// The actor's own number of its next transition.
    next_seq: u64,
}

/// What has come for the round under way, in the order in which it counts.
enum Came {
    Batch(Checked<Batch>),
    /// An actor of free mode has announced itself.
    Joined {
        actor: u32,
        incarnation: Incarnation,
        host: String,
    },
}

struct Loop<'a> {
    link: &'a mut dyn LearnerLink,
    plan: &'a RunPlan,
    session: Session<'a>,
    /// Lockstep: a round has one batch of each actor, and no process is replaced.
    barrier: bool,
    came: Vec<Came>,
    /// Batches whose memory is free.
    spare: Vec<Checked<Batch>>,
    answers: Answers,
    /// None until the actor has announced itself.
    seats: Vec<Option<Seat>>,
    /// As published last.
    orders: Orders,
    /// The snapshots that have come since they were asked for.
    snapshots: Vec<Option<Vec<u8>>>,
    /// What the actors act with where it is not the agent's newest: until the first publication of a resumed run, and
    /// for the checkpoint that is being taken.
    behaviour: Option<Acting>,
    /// The round of the last checkpoint that the run can go on from.
    saved: Option<Round>,
    stop: Stop<'a>,
}

impl<'a> Loop<'a> {
    fn new(link: &'a mut dyn LearnerLink, plan: &'a RunPlan, resumed: Resumed<'a>, stop: Stop<'a>) -> Self {
        let Resumed { session, behaviour, pending } = resumed;
        let RunPlan { experiment, life } = plan;
        let run = &experiment.config.run;
        let (actors, barrier) = (run.actors as usize, run.mode != Mode::Free);
        // In lockstep every actor is there, and goes on from its snapshot.
        let ticks = session.tick() + u64::from(!pending.is_empty());
        let next_seq = u64::from(ticks) * u64::from(run.rollout);
        let seat = barrier.then_some(Seat { incarnation: Incarnation::default(), batches: 0, next_seq });
        Self {
            barrier,
            came: pending.into_iter().map(Came::Batch).collect(),
            spare: vec![Checked::with_capacity(run.rollout as usize, experiment.spec.row()); actors],
            answers: Answers::default(),
            seats: vec![seat; actors],
            orders: Orders { run: life.run, generation: life.generation, ..Orders::default() },
            snapshots: vec![None; actors],
            saved: life.resume_tick,
            link,
            plan,
            session,
            behaviour,
            stop,
        }
    }

    fn run(mut self) -> Result<RunResult, RunError> {
        if self.barrier && self.session.done() {
            // The checkpoint is beyond limits that are lower now.
            self.session.start();
            return self.leave(false);
        }
        if !self.barrier {
            self.session.start();
        }
        if self.plan.life.resume_tick.is_some()
            && self.plan.experiment.mentor_len() > 0
            && !self.give_history(false)?
        {
            return self.leave(true);
        }
        if self.barrier {
            // With all processes ready; in free mode there may be none for a while.
            self.session.start();
        }
        self.begin()?;
        let lag = self.plan.experiment.config.run.lag == 1;
        while !self.session.done() {
            logging::set_tick(self.session.tick().next());
            self.receive()?;
            let ending = self.barrier && self.session.ends_within(batches(&self.came));
            if ending {
                self.save_before_last()?;
            }
            // The actors stay where they are after the last tick.
            let leaving = ending || (self.stop)();
            let before = self.session.agent().counters().env_steps;
            let due = leaving || self.session.checkpoint_due(before, self.steps_received());
            let saving = due && !ending;
            if lag {
                self.dispatch(saving, leaving)?;
            }
            if !self.learn()? {
                self.save(Taken::Amid)?;
                return self.leave(true);
            }
            if self.session.done() {
                return self.finish();
            }
            if !lag {
                self.dispatch(saving, leaving)?;
            }
            if saving {
                self.save(Taken::Amid)?;
            }
            if leaving {
                tracing::info!("interrupted: the round is finished and saved");
                return self.leave(true);
            }
        }
        self.finish()
    }

    /// Publishes the weights to begin with, and grants the first batches, unless these are here already.
    fn begin(&mut self) -> Result<(), RunError> {
        let tick = self.session.tick();
        match self.behaviour.take() {
            Some(acting) => {
                let version = tick.before(u64::from(self.plan.experiment.config.run.lag));
                self.link.send_acting(version, &acting)?;
                self.orders.weights_version = version;
            }
            None => self.publish_weights()?,
        }
        if self.came.is_empty() {
            self.grant();
        }
        Ok(self.link.send_orders(&self.orders)?)
    }

    /// Environment steps of all actors, those of batches that are still to be learnt from included.
    fn steps_received(&self) -> u64 {
        let came: u64 = batches(&self.came).map(|batch| batch.len() as u64).sum();
        self.session.agent().counters().env_steps + came
    }

    /// Waits for what the round needs: in lockstep a batch of every actor and the evaluation that has been asked for; in
    /// free mode anything at all, and then takes what else has come: no more than all windows hold, so that learning goes
    /// on, and no less, so that no actor is overlooked.
    fn receive(&mut self) -> Result<(), RunError> {
        if self.barrier {
            loop {
                let evaluation = usize::from(self.session.awaits_evaluation());
                match self.seats.len().saturating_sub(self.came.len()) + evaluation {
                    0 => break,
                    missing => self.next(missing, WAIT_SLICE)?,
                };
            }
            self.came.sort_by_key(|came| match came {
                Came::Batch(batch) => batch.header.actor,
                Came::Joined { actor, .. } => *actor,
            });
            return Ok(());
        }
        let most = self.seats.len() * self.plan.experiment.window() as usize;
        let mut timeout = WAIT_SLICE;
        while self.came.len() < most && self.next(1, timeout)? {
            timeout = Duration::ZERO;
        }
        if self.link.mentor_waits() {
            self.give_history(true)?;
        }
        Ok(())
    }

    /// Takes the next message, if one comes within `timeout`; false if none does. `missing` are the messages that the round cannot do
    /// without, among them this one. It is the supervisor that notices when a
    /// process dies or hangs.
    fn next(&mut self, missing: usize, timeout: Duration) -> Result<bool, RunError> {
        let start = Instant::now();
        let mut batch = self.spare.pop().unwrap_or_default();
        let message = self.link.recv(&mut batch, missing as u32, timeout)?;
        if !timeout.is_zero() {
            self.session.waited_for_actors(start.elapsed());
        }
        let came = message.is_some();
        match message {
            Some(FromActor::Batch) if self.accept(&batch)? => self.came.push(Came::Batch(batch)),
            other => {
                self.spare.push(batch);
                match other {
                    Some(FromActor::Reply(reply)) => self.take_reply(reply)?,
                    Some(FromActor::Batch) => {}
                    None => pulse::step(),
                }
            }
        }
        Ok(came)
    }

    /// Whether `batch` counts: it must be the next of its actor's incarnation, and granted. One of an incarnation that has
    /// been replaced does not.
    fn accept(&mut self, batch: &Batch) -> Result<bool, RunError> {
        let header = batch.header;
        let actor = header.actor;
        let unexpected = |text| Err(LinkError::Unexpected(text).into());
        let seat = self.seats[actor as usize].as_mut();
        let Some(seat) = seat.filter(|seat| seat.incarnation == header.incarnation) else {
            if self.barrier {
                return unexpected(format!("a batch of incarnation {} of actor {actor}", header.incarnation));
            }
            tracing::info!(actor, incarnation = %header.incarnation, "a batch of a replaced actor is dropped");
            return Ok(false);
        };
        let (found, expected) = (header.first_seq, seat.next_seq);
        if found != expected {
            return unexpected(format!(
                "a batch of actor {actor} from number {found} on; {expected} is the next"
            ));
        }
        let granted = self.orders.granted(actor, seat.incarnation);
        let (count, rollout) = (header.count, self.plan.experiment.config.run.rollout);
        if count != rollout || seat.batches >= granted {
            return unexpected(format!(
                "a batch of actor {actor} with {count} transitions, after {} batches; it is granted {granted} of {rollout}",
                seat.batches
            ));
        }
        let (version, wanted) = (header.weights_version, self.orders.weights_version);
        if self.barrier && version != wanted {
            return unexpected(format!(
                "a batch of actor {actor} with weights {version}; it was to act with {wanted}"
            ));
        }
        seat.batches += 1;
        seat.next_seq += batch.len() as u64;
        Ok(true)
    }

    fn take_reply(&mut self, reply: Reply) -> Result<(), RunError> {
        let (actor, number) = (reply.header.actor, reply.header.number);
        match reply.header.kind {
            JOINED => self.join(actor, reply.header.incarnation, &reply.payload),
            EVALUATION => {
                let evaluation: Evaluation = codec::decode(EVALUATION_KIND, &reply.payload)?;
                // An actor and the one that replaces it may both have played the same. One that has not announced itself to this
                // learner has played it with another one's weights.
                let announced = self.seats[actor as usize].is_some();
                if announced && self.orders.evaluation == number && number > 0 {
                    self.session.evaluated(&evaluation)?;
                    self.orders.evaluation = 0;
                } else if self.barrier {
                    let text = format!("evaluation {number} from actor {actor}");
                    return Err(LinkError::Unexpected(text).into());
                }
                Ok(())
            }
            ACTOR_STATE if number == self.orders.snapshot => {
                self.snapshots[actor as usize] = Some(reply.payload);
                Ok(())
            }
            // The run has reached its end before they were needed.
            ACTOR_STATE if number < self.orders.snapshot => Ok(()),
            kind => {
                let text = format!("a reply of kind {kind} with number {number} from actor {actor}");
                Err(LinkError::Unexpected(text).into())
            }
        }
    }

    /// An actor has announced itself. In lockstep it was expected.
    fn join(&mut self, actor: u32, incarnation: Incarnation, host: &[u8]) -> Result<(), RunError> {
        let host = String::from_utf8_lossy(host).into_owned();
        if !host.is_empty() && !is_name(&host) {
            return Err(LinkError::Unexpected(format!("{host:?} as the host of actor {actor}")).into());
        }
        let (generation, present) = (incarnation.generation(), self.plan.life.generation);
        let seat = &mut self.seats[actor as usize];
        let known = seat.is_some_and(|seat| seat.incarnation >= incarnation);
        if generation > present || (self.barrier && !known) {
            return Err(LinkError::Unexpected(format!("incarnation {incarnation} of actor {actor}")).into());
        }
        // One of an earlier generation has not heard of this learner yet.
        if generation == present && !known {
            *seat = Some(Seat { incarnation, batches: 0, next_seq: 0 });
            tracing::info!(actor, %incarnation, host, "an actor has come");
            self.came.push(Came::Joined { actor, incarnation, host });
        }
        Ok(())
    }

    /// Takes in what has come, and trains. False: there is no mentor-server, and the run is to end.
    fn learn(&mut self) -> Result<bool, RunError> {
        let before = self.session.agent().counters().env_steps;
        let mut mentored = true;
        while !self.came.is_empty() {
            // In lockstep this is the whole tick.
            let count = self.came.len().min(self.seats.len());
            mentored = self.plan.experiment.mentor_len() == 0 || self.past_end() || self.observe(count)?;
            if !mentored || self.past_end() {
                self.pass_over();
                break;
            }
            let mut answers = self.answers.parts().iter();
            for came in self.came.drain(..count) {
                match came {
                    Came::Joined { actor, incarnation, host } => {
                        self.session.joined(actor, incarnation, host)
                    }
                    Came::Batch(batch) => {
                        let answer = answers.next();
                        // In lockstep what the mentor-server has found in the whole tick counts to the end.
                        if self.barrier || !self.session.done() {
                            let counted = self.session.ingest(&batch, answer)?;
                            self.session.count_batch(&batch, counted);
                        }
                        self.spare.push(batch);
                    }
                }
            }
        }
        if self.session.agent().counters().env_steps > before {
            self.session.train(self.session.tick().next())?;
        }
        self.spare.truncate(self.seats.len());
        Ok(mentored)
    }

    /// Free mode: whether the run has reached its end, so that no more batches count.
    fn past_end(&self) -> bool {
        !self.barrier && self.session.done()
    }

    /// Free mode: takes note of the actors that have come, and drops the batches.
    fn pass_over(&mut self) {
        for came in self.came.drain(..) {
            match came {
                Came::Joined { actor, incarnation, host } => self.session.joined(actor, incarnation, host),
                Came::Batch(batch) => self.spare.push(batch),
            }
        }
    }

    /// Asks the mentor-server about the batches among the first `count` messages; in free mode another one if it dies
    /// meanwhile. False: there is none, and the run is to end.
    fn observe(&mut self, count: usize) -> Result<bool, RunError> {
        // Once the run has reached its limits, what the agent drops still counts for the mentor-server.
        let first_index = self.session.agent().counters().env_steps;
        let round = self.session.tick().next();
        loop {
            let parts: Vec<Part<'_>> = batches(&self.came[..count]).map(Part::of).collect();
            if parts.is_empty() {
                return Ok(true);
            }
            let request = request(self.plan, round, first_index, OBSERVE, parts.len());
            let start = Instant::now();
            let answer = self.link.observe(&request, &parts, &mut self.answers);
            self.session.waited_for_mentor(start.elapsed());
            match answer {
                Ok(()) => return Ok(true),
                Err(error) if !self.barrier && is_lost_mentor(&error) => {
                    tracing::warn!("the mentor-server is lost: {error}");
                    if !self.give_history(true)? {
                        return Ok(false);
                    }
                }
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Gives the mentor-server, which knows nothing, the history; where it is `lost`, or in free mode is lost meanwhile, the
    /// next one that comes. False: the run is to end first.
    fn give_history(&mut self, mut lost: bool) -> Result<bool, RunError> {
        loop {
            if lost {
                let start = Instant::now();
                let joined = self.link.rejoin_mentor(self.stop);
                self.session.waited_for_mentor(start.elapsed());
                match joined {
                    Err(LinkError::Interrupted(_)) => return Ok(false),
                    joined => joined?,
                }
            }
            match rebuild_mentor(self.link, self.plan, self.session.agent(), self.session.tick()) {
                Ok(()) => break,
                Err(error) if !self.barrier && is_lost_mentor(&error) => {
                    tracing::warn!("the mentor-server is lost: {error}");
                    lost = true;
                }
                Err(error) => return Err(error.into()),
            }
        }
        tracing::info!("a new mentor-server has the history");
        Ok(true)
    }

    fn publish_weights(&mut self) -> Result<(), RunError> {
        self.orders.weights_version = self.session.tick();
        Ok(self.link.send_acting(self.session.tick(), self.session.agent().acting())?)
    }

    /// Puts into the orders what each actor may send next: in lockstep one batch, in free mode as many as its window holds.
    fn grant(&mut self) {
        self.orders.round = self.session.tick() + 1 + u64::from(!self.came.is_empty());
        self.orders.env_steps = self.steps_received();
        for (share, seat) in self.orders.shares.iter_mut().zip(&self.seats) {
            let Some(Seat { incarnation, batches, .. }) = *seat else { continue };
            *share = Share {
                counted: batches,
                granted: batches + self.plan.experiment.window(),
                incarnation,
                reserved: 0,
            };
        }
    }

    /// Publishes the newest weights and gives the orders for the next round: an evaluation that is due, snapshots if a
    /// checkpoint is taken, and, unless the run is leaving, the next batches.
    ///
    /// In free mode this also happens where nothing has changed: a new actor waits for it.
    fn dispatch(&mut self, saving: bool, leaving: bool) -> Result<(), RunError> {
        let version = self.session.tick();
        if version != self.orders.weights_version {
            self.publish_weights()?;
        }
        // In free mode one that is awaited keeps the next one waiting.
        if !self.session.awaits_evaluation()
            && let Some((number, episodes)) = self.session.evaluate()
        {
            (self.orders.evaluation, self.orders.episodes) = (number + 1, episodes);
        }
        if saving && self.barrier {
            // With a lag the agent learns on before the checkpoint is written.
            let older = !self.came.is_empty();
            self.behaviour = older.then(|| self.session.agent().acting().clone());
            self.snapshots.fill(None);
            self.orders.snapshot += 1;
        }
        // In free mode orders also acknowledge what has been counted.
        if !leaving || !self.barrier {
            self.grant();
        }
        Ok(self.link.send_orders(&self.orders)?)
    }

    /// Writes the checkpoint; in lockstep once all snapshots and the evaluation that were asked for have come. Batches of
    /// the next tick, which the actors begin as soon as they have answered, may come meanwhile. In free mode the actors
    /// begin a new episode when the run is resumed.
    fn save(&mut self, taken: Taken<'_>) -> Result<(), RunError> {
        if !self.barrier {
            // What has come since the last one need not be a batch, and checkpoints are told apart by their rounds.
            if self.saved == Some(self.session.tick()) {
                self.session.skip_round();
            }
            self.saved = Some(self.session.tick());
            return Ok(self.session.checkpoint(None, &vec![Vec::new(); self.seats.len()], taken)?);
        }
        let snapshots = self.await_snapshots()?;
        self.saved = Some(self.session.tick());
        Ok(self.session.checkpoint(self.behaviour.take(), &snapshots, taken)?)
    }

    /// Those of all actors, once they have come, and the evaluation that was asked for has, too.
    fn await_snapshots(&mut self) -> Result<Vec<Vec<u8>>, RunError> {
        loop {
            let snapshots = self.snapshots.iter().filter(|snapshot| snapshot.is_none()).count();
            match snapshots + usize::from(self.session.awaits_evaluation()) {
                0 => break,
                missing => self.next(missing, WAIT_SLICE)?,
            };
        }
        Ok(self.snapshots.iter_mut().filter_map(Option::take).collect())
    }

    /// Lockstep: the batches of the run's last tick have come. Writes the checkpoint that a longer run goes on from: nothing of the
    /// tick has been learnt, and nothing is asked of the actors that a longer run would not ask of them. Where there is a
    /// checkpoint of this very round, it is as good.
    fn save_before_last(&mut self) -> Result<(), RunError> {
        if self.saved == Some(self.session.tick()) {
            return Ok(());
        }
        self.snapshots.fill(None);
        self.orders.snapshot += 1;
        self.link.send_orders(&self.orders)?;
        let snapshots = self.await_snapshots()?;
        let parts: Vec<Part<'_>> = batches(&self.came).map(Part::of).collect();
        Ok(self.session.checkpoint(None, &snapshots, Taken::BeforeLast(&parts))?)
    }

    /// The run has reached its limits: a last evaluation, a last checkpoint, the result. In free mode the run may be interrupted
    /// meanwhile, and then still owes the evaluation.
    fn finish(mut self) -> Result<RunResult, RunError> {
        if !self.barrier {
            // Before the evaluation, too: whatever happens to the actor that plays it, the training is kept, and a longer run
            // goes on from here.
            self.save(Taken::Amid)?;
        }
        if !self.await_evaluation()? {
            return self.leave(true);
        }
        self.session.request_final_evaluation();
        self.dispatch(true, true)?;
        if !self.await_evaluation()? {
            return self.leave(true);
        }
        self.save(Taken::Last)?;
        self.leave(false)
    }

    /// False: the run is to end first.
    fn await_evaluation(&mut self) -> Result<bool, RunError> {
        while self.session.awaits_evaluation() {
            if !self.barrier && (self.stop)() {
                return Ok(false);
            }
            self.next(1, WAIT_SLICE)?;
            if !self.barrier {
                self.pass_over();
            }
        }
        Ok(true)
    }

    fn leave(mut self, interrupted: bool) -> Result<RunResult, RunError> {
        self.orders.stop = 1;
        self.link.send_orders(&self.orders)?;
        Ok(self.session.finish(interrupted)?)
    }
}

/// The batches of a round, in order.
fn batches(came: &[Came]) -> impl Iterator<Item = &Batch> {
    came.iter().filter_map(|came| match came {
        Came::Batch(batch) => Some(&**batch),
        Came::Joined { .. } => None,
    })
}

/// Whether the mentor-server is gone, or one that has not been let in has taken its place.
fn is_lost_mentor(error: &LinkError) -> bool {
    match error {
        LinkError::Receivers { found, expected, .. } => found < expected,
        LinkError::Refused { reason, .. } => *reason == status_text(NOT_READY),
        _ => false,
    }
}

/// Asks the mentor-server for the mentor's transitions, piece by piece.
fn fetch_transitions(link: &mut dyn LearnerLink, plan: &RunPlan) -> Result<MentorTransitions, RunError> {
    let experiment = &plan.experiment;
    let mut transitions = MentorTransitions::new(experiment.spec.obs_dim());
    let mut words = Vec::new();
    while transitions.len() < experiment.mentor_len() {
        let before = transitions.len();
        let request = QueryRequest {
            run: plan.life.run,
            op: TRANSITIONS,
            first: before as u32,
            count: ((experiment.mentor_len() - before) as u32).min(MAX_QUERY_ROWS),
            obs_dim: experiment.spec.obs_dim() as u32,
        };
        link.query(&request, &[], &mut words)?;
        transitions.decode(&words)?;
        if transitions.len() == before || transitions.len() > experiment.mentor_len() {
            let text =
                format!("{} mentor transitions, {} are expected", transitions.len(), experiment.mentor_len());
            return Err(LinkError::Unexpected(text).into());
        }
    }
    Ok(transitions)
}

#[cfg(test)]
#[path = "run_tests.rs"]
mod tests;
