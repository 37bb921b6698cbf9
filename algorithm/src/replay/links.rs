//! Which transition follows upon which: the same actor's next one of the same episode.
//!
//! The replay is one ring for all actors, so an actor's next transition stands some positions further on. An entry keeps
//! that distance. There is no link across the end of an episode, whether terminal or cut off, to a transition that begins
//! one, as a replaced actor's does, or to one whose s is not the other's s' bit for bit: the mentor-server's
//! [`crate::history`] draws the line at the same places. An entry without a successor keeps the place of its s' instead.
//!
//! A link leads to a later transition, which the ring overwrites later: a stored transition has a successor that is stored.

use super::Replay;
use trestle_proto::batch::FIRST;
use trestle_proto::limits::{MAX_ACTORS, MAX_REPLAY};

/// Marks the place of an s'. A number below it is a distance; 0 is neither.
const TAIL: u32 = 1 << 31;

// Distances are below the capacity, and there is at most one s' a slot.
const _: () = assert!(MAX_REPLAY <= TAIL as usize);

/// The links of a ring.
#[derive(Clone, Debug)]
pub(super) struct Links {
    /// How many positions after each slot's transition its successor stands, or the place of its s'.
    links: Vec<u32>,
    /// Global index of the newest transition of each actor, where there has been one.
    newest: [Option<u64>; MAX_ACTORS as usize],
}

impl Links {
    /// No links; `room` is empty and has room for one a slot.
    pub(super) fn new(room: Vec<u32>) -> Self {
        Self { links: room, newest: [None; MAX_ACTORS as usize] }
    }

    /// No links between `len` transitions.
    pub(super) fn blank(&mut self, len: usize) {
        self.links.clear();
        self.links.resize(len, 0);
        self.newest.fill(None);
    }

    /// Where the s' of `slot` lies, if there is no successor.
    #[inline]
    pub(super) fn tail(&self, slot: usize) -> Option<u32> {
        let link = self.links[slot];
        (link & TAIL != 0).then_some(link & !TAIL)
    }

    /// The s' of `slot` lies at `place`.
    pub(super) fn set_tail(&mut self, slot: usize, place: u32) {
        self.links[slot] = TAIL | place;
    }

    /// The successor of `slot` stands `ahead` positions further on.
    pub(super) fn set_ahead(&mut self, slot: usize, ahead: u32) {
        self.links[slot] = ahead;
    }

    /// Bytes that are reserved for a link of each slot.
    #[cfg(test)]
    pub(super) fn reserved(&self) -> usize {
        4 * self.links.capacity()
    }
}

impl Replay {
    /// Links the transition with global index `index`, the newest that is linked, to the one that it follows upon. Its own s'
    /// lies at `tail`; none if its link is known.
    pub(super) fn link(&mut self, index: u64, tail: Option<u32>) {
        let slot = self.slot(index);
        if let Some(place) = tail {
            if slot == self.links.links.len() {
                self.links.links.push(0);
            }
            self.links.set_tail(slot, place);
        }
        let last = self.links.newest[usize::from(self.actor[slot])].replace(index);
        let Some(last) = last.filter(|&last| last >= self.first_index()) else { return };
        let before = self.slot(last);
        let Some(place) = self.links.tail(before) else { return };
        let same = self.tails.get(place) == self.words(slot);
        if same && !self.get(before).ends_episode() && self.get(slot).flags & FIRST == 0 {
            self.tails.give(place);
            // Below the capacity, since both are stored.
            self.links.set_ahead(before, (index - last) as u32);
        }
    }

    /// Gives back the s' of `slot`, which is to be overwritten.
    pub(super) fn unlink(&mut self, slot: usize) {
        if let Some(place) = self.links.tail(slot) {
            self.tails.give(place);
        }
    }

    /// Finds the links between segments, after [`Replay::read_segment`] has read them all.
    pub fn relink(&mut self) {
        self.links.newest.fill(None);
        (self.first_index()..self.next_index()).for_each(|index| self.link(index, None));
    }

    /// The slot of the transition that follows upon the one in `slot`, if there is one yet.
    #[inline]
    pub fn successor(&self, slot: usize) -> Option<usize> {
        let ahead = self.links.links[slot];
        (ahead != 0 && ahead & TAIL == 0).then(|| (slot + ahead as usize) % self.capacity)
    }

    /// The slots of the path that begins with the transition in `slot`: at most `most` (at least 1) transitions, fewer
    /// where the episode or what is stored of it ends.
    pub fn path(&self, slot: usize, most: usize) -> impl Iterator<Item = usize> {
        std::iter::successors(Some(slot), |&slot| self.successor(slot)).take(most)
    }
}
