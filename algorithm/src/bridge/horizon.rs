//! How far stored states are from the mentor's path: lower bounds, which spare a search all that leads nowhere.
//!
//! The mentor's transitions form up to [`GROUPS`] groups, each a stretch of the demonstration. For each stored state and each
//! group two numbers of steps are kept:
//!
//! - *ahead*: no path from the state to where a bridge of the group may end is shorter;
//! - *behind*: no path to the state from where a bridge of the group may begin is shorter.
//!
//! A bridge through the newest transition t has at least as many steps as lie behind its beginning and ahead of its end
//! together, and t. Mostly that is too many in every group, and there is nothing to search for.
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
use super::graph::{Graph, News};
use super::{Arrival, Path, known};
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

/// What is known of a state in one direction.
#[derive(Clone, Debug)]
struct Label {
    /// The steps of a path of one step or more.
    onward: Steps,
    /// The groups to which the state itself belongs: as bits.
    here: u32,
}

impl Label {
    /// The steps of any path.
    fn least(&self) -> Steps {
        let mut least = self.onward;
        for (g, steps) in least.iter_mut().enumerate() {
            *steps *= u8::from(self.here >> g & 1 == 0);
        }
        least
    }

    /// Takes into account that a path of `steps` leads on. Whether that is news.
    fn lower(&mut self, steps: &Steps) -> bool {
        let is_news = steps.iter().zip(&self.onward).any(|(new, old)| new < old);
        self.onward.iter_mut().zip(steps).for_each(|(old, new)| *old = (*old).min(*new));
        is_news
    }
}

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
    of: Vec<Label>,
    /// States whose label has been lowered.
    queue: VecDeque<u32>,
}

/// The numbers of all stored states. Memory: about 75 bytes a state while they are kept.
#[derive(Clone, Debug)]
pub(super) struct Horizon {
    ahead: Labels,
    behind: Labels,
    /// Steps of the longest bridge that is of use in each group, or more.
    limits: Steps,
    /// Whether the limits must be brought up to date, all of them.
    stale: bool,
    searches: u64,
    n_transitions: usize,
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
    pub(super) fn new(n_transitions: usize) -> Self {
        let labels = |way| Labels { way, of: Vec::new(), queue: VecDeque::new() };
        Self {
            ahead: labels(Way::Ahead),
            behind: labels(Way::Behind),
            limits: [0; GROUPS],
            stale: true,
            searches: 0,
            n_transitions,
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
        self.give_up();
        (self.is_kept, self.is_ignored, self.expected) = (true, false, None);
        for labels in [&mut self.ahead, &mut self.behind] {
            labels.of = vec![Label { onward: FAR, here: 0 }; states.bound()];
        }
        for id in graph.states() {
            path.similarity.states(states.whitened(id), &mut stack, &mut hits);
            let here = self.groups(&hits, path);
            for (labels, here) in [&mut self.ahead, &mut self.behind].into_iter().zip(here) {
                labels.of[id as usize].here = here;
                if graph.cells.listed(id).is_none() {
                    labels.give_up(id);
                } else if here != 0 {
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

    /// The group of mentor transition `j`.
    fn group(&self, j: usize) -> usize {
        j * GROUPS.min(self.n_transitions) / self.n_transitions
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
            labels.of.resize(bound.max(labels.of.len()), Label { onward: FAR, here: 0 });
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

    /// Of which groups a bridge may end, and begin, in a state with these `hits`, as bits.
    fn groups(&self, hits: &[Hit], path: &Path<'_>) -> [u32; 2] {
        let ends = hits.iter().flat_map(|hit| path.order.behind(hit.state as usize, path.rule.n));
        let ends = ends.fold(0, |bits, j| bits | 1 << self.group(j));
        let starts = transitions(hits, path.order).fold(0, |bits, (j, _)| bits | 1 << self.group(j));
        [ends, starts]
    }

    /// Whether a bridge through t may be of use.
    pub(super) fn promises(&mut self, new: &Arrival<'_>, path: &Path<'_>, table: &AnnotationTable) -> bool {
        if !self.is_kept || self.is_ignored {
            return true;
        }
        self.refresh(path, table);
        let (ahead, behind) =
            (self.ahead.of[new.t.to as usize].least(), self.behind.of[new.t.from as usize].least());
        (0..GROUPS).any(|g| ahead[g] < self.limits[g].saturating_sub(behind[g]))
    }

    /// Whether the numbers are kept.
    #[cfg(test)]
    pub(super) fn is_kept(&self) -> bool {
        self.is_kept
    }

    /// Brings limits up to date: one after the other, or all where they may have risen.
    fn refresh(&mut self, path: &Path<'_>, table: &AnnotationTable) {
        let groups = GROUPS.min(self.n_transitions);
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
            let first = |g: usize| (g * self.n_transitions).div_ceil(groups);
            let useful = |j: usize| {
                let open = table.errors()[j] >= path.rule.e_infeas;
                let most = known(table, j, &path.rule).map_or(path.rule.k as u32, |known| known.length);
                if open { most as u8 } else { 0 }
            };
            self.limits[g] = (first(g)..first(g + 1)).map(useful).max().unwrap_or(0);
        }
    }
}

impl Labels {
    /// State `id` is in a crowd.
    fn give_up(&mut self, id: u32) {
        self.of[id as usize].onward = [0; GROUPS];
        self.queue.push_back(id);
    }

    /// State `id` has come up, which belongs to the groups `here` itself.
    fn meet(&mut self, id: u32, here: u32, graph: &Graph, states: &States, path: &Path<'_>) {
        let mut label = Label { onward: FAR, here };
        if graph.cells.listed(id).is_none() {
            label.onward = [0; GROUPS];
            self.of[id as usize] = label;
            return;
        }
        let (of, way) = (&self.of, self.way);
        around(id, graph, states, path, |z| {
            let mut link = |next: u32| _ = label.lower(&further(&of[next as usize], u8::MAX));
            match way {
                Way::Ahead => graph.outgoing(z).for_each(|l| link(l.to)),
                Way::Behind => graph.incoming(z).for_each(|l| link(l.from)),
            }
        });
        self.of[id as usize] = label;
    }

    /// A step leads from state `id` on to state `next`. Numbers of `most` steps and more do not matter.
    fn join(&mut self, id: u32, next: u32, most: u8, graph: &Graph, states: &States, path: &Path<'_>) {
        let steps = further(&self.of[next as usize], most);
        let Self { of, queue, .. } = self;
        around(id, graph, states, path, |x| {
            if of[x as usize].lower(&steps) {
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

/// One step more than `label` says; [`FAR`] where that is `most` or more.
fn further(label: &Label, most: u8) -> Steps {
    let mut steps = label.least();
    for step in &mut steps {
        *step = step.saturating_add(1);
        if *step >= most {
            *step = u8::MAX;
        }
    }
    steps
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
