//! Cross-referenced bridges: all paths through the newest transition, by breadth-first search in both directions.
//!
//! A bridge through transition t is p steps that lead to t, t itself, and q steps that follow, p + 1 + q <= k. Forward
//! from t, level q holds the states that q further steps reach; backward, level p the states from which p steps
//! lead to t. For each mentor transition the smallest p of a state similar to its beginning and the smallest q of a
//! state similar to one ahead of it make the shortest bridge through t, and each level gives the best of its ties. A
//! state is expanded at its first level only, since a later one makes no shorter path.
//!
//! Only levels that could matter are looked at: those that together make no more than k steps, and no more than the
//! bridge that is known of a mentor transition found on the other side. Of two such levels the one with fewer states to
//! expand comes first. Far from the mentor's path, little is looked at.
//!
//! What a level holds depends on the stored transitions alone, not on the order in which the graph keeps them. A search
//! that has looked at [`MAX_LOOKS`] states and links in one direction drops the whole level that it is in, and goes no
//! further that way: the choice, too, is one of the stored transitions alone.

use super::frontier::{Marks, Side, similar};
use super::graph::{Graph, News};
use super::{Path, improve};
use crate::history::Stored;
use crate::similarity::{Hit, transitions};
use crate::states::States;
use std::cmp::Ordering;
use trestle_proto::annotation::{AnnotationTable, Bridge};

/// States and links that a search looks at in each direction, at most. Beyond it bridges may be missed, or longer
/// than they could be; those without cross-referencing never are.
pub const MAX_LOOKS: usize = 1 << 15;
const NEVER: u32 = u32::MAX;

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
    /// Forward: states reached; those of them that a path may go on from; states that its steps leave from.
    reached: Marks,
    continued: Marks,
    onward: Marks,
    level: Vec<u32>,
    next_level: Vec<u32>,
    next_reached: Vec<u32>,
    /// Backward: states from which a path comes in; states that its steps leave from.
    entered: Marks,
    left: Marks,
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
            onward: Marks::default(),
            entered: Marks::default(),
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
        let Arrival { states, t, news, .. } = *new;
        let bound = states.bound();
        let Self { reached, continued, onward, entered, left, .. } = self;
        [reached, continued, onward, entered, left].into_iter().for_each(|marks| marks.begin(bound));
        self.slots.resize(bound.max(self.slots.len()), 0);
        let mut ahead = Side::new(!t.ends_episode(), self.limit);
        let mut behind = Side::new(news == News::Link, self.limit);

        self.reached.first_time(t.to);
        self.continued.first_time(t.to);
        self.level.clear();
        self.level.push(t.to);
        self.arrive(states, t.to, &mut ahead, path, table);
        self.left.first_time(t.from);
        self.back.clear();
        self.back.push((t.from, First { action: t.action, reward: t.reward, to: t.to }));
        self.depart(states, &mut behind, path, table);
        let most = path.rule.k - 1;
        loop {
            match (ahead.is_wanted(&behind, most), behind.is_wanted(&ahead, most)) {
                (false, false) => break,
                (true, true) if self.back.len() < self.level.len() => {
                    self.backward(new, &mut behind, path, table)
                }
                (true, _) => self.forward(new, &mut ahead, path, table),
                (false, true) => self.backward(new, &mut behind, path, table),
            }
        }
        self.cut_short += u64::from(ahead.exhausted() || behind.exhausted());
        self.join(new, path, table, &mut improved);
        self.ends.touched.drain(..).for_each(|m| self.ends.steps[m as usize] = NEVER);
        self.starts.touched.drain(..).for_each(|j| self.starts.steps[j as usize] = NEVER);
    }

    /// The next level of states after t.
    fn forward(&mut self, new: &Arrival<'_>, side: &mut Side, path: &Path<'_>, table: &AnnotationTable) {
        let Arrival { states, graph, .. } = *new;
        self.next_level.clear();
        self.next_reached.clear();
        let Self { reached, continued, onward, level, next_level, next_reached, .. } = self;
        for &y in level.iter() {
            similar(graph, states, y, path, side, |z, side| {
                if !onward.first_time(z) {
                    return;
                }
                side.look(graph.outgoing(z).len());
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
        side.steps += 1;
        side.open = !side.exhausted() && !next_level.is_empty();
        if side.exhausted() {
            return;
        }
        std::mem::swap(&mut self.level, &mut self.next_level);
        for i in 0..self.next_reached.len() {
            self.arrive(states, self.next_reached[i], side, path, table);
        }
    }

    /// Notes the mentor states that state `id`, on the present level after t, is similar to.
    fn arrive(
        &mut self,
        states: &States,
        id: u32,
        side: &mut Side,
        path: &Path<'_>,
        table: &AnnotationTable,
    ) {
        let steps = side.steps as u32;
        path.similarity.states(states.whitened(id), &mut self.stack, &mut self.hits);
        for hit in &self.hits {
            let m = hit.state as usize;
            if self.ends.steps[m] == NEVER {
                self.ends.touched.push(hit.state);
                for j in path.order.behind(m, path.rule.n) {
                    side.asks = side.asks.max(spare(j, side.steps, path, table).unwrap_or(0));
                }
            }
            if (steps, hit.kl) < (self.ends.steps[m], self.ends.kl[m]) {
                (self.ends.steps[m], self.ends.kl[m]) = (steps, hit.kl);
            }
        }
    }

    /// The next level of states before t.
    fn backward(&mut self, new: &Arrival<'_>, side: &mut Side, path: &Path<'_>, table: &AnnotationTable) {
        let Arrival { states, graph, .. } = *new;
        self.next_back.clear();
        let Self { entered, left, back, next_back, slots, .. } = self;
        for &(z, _) in back.iter() {
            similar(graph, states, z, path, side, |y, side| {
                if !entered.first_time(y) {
                    return;
                }
                side.look(graph.incoming(y).len());
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
        side.steps += 1;
        side.open = !side.exhausted() && !next_back.is_empty();
        if side.exhausted() {
            return;
        }
        std::mem::swap(&mut self.back, &mut self.next_back);
        self.depart(states, side, path, table);
    }

    /// Notes the mentor transitions whose beginnings the states of `back`, on the present level before t, are similar
    /// to, where a bridge through them could be of use.
    fn depart(&mut self, states: &States, side: &mut Side, path: &Path<'_>, table: &AnnotationTable) {
        let steps = side.steps as u32;
        for &(x, first) in &self.back {
            path.similarity.states(states.whitened(x), &mut self.stack, &mut self.hits);
            for (j, _) in transitions(&self.hits, path.order) {
                let Some(spare) = spare(j, side.steps, path, table) else { continue };
                side.asks = side.asks.max(spare);
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

/// How many steps a bridge for mentor transition `j` may still have, besides t and `steps` others, to be as short as the
/// one that is known. None if it would be longer anyway, or if `j` is feasible and needs no bridge.
fn spare(j: usize, steps: usize, path: &Path<'_>, table: &AnnotationTable) -> Option<usize> {
    if table.errors()[j] < path.rule.e_infeas {
        return None;
    }
    let longest = table.bridge(j).map_or(path.rule.k, |b| path.rule.k.min(b.length as usize));
    longest.checked_sub(1 + steps)
}
