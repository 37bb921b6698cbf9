//! The loop of an actor's process in free mode: send batches for as long as the learner's orders allow, with the newest
//! weights.

use crate::run::{Left, RunError};
use crate::worker::Worker;
use std::time::Duration;
use trestle_proto::batch::Batch;
use trestle_proto::codec;
use trestle_proto::limits::WAIT_SLICE;
use trestle_proto::orders::Orders;
use trestle_proto::pulse;
use trestle_proto::reply::{EVALUATION, EVALUATION_KIND, JOINED, Reply, ReplyHeader};
use trestle_proto::tick::{COLLECT, EVALUATE, Tick};
use trestle_proto::transport::{ActorLink, Stop};

/// Streams batches of `rollout` steps of run `run` to the learner at the other end of `link`, until its orders or `stop`
/// say that the run is over.
///
/// # Errors
/// A message that cannot be right, a learner that is gone, or an environment that fails.
pub fn stream(
    link: &mut impl ActorLink,
    worker: &mut Worker,
    run: u64,
    rollout: u32,
    stop: Stop<'_>,
) -> Result<Left, RunError> {
    link.hello(stop)?;
    let (actor, incarnation) = (worker.index(), worker.incarnation());
    let header = |tick, kind| ReplyHeader { run, tick, actor, kind };
    link.send_reply(&Reply { header: header(incarnation.into(), JOINED), payload: Vec::new() })?;
    tracing::info!(incarnation, "ready");
    let mut batch = Batch::with_capacity(rollout as usize, worker.obs_dim());
    let mut orders = Orders::default();
    // Batches sent, and the number of the last evaluation played.
    let (mut sent, mut played) = (0, 0);
    while !stop() {
        pulse::step();
        let evaluating = actor == 0 && orders.evaluation > played;
        let collecting = sent < orders.granted(actor, incarnation);
        let timeout = if evaluating || collecting { Duration::ZERO } else { WAIT_SLICE };
        if let Some(newest) = link.recv_orders(timeout)? {
            orders = newest;
            if orders.stop == 1 {
                tracing::info!("the run is over");
                return Ok(Left::Stopped);
            }
            continue;
        }
        if !evaluating && !collecting {
            continue;
        }
        let Some((weights_version, acting)) = link.newest_weights()? else {
            // They are on their way, and new orders with them.
            orders = Orders::default();
            continue;
        };
        if evaluating {
            let (evaluation, amount) = (orders.evaluation - 1, orders.episodes);
            let tick = Tick { run, weights_version, evaluation, kind: EVALUATE, amount, ..Tick::default() };
            let payload = codec::encode(EVALUATION_KIND, &worker.evaluate(acting, &tick)?)?;
            link.send_reply(&Reply { header: header(weights_version, EVALUATION), payload })?;
            played = orders.evaluation;
        } else {
            let env_steps = orders.env_steps;
            let tick =
                Tick { run, weights_version, env_steps, kind: COLLECT, amount: rollout, ..Tick::default() };
            worker.collect(acting, &tick, &mut batch)?;
            link.send_batch(&batch)?;
            sent += 1;
        }
    }
    tracing::info!("told to leave");
    Ok(Left::Told)
}
