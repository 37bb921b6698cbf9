//! Where the agent was lately, where there is no map to count it on: some of its newest states.

use super::APART;
use super::moment::Head;
use std::collections::VecDeque;
use trestle_algorithm::agent::Agent;

/// States that a moment tells of, at most.
const MOST: usize = 256;

/// Every [`APART`]th of the newest states, the newest last, as they are drawn.
#[derive(Debug, Default)]
pub(super) struct Visits {
    kept: VecDeque<Vec<f64>>,
    /// Transitions that have been looked at, by their number in the history.
    seen: u64,
}

impl Visits {
    /// The points of the states that there are now.
    pub(super) fn look(&mut self, agent: &Agent, head: &Head) -> Vec<f64> {
        let replay = agent.replay();
        let next = replay.next_index();
        let newest = next.saturating_sub(APART * MOST as u64);
        let from = self.seen.max(replay.first_index()).max(newest);
        let mut wide = Vec::new();
        for index in (from..next).filter(|index| index.is_multiple_of(APART)) {
            self.kept.push_back(head.point(replay.obs(replay.slot(index)).wide(&mut wide)));
        }
        self.seen = next;
        let surplus = self.kept.len().saturating_sub(MOST);
        self.kept.drain(..surplus);
        self.kept.iter().flatten().copied().collect()
    }
}
