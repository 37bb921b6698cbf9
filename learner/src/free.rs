//! The loop of the learner's process in free mode: take in what has come from any actor, learn from it, publish weights,
//! grant more. Actors and the mentor-server may be replaced meanwhile.

use crate::record::RunResult;
use crate::run::{RunError, rebuild_mentor, request};
use crate::session::Session;
use std::time::{Duration, Instant};
use trestle_proto::batch::Batch;
use trestle_proto::codec;
use trestle_proto::limits::WAIT_SLICE;
use trestle_proto::observe::{OBSERVE, Observed};
use trestle_proto::orders::{Orders, Share};
use trestle_proto::plan::RunPlan;
use trestle_proto::pulse;
use trestle_proto::query::{NOT_READY, status_text};
use trestle_proto::reply::{EVALUATION, EVALUATION_KIND, Evaluation, JOINED, Reply};
use trestle_proto::transport::{FromActor, LearnerLink, LinkError, Stop};

/// Trains `session` to its end over `link`, whose processes are all ready, or until `stop` says so.
///
/// # Errors
/// What the peers send that cannot be right, a mentor-server that does not come back, training that diverges, or a file
/// that cannot be written.
pub(crate) fn run<L: LearnerLink>(
    link: &mut L,
    plan: &RunPlan,
    session: Session<'_>,
    stop: Stop<'_>,
) -> Result<RunResult, RunError> {
    let rollout = plan.config.run.rollout as usize;
    let actors = plan.config.run.actors as usize;
    Free {
        link,
        plan,
        session,
        batches: vec![Batch::with_capacity(rollout, plan.spec.obs_dim()); actors],
        observed: Observed::default(),
        actors: vec![None; actors],
        orders: Orders { run: plan.run, ..Orders::default() },
        stop,
    }
    .run()
}

/// The present incarnation of an actor.
#[derive(Clone, Copy)]
struct Incarnation {
    number: u32,
    /// Batches that have been counted.
    batches: u64,
    /// The actor's own number of its next transition.
    next_seq: u64,
}

struct Free<'a, L> {
    link: &'a mut L,
    plan: &'a RunPlan,
    session: Session<'a>,
    /// A batch has the place of its actor.
    batches: Vec<Batch>,
    observed: Observed,
    /// None until it has announced itself.
    actors: Vec<Option<Incarnation>>,
    /// As published last.
    orders: Orders,
    stop: Stop<'a>,
}

