//! How messages travel between the processes of a run: one narrow interface for each role, and [`Transport`], which makes a
//! run, holds it, hands out the ends of the roles, and cleans up. Nothing outside this crate knows iceoryx2.
//!
//! - [`iceoryx`]: shared memory between processes;
//! - [`local`]: queues between threads of one process, for tests of the roles' loops;
//! - [`pulse`] and [`logging`]: what a process says of itself, to its supervisor and in its log.
//!
//! A call that waits returns when something came, when its time is over, or with an error; it never spins.

pub mod iceoryx;
pub mod local;
pub mod log_file;
pub mod logging;
pub mod pulse;
mod transport;

pub use transport::{Footprint, Host, Liveness, Remains, Transport};

use std::time::Duration;
use trestle_proto::acting::{Acting, ActingError};
use trestle_proto::annotation::AnnotationError;
use trestle_proto::batch::{Batch, BatchError, Checked};
use trestle_proto::mentor::MentorTransitionsError;
use trestle_proto::observe::{Answers, ObserveAnswer, ObserveError, ObserveRequest, Part};
use trestle_proto::orders::{Orders, OrdersError};
use trestle_proto::query::{QueryAnswer, QueryRequest};
use trestle_proto::reply::Reply;
use trestle_proto::round::Round;

/// A message that could not be sent, received or believed.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The transport itself failed.
    #[error("{what}: {message}")]
    Transport {
        /// What was being done.
        what: &'static str,
        /// What the transport says.
        message: String,
    },
    /// A message had no receiver.
    #[error("{what} reached {found} receivers; {expected} are expected")]
    Receivers {
        /// What was sent.
        what: &'static str,
        /// How many received it.
        found: usize,
        /// How many should have.
        expected: usize,
    },
    /// The other side did not answer in time.
    #[error("no answer from {peer} within {waited_ms} ms: {what}")]
    Deadline {
        /// Who was asked.
        peer: String,
        /// What was asked.
        what: &'static str,
        /// For how long.
        waited_ms: u128,
    },
    /// The mentor-server refused a request.
    #[error("the mentor-server refuses {what}: {reason}")]
    Refused {
        /// What was asked.
        what: &'static str,
        /// Its reason.
        reason: &'static str,
    },
    /// A message from an actor that this run does not have, or for a tick that is not due.
    #[error("unexpected message: {0}")]
    Unexpected(String),
    /// Asked to leave while waiting.
    #[error("interrupted while waiting for {0}")]
    Interrupted(&'static str),
    /// See [`BatchError`].
    #[error(transparent)]
    Batch(#[from] BatchError),
    /// See [`OrdersError`].
    #[error(transparent)]
    Orders(#[from] OrdersError),
    /// See [`ActingError`].
    #[error(transparent)]
    Acting(#[from] ActingError),
    /// See [`ObserveError`].
    #[error(transparent)]
    Observe(#[from] ObserveError),
    /// See [`AnnotationError`].
    #[error(transparent)]
    Annotation(#[from] AnnotationError),
    /// See [`MentorTransitionsError`].
    #[error(transparent)]
    MentorTransitions(#[from] MentorTransitionsError),
}

impl LinkError {
    /// Whether it says that another process is gone, or no longer answers: then that one is to blame.
    pub fn is_lost_peer(&self) -> bool {
        match self {
            Self::Receivers { found, expected, .. } => found < expected,
            Self::Deadline { .. } => true,
            _ => false,
        }
    }
}

/// Tells a waiting process to leave.
pub type Stop<'a> = &'a dyn Fn() -> bool;

/// An actor's side.
pub trait ActorLink {
    /// Announces this actor until the learner has answered; nothing is sent before. Once more after a learner has been
    /// replaced.
    fn hello(&mut self, stop: Stop<'_>) -> Result<(), LinkError>;
    /// The newest orders, if others than those before come within `timeout`.
    fn recv_orders(&mut self, timeout: Duration) -> Result<Option<Orders>, LinkError>;
    /// What has been published last to act with, checked, and its version; none if nothing of the learner's start
    /// `generation`, of version `at_least` or later, has come yet.
    fn acting(&mut self, generation: u16, at_least: Round) -> Result<Option<(Round, &Acting)>, LinkError>;
    /// Sends one batch.
    fn send_batch(&mut self, batch: &Batch) -> Result<(), LinkError>;
    /// Sends an evaluation or a snapshot.
    fn send_reply(&mut self, reply: &Reply) -> Result<(), LinkError>;
}

/// What came from an actor.
#[derive(Clone, Debug, PartialEq)]
pub enum FromActor {
    /// A batch, now in the place that was made for it.
    Batch,
    /// An evaluation, a snapshot, or the news that it has come.
    Reply(Reply),
}

/// The learner's side. In lockstep every message to the actors must reach all of them. In free mode it may miss those that
/// have just died: the next ones get the newest weights and orders when they come.
pub trait LearnerLink {
    /// Waits until every actor, and the mentor-server if the run has one, has announced itself; in free mode for the
    /// mentor-server alone, for as long as it takes: actors may come at any time.
    fn welcome(&mut self, stop: Stop<'_>) -> Result<(), LinkError>;
    /// Publishes what actors are to act with; they see the newest only.
    fn send_acting(&mut self, version: Round, acting: &Acting) -> Result<(), LinkError>;
    /// Gives orders to the actors, who see the newest only.
    fn send_orders(&mut self, orders: &Orders) -> Result<(), LinkError>;
    /// Whether a new mentor-server waits to be let in; never in lockstep.
    fn mentor_waits(&self) -> bool;
    /// Waits, for as long as it takes, until a new mentor-server has announced itself; it knows nothing of the history. Until
    /// then requests for its history fail.
    fn rejoin_mentor(&mut self, stop: Stop<'_>) -> Result<(), LinkError>;
    /// The next message of any actor, if one comes within `timeout`. A batch is copied into `batch` and checked; its
    /// actor is one of the run's. `wanted` is how many messages the caller cannot go on without, 1 or more: where there is none yet,
    /// this process may sleep until so many have come.
    fn recv(
        &mut self,
        batch: &mut Checked<Batch>,
        wanted: u32,
        timeout: Duration,
    ) -> Result<Option<FromActor>, LinkError>;
    /// Hands the parts of one round to the mentor-server's history and waits for its answer to each.
    fn observe(
        &mut self,
        request: &ObserveRequest,
        parts: &[Part<'_>],
        into: &mut Answers,
    ) -> Result<(), LinkError>;
    /// Tells the mentor-server what it is to know without an answer to it: history
    /// ([`trestle_proto::observe::REBUILD`]) or annotations ([`trestle_proto::observe::RESTORE`]). Waits until it has
    /// taken it.
    fn teach(&mut self, request: &ObserveRequest, payload: &[u32]) -> Result<(), LinkError>;
    /// Asks the mentor-server a question; the answer's payload replaces `into`.
    fn query(
        &mut self,
        request: &QueryRequest,
        payload: &[f32],
        into: &mut Vec<u32>,
    ) -> Result<QueryAnswer, LinkError>;
}

/// What answers the mentor-server's requests.
pub trait MentorHandler {
    /// Another learner has taken the former one's place: what it had been told does not count any more.
    fn forget(&mut self);
    /// Carries `request` out; appends the answer's payload to `out`, which is empty.
    fn observe(&mut self, request: &ObserveRequest, payload: &[u32], out: &mut Vec<u32>) -> ObserveAnswer;
    /// Answers `request`; appends the answer's payload to `out`, which is empty.
    fn query(&mut self, request: &QueryRequest, payload: &[f32], out: &mut Vec<u32>) -> QueryAnswer;
}

/// The mentor-server's side.
pub trait MentorLink {
    /// Announces itself until the learner has answered, answering requests meanwhile.
    fn hello(&mut self, handler: &mut dyn MentorHandler, stop: Stop<'_>) -> Result<(), LinkError>;
    /// Answers what has come, or the first that comes within `timeout`; returns how many were answered. In free mode
    /// another learner may call meanwhile: then `handler` forgets, and is let in anew.
    fn serve(&mut self, handler: &mut dyn MentorHandler, timeout: Duration) -> Result<usize, LinkError>;
}

/// The side of a process that only asks the mentor-server.
pub trait ClientLink {
    /// Asks `request` (its `run` is filled in) and waits up to `deadline`; the answer's payload replaces `into`.
    fn ask(
        &self,
        request: &QueryRequest,
        payload: &[f32],
        into: &mut Vec<u32>,
        deadline: Duration,
    ) -> Result<QueryAnswer, LinkError>;
}
