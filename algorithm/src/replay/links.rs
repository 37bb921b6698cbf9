//! Which transition follows upon which: the same actor's next one of the same episode.
//!
//! The replay is one ring for all actors, so an actor's next transition stands some positions further on. An entry keeps
//! that distance. There is no link across the end of an episode, whether terminal or cut off, to a transition that begins
//! one, as a replaced actor's does, or to one whose s is not the other's s' bit for bit: the mentor-server's
//! [`crate::history`] draws the line at the same places.
//!
//! A link leads to a later transition, which the ring overwrites later: a stored transition has a successor that is stored.
//! Links follow from what is stored, so no file holds them.

use super::Replay;
use trestle_proto::batch::FIRST;
use trestle_proto::limits::MAX_ACTORS;

/// The links of a ring.
#[derive(Clone, Debug)]
pub(super) struct Links {
    /// How many positions after each slot's transition its successor stands; 0 for none.
    ahead: Vec<u32>,
    /// Global index of the newest transition of each actor, where there has been one.
    newest: [Option<u64>; MAX_ACTORS as usize],
}

impl Links {
    /// No links; `room` is empty and has room for one a slot.
    pub(super) fn new(room: Vec<u32>) -> Self {
        Self { ahead: room, newest: [None; MAX_ACTORS as usize] }
    }

    /// No links between `len` transitions.
    pub(super) fn blank(&mut self, len: usize) {
        self.ahead.clear();
        self.ahead.resize(len, 0);
        self.newest.fill(None);
    }

    /// Bytes that are reserved for a link of each slot.
    #[cfg(test)]
    pub(super) fn reserved(&self) -> usize {
        4 * self.ahead.capacity()
    }
}

impl Replay {
    /// Links the transition with global index `index`, the newest that is linked, to the one that it follows upon.
    pub(super) fn link(&mut self, index: u64) {
        let slot = self.slot(index);
        match self.links.ahead.get_mut(slot) {
            Some(ahead) => *ahead = 0,
            None => self.links.ahead.push(0),
        }
        let last = self.links.newest[usize::from(self.actor[slot])].replace(index);
        let Some(before) = last.filter(|&last| last >= self.first_index()).map(|last| self.slot(last)) else {
            return;
        };
        let (from, to) = (self.get(before).transition, self.get(slot).transition);
        let same = from.next_obs.iter().map(|x| x.to_bits()).eq(to.obs.iter().map(|x| x.to_bits()));
        if same && !from.ends_episode() && to.flags & FIRST == 0 {
            // Below the capacity, since both are stored.
            self.links.ahead[before] = last.map_or(0, |last| (index - last) as u32);
        }
    }

    /// Finds all links anew, after [`Replay::read_segment`] has read the transitions.
    pub fn relink(&mut self) {
        self.links.blank(self.len());
        (self.first_index()..self.next_index()).for_each(|index| self.link(index));
    }

    /// The slot of the transition that follows upon the one in `slot`, if there is one yet.
    pub fn successor(&self, slot: usize) -> Option<usize> {
        let ahead = self.links.ahead[slot] as usize;
        (ahead > 0).then(|| (slot + ahead) % self.capacity)
    }

    /// The slots of the path that begins with the transition in `slot`: at most `most` (at least 1) transitions, fewer
    /// where the episode or what is stored of it ends.
    pub fn path(&self, slot: usize, most: usize) -> impl Iterator<Item = usize> {
        std::iter::successors(Some(slot), |&slot| self.successor(slot)).take(most)
    }
}
