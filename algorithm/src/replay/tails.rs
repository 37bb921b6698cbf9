//! The next states of transitions that have no successor, in places that are used again.

/// A free place leads to the next one by its first word.
const END: u32 = u32::MAX;

/// States of equal size. A place is free until it is taken, and after it has been given back.
#[derive(Clone, Debug)]
pub(super) struct Tails {
    words: Vec<u32>,
    /// Words of a state, 1 or more.
    width: usize,
    /// The place that was given back last.
    free: u32,
}

impl Tails {
    /// No state; `room` is empty and has room for as many states of `width` words as will ever be taken at once.
    pub(super) fn new(room: Vec<u32>, width: usize) -> Self {
        Self { words: room, width, free: END }
    }

    /// Gives all places back.
    pub(super) fn clear(&mut self) {
        self.words.clear();
        self.free = END;
    }

    /// A place, whose old contents the caller overwrites.
    pub(super) fn take(&mut self) -> u32 {
        if self.free == END {
            let place = self.words.len() / self.width;
            self.words.resize(self.words.len() + self.width, 0);
            return place as u32;
        }
        let place = self.free;
        self.free = self.get(place)[0];
        place
    }

    /// Gives `place` back.
    pub(super) fn give(&mut self, place: u32) {
        let free = self.free;
        self.get_mut(place)[0] = free;
        self.free = place;
    }

    /// The state at `place`.
    #[inline]
    pub(super) fn get(&self, place: u32) -> &[u32] {
        &self.words[place as usize * self.width..][..self.width]
    }

    /// The state at `place`.
    pub(super) fn get_mut(&mut self, place: u32) -> &mut [u32] {
        &mut self.words[place as usize * self.width..][..self.width]
    }

    /// Bytes of all places that have ever been in use at once.
    pub(super) fn bytes(&self) -> usize {
        4 * self.words.len()
    }

    /// Places in use, and bytes that are reserved.
    #[cfg(test)]
    pub(super) fn books(&self) -> (usize, usize) {
        let (mut used, mut free) = (self.words.len() / self.width, self.free);
        while free != END {
            used -= 1;
            free = self.get(free)[0];
        }
        (used, 4 * self.words.capacity())
    }
}
