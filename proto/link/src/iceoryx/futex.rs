//! How a sleeping process is woken up: by a futex in the shared memory of its listener.
//!
//! iceoryx2's own trigger between processes is a datagram through a Unix socket. A listener needs several system calls to
//! look for it and to take it, and its wake-up takes longer than a futex's. The rest of an event is iceoryx2's: the ids that
//! have come, and the list of listeners. iceoryx2's state of a listener (`notification_state` in iceoryx2-cal's
//! `event/common.rs`) says whether a notifier need call this trigger at all.
#![allow(unsafe_code)]

use iceoryx2::prelude::{FileName, Path, ZeroCopySend};
use iceoryx2::service::Service;
use iceoryx2::service::internal::ServiceInternal;
use iceoryx2::service::ipc;
use iceoryx2_bb_elementary_traits::testing::abandonable::Abandonable;
use iceoryx2_cal::dynamic_storage::DynamicStorage;
use iceoryx2_cal::event::common::EventImpl;
use iceoryx2_cal::event::event_state::EventState;
use iceoryx2_cal::event::event_state::counting_bit_set::RelocatableCountingBitSet;
use iceoryx2_cal::event::trigger::{Configuration, HandlerInterface, State, WaiterInterface};
use iceoryx2_cal::event::{ListenerCreateError, ListenerWaitError, NotifierNotifyError, NotifierOpenError};
use iceoryx2_cal::named_concept::{NamedConceptPathHintRemoveError, NamedConceptRemoveError};
use rustix::io::Errno;
use rustix::thread::futex::{self, Flags, Timespec};
use std::fmt::Debug;
use std::mem::MaybeUninit;
use std::ptr::NonNull;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// The kind of iceoryx2 service in use: between processes, each port on one thread, woken up by futexes.
#[derive(Debug, Clone)]
pub struct Ipc {}

impl Service for Ipc {
    type StaticStorage = <ipc::Service as Service>::StaticStorage;
    type ConfigSerializer = <ipc::Service as Service>::ConfigSerializer;
    type PersistentDynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> =
        <ipc::Service as Service>::PersistentDynamicStorage<T>;
    type Bag = <ipc::Service as Service>::Bag;
    type DynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> =
        <ipc::Service as Service>::DynamicStorage<T>;
    type ServiceNameHasher = <ipc::Service as Service>::ServiceNameHasher;
    type SharedMemory = <ipc::Service as Service>::SharedMemory;
    type ResizableSharedMemory = <ipc::Service as Service>::ResizableSharedMemory;
    type Connection = <ipc::Service as Service>::Connection;
    type Event = EventImpl<
        RelocatableCountingBitSet,
        Futex,
        <ipc::Service as Service>::DynamicStorage<State<RelocatableCountingBitSet, Futex>>,
        Waker,
        Sleeper,
    >;
    type Monitoring = <ipc::Service as Service>::Monitoring;
    type Reactor = <ipc::Service as Service>::Reactor;
    type ArcThreadSafetyPolicy<T: Send + Debug + Abandonable> =
        <ipc::Service as Service>::ArcThreadSafetyPolicy<T>;
    type BlackboardMgmt<T: Send + Sync + Debug + ZeroCopySend + 'static> =
        <ipc::Service as Service>::BlackboardMgmt<T>;
    type BlackboardPayload = <ipc::Service as Service>::BlackboardPayload;
    type UniqueId = <ipc::Service as Service>::UniqueId;
}

impl ServiceInternal<Ipc> for Ipc {}

/// Nobody sleeps, and nothing has come.
const IDLE: u32 = 0;
/// Something has come.
const NOTIFIED: u32 = 1;
/// The listener sleeps.
const ASLEEP: u32 = 2;

/// The word that a listener sleeps on: one of [`IDLE`], [`NOTIFIED`], [`ASLEEP`]. If a peer writes any other value there, one
/// wait ends at once, or lasts for its whole time.
#[derive(Debug)]
#[repr(transparent)]
pub struct Futex(AtomicU32);

