//! Where along the mentor's path an episode is, and in which episodes the guide is used at all.
//!
//! The place on the path is the furthest mentor state within the radius of the observer's state, among those whose length
//! differs from the last place's by no more than the window: what lies behind a wall or on another round of the path is out
//! of it. Where there is none it is found anew, as the nearest state within the radius, and where there is none either,
//! the last place stays: the guide leads back to the path.
//!
//! *Gate.* A guided episode got stuck if it neither succeeded nor came to the path's end, and its progress ended in the
//! first half of its steps. After k such episodes in a row an episode is guided with probability 1 / (1 + k): where the
//! guide cannot get on, the observer is soon left to itself, and where it can, nothing changes.

use super::path::MentorPath;
use crate::similarity::Hit;
use serde::{Deserialize, Serialize};

/// Lengths of a tracker, in the path's units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reach {
    /// How far from the last place, along the path and either way, the next one is looked for.
    pub window: f32,
    /// How far ahead of the place the goal is.
    pub ahead: f32,
}

/// One actor's progress. All of it belongs to a snapshot.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tracker {
    /// The mentor state that this episode is at; none before the path has been found.
    at: Option<u32>,
    /// The furthest share of the path in this episode, and after how many of its steps it was reached.
    furthest: Option<(f32, u64)>,
    /// Steps of this episode.
    steps: u64,
    /// Whether this episode is guided.
    guided: bool,
    /// Guided episodes in a row that got stuck.
    stuck: u32,
}

impl Tracker {
    /// The probability with which the next episode is guided.
    pub fn chance(&self) -> f64 {
        1.0 / (1.0 + f64::from(self.stuck))
    }

    /// Begins an episode; `u`, in [0, 1), decides whether it is guided.
    pub fn begin(&mut self, u: f64) {
        let guided = u < self.chance();
        *self = Self { guided, stuck: self.stuck, ..Self::default() };
    }

    /// Ends an episode, which may have been a success.
    pub fn finish(&mut self, success: bool) {
        if self.guided {
            self.stuck = if self.is_stuck(success) { self.stuck.saturating_add(1) } else { 0 };
        }
    }

    /// Whether an episode that ends now got stuck.
    pub fn is_stuck(&self, success: bool) -> bool {
        let (share, step) = self.furthest.unwrap_or((0.0, 0));
        !success && share < 1.0 && 2 * step <= self.steps
    }

    /// Takes in the observer's place, of the first state or of that which a step led to. `stack` and `hits` are working
    /// memory.
    pub fn observe(
        &mut self,
        path: &MentorPath,
        reach: &Reach,
        place: &[f32],
        stack: &mut Vec<u32>,
        hits: &mut Vec<Hit>,
    ) {
        path.near(place, stack, hits);
        let near_last = |m: usize, at: usize| {
            path.end(m) == path.end(at) && (path.length(m) - path.length(at)).abs() <= reach.window
        };
        let on = self.at.and_then(|at| {
            hits.iter().map(|hit| hit.state).rfind(|&state| near_last(state as usize, at as usize))
        });
        let nearest = || hits.iter().min_by(|a, b| a.kl.total_cmp(&b.kl)).map(|hit| hit.state);
        let Some(at) = on.or_else(nearest) else { return };
        self.at = Some(at);
        let share = path.share(at as usize);
        if self.furthest.is_none_or(|(furthest, _)| share > furthest) {
            self.furthest = Some((share, self.steps));
        }
    }

    /// Counts a step of the episode; to be called before what it led to is observed.
    pub fn step(&mut self) {
        self.steps += 1;
    }

    /// The mentor state that the guide aims at; none where the episode is not guided or the path has not been found.
    pub fn goal(&self, path: &MentorPath, reach: &Reach) -> Option<usize> {
        self.at.filter(|_| self.guided).map(|at| path.ahead(at as usize, reach.ahead))
    }

    /// The mentor state that this episode is at; none before the path has been found.
    pub fn at(&self) -> Option<usize> {
        self.at.map(|at| at as usize)
    }

    /// The furthest share of the path in this episode, 0 to 1; 0 before the path has been found.
    pub fn furthest(&self) -> f32 {
        self.furthest.map_or(0.0, |(share, _)| share)
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
    pub fn fits(&self, path: &MentorPath) -> bool {
        self.at.is_none_or(|at| (at as usize) < path.len())
    }
}
