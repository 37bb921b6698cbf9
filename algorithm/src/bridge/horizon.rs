//! How far stored states are from the mentor's path: lower bounds, which spare a search all that leads nowhere.
//!
//! The mentor's transitions form up to [`GROUPS`] groups of transitions that begin near each other. For each stored state and
//! each group two numbers of steps are kept:
//!
//! - *ahead*: no path from the state to where a bridge of the group may end is shorter;
//! - *behind*: no path to the state from where a bridge of the group may begin is shorter.
//!
//! A bridge through the newest transition t has at least as many steps as lie behind its beginning and ahead of its end
//! together, and t. Mostly that is too many in every group, and there is nothing to search for. A search that has begun asks
//! again after each level ([`Outline::is_settled`]): what is left may be too many, or more than its limit lets it look at.
//!
//! All this is kept only while searches without it are dear: after [`WINDOW`] transitions whose searches looked at many
//! states. Every now and then some searches go without it, to see whether they still are. The bridges found are the same with and
//! without it.
//!
//! A new transition lowers the numbers of the states before it and after it, and that of further ones as far as they
//! change. A number falls at most k times as long as its state is stored, so the work for a transition is bounded by what
//! lies around it. A transition that leaves raises nothing: the numbers stay lower bounds, and the numbers of newer states are formed
//! without it. In a crowd, where no lists of similar states are kept ([`super::cells`]), every number is 0.

use super::cells::CROWDED_AT_MOST;
use super::frontier::Side;
use super::graph::{Graph, News};
use super::{Arrival, Path, known_length};
use crate::demonstration::transitions;
use crate::similarity::Hit;
use crate::similarity::metric::kl;
use crate::states::States;
use std::collections::VecDeque;
use trestle_proto::annotation::AnnotationTable;

/// Groups of mentor transitions, at most.
pub(super) const GROUPS: usize = 32;
/// One group's limit is brought up to date in so many searches.
const REFRESH: u64 = 16;

/// Transitions between two decisions whether numbers are kept, while they are not.
const WINDOW: u32 = 1024;
/// They are from so many states and links a transition on.
const DEAR: u64 = 128;
/// While they are, the first searches of each [`CYCLE`] of transitions go without them, as many as [`PROBE`].
const CYCLE: u32 = 16_384;
const PROBE: u32 = 64;
/// They are given up below so many states and links a transition.
const CHEAP: u64 = 32;

/// A number of steps for each group.
type Steps = [u8; GROUPS];

/// More steps than any bridge has.
const FAR: Steps = [u8::MAX; GROUPS];

/// Where the steps of a path are counted to.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Way {
    Ahead,
    Behind,
}

/// The labels of all stored states in one direction.
#[derive(Clone, Debug)]
struct Labels {
    way: Way,
    /// The steps of any path from each state, or to it: 0 for the groups to which the state itself belongs.
    of: Vec<Steps>,
    /// States whose numbers have been lowered.
    queue: VecDeque<u32>,
}

/// The groups of mentor transitions.
#[derive(Clone, Debug, Default)]
struct Groups {
    /// The group of each mentor transition.
    of: Vec<u8>,
    /// The mentor transitions, a group's side by side, and where each group begins.
    members: Vec<u32>,
    starts: Vec<usize>,
}

/// The numbers of all stored states. Memory: about 70 bytes a state while they are kept, and 5 a mentor
/// transition from then on.
#[derive(Clone, Debug)]
pub(super) struct Horizon {
    ahead: Labels,
    behind: Labels,
    /// Steps of the longest bridge that is of use in each group, or more.
    limits: Steps,
    /// Whether the limits must be brought up to date, all of them.
    stale: bool,
    searches: u64,
    groups: Groups,
    /// Whether the numbers are kept, and whether the present search goes without them.
    is_kept: bool,
    is_ignored: bool,
    /// Number of the transition that comes next. One that does not come leaves numbers that may be too high.
    expected: Option<u64>,
    /// Transitions since the last decision, and what their searches looked at.
    transitions: u32,
    looks: u64,
}

