//! Sleeping until something has come.
//!
//! Every consumer looks for data first and sleeps only when there is none. The listener keeps a notification that comes
//! in between, so none is lost. Each wake-up takes all notifications.

use super::{Ipc, failed};
use crate::LinkError;
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::prelude::EventId;
use iceoryx2::service::port_factory::event::PortFactory;
use iceoryx2_cal::event::ListenerWaitError;
use iceoryx2_cal::event::event_state::EventActivation;
use std::time::{Duration, Instant};
use trestle_proto::limits::WAIT_SLICE;

/// Something to receive.
pub(super) const DATA: usize = 0;
/// The learner, or the mentor-server, has mapped the memory of peer `i`: `WELCOME + i`.
pub(super) const WELCOME: usize = 1;
/// Peer `i` has created its ports: `HELLO + i`.
pub(super) const HELLO: usize = 66;
/// Peer `i` has mapped the learner's memory: `READY + i`.
pub(super) const READY: usize = 131;
/// A learner asks the mentor-server to announce itself. Its id is above every welcome's: a mentor-server that takes both at
/// once has been let in since.
pub(super) const ROLL_CALL: usize = 196;
/// A notifier came.
pub(super) const CREATED: usize = 252;
/// A notifier went.
pub(super) const DROPPED: usize = 253;
/// A process died.
pub(super) const DEAD: usize = 254;
/// Largest event id in use.
pub(super) const LAST: usize = 254;

/// Sleeps until notified or until `timeout` is over; calls `on_event` for every kind of event that has come. It may also
/// wake up for nothing.
///
/// A notification whose wake-up is lost is found when the time is over. iceoryx2 does not wake up a listener that another
/// notifier has marked as notified (`iceoryx2-cal` 0.10, `event/common.rs`). A notifier that is killed or stopped in the midst
/// of this can leave that mark on a sleeping listener. So no process should sleep for longer than [`WAIT_SLICE`] at a time.
pub(super) fn sleep(
    listener: &Listener<Ipc>,
    timeout: Duration,
    mut on_event: impl FnMut(usize),
) -> Result<(), LinkError> {
    let on_event = |event: EventActivation| on_event(event.id.as_value());
    let slept =
        if timeout.is_zero() { listener.try_wait(on_event) } else { listener.timed_wait(on_event, timeout) };
    match slept {
        // A signal for this process: its handler has set a flag that the caller looks at.
        Ok(_) | Err(ListenerWaitError::InterruptSignal) => Ok(()),
        Err(e) => Err(failed("waiting for an event")(e)),
    }
}

/// Polls until `poll` gives something or `timeout` is over, asleep in between. A wake-up need not mean data: the
/// event may be of a message that was received before.
pub(super) fn wait<T>(
    listener: &Listener<Ipc>,
    timeout: Duration,
    mut poll: impl FnMut() -> Result<Option<T>, LinkError>,
) -> Result<Option<T>, LinkError> {
    let start = Instant::now();
    loop {
        if let Some(found) = poll()? {
            return Ok(Some(found));
        }
        let left = timeout.saturating_sub(start.elapsed());
        if left.is_zero() {
            return Ok(None);
        }
        sleep(listener, left.min(WAIT_SLICE), |_| {})?;
    }
}

/// Tells all listeners of the service.
pub(super) fn notify(notifier: &Notifier<Ipc>, event: usize) -> Result<(), LinkError> {
    notifier.notify_with_custom_event_id(EventId::new(event)).map(|_| ()).map_err(failed("notifying a peer"))
}

pub(super) fn listener(service: &PortFactory<Ipc>) -> Result<Listener<Ipc>, LinkError> {
    service.listener_builder().create().map_err(failed("creating a listener"))
}

pub(super) fn notifier(service: &PortFactory<Ipc>) -> Result<Notifier<Ipc>, LinkError> {
    service.notifier_builder().create().map_err(failed("creating a notifier"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::iceoryx::Domain;
    use iceoryx2::node::Node;
    use iceoryx2::prelude::ServiceName;
    use std::sync::Barrier;
    use std::thread;

    const ROUNDS: u32 = 100;

    /// Two threads, each with its memory mapped at an address of its own, as in two processes.
    #[test]
    fn notifications_wake_up_whoever_sleeps_elsewhere() {
        let domain = Domain::create(u64::from(std::process::id()) << 32 | 3).unwrap();
        let service = |node: &Node<Ipc>, name: &str| {
            node.service_builder(&ServiceName::new(name).unwrap()).event().open_or_create().unwrap()
        };
        let barrier = Barrier::new(2);
        // Sends first or answers, and returns how long the sleeps took.
        let play = |mine: &str, theirs: &str, first: bool| {
            let node = domain.node().unwrap();
            let listener = listener(&service(&node, mine)).unwrap();
            barrier.wait();
            let notifier = notifier(&service(&node, theirs)).unwrap();
            barrier.wait();
            let start = Instant::now();
            for _ in 0..ROUNDS {
                if first {
                    notify(&notifier, DATA).unwrap();
                }
                let mut come = false;
                while !come {
                    sleep(&listener, WAIT_SLICE, |event| come |= event == DATA).unwrap();
                }
                if !first {
                    notify(&notifier, DATA).unwrap();
                }
            }
            let took = start.elapsed();
            barrier.wait();
            took
        };
        let took = thread::scope(|scope| {
            scope.spawn(|| play("there", "back", false));
            play("back", "there", true)
        });
        domain.remove().unwrap();
        assert!(took < ROUNDS / 2 * WAIT_SLICE, "{took:?}: nobody was woken up");
    }
}
