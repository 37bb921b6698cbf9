//! The loop of an actor's process: wait for a tick, do what it says, answer.

use crate::worker::{ActorError, Worker};
use trestle_link::{ActorLink, LinkError, Stop};
use trestle_link::{logging, pulse};
use trestle_proto::batch::Batch;
use trestle_proto::codec::{self, CodecError};
use trestle_proto::limits::WAIT_SLICE;
use trestle_proto::reply::{ACTOR_STATE, EVALUATION, EVALUATION_KIND, Reply, ReplyHeader};
use trestle_proto::tick::{COLLECT, EVALUATE, SNAPSHOT, STOP, Tick};

/// What ends an actor's process before the learner says so.
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

/// Why an actor left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Left {
    /// The learner sent [`STOP`]: the run is over.
    Stopped,
    /// `stop` said so, in the middle of the run.
    Told,
}

/// Serves the learner at the other end of `link` with `worker`, until it sends [`STOP`] or `stop` says so.
///
/// # Errors
/// A message that cannot be right, a peer that is gone, or an environment that fails.
pub fn run(
    link: &mut impl ActorLink,
    worker: &mut Worker,
    rollout: usize,
    stop: Stop<'_>,
) -> Result<Left, RunError> {
    link.hello(stop)?;
    tracing::info!("ready");
    let mut batch = Batch::with_capacity(rollout, worker.obs_dim());
    while !stop() {
        pulse::step();
        let Some(tick) = link.recv_tick(WAIT_SLICE)? else { continue };
        logging::set_tick(tick.tick);
        match tick.kind {
            COLLECT => {
                worker.collect(link.weights(tick.weights_version)?, &tick, &mut batch)?;
                link.send_batch(&batch)?;
            }
            EVALUATE if worker.index() == 0 => {
                let evaluation = worker.evaluate(link.weights(tick.weights_version)?, &tick)?;
                let payload = codec::encode(EVALUATION_KIND, &evaluation)?;
                link.send_reply(&Reply { header: header(worker, &tick, EVALUATION), payload })?;
            }
            SNAPSHOT => {
                let payload = worker.snapshot()?;
                link.send_reply(&Reply { header: header(worker, &tick, ACTOR_STATE), payload })?;
            }
            STOP => {
                tracing::info!("the run is over");
                return Ok(Left::Stopped);
            }
            _ => {}
        }
    }
    tracing::info!("told to leave");
    Ok(Left::Told)
}

fn header(worker: &Worker, tick: &Tick, kind: u32) -> ReplyHeader {
    ReplyHeader { run: tick.run, tick: tick.tick, actor: worker.index(), kind }
}
