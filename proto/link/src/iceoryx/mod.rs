//! The transport over iceoryx2: one run, one root directory, one prefix in `/dev/shm`.
//!
//! - `shared_memory`: the transport as a whole;
//! - `domain`: where a run's files lie, how they are removed;
//! - `sizes`: how large its messages are;
//! - `services`: every service with its limits; the supervisor creates and holds them, the others open them;
//! - `bell`: sleeping until something has come;
//! - `wire`: messages in the form that iceoryx2 accepts;
//! - `actor`, `learner`, `mentor`, `client`: the roles' ends;
//! - [`relay`]: the ends of a process that stands for those on other hosts.

mod actor;
mod bell;
mod client;
mod domain;
mod learner;
mod mentor;
pub mod relay;
mod services;
mod shared_memory;
mod sizes;
mod wire;

pub use actor::IceoryxActor;
pub use client::IceoryxClient;
pub use domain::{Departure, Domain, DomainError, HeldDomain};
pub use learner::IceoryxLearner;
pub use mentor::IceoryxMentor;
pub use shared_memory::{IceoryxHost, SharedMemory};
pub use wire::Wire;

use crate::{LinkError, Stop, pulse};
use bell::{Bells, Consumer, HELLO};
use iceoryx2::port::{BackpressureAction, BackpressureInfo};
use std::fmt::Display;
use std::time::{Duration, Instant};
use trestle_proto::limits::{ASSEMBLY, BACKPRESSURE, HELLO_INTERVAL};

/// The kind of iceoryx2 service in use: between processes, each port on one thread.
type Ipc = iceoryx2::service::ipc::Service;

/// Says hello as `peer` until the learner lets this process in: half an hour at the most, but where processes are replaced for as long as
/// it takes. `let_in` waits for that for up to a given time.
fn announce(
    bells: &Bells,
    replaces: bool,
    peer: usize,
    stop: Stop<'_>,
    mut let_in: impl FnMut(Duration) -> Result<bool, LinkError>,
) -> Result<(), LinkError> {
    let start = Instant::now();
    loop {
        if stop() {
            return Err(LinkError::Interrupted("the learner"));
        }
        // In free mode the learner may be busy for long.
        if !replaces && start.elapsed() > ASSEMBLY {
            let waited_ms = ASSEMBLY.as_millis();
            return Err(LinkError::Deadline { peer: "learner".into(), what: "hello", waited_ms });
        }
        pulse::step();
        bells.call(Consumer::Learner, HELLO + peer)?;
        if let_in(HELLO_INTERVAL)? {
            return Ok(());
        }
    }
}

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