impl<L: LearnerLink> Free<'_, L> {
    fn run(mut self) -> Result<RunResult, RunError> {
        self.session.start()?;
        self.publish_weights()?;
        while !self.session.done() {
            let before = self.session.agent().counters().env_steps;
            self.receive()?;
            let after = self.session.agent().counters().env_steps;
            if after > before {
                self.session.train(self.session.tick() + 1)?;
                self.publish_weights()?;
            }
            let leaving = (self.stop)();
            if leaving || self.session.checkpoint_due(before, after) {
                self.checkpoint()?;
            }
            if leaving {
                tracing::info!("interrupted: what has come is learnt from and saved");
                return self.leave(true);
            }
            self.order_evaluation();
            self.publish_orders()?;
        }
        self.finish()
    }

    /// Takes in what has come; waits only if there is nothing. No more than all windows hold, so that learning goes on.
    fn receive(&mut self) -> Result<(), RunError> {
        let most = self.plan.window() * self.actors.len() as u64;
        let start = Instant::now();
        let mut timeout = WAIT_SLICE;
        for _ in 0..most {
            let Some(message) = self.link.recv(&mut self.batches, timeout)? else {
                pulse::step();
                break;
            };
            if !timeout.is_zero() {
                self.session.waited(start.elapsed());
            }
            timeout = Duration::ZERO;
            self.take(message)?;
            if self.session.done() {
                break;
            }
        }
        if self.link.mentor_waits() {
            self.revive_mentor()?;
        }
        Ok(())
    }

    fn take(&mut self, message: FromActor) -> Result<(), RunError> {
        match message {
            FromActor::Batch(actor) => self.take_batch(actor),
            FromActor::Reply(reply) => self.take_reply(&reply),
        }
    }

    fn take_reply(&mut self, reply: &Reply) -> Result<(), RunError> {
        let (actor, tick) = (reply.header.actor, reply.header.tick);
        match reply.header.kind {
            JOINED => {
                let number = u32::try_from(tick)
                    .map_err(|_| LinkError::Unexpected(format!("incarnation {tick} of actor {actor}")))?;
                let present = &mut self.actors[actor as usize];
                if present.is_none_or(|present| present.number < number) {
                    *present = Some(Incarnation { number, batches: 0, next_seq: 0 });
                    self.session.joined(actor, number);
                    tracing::info!(actor, incarnation = number, "an actor has come");
                }
                Ok(())
            }
            EVALUATION => {
                let evaluation: Evaluation = codec::decode(EVALUATION_KIND, &reply.payload)?;
                // An actor and the one that replaces it may both have played the same.
                if evaluation.evaluation + 1 == self.orders.evaluation {
                    self.session.evaluated(&evaluation)?;
                    self.orders.evaluation = 0;
                }
                Ok(())
            }
            kind => Err(LinkError::Unexpected(format!("a reply of kind {kind} from actor {actor}")).into()),
        }
    }

    /// Takes `actor`'s batch in, unless it is of an incarnation that has been replaced.
    fn take_batch(&mut self, actor: u32) -> Result<(), RunError> {
        let header = self.batches[actor as usize].header;
        let Some(present) =
            self.actors[actor as usize].filter(|present| present.number == header.incarnation)
        else {
            tracing::info!(actor, incarnation = header.incarnation, "a batch of a replaced actor is dropped");
            return Ok(());
        };
        if self.session.done() {
            return Ok(());
        }
        let (found, expected) = (header.first_seq, present.next_seq);
        if found != expected {
            let text = format!("a batch of actor {actor} from number {found} on; {expected} is the next");
            return Err(LinkError::Unexpected(text).into());
        }
        let has_mentor = self.plan.mentor_len() > 0;
        if has_mentor && !self.observe(actor)? {
            return Ok(());
        }
        let batch = &self.batches[actor as usize];
        let counted = self.session.ingest(batch, has_mentor.then_some(&self.observed))?;
        self.session.count_batch(batch, counted);
        let (batches, next_seq) = (present.batches + 1, present.next_seq + batch.len() as u64);
        self.actors[actor as usize] = Some(Incarnation { batches, next_seq, ..present });
        Ok(())
    }

    /// Asks the mentor-server about `actor`'s batch, another one if it dies meanwhile. False: there is none, and the run is
    /// to end.
    fn observe(&mut self, actor: u32) -> Result<bool, RunError> {
        let batch = &self.batches[actor as usize];
        let (first, count) = (self.session.agent().counters().env_steps, batch.len());
        let request = request(self.plan, self.session.tick(), first, OBSERVE, actor, count);
        loop {
            let start = Instant::now();
            let payload = self.batches[actor as usize].payload();
            let answer = self.link.observe(&request, payload, &mut self.observed);
            self.session.waited(start.elapsed());
            match answer {
                Ok(()) => return Ok(true),
                Err(error) if is_lost_mentor(&error) => {
                    tracing::warn!("the mentor-server is lost: {error}");
                    if !self.revive_mentor()? {
                        return Ok(false);
                    }
                }
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Waits for a new mentor-server and gives it the history. False: the run is to end first.
    fn revive_mentor(&mut self) -> Result<bool, RunError> {
        loop {
            match self.link.rejoin_mentor(self.stop) {
                Err(LinkError::Interrupted(_)) => return Ok(false),
                joined => joined?,
            }
            match rebuild_mentor(self.link, self.plan, &self.session) {
                Ok(()) => break,
                Err(RunError::Link(error)) if is_lost_mentor(&error) => {
                    tracing::warn!("the new mentor-server is lost: {error}");
                }
                Err(error) => return Err(error),
            }
        }
        self.session.mentor_replaced();
        tracing::info!("a new mentor-server has the history");
        Ok(true)
    }

    fn publish_weights(&mut self) -> Result<(), RunError> {
        Ok(self.link.send_weights(self.session.tick(), self.session.agent().acting())?)
    }

    /// Asks for the evaluation that is due, unless another one is still awaited. The weights have been published.
    fn order_evaluation(&mut self) {
        if self.session.awaits_evaluation() {
            return;
        }
        if let Some(tick) = self.session.evaluate() {
            (self.orders.evaluation, self.orders.episodes) = (tick.evaluation + 1, tick.amount);
        }
    }

    /// Publishes what each actor may send, where that has changed.
    fn publish_orders(&mut self) -> Result<(), RunError> {
        let mut orders = self.orders;
        orders.env_steps = self.session.agent().counters().env_steps;
        for (share, actor) in orders.shares.iter_mut().zip(&self.actors) {
            let Some(present) = actor else { continue };
            let (counted, granted) = (present.batches, present.batches + self.plan.window());
            *share = Share { counted, granted, incarnation: present.number, reserved: 0 };
        }
        self.orders = orders;
        Ok(self.link.send_orders(&orders)?)
    }

    fn checkpoint(&mut self) -> Result<(), RunError> {
        // Actors begin a new episode when the run is resumed.
        let none = vec![Vec::new(); self.actors.len()];
        Ok(self.session.checkpoint(None, &none)?)
    }

    /// The run has reached its limits: a last evaluation, a last checkpoint, the result.
    fn finish(mut self) -> Result<RunResult, RunError> {
        // Before the evaluation, too: whatever happens to the actor that plays it, the training is kept.
        self.checkpoint()?;
        self.await_evaluation()?;
        self.session.request_final_evaluation();
        self.order_evaluation();
        self.publish_orders()?;
        self.await_evaluation()?;
        self.checkpoint()?;
        self.leave(false)
    }

    fn await_evaluation(&mut self) -> Result<(), RunError> {
        while self.session.awaits_evaluation() {
            match self.link.recv(&mut self.batches, WAIT_SLICE)? {
                Some(message) => self.take(message)?,
                None => pulse::step(),
            }
        }
        Ok(())
    }

    fn leave(mut self, interrupted: bool) -> Result<RunResult, RunError> {
        self.orders.stop = 1;
        self.link.send_orders(&self.orders)?;
        Ok(self.session.finish(interrupted)?)
    }
}

/// Whether the mentor-server is gone, or one that has not been let in has taken its place.
fn is_lost_mentor(error: &LinkError) -> bool {
    match error {
        LinkError::Receivers { found, expected, .. } => found < expected,
        LinkError::Refused { reason, .. } => *reason == status_text(NOT_READY),
        _ => false,
    }
}
