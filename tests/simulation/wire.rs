//! Messages between simulated processes: the ends of `trestle_link::local` over queues that live in the world.
//!
//! A model of what shared memory does, not the code that does it. Messages are checked by the same code. What a process has sent
//! is there whatever becomes of the process; to send to one that has ended fails.

use super::world::{On, World, here, is_over};
use std::sync::Arc;
use std::time::Duration;
use trestle_link::LinkError;
use trestle_link::local::{Place, Want, Wire};

/// The place of a simulated process among those of a run.
pub(super) struct Seat {
    world: Arc<World>,
    process: usize,
    run: u64,
}

fn ended() -> LinkError {
    LinkError::Transport { what: "a message", message: "the process has ended".into() }
}

impl Seat {
    /// This process's place in the run `run`; none outside of a simulated process.
    pub(super) fn take(run: u64) -> Option<Self> {
        let place = here()?;
        let process = place.world.lock().process_of(place.thread);
        Some(Self { world: place.world.clone(), process, run })
    }
}

impl Place for Seat {
    fn process(&self) -> usize {
        self.process
    }

    fn with<R>(&self, work: impl FnOnce(&mut Wire, &dyn Fn(usize) -> bool) -> R) -> Result<R, LinkError> {
        if is_over() {
            return Err(ended());
        }
        let mut state = self.world.lock();
        let alive: Vec<bool> = state.processes.iter().map(|process| process.end.is_none()).collect();
        let wire = state.wires.get_mut(&self.run).ok_or_else(ended)?;
        Ok(work(wire, &|process| alive[process]))
    }

    fn wait(&self, want: Want, timeout: Duration) -> Result<(), LinkError> {
        let time = Some(timeout.as_nanos() as u64);
        let there = here().is_some_and(|place| self.world.wait(place.thread, On::Wire(self.run, want), time));
        if there { Ok(()) } else { Err(ended()) }
    }

    fn step(&self) -> Result<(), LinkError> {
        let there = here().is_some_and(|place| self.world.step(place.thread, "message"));
        if there { Ok(()) } else { Err(ended()) }
    }
}
