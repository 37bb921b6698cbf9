//! How a sleeping process is woken up: by a bell in a small piece of shared memory, one for each kind of consumer.
//!
//! iceoryx2's own events cost a system call for each listener and wake a listener for each event. A bell wakes all actors by
//! one system call, and the learner only when the last of the messages has come that it cannot go on without. So a tick has
//! one wake-up each way and process, however many actors there are.
//!
//! A consumer *listens*, looks for data, and only then sleeps. It does not fall asleep if the bell has been rung since it
//! listened, so no ring is lost. Beside the rings a bell holds *calls*: numbers that stay until the consumer takes them.
#![allow(unsafe_code)]

use super::{Domain, failed};
use crate::LinkError;
use iceoryx2::prelude::{FileName, SemanticString, ZeroCopySend};
use iceoryx2_bb_posix::access_mode::AccessMode;
use iceoryx2_cal::dynamic_storage::posix_shared_memory::{Builder, Configuration, Storage};
use iceoryx2_cal::dynamic_storage::{DynamicStorage, DynamicStorageBuilder};
use iceoryx2_cal::named_concept::{NamedConceptBuilder, NamedConceptConfiguration};
use nix::sys::time::TimeSpec;
use nix::time::{ClockId, clock_gettime};
use rustix::io::Errno;
use rustix::thread::futex::{self, Flags, Timespec};
use std::cell::Cell;
use std::num::NonZeroU32;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::SeqCst};
use std::time::{Duration, Instant};
use trestle_proto::limits::{MAX_ACTORS, WAIT_SLICE};

/// Peers that say hello: the actors, and the mentor-server.
const PEERS: usize = MAX_ACTORS as usize + 1;
/// The call by which the learner lets peer `i` in: `WELCOME + i`.
pub(super) const WELCOME: usize = 0;
/// The call of peer `i`, which has created its ports: `HELLO + i`.
pub(super) const HELLO: usize = WELCOME + PEERS;
/// The call of peer `i`, which has mapped the learner's memory: `READY + i`.
pub(super) const READY: usize = HELLO + PEERS;
/// The call of a learner that asks the mentor-server to announce itself. It is above every welcome: a mentor-server that takes both
/// at once has been let in since.
pub(super) const ROLL_CALL: usize = READY + PEERS;
/// Numbers of calls, and as many bits.
const CALLS: usize = 256;

/// Every sleeper of a bell.
const ALL: NonZeroU32 = NonZeroU32::MAX;

/// Whose bell it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Consumer {
    Learner,
    Mentor,
    /// All actors together.
    Actors,
    /// All clients of `mentor/query` but the learner.
    Clients,
}

/// A bell as it lies in shared memory. Whatever a peer writes there, it costs wake-ups and no more.
#[repr(C, align(64))]
#[derive(Debug, Default)]
pub(super) struct Bell {
    /// How many times it has been rung. Consumers sleep on it.
    rung: AtomicU32,
    /// Processes that sleep, or were killed in their sleep.
    asleep: AtomicU32,
    /// The count of rings at which the one consumer of the bell wants to be woken.
    due: AtomicU32,
    /// Calls that have not been taken, one bit each.
    calls: [AtomicU64; CALLS / 64],
}

// SAFETY: plain numbers without pointers or a destructor, valid with any bits and mapped at any address.
unsafe impl ZeroCopySend for Bell {}

impl Bell {
    /// One message more for the bell's one consumer.
    fn ring(&self) -> Result<(), Errno> {
        let rung = self.rung.fetch_add(1, SeqCst).wrapping_add(1);
        let early = rung.wrapping_sub(self.due.load(SeqCst)).cast_signed() < 0;
        if early { Ok(()) } else { self.wake(ALL) }
    }

    /// Something to look at for the consumers `whom`.
    fn ring_for(&self, whom: NonZeroU32) -> Result<(), Errno> {
        self.rung.fetch_add(1, SeqCst);
        self.wake(whom)
    }

