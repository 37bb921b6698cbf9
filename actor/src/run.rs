//! The loop of an actor's process: carry out the learner's standing orders with the newest weights.
//!
//! The loop is the same in lockstep and in free mode; in lockstep the orders grant one batch at a time. A learner may die
//! and another take its place meanwhile: then the actor announces itself anew.

use crate::error::ActorError;
use crate::worker::Worker;
use std::time::{Duration, Instant};
use trestle_algorithm::reference::Actor;
use trestle_link::{ActorLink, LinkError, Stop, logging, pulse};
use trestle_proto::batch::Batch;
use trestle_proto::codec::{self, CodecError};
use trestle_proto::config::Mode;
use trestle_proto::incarnation::Incarnation;
use trestle_proto::limits::{HANDSHAKE, WAIT_SLICE};
use trestle_proto::orders::Orders;
use trestle_proto::plan::RunPlan;
use trestle_proto::reply::{ACTOR_STATE, EVALUATION, EVALUATION_KIND, JOINED, Reply, ReplyHeader};

/// What ends an actor's process before it is told to leave.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The environment, the network or a snapshot.
    #[error(transparent)]
    Actor(#[from] ActorError),
    /// The other processes.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// An evaluation that cannot be encoded.
    #[error(transparent)]
    Codec(#[from] CodecError),
}

/// Serves the learner of `plan`'s run at the other end of `link` with `worker`, until `stop` says so. It is no error that
/// there is no learner for a while.
///
/// # Errors
/// A message that cannot be right, a transport or an environment that fails, or a learner that gives orders but cannot be
/// reached.
pub fn run(
    link: &mut dyn ActorLink,
    plan: &RunPlan,
    worker: &mut Worker,
    stop: Stop<'_>,
) -> Result<(), RunError> {
    let rollout = plan.experiment.config.run.rollout;
    let mut actor = Serving {
        run: plan.life.run,
        rollout,
        orders: Orders::default(),
        // In free mode the plan may be of a later learner than the one whose supervisor started this process.
        generation: if plan.experiment.config.run.mode == Mode::Free {
            worker.incarnation().generation()
        } else {
            plan.life.generation
        },
        sent: 0,
        played: 0,
        saved: 0,
        batch: Batch::with_capacity(rollout as usize, worker.obs_dim()),
        pending: None,
        unreachable: None,
        link,
        worker,
    };
    actor.announce(stop)?;
    let mut ready = true;
    while !stop() {
        pulse::step();
        actor.send()?;
        let work = actor.work().filter(|_| ready);
        let timeout = if work.is_some() { Duration::ZERO } else { WAIT_SLICE };
        ready = match (actor.link.recv_orders(timeout)?, work) {
            (Some(newest), _) => actor.obey(newest, stop).map(|()| true)?,
            (None, Some(work)) => actor.carry_out(work)?,
            (None, None) => true,
        };
    }
    tracing::info!("told to leave");
    Ok(())
}

/// What orders ask for that needs no waiting.
#[derive(Clone, Copy)]
enum Work {
    Evaluation,
    Snapshot,
    Batch,
}

/// What is to be sent.
enum Message {
    /// The batch that is kept.
    Batch,
    Reply(Reply),
}

struct Serving<'a> {
    link: &'a mut dyn ActorLink,
    worker: &'a mut Worker,
    run: u64,
    rollout: u32,
    /// The newest of this generation.
    orders: Orders,
    /// The start of the learner that this actor has announced itself to.
    generation: u16,
    /// Batches sent.
    sent: u64,
    /// Number of the last evaluation played.
    played: u64,
    /// Number of the last snapshot taken.
    saved: u64,
    batch: Batch,
    /// Goes before all else. It stays where there is no learner to receive it: until there is one, which may not want it.
    pending: Option<Message>,
    /// Since when nobody receives what is pending.
    unreachable: Option<Instant>,
}

