//! The observer's stored transitions: first in, first out, with the learner's replay's order and capacity, so that both
//! always hold the same ones.
//!
//! A transition has a number, its position in the run's one history. Numbers go up by one, and survive neither gaps nor
//! repetition. Each transition knows its *predecessor*: the one before it of the same actor, if that is still stored
//! and did not end its episode, if this one does not begin one, and if the one's s' is the other's s bit for bit. So
//! no path of predecessors crosses the end of an episode, an actor's replacement or an eviction.

use crate::states::States;
use trestle_proto::batch::{FIRST, TERMINATED, TRUNCATED};
use trestle_proto::limits::MAX_ACTORS;

/// A stored transition. Its states are numbers of [`States`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stored {
    /// s.
    pub from: u32,
    /// s'.
    pub to: u32,
    /// The action.
    pub action: u32,
    /// The reward.
    pub reward: f32,
    /// Flags as in a batch.
    pub flags: u32,
    /// How many positions before this one the predecessor stands; 0 for none.
    back: u32,
}

impl Stored {
    /// Whether the episode ended with this step, for whichever reason: nothing follows upon it.
    pub fn ends_episode(&self) -> bool {
        self.flags & (TERMINATED | TRUNCATED) != 0
    }

    /// Whether s' is terminal.
    pub fn terminated(&self) -> bool {
        self.flags & TERMINATED != 0
    }
}

/// The ring. Memory: 24 bytes a transition, grown as they arrive, up to the capacity; and the distinct states.
#[derive(Clone, Debug)]
pub struct History {
    /// The distinct states of the stored transitions.
    pub states: States,
    capacity: usize,
    rows: Vec<Stored>,
    /// Number of the first transition ever stored here; it went to the ring's first row.
    base: u64,
    /// One past the newest transition.
    end: u64,
    /// The newest transition of each actor, where there has been one.
    newest: Vec<Option<u64>>,
}

impl History {
    /// Room for `capacity` (1 to 2^32 - 1) transitions of `dim` features.
    pub fn new(capacity: usize, dim: usize) -> Self {
        Self {
            states: States::new(dim),
            capacity,
            rows: Vec::new(),
            base: 0,
            end: 0,
            newest: vec![None; MAX_ACTORS as usize],
        }
    }

    /// The number that the next transition must have; none before the first, which may have any.
    pub fn expected(&self) -> Option<u64> {
        (!self.rows.is_empty()).then_some(self.end)
    }

    /// Says which number the first transition has. Without effect once there is one.
    pub fn begin(&mut self, first: u64) {
        if self.rows.is_empty() {
            (self.base, self.end) = (first, first);
        }
    }

    /// Number of stored transitions.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Number of the oldest stored transition.
    pub fn oldest(&self) -> u64 {
        self.end - self.rows.len() as u64
    }

    /// One past the number of the newest stored transition.
    pub fn end(&self) -> u64 {
        self.end
    }

    /// The stored transition with number `index`.
    pub fn get(&self, index: u64) -> &Stored {
        debug_assert!((self.oldest()..self.end).contains(&index));
        &self.rows[self.row(index)]
    }

    fn row(&self, index: u64) -> usize {
        ((index - self.base) % self.capacity as u64) as usize
    }

    /// The number of the transition before `index` in its episode, if it is stored.
    pub fn predecessor(&self, index: u64) -> Option<u64> {
        let back = u64::from(self.get(index).back);
        (back != 0 && index - back >= self.oldest()).then(|| index - back)
    }

    /// The transition that the next one will displace. Its states are released when that happens.
    pub fn displaced(&self) -> Option<(u64, Stored)> {
        (self.rows.len() == self.capacity).then(|| (self.oldest(), *self.get(self.oldest())))
    }

    /// Stores a transition of `actor` between two states that have been acquired for it. Returns its number.
    pub fn push(&mut self, actor: u32, from: u32, to: u32, action: u32, reward: f32, flags: u32) -> u64 {
        let index = self.end;
        let newest = &mut self.newest[actor as usize];
        let last = newest.replace(index);
        let kept = last.filter(|&last| flags & FIRST == 0 && index - last < self.capacity as u64);
        let follows = kept.filter(|&last| {
            let before = self.get(last);
            !before.ends_episode() && before.to == from
        });
        let back = follows.map_or(0, |last| (index - last) as u32);
        let stored = Stored { from, to, action, reward, flags, back };
        let row = self.row(index);
        if row == self.rows.len() {
            self.rows.push(stored);
        } else {
            self.rows[row] = stored;
        }
        self.end += 1;
        index
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers of the predecessors of all stored transitions.
    fn predecessors(history: &History) -> Vec<Option<u64>> {
        (history.oldest()..history.end()).map(|i| history.predecessor(i)).collect()
    }

    #[test]
    fn predecessors_respect_actors_episodes_and_jumps() {
        let mut h = History::new(10, 1);
        h.begin(100);
        assert_eq!(h.expected(), None);
        h.push(0, 0, 1, 0, 0.0, FIRST); // 100
        h.push(1, 7, 8, 0, 0.0, FIRST); // 101
        h.push(0, 1, 2, 0, 0.0, 0); // 102
        h.push(1, 8, 9, 0, 0.0, TRUNCATED); // 103
        h.push(0, 2, 3, 0, 0.0, FIRST); // 104: a replaced actor
        h.push(1, 9, 9, 0, 0.0, 0); // 105: after an episode's end
        h.push(0, 4, 5, 0, 0.0, 0); // 106: a jump
        assert_eq!(predecessors(&h), [None, None, Some(100), Some(101), None, None, None]);
        assert_eq!((h.expected(), h.len()), (Some(107), 7));
    }

    #[test]
    fn eviction_cuts_paths_and_keeps_numbers() {
        let mut h = History::new(3, 1);
        h.begin(5);
        for i in 0..7 {
            let full = h.displaced();
            assert_eq!(full.map(|(index, _)| index), (i >= 3).then(|| 2 + u64::from(i)));
            assert_eq!(h.push(0, i, i + 1, 0, 0.0, 0), 5 + u64::from(i));
        }
        assert_eq!((h.oldest(), h.end()), (9, 12));
        assert_eq!(predecessors(&h), [None, Some(9), Some(10)]);
        assert_eq!(h.get(11).from, 6);
        // A predecessor that is evicted by the transition itself.
        let mut h = History::new(2, 1);
        h.push(0, 0, 1, 0, 0.0, FIRST);
        h.push(1, 5, 6, 0, 0.0, FIRST);
        h.push(0, 1, 2, 0, 0.0, 0);
        assert_eq!(predecessors(&h), [None, None]);
    }
}
