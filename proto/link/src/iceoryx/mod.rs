//! The transport over iceoryx2: one run, one root directory, one prefix in `/dev/shm`.
//!
//! - [`domain`]: where a run's files lie, how they are removed;
//! - [`services`]: every service with its limits; the supervisor creates and holds them, the others open them;
//! - `wake`: sleeping until something has come; `futex`: the word in shared memory to sleep on;
//! - `wire`: messages in the form that iceoryx2 accepts;
//! - [`actor`], [`learner`], [`mentor`], [`query`]: the roles' ends.

pub mod actor;
pub mod domain;
mod futex;
pub mod learner;
pub mod mentor;
pub mod query;
pub mod services;
mod wake;
mod wire;

pub use actor::IceoryxActor;
pub use domain::{Domain, DomainError, HeldDomain, Liveness};
pub use learner::IceoryxLearner;
pub use mentor::IceoryxMentor;
pub use query::QueryClient;
pub use services::Services;
pub use wire::Wire;

use crate::LinkError;
use futex::Ipc;
use iceoryx2::port::{BackpressureAction, BackpressureInfo};
use std::fmt::Display;
use trestle_proto::limits::BACKPRESSURE;

/// Turns an error of iceoryx2 into ours; `what` names the operation.
fn failed<E: Display>(what: &'static str) -> impl Fn(E) -> LinkError {
    move |e| LinkError::Transport { what, message: e.to_string() }
}

/// A sender whose receiver's buffer is full waits, but not for ever.
fn give_up_in_time(info: &BackpressureInfo) -> BackpressureAction {
    if info.elapsed_time < BACKPRESSURE {
        BackpressureAction::Retry
    } else {
        BackpressureAction::DiscardDataAndFail
    }
}
