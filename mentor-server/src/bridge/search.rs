//! Cross-referenced bridges: all paths through the newest transition, by breadth-first search in both directions.
//!
//! A bridge through transition t is p steps that lead to t, t itself, and q steps that follow, p + 1 + q <= k. Forward
//! from t, level q holds the states that q further steps reach; backward, level p the states from which p steps
//! lead to t. For each mentor transition the smallest p of a state similar to its beginning and the smallest q of a
//! state similar to one ahead of it make the shortest bridge through t, and each level gives the best of its ties. A
//! state is expanded at its first level only, since a later one makes no shorter path.
//!
//! What a level holds depends on the stored transitions alone, not on the order in which the graph keeps them. A search
//! that has looked at [`MAX_LOOKS`] states and links in one direction drops the whole level that it is in, and goes no
//! further that way: the choice, too, is one of the stored transitions alone.

use super::graph::{Graph, News};
use super::{Path, improve};
use crate::history::Stored;
use crate::metric::kl;
use crate::similarity::{Hit, transitions};
use crate::states::States;
use std::cmp::Ordering;
use trestle_proto::annotation::{AnnotationTable, Bridge};

/// States and links that a search looks at in each direction, at most. Beyond it bridges may be missed, or longer
/// than they could be; those without cross-referencing never are.
pub const MAX_LOOKS: usize = 1 << 15;
const NEVER: u32 = u32::MAX;

/// Which states have been seen in the present search.
#[derive(Clone, Debug, Default)]
struct Marks {
    stamps: Vec<u32>,
    now: u32,
}

impl Marks {
    fn begin(&mut self, bound: usize) {
        if self.now == u32::MAX {
            self.stamps.fill(0);
            self.now = 0;
        }
        self.now += 1;
        self.stamps.resize(bound.max(self.stamps.len()), 0);
    }

    /// Marks `id`; whether it was not marked before.
    fn first_time(&mut self, id: u32) -> bool {
        std::mem::replace(&mut self.stamps[id as usize], self.now) != self.now
    }
}

/// The first step of a path, as far as it decides between equally long ones.
#[derive(Clone, Copy, Debug)]
struct First {
    action: u32,
    reward: f32,
    to: u32,
}

impl First {
    fn beats(&self, other: &Self, states: &States) -> bool {
        let features = || {
            let pairs = states.raw(self.to).iter().zip(states.raw(other.to));
            pairs.map(|(a, b)| a.total_cmp(b)).find(|o| o.is_ne()).unwrap_or(Ordering::Equal)
        };
        let order = other.reward.total_cmp(&self.reward).then(self.action.cmp(&other.action));
        order.then_with(features).is_lt()
    }
}

/// Where paths from t end, for each mentor state: fewest steps after t, then smallest KL.
#[derive(Clone, Debug, Default)]
struct Ends {
    steps: Vec<u32>,
    kl: Vec<f32>,
    touched: Vec<u32>,
}

/// Where paths to t begin, for each mentor transition: fewest steps before t, then best first step.
#[derive(Clone, Debug, Default)]
struct Starts {
    steps: Vec<u32>,
    first: Vec<First>,
    touched: Vec<u32>,
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
    /// What it has added to the graph.
    pub news: News,
}

/// Working memory of the search.
#[derive(Clone, Debug)]
pub struct Search {
    /// [`MAX_LOOKS`], but for tests.
    pub(crate) limit: usize,
    ends: Ends,
    starts: Starts,
    /// States reached; those of them that a path may go on from; states that a step leaves from.
    reached: Marks,
    continued: Marks,
    left: Marks,
    level: Vec<u32>,
    next_level: Vec<u32>,
    next_reached: Vec<u32>,
    back: Vec<(u32, First)>,
    next_back: Vec<(u32, First)>,
    /// Position of a state in `next_back`, where it is there.
    slots: Vec<u32>,
    stack: Vec<u32>,
    hits: Vec<Hit>,
    cut_short: u64,
}