impl Horizon {
    /// Nothing is stored yet.
    pub(super) fn new() -> Self {
        let labels = |way| Labels { way, of: Vec::new(), queue: VecDeque::new() };
        Self {
            ahead: labels(Way::Ahead),
            behind: labels(Way::Behind),
            limits: [0; GROUPS],
            stale: true,
            searches: 0,
            groups: Groups::default(),
            is_kept: false,
            is_ignored: false,
            expected: None,
            transitions: 0,
            looks: 0,
        }
    }

    /// Annotations have been replaced, or transitions stored without [`Horizon::add`].
    pub(super) fn forget(&mut self) {
        self.stale = true;
        self.give_up();
    }

    fn give_up(&mut self) {
        self.is_kept = false;
        (self.transitions, self.looks) = (0, 0);
        for labels in [&mut self.ahead, &mut self.behind] {
            (labels.of, labels.queue) = (Vec::new(), VecDeque::new());
        }
    }

    /// A search has looked at so many states and links.
    pub(super) fn looked(&mut self, looks: u64) {
        if !self.is_kept || self.is_ignored {
            self.looks += looks;
        }
    }

    /// Before the search through each transition, which has been stored: decides whether the numbers are kept.
    pub(super) fn prepare(&mut self, graph: &mut Graph, states: &States, path: &Path<'_>) {
        self.transitions += 1;
        if self.is_kept {
            self.is_ignored = self.transitions <= PROBE;
            if self.transitions == PROBE + 1 && self.looks < CHEAP * u64::from(PROBE) {
                self.give_up();
                graph.widen(0, states);
            } else if graph.cells.is_full() {
                graph.widen(graph.cells.crowded() / 2, states);
                self.build(graph, states, path);
                self.transitions = PROBE + 1;
            } else if self.transitions == CYCLE {
                (self.transitions, self.looks) = (0, 0);
            }
        } else if self.transitions == WINDOW {
            if self.looks >= DEAR * u64::from(WINDOW) {
                graph.widen(CROWDED_AT_MOST, states);
                self.build(graph, states, path);
            } else if graph.cells.is_wide() {
                graph.widen(0, states);
            }
            // The first probe comes after a cycle.
            (self.transitions, self.looks) = (if self.is_kept { PROBE + 1 } else { 0 }, 0);
        }
    }

    /// Forms the numbers of all stored states.
    pub(super) fn build(&mut self, graph: &Graph, states: &States, path: &Path<'_>) {
        let (mut stack, mut hits) = (Vec::new(), Vec::new());
        if self.groups.of.is_empty() {
            self.groups = Groups::new(path);
        }
        self.give_up();
        (self.is_kept, self.is_ignored, self.expected) = (true, false, None);
        for labels in [&mut self.ahead, &mut self.behind] {
            labels.of = vec![FAR; states.bound()];
        }
        for id in graph.states() {
            path.similarity.states(states.whitened(id), &mut stack, &mut hits);
            let here = self.groups(&hits, path);
            for (labels, here) in [&mut self.ahead, &mut self.behind].into_iter().zip(here) {
                labels.of[id as usize] = here;
                if graph.cells.listed(id).is_none() {
                    labels.give_up(id);
                } else if here != FAR {
                    labels.queue.push_back(id);
                }
            }
        }
        self.settle(graph, states, path);
    }

    fn settle(&mut self, graph: &Graph, states: &States, path: &Path<'_>) {
        let most = path.rule.k as u8;
        self.ahead.settle(most, graph, states, path);
        self.behind.settle(most, graph, states, path);
    }

