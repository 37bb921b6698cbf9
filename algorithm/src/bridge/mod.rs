//! Bridges: paths of the observer's own stored transitions that lead from a mentor state back onto the mentor's path
//! where the mentor's own next step is out of reach (deep k-n step repair, paper Algorithm 1, Fig. 4 and 5).
//!
//! # Definition
//! States are similar up to KL = `e_th`. A *bridge* for mentor transition j, which begins in s_m, is a path of stored
//! transitions t_1 ... t_l, 1 <= l <= k, such that
//!
//! 1. s of t_1 is similar to s_m;
//! 2. each t_{i+1} may follow t_i, which did not end its episode: t_i is t_{i+1}'s predecessor
//!    ([`crate::history`]), or, with *cross-referencing* (Fig. 5), s of t_{i+1} is similar to s' of t_i, whatever their
//!    episodes and actors;
//! 3. s' of t_l is similar to a mentor state 1 to n mentor steps after s_m in the same trajectory. The nearest such
//!    state's KL is the bridge's *end KL*. (t_l may end its episode.)
//!
//! Of two bridges the shorter one is better (the paper wants the shortest), then the one with the smaller end KL, then the
//! one whose first step has the higher reward. The last two and their order are our choice: a path that truly returns to
//! the mentor's is worth more than a reward that may owe to circumstances. The search finds the best of all bridges that
//! one transition completes. Among equally good ones it takes the one whose first step has the smaller action, then the
//! smaller s', so that no order of storage shows.
//!
//! It replaces the known bridge if it is shorter. If it is as long, it does so only by a gain of the newest transition
//! itself:
//!
//! - as the last step, an end that is nearer, or as near with a better first step;
//! - as the first step, a higher reward with an end no farther;
//! - at any place, a higher reward, if the known bridge ends in the mentor's very state.
//!
//! The search does not look at other stored ends that a path could reach because it has just become possible. In a crowd
//! of states that are never seen twice there are always nearer ends to which no bridge of this length leads, so every
//! transition would start a search in vain. In a world of few states, all equal or dissimilar, nothing is lost: the bridge
//! is at any time the best one that has ever been in the history.
//!
//! Of a bridge its first step is kept, and, where that is asked for, all of its steps ([`AnnotationTable::further`]). Several paths may
//! have one first step, one length and one end KL: `trace` says which of them counts. A bridge that is not replaced keeps its steps.
//!
//! The search serves mentor transitions that are infeasible at the time: e_KL >= `e_infeas`, or no estimate yet. A bridge
//! stays when its transitions have left the history.
//!
//! # Search
//! The search never scans the history. Every new bridge contains the newest transition, so it is enough to look for paths
//! through that one when it arrives: [`straight`] follows its predecessors, [`graph`] and [`search`] do the
//! cross-referencing, and `horizon`, `outlook`, `room` and `wanted` say beforehand where that could improve anything.
//! [`oracle`] is Algorithm 1 as it stands, and the tests compare with it. At any time each infeasible transition's
//! bridge is as short as the shortest that has ever been in the history, and in a world of few states it is the best.

pub mod cells;
mod frontier;
pub mod graph;
mod horizon;
pub mod oracle;
mod outlook;
mod room;
pub mod search;
pub mod store;
pub mod straight;
pub mod strides;
mod trace;
mod wanted;

#[cfg(test)]
mod tests;

use crate::demonstration::Order;
use crate::history::Stored;
use crate::similarity::{Hit, Similarity};
use crate::states::States;
use graph::{Graph, News};
use trestle_proto::annotation::{AnnotationTable, Bridge};

/// More steps than any path has.
const NEVER: u32 = u32::MAX;

/// The definition's parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BridgeRule {
    /// Most observer steps, 1 to 64.
    pub k: usize,
    /// Most mentor steps, 1 to 64.
    pub n: usize,
    /// A mentor transition with this e_KL or more is infeasible.
    pub e_infeas: f32,
}

/// The mentor's path, as bridge search sees it.
#[derive(Clone, Copy, Debug)]
pub struct Path<'a> {
    /// The parameters of bridges.
    pub rule: BridgeRule,
    /// The order of its states.
    pub order: &'a Order,
    /// Which of its states are similar to a state.
    pub similarity: &'a Similarity,
}

impl Path<'_> {
    /// The smallest KL among the `hits` that are mentor states ahead of transition `j`, and how many mentor steps ahead the first
    /// such state is.
    fn nearest_end(&self, j: usize, hits: &[Hit]) -> Option<(f32, u32)> {
        let ahead = self.order.ahead(j, self.rule.n);
        let from = hits.partition_point(|hit| (hit.state as usize) < ahead.start);
        let inside = hits[from..].iter().take_while(|hit| (hit.state as usize) < ahead.end);
        let nearest = inside.reduce(|nearest, hit| if hit.kl < nearest.kl { hit } else { nearest })?;
        Some((nearest.kl, (nearest.state as usize - self.order.state_of(j)) as u32))
    }
}

/// The newest transition and where it has arrived.
#[derive(Clone, Copy, Debug)]
pub struct Arrival<'a> {
    /// The distinct states.
    pub states: &'a States,
    /// The stored transitions, the newest among them.
    pub graph: &'a Graph,
    /// The newest transition t.
    pub t: &'a Stored,
    /// Its number.
    pub index: u64,
    /// Number of the oldest stored transition.
    pub oldest: u64,
    /// Its effect on the graph.
    pub news: News,
    /// The mentor states similar to its beginning, and to its end.
    pub starts: &'a [Hit],
    /// See `starts`.
    pub ends: &'a [Hit],
}

/// Whether the newest transition is the first step of a path, and whether it is the last.
#[derive(Clone, Copy, Debug)]
struct Place {
    first: bool,
    last: bool,
}

/// The bridge of mentor transition `j`, if it counts.
fn known<'a>(table: &'a AnnotationTable, j: usize, rule: &BridgeRule) -> Option<Bridge<'a>> {
    table.bridge(j).filter(|known| known.length as usize <= rule.k)
}

/// The length of the bridge of mentor transition `j`, if it counts.
fn known_length(table: &AnnotationTable, j: usize, rule: &BridgeRule) -> Option<u32> {
    table.bridge_length(j).filter(|&length| length as usize <= rule.k)
}

/// Makes `found`, in which the newest transition has this `place`, the bridge of mentor transition `j` if it is better
/// than the known one. Returns whether it was.
fn improve(table: &mut AnnotationTable, j: usize, found: &Bridge<'_>, place: Place) -> bool {
    let better = table.bridge(j).is_none_or(|known| {
        if found.length != known.length {
            return found.length < known.length;
        }
        let better_start = found.end_kl <= known.end_kl && found.reward > known.reward;
        place.last && (found.end_kl < known.end_kl || better_start)
            || (place.first || known.end_kl == 0.0) && better_start
    });
    if better {
        table.set_bridge(j, found);
    }
    better
}
