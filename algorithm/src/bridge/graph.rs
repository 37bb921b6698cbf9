//! The stored transitions as a graph, for cross-referencing: nodes are the distinct states, and a *link* stands for
//! all stored transitions from one state to another.
//!
//! The transitions of a link are counted, so eviction removes a link exactly when its last stored transition goes. A link
//! keeps only the transitions that could be the best first step of a bridge while they are stored. It drops one as soon as
//! a newer one has the same action, the same end and a reward at least as high. So a link stays small however often it is
//! travelled, and its contents depend on the stored transitions alone.

use super::cells::Cells;
use super::strides::Strides;
use crate::history::Stored;
use crate::states::{MixedMap, States, mix};
use smallvec::{SmallVec, smallvec};
use trestle_proto::batch::{TERMINATED, TRUNCATED};

/// All stored transitions from one state to another.
#[derive(Clone, Debug)]
pub struct Link {
    /// s.
    pub from: u32,
    /// s'.
    pub to: u32,
    /// Positions in the two states' lists.
    out_at: u32,
    in_at: u32,
    count: u32,
    /// Mostly one, which lies here.
    steps: SmallVec<[Step; 1]>,
}

/// A stored transition that could be a bridge's first step.
#[derive(Clone, Copy, Debug)]
struct Step {
    index: u64,
    action: u32,
    reward: f32,
    /// Flags that end the episode.
    end: u32,
}

impl Link {
    /// Whether one of the transitions did not end its episode, so that a path may go on.
    pub fn continues(&self) -> bool {
        self.steps.iter().any(|step| step.end == 0)
    }

    /// Number of the newest of the transitions.
    pub fn newest(&self) -> u64 {
        // The newest one is never dropped.
        self.steps.iter().map(|step| step.index).max().unwrap_or(0)
    }

    /// Numbers and rewards of the transitions that are kept; the newest with the highest reward is among them.
    pub fn rewards(&self) -> impl Iterator<Item = (u64, f32)> {
        self.steps.iter().map(|step| (step.index, step.reward))
    }

    /// Action and reward of the best first step of a path that goes on: the highest reward, then the smallest action.
    pub fn best_continuing(&self) -> Option<(u32, f32)> {
        best(self.steps.iter().filter(|step| step.end == 0))
    }

    /// The same of the best step, whether or not a path may go on.
    pub fn best(&self) -> Option<(u32, f32)> {
        best(self.steps.iter())
    }
}

/// Action and reward of the best of `steps`: the highest reward, then the smallest action.
fn best<'a>(steps: impl Iterator<Item = &'a Step>) -> Option<(u32, f32)> {
    let best = steps.min_by(|a, b| b.reward.total_cmp(&a.reward).then(a.action.cmp(&b.action)))?;
    Some((best.action, best.reward))
}

/// The effect of a new transition on the graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum News {
    /// Nothing: paths through it existed already, with a first step no worse.
    Nothing,
    /// A better first step; no new path.
    FirstStep,
    /// New paths.
    Link,
}

/// Places of links. Where no state comes twice there are one or two, which lie with the state: a search that goes through many
/// states waits for memory most of the time.
type Links = SmallVec<[u32; 2]>;

/// The graph. Memory: about 100 bytes for each distinct pair (s, s') and 80 for each distinct state.
#[derive(Clone, Debug)]
pub struct Graph {
    /// The distinct states in space.
    pub cells: Cells,
    /// How far the stored transitions go.
    pub strides: Strides,
    links: Vec<Link>,
    free: Vec<u32>,
    /// Links that begin and that end in each state.
    outgoing: Vec<Links>,
    incoming: Vec<Links>,
    /// The link of each pair (s, s').
    known: MixedMap<u32>,
}

impl Graph {
    /// No transition yet.
    pub fn new(cells: Cells) -> Self {
        Self {
            cells,
            strides: Strides::default(),
            links: Vec::new(),
            free: Vec::new(),
            outgoing: Vec::new(),
            incoming: Vec::new(),
            known: MixedMap::default(),
        }
    }

    /// The links that begin in state `id`.
    pub fn outgoing(&self, id: u32) -> impl ExactSizeIterator<Item = &Link> {
        let list = self.outgoing.get(id as usize).map_or(&[][..], Links::as_slice);
        list.iter().map(|&at| &self.links[at as usize])
    }

