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
//! *Roaming.* Where a guided episode has not come further for `idle` steps, the guide lets go for `roam` steps, in which the
//! observer explores freely, and then leads again: the mentor may have gone on where the observer cannot, and the way round begins
//! elsewhere.

use super::path::MentorPath;
use crate::similarity::Hit;
use serde::{Deserialize, Serialize};
use trestle_proto::config::Learned;

/// How a tracker goes along a path. Lengths are in the path's units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// How far from the last place, along the path and either way, the next one is looked for.
    pub window: f32,
    /// How far ahead of the place the goal is.
    pub lookahead: f32,
    /// Whether episodes are left to themselves after guided ones that got stuck.
    pub gate: bool,
    /// Steps without progress after which the guide lets go; 0: it never does.
    pub idle: u64,
    /// Steps for which it does.
    pub roam: u64,
}

impl Pace {
    /// By resolved settings.
    pub fn of(settings: &Learned) -> Self {
        Self {
            window: settings.window as f32,
            lookahead: settings.lookahead as f32,
            gate: settings.gate,
            idle: settings.idle,
            roam: settings.roam,
        }
    }
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
    /// Steps of this episode when it came further last, or when the guide began to lead again.
    led_from: u64,
    /// Steps for which the guide lets go from now on.
    roaming: u64,
    /// Guided episodes in a row that got stuck.
    stuck: u32,
}

impl Tracker {
    /// The probability with which the next episode is guided.
    pub fn chance(&self, pace: &Pace) -> f64 {
        if pace.gate { 1.0 / (1.0 + f64::from(self.stuck)) } else { 1.0 }
    }

    /// Begins an episode; `u`, in [0, 1), decides whether it is guided.
    pub fn begin(&mut self, pace: &Pace, u: f64) {
        self.guided = u < self.chance(pace);
        (self.at, self.furthest) = (None, None);
        (self.steps, self.led_from, self.roaming) = (0, 0, 0);
    }

    /// Ends an episode, which may have been a success. Returns whether it got stuck.
    pub fn finish(&mut self, success: bool) -> bool {
        let stuck = self.is_stuck(success);
        if self.guided {
            self.stuck = if stuck { self.stuck.saturating_add(1) } else { 0 };
        }
        stuck
    }

    /// Whether an episode that ends now got stuck.
    pub fn is_stuck(&self, success: bool) -> bool {
        let (share, step) = self.furthest.unwrap_or((0.0, 0));
        !success && share < 1.0 && 2 * step <= self.steps
    }

    /// Takes in the place that a step has led to, as [`Tracker::observe`] does.
    pub fn follow(
        &mut self,
        path: &MentorPath,
        pace: &Pace,
        place: &[f32],
        stack: &mut Vec<u32>,
        hits: &mut Vec<Hit>,
    ) {
        self.steps += 1;
        self.observe(path, pace, place, stack, hits);
        if self.roaming > 0 {
            self.roaming -= 1;
            if self.roaming == 0 {
                self.led_from = self.steps;
            }
        } else if pace.idle > 0 && self.steps - self.led_from >= pace.idle {
            self.roaming = pace.roam;
        }
    }

    /// Takes in the place of an episode's first state. `stack` and `hits` are working memory.
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
        if self.furthest.is_none_or(|(furthest, _)| share > furthest) {
            self.furthest = Some((share, self.steps));
            self.led_from = self.steps;
        }
    }

    /// The mentor state that the guide aims at; none where the episode is not guided, the guide lets go, or the path has not
    /// been found.
    pub fn goal(&self, path: &MentorPath, pace: &Pace) -> Option<usize> {
        let at = self.at.filter(|_| self.guided && self.roaming == 0)?;
        Some(path.ahead(at as usize, pace.lookahead))
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
        self.at.is_none_or(|at| (at as usize) < path.len()) && self.led_from <= self.steps
    }
}
