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
//! Of two bridges the better one is the shorter; of equally long ones that with the smaller end KL; then that whose
//! first step has the higher reward. (The paper wants the shortest. The rest is our choice, and so is its order: a path
//! that truly returns to the mentor's is worth more than a reward that may owe to circumstances.) Only a better bridge
//! replaces the one that is known. Among equally good ones that one transition completes, the first step with the
//! smaller action, then the smaller s', wins, so that no order of storage shows.
//!
//! Bridges are looked for where the mentor transition is infeasible at the time: e_KL >= `e_infeas`, or no estimate
//! yet. A bridge is kept when the transitions that it was found from have left the history.
//!
//! # Search
//! Nothing is ever scanned. Every new bridge contains the newest transition, so it is enough to look for paths through
//! that one when it arrives: [`straight`] follows its predecessors, [`graph`] and [`search`] do the cross-referencing, and
//! `outlook` and `wanted` say beforehand where that could improve anything.
//! [`oracle`] is Algorithm 1 as it stands, which the tests compare with: at any time each infeasible transition's
//! bridge is exactly the best one that has ever been in the history.

pub mod cells;
mod frontier;
pub mod graph;
pub mod oracle;
mod outlook;
pub mod search;
pub mod store;
pub mod straight;
pub mod strides;
mod wanted;

#[cfg(test)]
mod tests;

use crate::demonstration::Order;
use trestle_proto::annotation::{AnnotationTable, Bridge};
use trestle_proto::similarity::{Hit, Similarity};

/// What bridges are.
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
    /// What bridges are.
    pub rule: BridgeRule,
    /// The order of its states.
    pub order: &'a Order,
    /// Which of its states are similar to a state.
    pub similarity: &'a Similarity,
}

impl Path<'_> {
    /// The smallest KL among the `hits` that are mentor states ahead of transition `j`.
    fn nearest_end(&self, j: usize, hits: &[Hit]) -> Option<f32> {
        let ahead = self.order.ahead(j, self.rule.n);
        let from = hits.partition_point(|hit| (hit.state as usize) < ahead.start);
        let inside = hits[from..].iter().take_while(|hit| (hit.state as usize) < ahead.end);
        inside.map(|hit| hit.kl).reduce(f32::min)
    }
}

/// Makes `found` the bridge of mentor transition `j` if it is better than the one that is known. Whether it was.
fn improve(table: &mut AnnotationTable, j: usize, found: &Bridge<'_>) -> bool {
    let better = table.bridge(j).is_none_or(|known| {
        (found.length, found.end_kl) < (known.length, known.end_kl)
            || ((found.length, found.end_kl) == (known.length, known.end_kl) && found.reward > known.reward)
    });
    if better {
        table.set_bridge(j, found);
    }
    better
}
