//! Bookkeeping of a breadth-first search over similar states: which states it has seen, how far it has gone, how many states and
//! links it has looked at, and which of two steps is the better one.

use super::Path;
use super::graph::Graph;
use crate::similarity::metric::kl;
use crate::states::States;
use trestle_proto::limits::MAX_BRIDGE_DEPTH;

/// Bits of a mark that hold the level, which is at most [`MAX_BRIDGE_DEPTH`].
const LEVEL_BITS: u32 = 7;
const _: () = assert!(MAX_BRIDGE_DEPTH < 1 << LEVEL_BITS);

/// Which states have been seen in the present search, and at which level.
#[derive(Clone, Debug, Default)]
pub(super) struct Marks {
    /// The number of the search that saw a state last, and in the lowest bits the level.
    stamps: Vec<u32>,
    now: u32,
}

impl Marks {
    /// Forgets all marks; states are below `bound`.
    pub(super) fn begin(&mut self, bound: usize) {
        if self.now == u32::MAX >> LEVEL_BITS {
            self.stamps.fill(0);
            self.now = 0;
        }
        self.now += 1;
        self.stamps.resize(bound.max(self.stamps.len()), 0);
    }

    /// Marks `id` as seen at `level`, unless it is marked; whether it was not.
    pub(super) fn first_time(&mut self, id: u32, level: u32) -> bool {
        let stamp = &mut self.stamps[id as usize];
        let first = *stamp >> LEVEL_BITS != self.now;
        if first {
            *stamp = self.now << LEVEL_BITS | level;
        }
        first
    }

    /// Whether `id` was seen at `level` first.
    pub(super) fn is_at(&self, id: u32, level: u32) -> bool {
        self.stamps.get(id as usize) == Some(&(self.now << LEVEL_BITS | level))
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

    /// States and links looked at.
    pub(super) fn looks(&self) -> u64 {
        self.looks as u64
    }

    /// Whether the limit is exceeded.
    pub(super) fn exhausted(&self) -> bool {
        self.looks > self.limit
    }
}

/// Calls `visit` with every stored state similar to state `id` while the limit of `side` lasts. Each state in the cells
/// around it counts, whether or not it has to be looked at.
pub(super) fn similar(
    graph: &Graph,
    states: &States,
    id: u32,
    path: &Path<'_>,
    side: &mut Side,
    mut visit: impl FnMut(u32, &mut Side),
) {
    if let Some((listed, crowd)) = graph.cells.listed(id) {
        side.look(crowd);
        for &other in listed {
            if side.exhausted() {
                return;
            }
            visit(other, side);
        }
        return;
    }
    let centre = states.whitened(id);
    graph.cells.nearby(centre, |list| {
        side.look(list.len());
        for &other in list {
            if side.exhausted() {
                return;
            }
            if kl(centre, states.whitened(other)) <= path.similarity.e_th() {
                visit(other, side);
            }
        }
    });
}