impl Search {
    /// Working memory for a demonstration with this many states and transitions.
    pub fn new(mentor_states: usize, mentor_transitions: usize) -> Self {
        let nowhere = First { action: 0, reward: 0.0, to: 0 };
        Self {
            limit: MAX_LOOKS,
            ends: Ends {
                steps: vec![NEVER; mentor_states],
                kl: vec![f32::INFINITY; mentor_states],
                touched: Vec::new(),
            },
            starts: Starts {
                steps: vec![NEVER; mentor_transitions],
                first: vec![nowhere; mentor_transitions],
                touched: Vec::new(),
            },
            reached: Marks::default(),
            continued: Marks::default(),
            left: Marks::default(),
            level: Vec::new(),
            next_level: Vec::new(),
            next_reached: Vec::new(),
            back: Vec::new(),
            next_back: Vec::new(),
            slots: Vec::new(),
            stack: Vec::new(),
            hits: Vec::new(),
            cut_short: 0,
        }
    }

    /// Searches that met their limit so far.
    pub fn cut_short(&self) -> u64 {
        self.cut_short
    }

    /// Looks for bridges through a new transition and improves `table`. `improved` is called with each mentor
    /// transition whose bridge was replaced.
    pub fn run(
        &mut self,
        new: &Arrival<'_>,
        path: &Path<'_>,
        table: &mut AnnotationTable,
        mut improved: impl FnMut(usize),
    ) {
        if new.news == News::Nothing {
            return;
        }
        let bound = new.states.bound();
        [&mut self.reached, &mut self.continued, &mut self.left]
            .into_iter()
            .for_each(|marks| marks.begin(bound));
        self.forward(new, path);
        let nearest = self.ends.touched.iter().map(|&m| self.ends.steps[m as usize] as usize).min();
        if let Some(nearest) = nearest {
            let before = if new.news == News::Link { path.rule.k - 1 - nearest } else { 0 };
            [&mut self.reached, &mut self.left].into_iter().for_each(|marks| marks.begin(bound));
            self.backward(new, before, path, table);
            self.join(new, path, table, &mut improved);
        }
        self.ends.touched.drain(..).for_each(|m| self.ends.steps[m as usize] = NEVER);
        self.starts.touched.drain(..).for_each(|j| self.starts.steps[j as usize] = NEVER);
    }

    /// Fills `ends`.
    fn forward(&mut self, new: &Arrival<'_>, path: &Path<'_>) {
        let Arrival { states, graph, t, .. } = *new;
        self.reached.first_time(t.to);
        self.arrive(states, t.to, 0, path);
        self.level.clear();
        if t.ends_episode() {
            return;
        }
        self.continued.first_time(t.to);
        self.level.push(t.to);
        let mut looks = Looks { count: 0, limit: self.limit };
        for steps in 1..path.rule.k {
            self.next_level.clear();
            self.next_reached.clear();
            let Self { reached, continued, left, level, next_level, next_reached, .. } = self;
            for &y in level.iter() {
                similar(graph, states, y, path, &mut looks, |z, looks| {
                    if !left.first_time(z) {
                        return;
                    }
                    looks.count += graph.outgoing(z).len();
                    for link in graph.outgoing(z) {
                        if reached.first_time(link.to) {
                            next_reached.push(link.to);
                        }
                        if link.continues() && continued.first_time(link.to) {
                            next_level.push(link.to);
                        }
                    }
                });
            }
            if looks.exhausted() {
                self.cut_short += 1;
                return;
            }
            for i in 0..self.next_reached.len() {
                self.arrive(states, self.next_reached[i], steps as u32, path);
            }
            std::mem::swap(&mut self.level, &mut self.next_level);
        }
    }

    /// Notes the mentor states that state `id`, `steps` steps after t, is similar to.
    fn arrive(&mut self, states: &States, id: u32, steps: u32, path: &Path<'_>) {
        path.similarity.states(states.whitened(id), &mut self.stack, &mut self.hits);
        for hit in &self.hits {
            let m = hit.state as usize;
            if self.ends.steps[m] == NEVER {
                self.ends.touched.push(hit.state);
            }
            if (steps, hit.kl) < (self.ends.steps[m], self.ends.kl[m]) {
                (self.ends.steps[m], self.ends.kl[m]) = (steps, hit.kl);
            }
        }
    }

