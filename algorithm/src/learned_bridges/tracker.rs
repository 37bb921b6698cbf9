//! Where along the mentor's path an episode is, in which episodes the guide is used at all, and where it lets go.
//!
//! The place on the path is the furthest mentor state within the radius of the observer's state, among those whose length
//! differs from the last place's by no more than the window: what lies behind a wall or on another round of the path is out
//! of it. Where there is none it is found anew, as the nearest state within the radius, and where there is none either,
//! the last place stays: the guide leads back to the path.
//!
//! *Gate.* A guided episode got stuck if it neither succeeded nor came to the path's end, and its progress ended in the
//! first half of its steps. After k such episodes in a row an episode is guided with probability 1 / (1 + k): where the
//! guide cannot get on, the observer is soon left to itself, and where it can, nothing changes.
//!
//! *Frontier.* A guided episode that ends without success has failed at the furthest mentor state that it came to, and has
//! passed those that lie more than a lookahead before it. After `patience` failures in a row, without an episode that passed
//! it, a state is a frontier: the mentor may have gone on where the observer cannot. An episode that comes to one is let go
//! for the rest of its steps, so that it explores freely from there. With [`FrontierKind::Skip`] an episode that comes to a
//! state with twice as many failures is led on again, towards a goal that lies one lookahead further for each `patience`.

use super::path::MentorPath;
use crate::similarity::Hit;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;
use trestle_proto::config::{FrontierKind, Learned};

/// How a tracker goes along a path. Lengths are in the path's units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// How far from the last place, along the path and either way, the next one is looked for.
    pub window: f32,
    /// How far ahead of the place the goal is.
    pub lookahead: f32,
    /// Whether episodes are left to themselves after guided ones that got stuck.
    pub gate: bool,
    /// What happens at a frontier.
    pub frontier: FrontierKind,
    /// Failures in a row that make a frontier, 1 or more.
    pub patience: u32,
}

impl Pace {
    /// By resolved settings.
    pub fn of(settings: &Learned) -> Self {
        Self {
            window: settings.window as f32,
            lookahead: settings.lookahead as f32,
            gate: settings.gate,
            frontier: settings.frontier,
            patience: settings.patience,
        }
    }
}

/// One actor's progress. All of it belongs to a snapshot.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tracker {
    /// The mentor state that this episode is at; none before the path has been found.
    at: Option<u32>,
    /// The furthest place of this episode.
    furthest: Option<Furthest>,
    /// Steps of this episode.
    steps: u64,
    /// Whether this episode is guided.
    guided: bool,
    /// The last frontier that this episode has come to.
    frontier: Option<u32>,
    /// Guided episodes in a row that got stuck.
    stuck: u32,
    /// For each mentor state the guided episodes that have failed there since one passed it; empty where that is of no use.
    failures: Vec<u32>,
}

/// The furthest place of an episode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Furthest {
    state: u32,
    /// Its share of the path.
    share: f32,
    /// After how many steps of the episode it was reached.
    step: u64,
}

impl Tracker {
    /// Before the first episode along `path`.
    pub fn new(path: &MentorPath, pace: &Pace) -> Self {
        let counted = pace.frontier != FrontierKind::Pinned;
        Self { failures: vec![0; if counted { path.len() } else { 0 }], ..Self::default() }
    }

    /// The probability with which the next episode is guided.
    pub fn chance(&self, pace: &Pace) -> f64 {
        if pace.gate { 1.0 / (1.0 + f64::from(self.stuck)) } else { 1.0 }
    }

    /// Begins an episode; `u`, in [0, 1), decides whether it is guided.
    pub fn begin(&mut self, pace: &Pace, u: f64) {
        self.guided = u < self.chance(pace);
        (self.at, self.furthest, self.frontier, self.steps) = (None, None, None, 0);
    }

    /// Ends an episode, which may have been a success. Returns whether it got stuck.
    pub fn finish(&mut self, path: &MentorPath, pace: &Pace, success: bool) -> bool {
        let stuck = self.is_stuck(success);
        if self.guided {
            self.stuck = if stuck { self.stuck.saturating_add(1) } else { 0 };
            self.count(path, pace, success);
        }
        stuck
    }

