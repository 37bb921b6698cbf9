//! Bookkeeping of a breadth-first search over similar states: which states it has seen, how far it has gone, how many states and
//! links it has looked at, and which of two steps is the better one.

use super::Path;
use super::graph::Graph;
use crate::similarity::metric::kl;
use crate::states::States;
use trestle_proto::limits::MAX_BRIDGE_DEPTH;

const _: () = assert!(MAX_BRIDGE_DEPTH <= u8::MAX as u32);

/// A set of numbers that is soon emptied: one bit for each, so that they stay in the nearest cache.
#[derive(Clone, Debug, Default)]
pub(super) struct Marks {
    /// The bits of 32 numbers in the lower half, and in the upper half which time they were set for.
    words: Vec<u64>,
    now: u32,
}

impl Marks {
    /// Forgets all marks; numbers are below `bound`.
    pub(super) fn begin(&mut self, bound: usize) {
        if self.now == u32::MAX {
            self.words.fill(0);
            self.now = 0;
        }
        self.now += 1;
        self.words.resize(bound.div_ceil(32).max(self.words.len()), 0);
    }

    /// Marks `id`; whether it was not marked before.
    #[inline]
    pub(super) fn first_time(&mut self, id: u32) -> bool {
        let word = &mut self.words[id as usize / 32];
        let (now, bit) = (u64::from(self.now) << 32, 1 << (id % 32));
        // Without branches: whether a state is marked is hard to predict.
        let bits = *word & (0u64.wrapping_sub(u64::from(*word >> 32 == u64::from(self.now)))) | now;
        *word = bits | bit;
        bits & bit == 0
    }

    /// Whether `id` is marked.
    fn is_marked(&self, id: u32) -> bool {
        let word = self.words.get(id as usize / 32).copied().unwrap_or(0);
        word >> 32 == u64::from(self.now) && word >> (id % 32) & 1 == 1
    }
}

/// Which states have been seen in the present search, and at which level. Memory: a byte and a quarter a state.
#[derive(Clone, Debug, Default)]
pub(super) struct Seen {
    marks: Marks,
    /// The level of each state that is marked, at most [`MAX_BRIDGE_DEPTH`].
    levels: Vec<u8>,
}

impl Seen {
    /// Forgets all states; they are below `bound`.
    pub(super) fn begin(&mut self, bound: usize) {
        self.marks.begin(bound);
        self.levels.resize(bound.max(self.levels.len()), 0);
    }

    /// Notes that `id` is seen at `level`, unless it has been seen; whether it had not.
    pub(super) fn first_time(&mut self, id: u32, level: u32) -> bool {
        let first = self.marks.first_time(id);
        if first {
            self.levels[id as usize] = level as u8;
        }
        first
    }

    /// The same for the states of `ids`. Puts those that had not been seen into `fresh`, in their order.
    fn sift(&mut self, ids: &[u32], level: u32, fresh: &mut Vec<u32>) {
        fresh.clear();
        fresh.resize(ids.len(), 0);
        let mut count = 0;
        for &id in ids {
            fresh[count] = id;
            count += usize::from(self.marks.first_time(id));
        }
        fresh.truncate(count);
        fresh.iter().for_each(|&id| self.levels[id as usize] = level as u8);
    }

    /// Whether `id` was seen at `level` first.
    pub(super) fn is_at(&self, id: u32, level: u32) -> bool {
        self.marks.is_marked(id) && u32::from(self.levels[id as usize]) == level
    }
}

/// A step of a path, as far as it decides between equally long ones.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    pub(super) action: u32,
    pub(super) reward: f32,
    /// s', or another state that tells steps apart.
    pub(super) to: u32,
}

impl Step {
    /// Whether this one is better: a higher reward, or a smaller action, or a smaller state.
    pub(super) fn beats(&self, other: &Self, states: &States) -> bool {
        let order = other.reward.total_cmp(&self.reward).then(self.action.cmp(&other.action));
        order.then_with(|| states.order(self.to, other.to)).is_lt()
    }
}