    /// The newest transition has been stored.
    pub(super) fn add(&mut self, new: &Arrival<'_>, path: &Path<'_>) {
        let Arrival { states, graph, t, starts, ends, .. } = *new;
        if !self.is_kept {
            return;
        }
        if self.expected.is_some_and(|expected| expected != new.index) {
            self.give_up();
            return;
        }
        self.expected = Some(new.index + 1);
        if new.news != News::Link {
            return;
        }
        let bound = states.bound();
        for labels in [&mut self.ahead, &mut self.behind] {
            labels.of.resize(bound.max(labels.of.len()), FAR);
            graph.cells.dispersed().iter().for_each(|&id| labels.give_up(id));
        }
        for (id, hits) in [(t.from, starts), (t.to, ends)] {
            // A state that no other link touches has just come up, or may as well have.
            let links = graph.outgoing(id).chain(graph.incoming(id));
            if links.into_iter().all(|link| (link.from, link.to) == (t.from, t.to)) {
                let [here_ahead, here_behind] = self.groups(hits, path);
                self.ahead.meet(id, here_ahead, graph, states, path);
                self.behind.meet(id, here_behind, graph, states, path);
            }
        }
        let most = path.rule.k as u8;
        self.ahead.join(t.from, t.to, most, graph, states, path);
        self.behind.join(t.to, t.from, most, graph, states, path);
        self.settle(graph, states, path);
    }

    /// The numbers of a state with these `hits` as such, ahead and behind: 0 for the groups of which a bridge may end there, and
    /// begin there.
    fn groups(&self, hits: &[Hit], path: &Path<'_>) -> [Steps; 2] {
        let (mut ends, mut starts) = (FAR, FAR);
        for hit in hits {
            path.order.behind(hit.state as usize, path.rule.n).for_each(|j| ends[self.groups.group(j)] = 0);
        }
        transitions(hits, path.order).for_each(|(j, _)| starts[self.groups.group(j)] = 0);
        [ends, starts]
    }

    /// What is known of the bridges through t before a search: nothing while no numbers are kept.
    pub(super) fn outline(
        &mut self,
        new: &Arrival<'_>,
        path: &Path<'_>,
        table: &AnnotationTable,
    ) -> Option<Outline> {
        if !self.is_kept || self.is_ignored {
            return None;
        }
        self.refresh(path, table);
        let [ahead, behind] = [self.ahead.of[new.t.to as usize], self.behind.of[new.t.from as usize]];
        Some(Outline { ahead, behind, limits: self.limits })
    }

    /// Whether the numbers are kept.
    #[cfg(test)]
    pub(super) fn is_kept(&self) -> bool {
        self.is_kept
    }

    /// Brings limits up to date: one after the other, or all where they may have risen.
    fn refresh(&mut self, path: &Path<'_>, table: &AnnotationTable) {
        let groups = self.groups.starts.len();
        let due = match self.searches % REFRESH {
            _ if self.stale => 0..groups,
            0 => {
                let g = (self.searches / REFRESH) as usize % groups;
                g..g + 1
            }
            _ => 0..0,
        };
        self.searches += 1;
        self.stale = false;
        for g in due {
            let useful = |&j: &u32| {
                let j = j as usize;
                let open = table.errors()[j] >= path.rule.e_infeas;
                let most = known_length(table, j, &path.rule).unwrap_or(path.rule.k as u32);
                if open { most as u8 } else { 0 }
            };
            self.limits[g] = self.groups.members(g).iter().map(useful).max().unwrap_or(0);
        }
    }
}

impl Labels {
    /// State `id` is in a crowd.
    fn give_up(&mut self, id: u32) {
        self.of[id as usize] = [0; GROUPS];
        self.queue.push_back(id);
    }

    /// State `id` has come up, with the numbers `here` as such.
    fn meet(&mut self, id: u32, here: Steps, graph: &Graph, states: &States, path: &Path<'_>) {
        let mut own = here;
        if graph.cells.listed(id).is_none() {
            self.of[id as usize] = [0; GROUPS];
            return;
        }
        let (of, way) = (&self.of, self.way);
        around(id, graph, states, path, |z| {
            let mut link = |next: u32| _ = lower(&mut own, &further(&of[next as usize], u8::MAX));
            match way {
                Way::Ahead => graph.outgoing(z).for_each(|l| link(l.to)),
                Way::Behind => graph.incoming(z).for_each(|l| link(l.from)),
            }
        });
        self.of[id as usize] = own;
    }

