//! The replay: a bounded ring of the observer's transitions, first in, first out, as a structure of arrays.
//!
//! Every transition has a *global index*, its position in the run's one history counted from 0, and lives in the
//! *slot* `global index % capacity`. States keep the type that they came with: one byte a feature where the environment's
//! spaces say so. They become the network's `f32` when a batch is drawn.
//!
//! Every entry also knows its *successor*, the same actor's next transition of the same episode: see `links`. Its s is the
//! entry's s', which is stored once. Where there is no successor, at the ends of episodes and after the newest transition of
//! each actor, s' lies apart: see `tails`.
//!
//! Beside the observer's transition an entry holds the index of the similar mentor transition that was picked for
//! it. The mentor transition's annotation is *not* copied. The learner looks the annotation up when it samples the entry, so that
//! training sees the newest one (our choice).

mod file;
mod links;
mod tails;

pub use file::{Bounds, ReplayFileError, Span};

use links::Links;
use rand::RngCore;
use std::hint::black_box;
use tails::Tails;
use trestle_proto::NONE;
use trestle_proto::batch::{Batch, BatchHeader, TERMINATED, TRUNCATED, Transition};
use trestle_proto::limits::MAX_ACTORS;
use trestle_proto::row::{Row, RowKind};

/// Words of a cache line.
const LINE: usize = 16;

// An actor's index is kept in a byte.
const _: () = assert!(MAX_ACTORS <= 256);

/// Bytes that one transition between states of kind `row` takes in the replay. Each transition
/// without a successor takes another state, `4 * row.words()` bytes.
pub fn bytes_per_transition(row: impl Into<RowKind>) -> usize {
    // s; action, reward, mentor index, link; flags, actor.
    4 * (row.into().words() + 4) + 2
}

/// A replay that does not fit into memory.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no memory for learner.replay = {capacity} transitions of {obs_dim} features (up to {bytes} bytes)")]
pub struct ReplayMemoryError {
    /// Transitions asked for.
    pub capacity: usize,
    /// Features of an observation.
    pub obs_dim: usize,
    /// Bytes that they would take if none had a successor.
    pub bytes: u128,
}

/// One stored transition without its states, which are [`Replay::obs`] and [`Replay::next_obs`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// Action a_o.
    pub action: u32,
    /// Reward r_o.
    pub reward: f32,
    /// Flags as in a batch.
    pub flags: u32,
    /// The actor that made it.
    pub actor: u32,
    /// The similar mentor transition picked for it; none if no mentor state is similar.
    pub mentor: Option<usize>,
}

impl Entry {
    /// Whether the episode ended with this step, for whichever reason.
    pub fn ends_episode(&self) -> bool {
        self.flags & (TERMINATED | TRUNCATED) != 0
    }

    /// Whether s' is terminal and so has no value.
    pub fn terminated(&self) -> bool {
        self.flags & TERMINATED != 0
    }
}

/// The replay. Memory is reserved once, for the case that no transition has a successor; nothing is allocated afterwards. Memory
/// that is reserved and not used costs addresses alone.
#[derive(Clone, Debug)]
pub struct Replay {
    row: RowKind,
    capacity: usize,
    /// Transitions ever stored: the global index of the next one.
    pushed: u64,
    /// s of each slot, `row.words()` words each.
    obs: Vec<u32>,
    tails: Tails,
    action: Vec<u32>,
    reward: Vec<f32>,
    /// Index of a mentor transition, or `NONE`.
    mentor: Vec<u32>,
    flags: Vec<u8>,
    actor: Vec<u8>,
    links: Links,
}