// SAFETY: a plain number without padding, pointers or a destructor, valid with any bits and mapped at any address.
unsafe impl ZeroCopySend for Futex {}

impl Futex {
    /// Wakes the listener up if it sleeps, or else keeps it from falling asleep.
    fn notify(&self) -> Result<(), Errno> {
        // Also if another notifier has marked it and may have been stopped before it could wake it up.
        if self.0.swap(NOTIFIED, Ordering::AcqRel) != IDLE {
            futex::wake(&self.0, Flags::empty(), 1)?;
        }
        Ok(())
    }

    /// Forgets that it was notified. Only for the listener.
    fn clear(&self) {
        // With all that the notifiers did before: their events are looked at next.
        self.0.swap(IDLE, Ordering::AcqRel);
    }

    /// Sleeps until notified, or for `timeout` (in which the machine's sleep does not count) at the most, or for no reason
    /// that the listener would know of; not at all if it was notified before. Only for the listener.
    ///
    /// # Errors
    /// `EINTR` if a signal came first; a notification is then still there.
    fn wait(&self, timeout: Duration) -> Result<(), Errno> {
        let tv_sec = timeout.as_secs().try_into().unwrap_or(i64::MAX);
        let timeout = Timespec { tv_sec, tv_nsec: timeout.subsec_nanos().into() };
        let mut waited = Ok(());
        if self.0.compare_exchange(IDLE, ASLEEP, Ordering::AcqRel, Ordering::Acquire).is_ok() {
            waited = futex::wait(&self.0, Flags::empty(), ASLEEP, Some(&timeout));
        }
        match waited {
            Ok(()) | Err(Errno::AGAIN | Errno::TIMEDOUT) => {
                self.clear();
                Ok(())
            }
            Err(error) => {
                let _ = self.0.compare_exchange(ASLEEP, IDLE, Ordering::AcqRel, Ordering::Acquire);
                Err(error)
            }
        }
    }
}

