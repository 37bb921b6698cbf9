//! One run over several hosts. Shared memory stays inside a host; between hosts messages go over a [wire], which may lose,
//! repeat and reorder them.
//!
//! Each host has one more process, the *relay*. To the learner, the relay of the run's own host (the *head*) looks like a set of
//! actors. To its own actors, the relay of a joined host looks like the learner. So none of these knows of other hosts.
//!
//! - [`frame`]: what travels, byte by byte;
//! - [`account`]: sequence numbers, acknowledgements, resending, what may be under way; a state machine without clock or network;
//! - [`stream`]: messages of any size over an account, in both directions;
//! - [`message`]: the messages that are counted;
//! - [`head`] and [`joined`]: the relays of the two kinds of host;
//! - `silence`: when people are told that a host is silent;
//! - [`wire`]: what carries frames, and the program that does it between hosts; `words`: what that program says.

pub mod account;
pub mod frame;
pub mod head;
pub mod joined;
pub mod limits;
pub mod message;
mod silence;
pub mod stream;
pub mod wire;
mod words;

use trestle_link::LinkError;
use trestle_proto::codec::CodecError;

/// What ends a relay before it is told to leave.
#[derive(Debug, thiserror::Error)]
pub enum RelayError {
    /// The processes of this host.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// What carries frames.
    #[error(transparent)]
    Wire(#[from] wire::WireError),
    /// A message that cannot be encoded.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// A host that the run cannot go on without is gone, or the head is.
    #[error("{0}")]
    Lost(String),
    /// The head does not let this host join.
    #[error("{0}")]
    Refused(String),
}