impl Replay {
    /// An empty replay for `capacity` (at least 1) transitions between states of kind `row`.
    ///
    /// # Errors
    /// The memory cannot be had.
    pub fn new(capacity: usize, row: impl Into<RowKind>) -> Result<Self, ReplayMemoryError> {
        let row = row.into();
        let fault = || ReplayMemoryError {
            capacity,
            obs_dim: row.dim,
            bytes: capacity as u128 * (bytes_per_transition(row) + 4 * row.words()) as u128,
        };
        let words = capacity.checked_mul(row.words()).ok_or_else(fault)?;
        fn room<T>(len: usize) -> Option<Vec<T>> {
            let mut room = Vec::new();
            room.try_reserve_exact(len).ok()?;
            Some(room)
        }
        Ok(Self {
            row,
            capacity,
            pushed: 0,
            obs: room(words).ok_or_else(fault)?,
            tails: Tails::new(room(words).ok_or_else(fault)?, row.words()),
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
        self.row.dim
    }

    /// Global index of the oldest transition that is still stored.
    pub fn first_index(&self) -> u64 {
        self.pushed - self.len() as u64
    }

    /// Global index that the next transition will have: all that were ever stored.
    pub fn next_index(&self) -> u64 {
        self.pushed
    }

    /// Bytes that the stored transitions take.
    pub fn bytes(&self) -> usize {
        self.len() * bytes_per_transition(self.row) + self.tails.bytes()
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

    /// Stores `transition` of `actor` (below [`MAX_ACTORS`]), in place of the oldest one where the ring is full. The replay's type
    /// [holds](trestle_proto::row::Element::holds) its features. `mentor` is the index of the picked mentor transition or
    /// [`NONE`]. Returns the slot.
    pub fn push(&mut self, transition: &Transition<'_>, actor: u32, mentor: u32) -> usize {
        let (slot, w) = (self.slot(self.pushed), self.row.words());
        let (flags, actor) = (transition.flags as u8, actor as u8);
        if slot == self.len() {
            self.obs.resize((slot + 1) * w, 0);
            self.action.push(transition.action);
            self.reward.push(transition.reward);
            self.mentor.push(mentor);
            self.flags.push(flags);
            self.actor.push(actor);
        } else {
            self.unlink(slot);
            self.action[slot] = transition.action;
            self.reward[slot] = transition.reward;
            self.mentor[slot] = mentor;
            self.flags[slot] = flags;
            self.actor[slot] = actor;
        }
        self.row.pack(transition.obs, &mut self.obs[slot * w..][..w]);
        let (row, tail) = (self.row, self.tails.take());
        row.pack(transition.next_obs, self.tails.get_mut(tail));
        self.pushed += 1;
        self.link(self.pushed - 1, Some(tail));
        slot
    }

    /// s of slot `slot` (below [`Replay::len`]).
    #[inline]
    pub fn obs(&self, slot: usize) -> Row<'_> {
        self.row.row(self.words(slot))
    }

    /// s' of slot `slot` (below [`Replay::len`]).
    #[inline]
    pub fn next_obs(&self, slot: usize) -> Row<'_> {
        self.row.row(self.next_words(slot))
    }

    /// s of slot `slot` as it is stored.
    #[inline]
    fn words(&self, slot: usize) -> &[u32] {
        let w = self.row.words();
        &self.obs[slot * w..][..w]
    }

    /// s' of slot `slot` as it is stored.
    #[inline]
    fn next_words(&self, slot: usize) -> &[u32] {
        match self.links.tail(slot) {
            Some(tail) => self.tails.get(tail),
            None => self.words(self.successor(slot).unwrap_or(slot)),
        }
    }

    /// What slot `slot` (below [`Replay::len`]) holds beside its states.
    #[inline]
    pub fn get(&self, slot: usize) -> Entry {
        Entry {
            action: self.action[slot],
            reward: self.reward[slot],
            flags: u32::from(self.flags[slot]),
            actor: u32::from(self.actor[slot]),
            mentor: (self.mentor[slot] != NONE).then_some(self.mentor[slot] as usize),
        }
    }

    /// Draws `n` slots uniformly with replacement into `out`, which is cleared first: one 64-bit word of `rng` a
    /// draw, scaled to the number of stored transitions (uniform to within 2^-64 of it). None if nothing is stored. What is drawn is
    /// in the processor's caches afterwards.
    pub fn sample(&self, rng: &mut impl RngCore, n: usize, out: &mut Vec<u32>) {
        out.clear();
        if self.is_empty() {
            return;
        }
        let len = self.len() as u128;
        out.extend((0..n).map(|_| ((u128::from(rng.next_u64()) * len) >> 64) as u32));
        // One word of each cache line, whose places do not depend on each other: so the processor waits for many of them at a time.
        let line = |words: &[u32]| words.iter().step_by(LINE).fold(0, |all, word| all ^ word);
        let touched = |&slot: &u32| line(self.words(slot as usize)) ^ line(self.next_words(slot as usize));
        black_box(out.iter().map(touched).fold(0, |all, word| all ^ word));
    }

    /// Fills `batch` with the transitions from global index `first` on, in the order in which they came: as many
    /// as one actor made in a row, and at most `most`. Returns how many; 0 if `first` is not stored.
    ///
    /// The header says only actor, count and the kind of its states: what the mentor-server needs to rebuild its history.
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
            obs_dim: self.row.dim as u32,
            element: self.row.element.code(),
            ..BatchHeader::default()
        });
        let (mut s, mut next) = (Vec::new(), Vec::new());
        for (at, index) in (first..).take(count).enumerate() {
            let slot = self.slot(index);
            let Entry { action, reward, flags, .. } = self.get(slot);
            let (obs, next_obs) = (self.obs(slot).wide(&mut s), self.next_obs(slot).wide(&mut next));
            batch.set(at, &Transition { obs, next_obs, action, reward, flags });
        }
        count
    }
}

#[cfg(test)]
mod tests;
