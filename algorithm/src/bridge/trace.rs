//! The steps of a bridge that the search has found, one by one.
//!
//! The search knows of a bridge through transition t how long it is, how it begins and how near to the mentor's path it ends.
//! There may be several such paths. The choice among them must depend on the stored transitions alone, so that a run that is
//! resumed finds the same one:
//!
//! - Before t, step by step from the bridge's beginning: of all steps from which t is still reached in time, the one with the
//!   highest reward, then the smallest action, then the smallest s'.
//! - The path ends in the smallest of the states that end it.
//! - After t, step by step from there back to t: of all steps that lead on, the one with the highest reward, then the smallest
//!   action, then the smallest state behind the step before.
//!
//! States are compared feature by feature. The levels of the search hold every state of such a path, each at its place, since the search
//! leaves out only states that lead to no bridge, and the paths are the shortest ones.

use super::frontier::{Seen, Step, each_similar};
use super::graph::Link;
use super::{Arrival, Path};
use crate::similarity::metric::kl;
use crate::states::States;

/// A path as its steps after the first.
#[derive(Clone, Debug, Default)]
pub(super) struct Trail {
    /// The action of each, and the state behind the step before.
    steps: Vec<(u32, u32)>,
}

impl Trail {
    /// The action of each step after the first, and the state in which it is taken.
    pub(super) fn steps<'a>(&self, states: &'a States) -> impl Iterator<Item = (u32, &'a [f32])> {
        self.steps.iter().map(|&(action, state)| (action, states.raw(state)))
    }
}

/// At which level the search has seen states.
#[derive(Clone, Copy, Debug)]
pub(super) struct Levels<'a> {
    /// After t: the states reached; those from which a path may go on; those that a step leaves.
    pub(super) reached: &'a Seen,
    pub(super) continued: &'a Seen,
    pub(super) onward: &'a Seen,
    /// Before t: the states from which a path comes in; those that a step leaves.
    pub(super) entered: &'a Seen,
    pub(super) left: &'a Seen,
}

/// What the search knows of a bridge.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ends<'a> {
    /// Steps before t, and after it.
    pub(super) before: u32,
    pub(super) after: u32,
    /// Its first step.
    pub(super) first: Step,
    /// The mentor state that it reaches, whitened, and the KL to it.
    pub(super) goal: &'a [f32],
    pub(super) end_kl: f32,
}

/// Fills `trail` with the steps of the bridge through t that has these `ends`. The search has just found it, and has these `levels`.
pub(super) fn trace(
    ends: &Ends<'_>,
    levels: &Levels<'_>,
    new: &Arrival<'_>,
    path: &Path<'_>,
    trail: &mut Trail,
) {
    trail.steps.clear();
    let whole = follow(ends, levels, new, path, &mut trail.steps);
    debug_assert!(whole.is_some(), "the levels lack a state of {ends:?}");
    if whole.is_none() {
        trail.steps.clear();
    }
}

/// Appends the steps to `steps`. None if a level lacks a state of the path.
fn follow(
    ends: &Ends<'_>,
    levels: &Levels<'_>,
    new: &Arrival<'_>,
    path: &Path<'_>,
    steps: &mut Vec<(u32, u32)>,
) -> Option<()> {
    // Where the path has arrived.
    let mut at = ends.first.to;
    for left in (1..ends.before).rev() {
        let next = step_towards(at, left, levels, new, path)?;
        steps.push((next.action, at));
        at = next.to;
    }
    if ends.before > 0 {
        steps.push((new.t.action, at));
    }
    let behind_t = steps.len();
    let mut at = end(ends, levels, new)?;
    for level in (1..=ends.after).rev() {
        // The last step alone may end its episode.
        let of_link = if level == ends.after { Link::best } else { Link::best_continuing };
        let before = step_from(at, level, of_link, levels, new, path)?;
        steps.push((before.action, before.to));
        at = before.to;
    }
    steps[behind_t..].reverse();
    Some(())
}

/// The best step that goes on from state `at` and begins a path of `left` steps to t's beginning.
fn step_towards(at: u32, left: u32, levels: &Levels<'_>, new: &Arrival<'_>, path: &Path<'_>) -> Option<Step> {
    let mut best: Option<Step> = None;
    each_similar(new.graph, new.states, at, path, |z| {
        if !levels.left.is_at(z, left) {
            return;
        }
        for link in new.graph.outgoing(z).filter(|link| levels.entered.is_at(link.to, left)) {
            let Some((action, reward)) = link.best_continuing() else { continue };
            keep_best(&mut best, Step { action, reward, to: link.to }, new.states);
        }
    });
    best
}

/// The state in which the path ends: the smallest one at its level with its KL.
fn end(ends: &Ends<'_>, levels: &Levels<'_>, new: &Arrival<'_>) -> Option<u32> {
    let Arrival { states, graph, t, .. } = *new;
    if ends.after == 0 {
        return Some(t.to);
    }
    let mut found: Option<u32> = None;
    graph.cells.nearby(ends.goal, |cell| {
        let there = |id: &&u32| {
            levels.reached.is_at(**id, ends.after) && kl(states.whitened(**id), ends.goal) == ends.end_kl
        };
        for &id in cell.iter().filter(there) {
            if found.is_none_or(|known| states.order(id, known).is_lt()) {
                found = Some(id);
            }
        }
    });
    found
}

/// The best step that ends in state `at`, so many steps after t, with `to` as the state behind the step before it.
fn step_from(
    at: u32,
    level: u32,
    of_link: impl Fn(&Link) -> Option<(u32, f32)>,
    levels: &Levels<'_>,
    new: &Arrival<'_>,
    path: &Path<'_>,
) -> Option<Step> {
    let mut best: Option<Step> = None;
    for link in new.graph.incoming(at).filter(|link| levels.onward.is_at(link.from, level)) {
        let Some((action, reward)) = of_link(link) else { continue };
        each_similar(new.graph, new.states, link.from, path, |y| {
            if levels.continued.is_at(y, level - 1) {
                keep_best(&mut best, Step { action, reward, to: y }, new.states);
            }
        });
    }
    best
}

fn keep_best(best: &mut Option<Step>, step: Step, states: &States) {
    if best.is_none_or(|known| step.beats(&known, states)) {
        *best = Some(step);
    }
}