/// The notifier's end.
#[derive(Debug)]
pub struct Waker(&'static Futex);

impl Abandonable for Waker {
    unsafe fn abandon_in_place(_: NonNull<Self>) {}
}

impl<E, S> HandlerInterface<E, Futex, S> for Waker
where
    E: EventState,
    S: DynamicStorage<State<E, Futex>>,
{
    fn open(_: &FileName, _: &Configuration, futex: &Futex) -> Result<Self, NotifierOpenError> {
        // SAFETY: the futex lies in memory that iceoryx2 keeps mapped for as long as it keeps this (`Handle` in
        // iceoryx2-cal's event/common.rs), and nobody ever has a mutable reference to it there.
        Ok(Self(unsafe { NonNull::from_ref(futex).as_ref() }))
    }

    fn notify(&self) -> Result<(), NotifierNotifyError> {
        self.0.notify().map_err(|_| NotifierNotifyError::InternalFailure)
    }
}

/// The listener's end.
#[derive(Debug)]
pub struct Sleeper(&'static Futex);

impl Abandonable for Sleeper {
    unsafe fn abandon_in_place(_: NonNull<Self>) {}
}

impl<E, S> WaiterInterface<E, Futex, S> for Sleeper
where
    E: EventState,
    S: DynamicStorage<State<E, Futex>>,
{
    const IS_FILE_DESCRIPTOR_BASED: bool = false;

    unsafe fn remove(_: &FileName, _: &Configuration) -> Result<bool, NamedConceptRemoveError> {
        // It has no file of its own.
        Ok(true)
    }

    fn remove_path_hint(_: &Path) -> Result<(), NamedConceptPathHintRemoveError> {
        Ok(())
    }

    fn create(
        _: &FileName,
        _: &Configuration,
        place: &mut MaybeUninit<Futex>,
    ) -> Result<Self, ListenerCreateError> {
        let futex = NonNull::from_mut(place.write(Futex(AtomicU32::new(IDLE))));
        // SAFETY: as with `Waker`, and iceoryx2's `Waiter`; the mutable reference by which its initialiser got here is not used
        // for these bytes again.
        Ok(Self(unsafe { futex.as_ref() }))
    }

    fn try_wait(&self) -> Result<(), ListenerWaitError> {
        self.0.clear();
        Ok(())
    }

    fn timed_wait(&self, timeout: Duration) -> Result<(), ListenerWaitError> {
        self.0.wait(timeout).map_err(|error| match error {
            Errno::INTR => ListenerWaitError::InterruptSignal,
            _ => ListenerWaitError::InternalFailure,
        })
    }

    fn blocking_wait(&self) -> Result<(), ListenerWaitError> {
        WaiterInterface::<E, Futex, S>::timed_wait(self, Duration::MAX)
    }

    /// Leaves a notification where it is: the next wait is then over at once, for nothing. iceoryx2 calls this when the
    /// listener counts as idle again. To take a notification away here would be wrong: a notifier could have just put it there.
    /// That notifier would then mark the sleeping listener as notified, and no later one would wake it up.
    fn empty_buffer(&self) -> Result<(), ListenerWaitError> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use nix::sys::pthread::{pthread_kill, pthread_self};
    use nix::sys::signal::Signal::SIGUSR1;
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;
    use std::sync::mpsc::channel;
    use std::thread;
    use std::time::Instant;

    const LONG: Duration = Duration::from_secs(600);
    const SHORT: Duration = Duration::from_millis(1);

    #[test]
    fn a_notification_of_before_is_not_lost_and_counts_once() {
        let futex = Futex(AtomicU32::new(IDLE));
        futex.notify().unwrap();
        futex.notify().unwrap();
        let start = Instant::now();
        futex.wait(LONG).unwrap();
        assert!(start.elapsed() < LONG);
        let start = Instant::now();
        futex.wait(SHORT).unwrap();
        assert!(start.elapsed() >= SHORT);
        futex.notify().unwrap();
        futex.clear();
        let start = Instant::now();
        futex.wait(SHORT).unwrap();
        assert!(start.elapsed() >= SHORT);
    }

    /// Were one wake-up lost, this would take ten minutes.
    #[test]
    fn every_notification_wakes_up() {
        let [there, back] = [(); 2].map(|()| (Futex(AtomicU32::new(IDLE)), AtomicU32::new(0)));
        let until = |(futex, sent): &(Futex, AtomicU32), number: u32| {
            while sent.load(Ordering::Acquire) < number {
                futex.wait(LONG).unwrap();
            }
        };
        let send = |(futex, sent): &(Futex, AtomicU32), number: u32| {
            sent.store(number, Ordering::Release);
            futex.notify().unwrap();
        };
        let start = Instant::now();
        thread::scope(|scope| {
            scope.spawn(|| {
                for number in 1..=10_000 {
                    until(&there, number);
                    send(&back, number);
                }
            });
            for number in 1..=10_000 {
                send(&there, number);
                until(&back, number);
            }
        });
        assert!(start.elapsed() < LONG);
    }

    #[test]
    fn a_signal_ends_the_wait() {
        signal_hook::flag::register(SIGUSR1 as i32, Arc::new(AtomicBool::new(false))).unwrap();
        let futex = Futex(AtomicU32::new(IDLE));
        let (send, id) = channel();
        let waited = thread::scope(|scope| {
            let sleeper = scope.spawn(|| {
                send.send(pthread_self()).unwrap();
                futex.wait(LONG)
            });
            let id = id.recv().unwrap();
            // One that comes before it has fallen asleep ends nothing.
            while !sleeper.is_finished() {
                pthread_kill(id, SIGUSR1).unwrap();
                thread::yield_now();
            }
            sleeper.join().unwrap()
        });
        assert_eq!(waited, Err(Errno::INTR));
        assert_eq!(futex.0.load(Ordering::Relaxed), IDLE);
    }
}