    /// A step leads from state `id` on to state `next`. Numbers of `most` steps and more do not matter.
    fn join(&mut self, id: u32, next: u32, most: u8, graph: &Graph, states: &States, path: &Path<'_>) {
        let steps = further(&self.of[next as usize], most);
        let Self { of, queue, .. } = self;
        around(id, graph, states, path, |x| {
            if lower(&mut of[x as usize], &steps) {
                queue.push_back(x);
            }
        });
    }

    /// Lowers what follows from labels that have been lowered.
    fn settle(&mut self, most: u8, graph: &Graph, states: &States, path: &Path<'_>) {
        while let Some(id) = self.queue.pop_front() {
            match self.way {
                Way::Ahead => {
                    graph.incoming(id).for_each(|link| self.join(link.from, id, most, graph, states, path))
                }
                Way::Behind => {
                    graph.outgoing(id).for_each(|link| self.join(link.to, id, most, graph, states, path))
                }
            }
        }
    }
}

/// One step more than `steps`; [`FAR`] where that is `most` or more.
fn further(steps: &Steps, most: u8) -> Steps {
    let mut more = *steps;
    for steps in &mut more {
        *steps = steps.saturating_add(1);
        if *steps >= most {
            *steps = u8::MAX;
        }
    }
    more
}

/// Takes into account that a path of so many `steps` leads on from a state with numbers `known`. Whether that is news.
fn lower(known: &mut Steps, steps: &Steps) -> bool {
    // Without a branch for each number.
    let before = *known;
    for (known, steps) in known.iter_mut().zip(steps) {
        *known = (*known).min(*steps);
    }
    before != *known
}

impl Groups {
    /// The groups of all mentor transitions: stretches of equal length in an order in which near ones stand together.
    fn new(path: &Path<'_>) -> Self {
        let near = path.similarity.near_together();
        let members: Vec<u32> = near.filter_map(|m| path.order.transition_of(m)).map(|j| j as u32).collect();
        let groups = GROUPS.min(members.len());
        let starts = (0..groups).map(|g| (g * members.len()).div_ceil(groups)).collect();
        let mut of = vec![0; members.len()];
        for (place, &j) in members.iter().enumerate() {
            of[j as usize] = (place * groups / members.len()) as u8;
        }
        Self { of, members, starts }
    }

    /// The group of mentor transition `j`.
    fn group(&self, j: usize) -> usize {
        usize::from(self.of[j])
    }

    /// The mentor transitions of group `g`.
    fn members(&self, g: usize) -> &[u32] {
        let end = self.starts.get(g + 1).copied().unwrap_or(self.members.len());
        &self.members[self.starts[g]..end]
    }
}

/// Lower bounds for the bridges through the newest transition t, group by group.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outline {
    /// The fewest steps after t.
    ahead: Steps,
    /// The fewest steps before t.
    behind: Steps,
    /// The most steps of a bridge that is of use.
    limits: Steps,
}

impl Outline {
    /// Whether a bridge through t may be of use.
    pub(super) fn promises(&self) -> bool {
        (0..GROUPS).any(|g| self.ahead[g] < self.limits[g].saturating_sub(self.behind[g]))
    }

    /// Whether no further level can add a bridge that is of use to those which all levels so far make up.
    pub(super) fn is_settled(&self, ahead: &Side, behind: &Side) -> bool {
        // The fewest steps on a level that has not been looked at, and the most on one that may come.
        let next = |side: &Side| if side.open { side.steps as u8 + 1 } else { u8::MAX };
        let last = |side: &Side| if side.open { u8::MAX } else { side.steps as u8 };
        let ([next_ahead, next_behind], [last_ahead, last_behind]) =
            ([next(ahead), next(behind)], [last(ahead), last(behind)]);
        !(0..GROUPS).any(|g| {
            let (before, after, most) = (self.behind[g], self.ahead[g], self.limits[g]);
            let fits = |before: u8, after: u8| before.saturating_add(after) < most;
            before <= last_behind
                && after <= last_ahead
                && (fits(before, after.max(next_ahead)) || fits(before.max(next_behind), after))
        })
    }
}

