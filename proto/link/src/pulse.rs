//! Whether this process gets ahead in its work, for the supervisor.
//!
//! Code that works calls [`step`] whenever it has finished a piece: an environment step, a gradient step, a request, or a
//! wait that found nothing. Another thread looks at the count and tells the supervisor once a [`BEAT`](trestle_proto::limits::BEAT),
//! by a byte on its line: [`BUSY`] or [`IDLE`].

use std::sync::atomic::{AtomicU64, Ordering};

static STEPS: AtomicU64 = AtomicU64::new(0);

/// Sign of life of a process that has got ahead since the last one.
pub const BUSY: u8 = b'+';
/// Sign of life of a process that has not.
pub const IDLE: u8 = b'.';
/// Besides: somebody has asked the process to leave, which is for the supervisor to decide.
pub const ASKED: u8 = b'!';
/// In the other direction: the supervisor's order to finish the work at hand and leave.
pub const LEAVE: u8 = b'x';
/// The supervisor's news for a process that it has started first: the run's services are there.
pub const GO: u8 = b'g';

/// A piece of work is finished.
#[inline]
pub fn step() {
    STEPS.fetch_add(1, Ordering::Relaxed);
}

/// Pieces of work finished so far.
pub fn steps() -> u64 {
    STEPS.load(Ordering::Relaxed)
}
