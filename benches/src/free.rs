//! `free`: what a batch costs where actors stream, and no work is done.

use super::Effort;
use super::clock::median;
use super::exchange::{Exchange, PATIENCE, Setup, SharedMemory};
use super::report::Row;
use super::sleeps::Sleeps;
use anyhow::{Result, ensure};
use std::time::{Duration, Instant};
use trestle_link::{FromActor, LearnerLink};
use trestle_proto::batch::{Batch, Checked};
use trestle_proto::observe::Part;
use trestle_proto::orders::{Orders, Share};

/// Batches of each actor between two looks at the clock.
const BATCHES: usize = 50;
/// Looks: as many as figures need, and for a quick look.
const LOOKS: [usize; 2] = [40, 2];

/// A learner of free mode that learns nothing.
struct Streaming {
    exchange: SharedMemory,
    orders: Orders,
    came: Vec<Checked<Batch>>,
}

impl Streaming {
    fn new(actors: u32, rollout: u32) -> Result<Self> {
        let exchange =
            SharedMemory::with_own_peers(Setup { actors, rollout, burst: 1, mentor: true, free: true })?;
        let plan = &exchange.learner.plan;
        let (run, window) = (plan.life.run, plan.experiment.window());
        let mut orders = Orders { run, ..Orders::default() };
        orders.shares[..actors as usize].fill(Share { granted: window, ..Share::default() });
        let came = vec![Checked::default(); actors as usize];
        let mut streaming = Self { exchange, orders, came };
        streaming.dispatch()?;
        Ok(streaming)
    }

    fn dispatch(&mut self) -> Result<()> {
        let SharedMemory { link, learner, .. } = &mut self.exchange;
        learner.number += 1;
        (self.orders.round, self.orders.weights_version) = (learner.number.into(), learner.number.into());
        link.send_acting(learner.number.into(), &learner.acting)?;
        Ok(link.send_orders(&self.orders)?)
    }

    /// One round: the batches that have come, at least one and at most one for each actor, the mentor-server's answer, weights and
    /// orders. Returns how many batches there were.
    fn round(&mut self) -> Result<usize> {
        let SharedMemory { link, learner, peers } = &mut self.exchange;
        let (mut count, mut timeout) = (0, PATIENCE);
        while count < self.came.len() {
            match link.recv(&mut self.came[count], 1, timeout)? {
                Some(FromActor::Batch) => {
                    let share = &mut self.orders.shares[self.came[count].header.actor as usize];
                    (share.counted, share.granted) = (share.counted + 1, share.granted + 1);
                    (count, timeout) = (count + 1, Duration::ZERO);
                }
                Some(FromActor::Reply(reply)) => {
                    ensure!(reply.payload.is_empty(), "a reply that nobody asked for: {:?}", reply.header);
                }
                None if count > 0 => break,
                None => peers.check()?,
            }
        }
        let came = &self.came[..count];
        let question = learner.question(came);
        let parts: Vec<Part<'_>> = came.iter().map(|batch| Part::of(batch)).collect();
        link.observe(&question, &parts, &mut learner.answers)?;
        self.dispatch()?;
        Ok(count)
    }

    /// Rounds until `batches` batches more have come; how many came, and how many rounds there were.
    fn go(&mut self, batches: usize) -> Result<[usize; 2]> {
        let (mut came, mut rounds) = (0, 0);
        while came < batches {
            came += self.round()?;
            rounds += 1;
        }
        Ok([came, rounds])
    }
}

/// A round of free mode, and what of it falls to each batch.
pub(super) fn run(effort: Effort) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for actors in [1, 2, 4, 8, 16] {
        let mut streaming = Streaming::new(actors, 32)?;
        let batches = BATCHES * actors as usize;
        streaming.go(batches)?;
        let sleeps = Sleeps::of(&streaming.exchange.peers())?;
        let (mut us, mut total) = (Vec::new(), [0, 0]);
        for _ in 0..effort.pick(LOOKS[0], LOOKS[1]) {
            let start = Instant::now();
            let [came, rounds] = streaming.go(batches)?;
            us.push(start.elapsed().as_secs_f64() * 1e6 / came as f64);
            total = [total[0] + came, total[1] + rounds];
        }
        let [came, rounds] = total.map(|count| count as f64);
        rows.push(
            Row::new()
                .with("actors", actors)
                .with("rollout", 32)
                .measured("us_a_batch", median(us))
                .measured("batches_a_round", came / rounds)
                .measured("sleeps_a_batch", sleeps.since()? / came),
        );
    }
    Ok(rows)
}
