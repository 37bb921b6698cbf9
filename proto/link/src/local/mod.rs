//! The transport within one process: queues between threads. For tests of the roles' loops, and the proof that the interfaces do
//! not depend on shared memory.
//!
//! - [`wire`]: the queues that the processes of one run share, and the events that a process can wait for there;
//! - [`ends`]: the roles' ends of it. They do not know where the queues lie or how a process waits: that is a [`Place`];
//! - [`Threads`]: the transport whose processes are threads of this process.
//!
//! Messages are checked by the same code as those of shared memory. The messages of a process that dies stay. Actors may be
//! replaced, learners and mentor-servers may not.

pub mod ends;
pub mod wire;

pub use ends::{LocalActor, LocalClient, LocalLearner, LocalMentor};
pub use wire::{Place, Want, Wire};

use crate::{Footprint, Host, LinkError, Liveness, Remains, Transport};
use std::collections::BTreeMap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use trestle_proto::experiment::Experiment;
use trestle_proto::plan::RunPlan;

/// Runs whose processes are threads of this process. Clones know the same runs.
#[derive(Clone, Debug, Default)]
pub struct Threads(Arc<Mutex<BTreeMap<u64, Arc<Hub>>>>);

/// The state that the threads of one run share.
#[derive(Debug)]
struct Hub {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug)]
struct State {
    wire: Wire,
    /// Of each end that there has been, whether it is still there.
    alive: Vec<bool>,
}

/// One thread's place among those of a run, which counts as alive as long as this is there.
#[derive(Debug)]
pub struct Seat {
    hub: Arc<Hub>,
    process: usize,
}

/// A run of [`Threads`], held.
#[derive(Debug)]
pub struct ThreadsHost {
    threads: Threads,
    run: u64,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Hub {
    fn new(plan: &RunPlan) -> Arc<Self> {
        let state = State { wire: Wire::of(plan), alive: Vec::new() };
        Arc::new(Self { state: Mutex::new(state), changed: Condvar::new() })
    }

    fn seat(self: &Arc<Self>) -> Seat {
        let mut state = lock(&self.state);
        state.alive.push(true);
        Seat { hub: self.clone(), process: state.alive.len() - 1 }
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        lock(&self.hub.state).alive[self.process] = false;
        self.hub.changed.notify_all();
    }
}

impl Place for Seat {
    fn process(&self) -> usize {
        self.process
    }

    fn with<R>(&self, work: impl FnOnce(&mut Wire, &dyn Fn(usize) -> bool) -> R) -> Result<R, LinkError> {
        let State { wire, alive } = &mut *lock(&self.hub.state);
        let done = work(wire, &|process| alive[process]);
        self.hub.changed.notify_all();
        Ok(done)
    }

    fn wait(&self, want: Want, timeout: Duration) -> Result<(), LinkError> {
        let missing = |state: &mut State| !state.wire.has(want, &|process| state.alive[process]);
        let waited = self.hub.changed.wait_timeout_while(lock(&self.hub.state), timeout, missing);
        drop(waited.unwrap_or_else(PoisonError::into_inner));
        Ok(())
    }
}

impl Threads {
    fn seat(&self, plan: &RunPlan) -> Result<Seat, LinkError> {
        let message = || "it is not in progress in this process".into();
        let hub = lock(&self.0).get(&plan.life.run).map(Hub::seat);
        hub.ok_or_else(|| LinkError::Transport { what: "joining the run", message: message() })
    }
}

impl Host for ThreadsHost {
    fn reap(&self) -> bool {
        true
    }

    fn remove(&self) -> Result<(), LinkError> {
        self.threads.remove(self.run)
    }
}

impl Drop for ThreadsHost {
    fn drop(&mut self) {
        lock(&self.threads.0).remove(&self.run);
    }
}

impl Transport for Threads {
    type Host = ThreadsHost;
    type Learner = LocalLearner<Seat>;
    type Actor = LocalActor<Seat>;
    type Mentor = LocalMentor<Seat>;
    type Client = LocalClient<Seat>;

    fn host(&self, plan: &RunPlan) -> Result<ThreadsHost, LinkError> {
        let (run, mut runs) = (plan.life.run, lock(&self.0));
        if runs.contains_key(&run) {
            let message = format!("run {run:08x} exists");
            return Err(LinkError::Transport { what: "making the run's place", message });
        }
        runs.insert(run, Hub::new(plan));
        Ok(ThreadsHost { threads: self.clone(), run })
    }

    fn learner(&self, plan: &RunPlan) -> Result<Self::Learner, LinkError> {
        Ok(LocalLearner::new(self.seat(plan)?, plan))
    }

    fn actor(&self, plan: &RunPlan, index: u32) -> Result<Self::Actor, LinkError> {
        Ok(LocalActor::new(self.seat(plan)?, plan, index))
    }

    fn mentor(&self, plan: &RunPlan) -> Result<Self::Mentor, LinkError> {
        Ok(LocalMentor::new(self.seat(plan)?))
    }

    fn client(&self, plan: &RunPlan) -> Result<Self::Client, LinkError> {
        Ok(LocalClient::new(self.seat(plan)?, plan))
    }

    fn liveness(&self, run: u64) -> Liveness {
        if lock(&self.0).contains_key(&run) { Liveness::Alive } else { Liveness::Absent }
    }

    fn remove(&self, run: u64) -> Result<(), LinkError> {
        lock(&self.0).remove(&run);
        Ok(())
    }

    fn runs(&self) -> Result<Vec<u64>, LinkError> {
        Ok(lock(&self.0).keys().copied().collect())
    }

    fn remains(&self, _: u64) -> Result<Remains, LinkError> {
        Ok(Remains { files: 0, bytes: 0, names: String::new() })
    }

    fn footprint(&self, _: &Experiment) -> Footprint {
        Footprint::default()
    }
}

/// The ends of `plan`'s run, as if all its processes had met already: learner, mentor-server, and one end for each actor.
pub fn connect(plan: &RunPlan) -> (LocalLearner<Seat>, LocalMentor<Seat>, Vec<LocalActor<Seat>>) {
    let hub = Hub::new(plan);
    let learner = LocalLearner::new(hub.seat(), plan);
    let mentor = LocalMentor::new(hub.seat());
    let indices = 0..plan.experiment.config.run.actors;
    let actors: Vec<_> = indices.map(|index| LocalActor::new(hub.seat(), plan, index)).collect();
    // In the order in which they have got their seats.
    lock(&hub.state).wire.introduce(0, 1, 2);
    (learner, mentor, actors)
}