    fn call(&self, number: usize) -> Result<(), Errno> {
        self.calls[number / 64].fetch_or(1 << (number % 64), SeqCst);
        self.ring_for(ALL)
    }

    fn wake(&self, whom: NonZeroU32) -> Result<(), Errno> {
        if self.asleep.load(SeqCst) > 0 {
            futex::wake_bitset(&self.rung, Flags::empty(), i32::MAX as u32, whom)?;
        }
        Ok(())
    }

    fn is_called(&self) -> bool {
        self.calls.iter().any(|word| word.load(SeqCst) != 0)
    }

    /// Sleeps until the bell has been rung `wanted` times since it said `heard`, or somebody calls, or `timeout` is over; or for no
    /// reason at all. Only its one consumer may want more than one ring.
    fn sleep(&self, heard: u32, wanted: u32, whom: NonZeroU32, timeout: Duration) -> Result<(), Errno> {
        let until = deadline(timeout)?;
        if whom == ALL {
            self.due.store(heard.wrapping_add(wanted), SeqCst);
        }
        // Before the last look at the count: a ring after that look finds this process asleep, or the kernel finds the ring.
        self.asleep.fetch_add(1, SeqCst);
        let slept = loop {
            let rung = self.rung.load(SeqCst);
            if rung.wrapping_sub(heard) >= wanted || (wanted > 1 && self.is_called()) {
                break Ok(());
            }
            match futex::wait_bitset(&self.rung, Flags::empty(), rung, Some(&until), whom) {
                // A ring in between, which need not be the last that is wanted.
                Err(Errno::AGAIN) => {}
                // A signal for this process: its handler has set a flag that the caller looks at.
                Ok(()) | Err(Errno::TIMEDOUT | Errno::INTR) => break Ok(()),
                Err(error) => break Err(error),
            }
        };
        self.asleep.fetch_sub(1, SeqCst);
        slept
    }
}

/// The time in `timeout` from now, a day at the most, in which the machine's sleep does not count.
fn deadline(timeout: Duration) -> Result<Timespec, Errno> {
    let now = clock_gettime(ClockId::CLOCK_MONOTONIC).map_err(|_| Errno::INVAL)?;
    let until = now + TimeSpec::from_duration(timeout.min(Duration::from_secs(86_400)));
    Ok(Timespec { tv_sec: until.tv_sec(), tv_nsec: until.tv_nsec() })
}

/// The bells of a run, mapped.
#[derive(Clone, Debug)]
pub(super) struct Bells(Arc<Storage<[Bell; 4]>>);

impl Bells {
    /// Makes them, or opens those that there are.
    pub(super) fn new(domain: &Domain, create: bool) -> Result<Self, LinkError> {
        let name = |name: &str| FileName::new(name.as_bytes()).map_err(failed("naming the bells"));
        let config = Configuration::default().prefix(&name(&domain.prefix())?);
        let builder = Builder::new(&name("bells")?).config(&config);
        let storage = if create {
            let zero = |place: &mut std::mem::MaybeUninit<[Bell; 4]>, _: &mut _| {
                place.write(Default::default());
                true
            };
            builder.initializer(zero).create().map_err(failed("creating the bells"))?
        } else {
            builder.has_ownership(false).open(AccessMode::ReadWrite).map_err(failed("opening the bells"))?
        };
        Ok(Self(Arc::new(storage)))
    }

    fn of(&self, consumer: Consumer) -> &Bell {
        &self.0.get()[consumer as usize]
    }

    /// One message more for the one process that `consumer` is.
    pub(super) fn ring(&self, consumer: Consumer) -> Result<(), LinkError> {
        self.of(consumer).ring().map_err(failed("waking a peer up"))
    }

    /// News for the clients.
    pub(super) fn ring_clients(&self) -> Result<(), LinkError> {
        self.of(Consumer::Clients).ring_for(ALL).map_err(failed("waking clients up"))
    }

    /// News for the actors in `whom` ([`bit`]).
    pub(super) fn ring_actors(&self, whom: u32) -> Result<(), LinkError> {
        let Some(whom) = NonZeroU32::new(whom) else { return Ok(()) };
        self.of(Consumer::Actors).ring_for(whom).map_err(failed("waking actors up"))
    }