/// Calls `visit` with every stored state that is similar to state `id` and not in a crowd, and perhaps with others that are.
fn around(id: u32, graph: &Graph, states: &States, path: &Path<'_>, mut visit: impl FnMut(u32)) {
    if let Some((listed, _)) = graph.cells.listed(id) {
        listed.iter().for_each(|&other| visit(other));
        return;
    }
    let centre = states.whitened(id);
    graph.cells.nearby(centre, |cell| {
        if graph.cells.is_crowd(cell) {
            return;
        }
        for &other in cell {
            if kl(centre, states.whitened(other)) <= path.similarity.e_th() {
                visit(other);
            }
        }
    });
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::bridge::BridgeRule;
    use crate::demonstration::Demonstration;
    use crate::similarity::Similarity;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn groups_part_the_mentor_transitions(places in proptest::collection::vec(-5i8..6, 2..200)) {
            let mut demo = Demonstration::new(vec!["x".into()]).unwrap();
            for part in places.chunks(7).filter(|part| part.len() > 1) {
                let states: Vec<f32> = part.iter().map(|&x| f32::from(x)).collect();
                demo.push_trajectory(&states, false).unwrap();
            }
            let (order, count) = (demo.order(), demo.n_transitions());
            let similarity = Similarity::new(demo.states().to_vec(), 1, 0.1);
            let rule = BridgeRule { k: 3, n: 1, e_infeas: 0.1 };
            let groups = Groups::new(&Path { rule, order: &order, similarity: &similarity });
            prop_assert_eq!(groups.starts.len(), GROUPS.min(count));
            let mut members: Vec<u32> = Vec::new();
            for g in 0..groups.starts.len() {
                let (size, even) = (groups.members(g).len(), count / groups.starts.len());
                prop_assert!((even..=even + 1).contains(&size));
                prop_assert!(groups.members(g).iter().all(|&j| groups.group(j as usize) == g));
                members.extend(groups.members(g));
            }
            members.sort_unstable();
            prop_assert_eq!(members, (0..count as u32).collect::<Vec<_>>());
        }

        /// Whether some bridge of use has a step on a level that has not been looked at: all numbers of steps are tried.
        #[test]
        fn what_is_settled_needs_no_further_level(
            bounds in proptest::collection::vec((0u8..6, 0u8..6, 0u8..8), 1..3),
            ahead in (0usize..5, any::<bool>()),
            behind in (0usize..5, any::<bool>()),
        ) {
            let mut outline = Outline { ahead: FAR, behind: FAR, limits: [0; GROUPS] };
            for (g, &(after, before, most)) in bounds.iter().enumerate() {
                (outline.ahead[g], outline.behind[g], outline.limits[g]) = (after, before, most);
            }
            let [ahead, behind] = [ahead, behind].map(|(steps, open)| {
                let mut side = Side::new(open, 0);
                side.steps = steps;
                side
            });
            let comes = |side: &Side, steps: usize| side.open || steps <= side.steps;
            let needs_more = |&(after, before, most): &(u8, u8, u8)| {
                (usize::from(after)..20).any(|q| {
                    (usize::from(before)..20).any(|p| {
                        p + 1 + q <= usize::from(most)
                            && comes(&ahead, q)
                            && comes(&behind, p)
                            && (q > ahead.steps || p > behind.steps)
                    })
                })
            };
            prop_assert_eq!(outline.is_settled(&ahead, &behind), !bounds.iter().any(needs_more));
            let promises = bounds.iter().any(|&(after, before, most)| after + before < most);
            prop_assert_eq!(outline.promises(), promises);
        }
    }
}
