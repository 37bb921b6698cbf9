//! The loop of an actor's process in free mode: send batches for as long as the learner's orders allow, with the newest
//! weights. A learner may die and another take its place meanwhile: then the actor announces itself anew.

use crate::run::RunError;
use crate::worker::Worker;
use std::time::{Duration, Instant};
use trestle_link::pulse;
use trestle_link::{ActorLink, LinkError, Stop};
use trestle_proto::batch::Batch;
use trestle_proto::codec;
use trestle_proto::limits::{HANDSHAKE, WAIT_SLICE};
use trestle_proto::orders::Orders;
use trestle_proto::reply::{EVALUATION, EVALUATION_KIND, JOINED, Reply, ReplyHeader};
use trestle_proto::tick::{COLLECT, EVALUATE, Tick};

/// Streams batches of `rollout` steps of run `run` to the learner at the other end of `link`, until `stop` says so. That
/// there is no learner for a while is no error.
///
/// # Errors
/// A message that cannot be right, a transport or an environment that fails, or a learner that gives orders but cannot be
/// reached.
pub fn stream(
    link: &mut impl ActorLink,
    worker: &mut Worker,
    run: u64,
    rollout: u32,
    stop: Stop<'_>,
) -> Result<(), RunError> {
    let mut actor = Streaming {
        run,
        rollout,
        orders: Orders::default(),
        generation: worker.incarnation() >> 16,
        sent: 0,
        played: 0,
        batch: Batch::with_capacity(rollout as usize, worker.obs_dim()),
        pending: None,
        unreachable: None,
        link,
        worker,
    };
    actor.announce(stop)?;
    while !stop() {
        pulse::step();
        actor.send()?;
        let timeout = if actor.has_work() { Duration::ZERO } else { WAIT_SLICE };
        if let Some(newest) = actor.link.recv_orders(timeout)? {
            actor.obey(newest, stop)?;
        } else if actor.has_work() {
            actor.work()?;
        }
    }
    tracing::info!("told to leave");
    Ok(())
}

/// What is to be sent.
enum Message {
    /// The batch that is kept.
    Batch,
    Reply(Reply),
}

struct Streaming<'a, L> {
    link: &'a mut L,
    worker: &'a mut Worker,
    run: u64,
    rollout: u32,
    /// The newest of this generation.
    orders: Orders,
    /// The start of the learner that this actor has announced itself to.
    generation: u32,
    /// Batches sent.
    sent: u64,
    /// Number of the last evaluation played.
    played: u64,
    batch: Batch,
    /// Goes before all else. It stays where there is no learner to receive it: until there is one, which may not want it.
    pending: Option<Message>,
    /// Since when nobody receives what is pending.
    unreachable: Option<Instant>,
}

impl<L: ActorLink> Streaming<'_, L> {
    /// Goes through the handshake and says which incarnation this is.
    fn announce(&mut self, stop: Stop<'_>) -> Result<(), RunError> {
        match self.link.hello(stop) {
            Err(LinkError::Interrupted(_)) => return Ok(()),
            done => done?,
        }
        let incarnation = self.worker.incarnation();
        self.reply(incarnation.into(), JOINED, Vec::new());
        tracing::info!(incarnation, "ready");
        Ok(())
    }

    /// Takes orders over. Those of an earlier generation may come late; those of a later one are another learner's, who
    /// knows nothing of this actor.
    fn obey(&mut self, orders: Orders, stop: Stop<'_>) -> Result<(), RunError> {
        if orders.generation < self.generation {
            return Ok(());
        }
        if orders.generation > self.generation {
            tracing::info!(generation = orders.generation, "another learner has come");
            self.generation = orders.generation;
            self.worker.begin(self.generation << 16)?;
            (self.sent, self.played, self.pending, self.unreachable) = (0, 0, None, None);
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

    fn evaluating(&self) -> bool {
        self.worker.index() == 0 && self.orders.evaluation > self.played
    }

    /// Whether there is something to do that needs no waiting.
    fn has_work(&self) -> bool {
        let granted = self.orders.granted(self.worker.index(), self.worker.incarnation());
        self.pending.is_none() && (self.evaluating() || self.sent < granted)
    }

    /// Plays the evaluation, or collects the batch, that the orders want.
    fn work(&mut self) -> Result<(), RunError> {
        let evaluating = self.evaluating();
        let Some((weights_version, acting)) = self.link.newest_weights(self.generation)? else {
            // They are on their way, and new orders with them.
            self.orders = Orders::default();
            return Ok(());
        };
        let run = self.run;
        if evaluating {
            let (evaluation, amount) = (self.orders.evaluation - 1, self.orders.episodes);
            let tick = Tick { run, weights_version, evaluation, kind: EVALUATE, amount, ..Tick::default() };
            let payload = codec::encode(EVALUATION_KIND, &self.worker.evaluate(acting, &tick)?)?;
            self.played = self.orders.evaluation;
            self.reply(weights_version, EVALUATION, payload);
            return Ok(());
        }
        let (env_steps, amount) = (self.orders.env_steps, self.rollout);
        let tick = Tick { run, weights_version, env_steps, kind: COLLECT, amount, ..Tick::default() };
        self.worker.collect(acting, &tick, &mut self.batch)?;
        self.pending = Some(Message::Batch);
        Ok(())
    }

    fn reply(&mut self, tick: u64, kind: u32, payload: Vec<u8>) {
        let header = ReplyHeader { run: self.run, tick, actor: self.worker.index(), kind };
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
