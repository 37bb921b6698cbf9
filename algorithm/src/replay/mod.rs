//! The replay: a bounded ring of the observer's transitions, first in, first out, as a structure of arrays.
//!
//! Every transition has a *global index*, its position in the run's one history counted from 0, and lives in the
//! *slot* `global index % capacity`. A transition keeps its own copy of s' although it mostly equals the next
//! one's s: at the ends of episodes, at the seams between actors and at the ring's seam there is no such next
//! one, and without the exceptions a sample is two plain reads. At 4 features the copy costs 16 of
//! [`bytes_per_transition`]'s 50 bytes.
//!
//! Beside the observer's transition an entry holds the index of the similar mentor transition that was picked for
//! it. The mentor transition's annotation is *not* copied. The learner looks the annotation up when it samples the entry, so that
//! training sees the newest one (our choice).
//!
//! Every entry also knows its *successor*, the same actor's next transition of the same episode: see `links`.

mod file;
mod links;

pub use file::{Bounds, ReplayFileError, Span};

use links::Links;
use rand::RngCore;
use trestle_proto::NONE;
use trestle_proto::batch::{Batch, BatchHeader, Transition};
use trestle_proto::limits::MAX_ACTORS;

// An actor's index is kept in a byte.
const _: () = assert!(MAX_ACTORS <= 256);

/// Bytes that one transition with `obs_dim` features takes in the replay.
pub const fn bytes_per_transition(obs_dim: usize) -> usize {
    // s, s'; action, reward, mentor index, link; flags, actor.
    4 * (2 * obs_dim + 4) + 2
}

/// A replay that does not fit into memory.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no memory for learner.replay = {capacity} transitions of {obs_dim} features ({bytes} bytes)")]
pub struct ReplayMemoryError {
    /// Transitions asked for.
    pub capacity: usize,
    /// Features of an observation.
    pub obs_dim: usize,
    /// What they would take.
    pub bytes: u128,
}

/// One stored transition, by reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry<'a> {
    /// The observer's transition.
    pub transition: Transition<'a>,
    /// The actor that made it.
    pub actor: u32,
    /// The similar mentor transition picked for it; none if no mentor state is similar.
    pub mentor: Option<usize>,
}

/// The replay. Memory is reserved once; nothing is allocated afterwards.
#[derive(Clone, Debug)]
pub struct Replay {
    obs_dim: usize,
    capacity: usize,
    /// Transitions ever stored: the global index of the next one.
    pushed: u64,
    obs: Vec<f32>,
    next: Vec<f32>,
    action: Vec<u32>,
    reward: Vec<f32>,
    /// Index of a mentor transition, or `NONE`.
    mentor: Vec<u32>,
    flags: Vec<u8>,
    actor: Vec<u8>,
    links: Links,
}

impl Replay {
    /// An empty replay for `capacity` (at least 1) transitions of `obs_dim` features.
    ///
    /// # Errors
    /// The memory cannot be had.
    pub fn new(capacity: usize, obs_dim: usize) -> Result<Self, ReplayMemoryError> {
        let fault = || ReplayMemoryError {
            capacity,
            obs_dim,
            bytes: capacity as u128 * bytes_per_transition(obs_dim) as u128,
        };
        let features = capacity.checked_mul(obs_dim).ok_or_else(fault)?;
        fn room<T>(len: usize) -> Option<Vec<T>> {
            let mut room = Vec::new();
            room.try_reserve_exact(len).ok()?;
            Some(room)
        }
        Ok(Self {
            obs_dim,
            capacity,
            pushed: 0,
            obs: room(features).ok_or_else(fault)?,
            next: room(features).ok_or_else(fault)?,
            action: room(capacity).ok_or_else(fault)?,
            reward: room(capacity).ok_or_else(fault)?,
            mentor: room(capacity).ok_or_else(fault)?,
            flags: room(capacity).ok_or_else(fault)?,
            actor: room(capacity).ok_or_else(fault)?,
            links: Links::new(room(capacity).ok_or_else(fault)?),
        })
    }

    /// Transitions stored now.
    pub fn len(&self) -> usize {
        self.action.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.action.is_empty()
    }

    /// Most transitions that are kept.
    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// Features of an observation.
    pub fn obs_dim(&self) -> usize {
        self.obs_dim
    }