impl Serving<'_> {
    /// Goes through the handshake and says which incarnation this is.
    fn announce(&mut self, stop: Stop<'_>) -> Result<(), RunError> {
        match self.link.hello(stop) {
            Err(LinkError::Interrupted(_)) => return Ok(()),
            done => done?,
        }
        self.reply(0, JOINED, Vec::new());
        tracing::info!(incarnation = %self.worker.incarnation(), "ready");
        Ok(())
    }

    /// Takes orders over. Those of an earlier generation may come late; those of a later one are another learner's, who
    /// knows nothing of this actor.
    fn obey(&mut self, orders: Orders, stop: Stop<'_>) -> Result<(), RunError> {
        if orders.generation < self.generation {
            return Ok(());
        }
        logging::set_tick(orders.round);
        if orders.generation > self.generation {
            tracing::info!(generation = orders.generation, "another learner has come");
            self.generation = orders.generation;
            self.worker.begin(Incarnation::new(self.generation, 0))?;
            (self.sent, self.played, self.saved) = (0, 0, 0);
            (self.pending, self.unreachable) = (None, None);
            self.announce(stop)?;
        } else if self.unreachable.is_some_and(|since| since.elapsed() > HANDSHAKE) {
            // The learner lives.
            return Err(LinkError::Receivers { what: "a message", found: 0, expected: 1 }.into());
        }
        if orders.stop == 1 {
            // The learner may still die before its result is written: another one would need this actor.
            tracing::info!("the run is over");
            (self.orders, self.pending) = (Orders::default(), None);
        } else {
            self.orders = orders;
        }
        Ok(())
    }

    /// The next work, if there is any and nothing to send before.
    fn work(&self) -> Option<Work> {
        let (orders, index) = (&self.orders, self.worker.index());
        if self.pending.is_some() {
            None
        } else if index == 0 && orders.evaluation > self.played {
            Some(Work::Evaluation)
        } else if orders.snapshot > self.saved {
            Some(Work::Snapshot)
        } else {
            let granted = orders.granted(index, self.worker.incarnation());
            (self.sent < granted).then_some(Work::Batch)
        }
    }

    /// False: the weights to do it with have not come yet.
    fn carry_out(&mut self, work: Work) -> Result<bool, RunError> {
        if let Work::Snapshot = work {
            let payload = self.worker.snapshot()?;
            self.saved = self.orders.snapshot;
            self.reply(self.saved, ACTOR_STATE, payload);
            return Ok(true);
        }
        let wanted = self.orders.weights_version;
        let Some((version, acting)) = self.link.acting(self.generation, wanted)? else {
            return Ok(false);
        };
        if let Work::Evaluation = work {
            let number = self.orders.evaluation - 1;
            let evaluation = Actor::evaluate(self.worker, acting, number, self.orders.episodes)?;
            self.played = self.orders.evaluation;
            self.reply(self.played, EVALUATION, codec::encode(EVALUATION_KIND, &evaluation)?);
        } else {
            self.worker.collect(acting, &self.orders.collect(version, self.rollout), &mut self.batch)?;
            self.pending = Some(Message::Batch);
        }
        Ok(true)
    }

    fn reply(&mut self, number: u64, kind: u32, payload: Vec<u8>) {
        let (actor, incarnation) = (self.worker.index(), self.worker.incarnation());
        let header = ReplyHeader { run: self.run, number, actor, kind, incarnation, reserved: 0 };
        self.pending = Some(Message::Reply(Reply { header, payload }));
    }

    /// Sends what is pending, if there is somebody to receive it.
    fn send(&mut self) -> Result<(), RunError> {
        let sent = match &self.pending {
            None => return Ok(()),
            Some(Message::Batch) => self.link.send_batch(&self.batch),
            Some(Message::Reply(reply)) => self.link.send_reply(reply),
        };
        match sent {
            // Tried again after the next wait.
            Err(LinkError::Receivers { found: 0, .. }) => {
                self.unreachable.get_or_insert_with(Instant::now);
                return Ok(());
            }
            sent => sent?,
        }
        self.unreachable = None;
        self.sent += u64::from(matches!(self.pending, Some(Message::Batch)));
        self.pending = None;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::worker::Worker;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::thread;
    use trestle_link::{FromActor, LearnerLink, local};
    use trestle_proto::batch::Checked;
    use trestle_proto::incarnation::Incarnation;
    use trestle_proto::plan::Life;

    /// The plan may be written anew, for the next learner, before an actor that was started earlier reads it.
    #[test]
    fn an_actor_of_the_former_learner_announces_itself_anew() {
        let experiment = crate::worker::tests::experiment(&["run.mode=free"]);
        let plan = RunPlan { life: Life { run: 1, generation: 1, ..Life::default() }, experiment };
        let (mut learner, _mentor, mut links) = local::connect(&plan);
        let over = AtomicBool::new(false);
        thread::scope(|scope| {
            let (plan, over) = (&plan, &over);
            let mut link = links.remove(0);
            scope.spawn(move || {
                let mut worker = Worker::replacing(&plan.experiment, 0, Incarnation::new(0, 1)).unwrap();
                run(&mut link, plan, &mut worker, &|| over.load(Ordering::Relaxed)).unwrap();
            });
            let announced = |learner: &mut local::LocalLearner<local::Seat>| match learner
                .recv(&mut Checked::default(), 1, 100 * WAIT_SLICE)
                .unwrap()
                .unwrap()
            {
                FromActor::Reply(reply) => (reply.header.kind, reply.header.incarnation),
                FromActor::Batch => panic!("a batch that was not granted"),
            };
            assert_eq!(announced(&mut learner), (JOINED, Incarnation::new(0, 1)));
            learner.send_orders(&Orders { run: plan.life.run, generation: 1, ..Orders::default() }).unwrap();
            assert_eq!(announced(&mut learner), (JOINED, Incarnation::new(1, 0)));
            over.store(true, Ordering::Relaxed);
        });
    }
}