    /// Calls `number` out to `consumer`.
    pub(super) fn call(&self, consumer: Consumer, number: usize) -> Result<(), LinkError> {
        self.of(consumer).call(number).map_err(failed("calling a peer"))
    }

    /// Makes everybody look up: a process has gone.
    pub(super) fn ring_everybody(&self) -> Result<(), LinkError> {
        self.0.get().iter().try_for_each(|bell| bell.ring_for(ALL)).map_err(failed("waking the run up"))
    }

    /// The ear of a process that alone is `consumer`, or of a client.
    pub(super) fn ear(&self, consumer: Consumer) -> Ear {
        Ear { bells: self.clone(), consumer, whom: ALL, heard: Cell::new(0) }
    }

    /// The ear of the actors in `whom` ([`bit`]).
    pub(super) fn ear_of_actors(&self, whom: u32) -> Ear {
        Ear { whom: NonZeroU32::new(whom).unwrap_or(ALL), ..self.ear(Consumer::Actors) }
    }
}

/// The bit of actor `index` among those that a ring wakes up. Actors that share one wake up together.
pub(super) fn bit(index: usize) -> u32 {
    1 << (index as u32 % u32::BITS)
}

/// A consumer's ear for its bell.
#[derive(Debug)]
pub(super) struct Ear {
    bells: Bells,
    consumer: Consumer,
    whom: NonZeroU32,
    /// How many times it had been rung when this process last listened.
    heard: Cell<u32>,
}

impl Ear {
    fn bell(&self) -> &Bell {
        self.bells.of(self.consumer)
    }

    /// From now on every ring counts. To be followed by a look at the data.
    pub(super) fn listen(&self) {
        self.heard.set(self.bell().rung.load(SeqCst));
    }

    /// Sleeps until the bell has been rung `wanted` times since this process listened, or somebody calls, or `timeout` is over; or for
    /// no reason at all. `wanted` is 1 for actors and clients, who share a bell.
    ///
    /// A process that is killed between a message and its ring leaves the others asleep. So no process should sleep for longer than
    /// [`WAIT_SLICE`] at a time.
    pub(super) fn sleep(&self, wanted: u32, timeout: Duration) -> Result<(), LinkError> {
        if timeout.is_zero() {
            return Ok(());
        }
        let slept = self.bell().sleep(self.heard.get(), wanted.max(1), self.whom, timeout);
        slept.map_err(failed("waiting for a message"))
    }

    /// Takes all calls, in the order of their numbers.
    pub(super) fn take(&self, mut on_call: impl FnMut(usize)) {
        for (at, word) in self.bell().calls.iter().enumerate() {
            // Mostly there are none.
            let mut bits = if word.load(SeqCst) == 0 { 0 } else { word.swap(0, SeqCst) };
            while bits != 0 {
                on_call(64 * at + bits.trailing_zeros() as usize);
                bits &= bits - 1;
            }
        }
    }

    /// Takes the call `number`; whether there was one.
    pub(super) fn take_one(&self, number: usize) -> bool {
        let bit = 1 << (number % 64);
        self.bell().calls[number / 64].fetch_and(!bit, SeqCst) & bit != 0
    }

    /// Looks by `poll` until it gives something or `timeout` is over, asleep in between. A ring need not mean data: it may be of a
    /// message that was received before.
    pub(super) fn wait<T>(
        &self,
        timeout: Duration,
        mut poll: impl FnMut() -> Result<Option<T>, LinkError>,
    ) -> Result<Option<T>, LinkError> {
        let start = Instant::now();
        loop {
            self.listen();
            if let Some(found) = poll()? {
                return Ok(Some(found));
            }
            let left = timeout.saturating_sub(start.elapsed());
            if left.is_zero() {
                return Ok(None);
            }
            self.sleep(1, left.min(WAIT_SLICE))?;
        }
    }
}

#[cfg(test)]
#[path = "bell_tests.rs"]
mod tests;