    /// Global index of the oldest transition that is still stored.
    pub fn first_index(&self) -> u64 {
        self.pushed - self.len() as u64
    }

    /// Global index that the next transition will have: all that were ever stored.
    pub fn next_index(&self) -> u64 {
        self.pushed
    }

    /// Bytes that the replay takes when full, all of which are reserved from the start.
    pub fn bytes(&self) -> usize {
        self.capacity * bytes_per_transition(self.obs_dim)
    }

    /// The slot of the transition with global index `index`.
    pub fn slot(&self, index: u64) -> usize {
        (index % self.capacity as u64) as usize
    }

    /// The global index of the transition that is stored in `slot` (below [`Replay::len`]).
    pub fn index(&self, slot: usize) -> u64 {
        let newest = self.pushed - 1;
        let back = (self.slot(newest) + self.capacity - slot) % self.capacity;
        newest - back as u64
    }

    /// Stores `transition` of `actor` (below [`MAX_ACTORS`]), in place of the oldest one where the ring is full.
    /// `mentor` is the index of the picked mentor transition or [`NONE`]. Returns the slot.
    pub fn push(&mut self, transition: &Transition<'_>, actor: u32, mentor: u32) -> usize {
        let (slot, d) = (self.slot(self.pushed), self.obs_dim);
        let (flags, actor) = (transition.flags as u8, actor as u8);
        if slot == self.len() {
            self.obs.extend_from_slice(transition.obs);
            self.next.extend_from_slice(transition.next_obs);
            self.action.push(transition.action);
            self.reward.push(transition.reward);
            self.mentor.push(mentor);
            self.flags.push(flags);
            self.actor.push(actor);
        } else {
            self.obs[slot * d..][..d].copy_from_slice(transition.obs);
            self.next[slot * d..][..d].copy_from_slice(transition.next_obs);
            self.action[slot] = transition.action;
            self.reward[slot] = transition.reward;
            self.mentor[slot] = mentor;
            self.flags[slot] = flags;
            self.actor[slot] = actor;
        }
        self.pushed += 1;
        self.link(self.pushed - 1);
        slot
    }

    /// What slot `slot` (below [`Replay::len`]) holds.
    #[inline]
    pub fn get(&self, slot: usize) -> Entry<'_> {
        let d = self.obs_dim;
        Entry {
            transition: Transition {
                obs: &self.obs[slot * d..][..d],
                next_obs: &self.next[slot * d..][..d],
                action: self.action[slot],
                reward: self.reward[slot],
                flags: u32::from(self.flags[slot]),
            },
            actor: u32::from(self.actor[slot]),
            mentor: (self.mentor[slot] != NONE).then_some(self.mentor[slot] as usize),
        }
    }

    /// Draws `n` slots uniformly with replacement into `out`, which is cleared first: one 64-bit word of `rng` a
    /// draw, scaled to the number of stored transitions (uniform to within 2^-64 of it). None if nothing is stored.
    pub fn sample(&self, rng: &mut impl RngCore, n: usize, out: &mut Vec<u32>) {
        out.clear();
        if self.is_empty() {
            return;
        }
        let len = self.len() as u128;
        out.extend((0..n).map(|_| ((u128::from(rng.next_u64()) * len) >> 64) as u32));
    }

    /// Fills `batch` with the transitions from global index `first` on, in the order in which they came: as many
    /// as one actor made in a row, and at most `most`. Returns how many; 0 if `first` is not stored.
    ///
    /// The header says only actor, count and `obs_dim`: what the mentor-server needs to rebuild its history.
    pub fn fill_batch(&self, first: u64, most: usize, batch: &mut Batch) -> usize {
        if first < self.first_index() || first >= self.pushed {
            return 0;
        }
        let actor = self.actor[self.slot(first)];
        let end = self.pushed.min(first.saturating_add(most as u64));
        let count = (first..end).take_while(|&index| self.actor[self.slot(index)] == actor).count();
        batch.prepare(BatchHeader {
            actor: u32::from(actor),
            count: count as u32,
            obs_dim: self.obs_dim as u32,
            ..BatchHeader::default()
        });
        for (at, index) in (first..).take(count).enumerate() {
            batch.set(at, &self.get(self.slot(index)).transition);
        }
        count
    }
}

#[cfg(test)]
mod tests;