/// How far a search has gone in one direction.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Side {
    /// Whether there is a further level.
    pub(super) open: bool,
    /// The last level that has been looked at.
    pub(super) steps: usize,
    /// States and links looked at.
    looks: usize,
    limit: usize,
}

impl Side {
    /// At level 0. At most `limit` looks.
    pub(super) fn new(open: bool, limit: usize) -> Self {
        Self { open, limit, ..Self::default() }
    }

    /// Counts `count` more looks.
    pub(super) fn look(&mut self, count: usize) {
        self.looks += count;
    }

    /// Exhausts the side if the crowds around the states of a `level` alone are more than it may look at: then the next level is
    /// dropped in any case.
    pub(super) fn expect(&mut self, graph: &Graph, level: impl Iterator<Item = u32>) {
        let crowds: usize = level.filter_map(|id| graph.cells.listed(id)).map(|(_, crowd)| crowd).sum();
        if self.looks + crowds > self.limit {
            self.looks += crowds;
        }
    }

    /// States and links looked at.
    pub(super) fn looks(&self) -> u64 {
        self.looks as u64
    }

    /// Whether the limit is exceeded.
    pub(super) fn exhausted(&self) -> bool {
        self.looks > self.limit
    }
}

/// Fills `fresh` with the stored states similar to state `id` that have not been `seen`, and notes that they are, at `level`. Each state
/// in the cells around it counts as looked at by `side`, whether or not it has to be.
pub(super) fn similar(
    graph: &Graph,
    states: &States,
    id: u32,
    path: &Path<'_>,
    (side, seen, level): (&mut Side, &mut Seen, u32),
    fresh: &mut Vec<u32>,
) {
    if let Some((listed, crowd)) = graph.cells.listed(id) {
        side.look(crowd);
        seen.sift(listed, level, fresh);
        return;
    }
    fresh.clear();
    let centre = states.whitened(id);
    graph.cells.nearby(centre, |list| {
        side.look(list.len());
        // A level beyond the limit is dropped.
        if !side.exhausted() {
            let near = |&&other: &&u32| kl(centre, states.whitened(other)) <= path.similarity.e_th();
            fresh.extend(list.iter().filter(near).filter(|&&other| seen.first_time(other, level)));
        }
    });
}

/// Calls `visit` with every stored state similar to state `id`, perhaps more than once.
pub(super) fn each_similar(
    graph: &Graph,
    states: &States,
    id: u32,
    path: &Path<'_>,
    mut visit: impl FnMut(u32),
) {
    if let Some((listed, _)) = graph.cells.listed(id) {
        listed.iter().for_each(|&other| visit(other));
        return;
    }
    let centre = states.whitened(id);
    graph.cells.nearby(centre, |list| {
        let near = |&&other: &&u32| kl(centre, states.whitened(other)) <= path.similarity.e_th();
        list.iter().filter(near).for_each(|&other| visit(other));
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    proptest! {
        #[test]
        fn a_state_is_seen_once_in_a_search(
            searches in proptest::collection::vec(proptest::collection::vec(0u32..200, 0..60), 1..6),
            now in prop_oneof![Just(0), u32::MAX - 3..=u32::MAX],
        ) {
            let mut seen = Seen { marks: Marks { words: Vec::new(), now }, levels: Vec::new() };
            let mut fresh = vec![7];
            for ids in searches {
                seen.begin(200);
                let (alone, together) = ids.split_at(ids.len() / 2);
                let mut expected = BTreeMap::new();
                for &id in alone {
                    prop_assert_eq!(seen.first_time(id, id % 3), expected.insert(id, id % 3).is_none());
                }
                seen.sift(together, 5, &mut fresh);
                let mut first = together.to_vec();
                first.retain(|&id| {
                    let is_new = !expected.contains_key(&id);
                    expected.entry(id).or_insert(5);
                    is_new
                });
                prop_assert_eq!(&fresh, &first);
                for (id, level) in (0..210).flat_map(|id| [0, 1, 2, 5].map(|level| (id, level))) {
                    prop_assert_eq!(seen.is_at(id, level), expected.get(&id) == Some(&level));
                }
            }
        }
    }
}