    /// Fills `starts`, with at most `before` steps to t.
    fn backward(&mut self, new: &Arrival<'_>, before: usize, path: &Path<'_>, table: &AnnotationTable) {
        let Arrival { states, graph, t, .. } = *new;
        self.slots.resize(states.bound().max(self.slots.len()), 0);
        self.left.first_time(t.from);
        self.back.clear();
        self.back.push((t.from, First { action: t.action, reward: t.reward, to: t.to }));
        self.depart(states, 0, path, table);
        let mut looks = Looks { count: 0, limit: self.limit };
        for steps in 1..=before {
            self.next_back.clear();
            let Self { reached, left, back, next_back, slots, .. } = self;
            for &(z, _) in back.iter() {
                similar(graph, states, z, path, &mut looks, |y, looks| {
                    if !reached.first_time(y) {
                        return;
                    }
                    looks.count += graph.incoming(y).len();
                    for link in graph.incoming(y) {
                        let Some((action, reward)) = link.best_continuing() else { continue };
                        let (x, first) = (link.from, First { action, reward, to: y });
                        if left.first_time(x) {
                            slots[x as usize] = next_back.len() as u32;
                            next_back.push((x, first));
                        } else if let Some((at, known)) = next_back.get_mut(slots[x as usize] as usize)
                            && *at == x
                            && first.beats(known, states)
                        {
                            *known = first;
                        }
                    }
                });
            }
            if looks.exhausted() {
                self.cut_short += 1;
                return;
            }
            std::mem::swap(&mut self.back, &mut self.next_back);
            self.depart(states, steps as u32, path, table);
        }
    }

    /// Notes the infeasible mentor transitions whose beginnings the states of `back`, `steps` steps before t, are
    /// similar to.
    fn depart(&mut self, states: &States, steps: u32, path: &Path<'_>, table: &AnnotationTable) {
        for &(x, first) in &self.back {
            path.similarity.states(states.whitened(x), &mut self.stack, &mut self.hits);
            for (j, _) in transitions(&self.hits, path.order) {
                if table.errors()[j] < path.rule.e_infeas {
                    continue;
                }
                let known = self.starts.steps[j];
                if known == NEVER {
                    self.starts.touched.push(j as u32);
                }
                if steps < known || (steps == known && first.beats(&self.starts.first[j], states)) {
                    (self.starts.steps[j], self.starts.first[j]) = (steps, first);
                }
            }
        }
    }

    /// Puts beginnings and ends together.
    fn join(
        &self,
        new: &Arrival<'_>,
        path: &Path<'_>,
        table: &mut AnnotationTable,
        improved: &mut impl FnMut(usize),
    ) {
        for &j in &self.starts.touched {
            let j = j as usize;
            let mut end = (NEVER, f32::INFINITY);
            for m in path.order.ahead(j, path.rule.n) {
                if (self.ends.steps[m], self.ends.kl[m]) < end {
                    end = (self.ends.steps[m], self.ends.kl[m]);
                }
            }
            if end.0 == NEVER || (self.starts.steps[j] + 1 + end.0) as usize > path.rule.k {
                continue;
            }
            let first = &self.starts.first[j];
            let found = Bridge {
                action: first.action,
                length: self.starts.steps[j] + 1 + end.0,
                reward: first.reward,
                end_kl: end.1,
                next_obs: new.states.raw(first.to),
                // A first step with another behind it did not end its episode.
                terminated: self.starts.steps[j] == 0 && new.t.terminated(),
            };
            if improve(table, j, &found) {
                improved(j);
            }
        }
    }
}

/// How much a search has looked at in one direction.
struct Looks {
    count: usize,
    limit: usize,
}

impl Looks {
    fn exhausted(&self) -> bool {
        self.count > self.limit
    }
}

/// Calls `visit` with every stored state similar to state `id` while the limit lasts. Each state that is looked at
/// counts.
fn similar(
    graph: &Graph,
    states: &States,
    id: u32,
    path: &Path<'_>,
    looks: &mut Looks,
    mut visit: impl FnMut(u32, &mut Looks),
) {
    let centre = states.whitened(id);
    graph.cells.nearby(centre, |list| {
        looks.count += list.len();
        for &other in list {
            if looks.exhausted() {
                return;
            }
            if kl(centre, states.whitened(other)) <= path.similarity.e_th() {
                visit(other, looks);
            }
        }
    });
}