    /// Counts what a guided episode says of the mentor states that it came to.
    fn count(&mut self, path: &MentorPath, pace: &Pace, success: bool) {
        let Some(furthest) = self.furthest.filter(|_| !self.failures.is_empty()) else { return };
        let state = furthest.state as usize;
        let arrived = success || furthest.share >= 1.0;
        let passed = if arrived { f32::INFINITY } else { path.length(state) - pace.lookahead };
        for m in path.trajectory(state) {
            if path.length(m) < passed {
                self.failures[m] = 0;
            }
        }
        if !arrived {
            self.failures[state] = self.failures[state].saturating_add(1);
        }
    }

    /// Whether an episode that ends now got stuck.
    pub fn is_stuck(&self, success: bool) -> bool {
        let (share, step) = self.furthest.map_or((0.0, 0), |furthest| (furthest.share, furthest.step));
        !success && share < 1.0 && 2 * step <= self.steps
    }

    /// Takes in the observer's place, of the first state or of that which a step led to. `stack` and `hits` are working
    /// memory.
    pub fn observe(
        &mut self,
        path: &MentorPath,
        pace: &Pace,
        place: &[f32],
        stack: &mut Vec<u32>,
        hits: &mut Vec<Hit>,
    ) {
        path.near(place, stack, hits);
        let near_last = |m: usize, at: usize| {
            path.end(m) == path.end(at) && (path.length(m) - path.length(at)).abs() <= pace.window
        };
        let on = self.at.and_then(|at| {
            hits.iter().map(|hit| hit.state).rfind(|&state| near_last(state as usize, at as usize))
        });
        let nearest = || hits.iter().min_by(|a, b| a.kl.total_cmp(&b.kl)).map(|hit| hit.state);
        let Some(at) = on.or_else(nearest) else { return };
        self.at = Some(at);
        let share = path.share(at as usize);
        if self.furthest.is_none_or(|furthest| share > furthest.share) {
            let passed = self.furthest.replace(Furthest { state: at, share, step: self.steps });
            self.look_for_frontier(path, pace, passed.map(|furthest| furthest.state as usize), at as usize);
        }
    }

    /// Looks for a frontier among the states that have been come to: all after `from` where that is of the same trajectory
    /// as `to`, else `to` alone.
    fn look_for_frontier(&mut self, path: &MentorPath, pace: &Pace, from: Option<usize>, to: usize) {
        let first =
            from.filter(|&from| path.end(from) == path.end(to) && from < to).map_or(to, |from| from + 1);
        let reached: RangeInclusive<usize> = first..=to;
        let failed = |m: &usize| self.failures.get(*m).is_some_and(|&failures| failures >= pace.patience);
        if let Some(frontier) = reached.rev().find(failed) {
            self.frontier = Some(frontier as u32);
        }
    }

    /// Counts a step of the episode; to be called before what it led to is observed.
    pub fn step(&mut self) {
        self.steps += 1;
    }

    /// The mentor state that the guide aims at; none where the episode is not guided, has been let go, or has not found the
    /// path.
    pub fn goal(&self, path: &MentorPath, pace: &Pace) -> Option<usize> {
        let at = self.at.filter(|_| self.guided)? as usize;
        let strides = match self.frontier.map(|frontier| frontier as usize) {
            None => 1,
            Some(frontier) => match self.failures[frontier] / pace.patience {
                times if pace.frontier == FrontierKind::Skip && times > 1 => {
                    let passed = path.end(at) != path.end(frontier)
                        || path.length(at) > path.length(frontier) + pace.lookahead;
                    if passed { 1 } else { times }
                }
                _ => return None,
            },
        };
        Some(path.ahead(at, strides as f32 * pace.lookahead))
    }

    /// The mentor state that this episode is at; none before the path has been found.
    pub fn at(&self) -> Option<usize> {
        self.at.map(|at| at as usize)
    }

    /// The furthest share of the path in this episode, 0 to 1; 0 before the path has been found.
    pub fn furthest(&self) -> f32 {
        self.furthest.map_or(0.0, |furthest| furthest.share)
    }

    /// Guided episodes in a row that got stuck.
    pub fn stuck(&self) -> u32 {
        self.stuck
    }

    /// Whether this episode is guided.
    pub fn guided(&self) -> bool {
        self.guided
    }

    /// Whether the tracker can be one of `path`.
    pub fn fits(&self, path: &MentorPath, pace: &Pace) -> bool {
        let known = |state: Option<u32>| state.is_none_or(|state| (state as usize) < path.len());
        let counted = self.failures.len() == Self::new(path, pace).failures.len();
        let frontier = self.frontier.is_none_or(|state| (state as usize) < self.failures.len());
        known(self.at) && known(self.furthest.map(|furthest| furthest.state)) && frontier && counted
    }
}