    /// The links that end in state `id`.
    pub fn incoming(&self, id: u32) -> impl ExactSizeIterator<Item = &Link> {
        let list = self.incoming.get(id as usize).map_or(&[][..], Links::as_slice);
        list.iter().map(|&at| &self.links[at as usize])
    }

    /// The distinct states, in ascending order.
    pub fn states(&self) -> impl Iterator<Item = u32> {
        let touched = self.outgoing.iter().zip(&self.incoming).enumerate();
        touched.filter(|(_, (out, into))| !(out.is_empty() && into.is_empty())).map(|(id, _)| id as u32)
    }

    /// Has lists of similar states kept where cells are not `crowded` ([`Cells::widen`]).
    pub fn widen(&mut self, crowded: usize, states: &States) {
        let ids: Vec<u32> = self.states().collect();
        self.cells.widen(crowded, &ids, |id| states.whitened(id));
    }

    /// Adds a distinct state that has just come up.
    pub fn add_state(&mut self, id: u32, states: &States) {
        self.cells.insert(id, |id| states.whitened(id));
        let bound = states.bound();
        self.outgoing.resize_with(bound.max(self.outgoing.len()), Links::new);
        self.incoming.resize_with(bound.max(self.incoming.len()), Links::new);
    }

    /// Removes a distinct state that has just been released for the last time; no link touches it any more.
    pub fn remove_state(&mut self, id: u32, states: &States) {
        debug_assert!(self.outgoing[id as usize].is_empty() && self.incoming[id as usize].is_empty());
        self.cells.remove(id, |id| states.whitened(id));
    }

    /// Adds stored transition `index`.
    pub fn add(&mut self, index: u64, t: &Stored) -> News {
        let step =
            Step { index, action: t.action, reward: t.reward, end: t.flags & (TERMINATED | TRUNCATED) };
        let key = key(t.from, t.to);
        if let Some(&at) = self.known.get(&key) {
            return self.links[at as usize].add(step);
        }
        let (out_at, in_at) = (self.outgoing[t.from as usize].len(), self.incoming[t.to as usize].len());
        let link = Link {
            from: t.from,
            to: t.to,
            out_at: out_at as u32,
            in_at: in_at as u32,
            count: 1,
            steps: smallvec![step],
        };
        let at = match self.free.pop() {
            Some(at) => {
                self.links[at as usize] = link;
                at
            }
            None => {
                self.links.push(link);
                self.links.len() as u32 - 1
            }
        };
        self.known.insert(key, at);
        self.outgoing[t.from as usize].push(at);
        self.incoming[t.to as usize].push(at);
        News::Link
    }

    /// Removes stored transition `index`, which was added before.
    pub fn remove(&mut self, index: u64, t: &Stored) {
        let key = key(t.from, t.to);
        let Some(&at) = self.known.get(&key) else { return };
        let link = &mut self.links[at as usize];
        link.count -= 1;
        if link.count > 0 {
            link.steps.retain(|step| step.index != index);
            return;
        }
        let (out_at, in_at) = (link.out_at as usize, link.in_at as usize);
        link.steps = SmallVec::new();
        self.known.remove(&key);
        self.free.push(at);
        let list = &mut self.outgoing[t.from as usize];
        list.swap_remove(out_at);
        if let Some(&moved) = list.get(out_at) {
            self.links[moved as usize].out_at = out_at as u32;
        }
        let list = &mut self.incoming[t.to as usize];
        list.swap_remove(in_at);
        if let Some(&moved) = list.get(in_at) {
            self.links[moved as usize].in_at = in_at as u32;
        }
    }
}

impl Link {
    fn add(&mut self, step: Step) -> News {
        let goes_on = step.end == 0;
        let news = if goes_on && !self.continues() {
            News::Link
        } else if self.steps.iter().any(|s| (s.end == 0 || !goes_on) && s.reward >= step.reward) {
            News::Nothing
        } else {
            News::FirstStep
        };
        self.count += 1;
        let same = |s: &Step| s.action == step.action && s.end == step.end;
        self.steps.retain(|s| !(same(s) && s.reward <= step.reward));
        self.steps.push(step);
        news
    }
}

/// Identifies a pair of states.
fn key(from: u32, to: u32) -> u64 {
    // A bijection of the pair: different pairs have different keys.
    mix(0, u64::from(from) << 32 | u64::from(to))
}
