//! Where along the mentor's path an episode is, in which episodes the guide is used at all, and where it lets go.
//!
//! The place on the path is the furthest mentor state within the radius of the observer's state, among those whose length
//! differs from the last place's by no more than the window: what lies behind a wall or on another round of the path is out
//! of it. Where there is none it is found anew, as the nearest state within the radius, and where there is none either,
//! the last place stays: the guide leads back to the path.
//!
//! *Gate.* The record is the furthest share of a path over all of an actor's episodes, since its own paths changed last. A guided
//! episode got stuck if it neither succeeded nor came further than the record. After k such episodes in a row an episode is guided with
//! probability 1 / (1 + k): where the guide cannot get on, the observer is soon left to itself.
//!
//! *Search.* As long as there is no own path, the probability is no less than `search`, since there is nothing yet that a guide could
//! disturb.
//!
//! *Balance.* With own paths, guided episodes may take as many steps as it took to find the first one, and from then on three times as
//! many as the other episodes: own paths are followed until they are learnt, and a quarter of the steps then looks for better ones.
//!
//! *Roaming.* Where a guided episode has not come further for `idle` steps, the guide lets go for `roam` steps, in which the
//! observer explores freely, and then leads again: the mentor may have gone on where the observer cannot, and the way round begins
//! elsewhere. As long as there is no own path, each time in a row is `back_off` times as long as the one before. At the end of a path
//! there is nothing to lead to, and it lets go for good.

use super::path::{Paths, Place, nearest};
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
    /// Steps for which it does the first time.
    pub roam: u64,
    /// By what each time in a row is longer than the one before, before there are own paths.
    pub back_off: f64,
    /// Least probability of a guided episode before there are own paths, 0 to 1.
    pub search: f64,
}

/// Steps of guided episodes for each step of others, once there are own paths.
const LED: u64 = 3;
/// Steps for which a guide lets go at most.
const MOST_ROAMING: f64 = 1e9;

impl Pace {
    /// By resolved settings.
    pub fn of(settings: &Learned) -> Self {
        Self {
            window: settings.window as f32,
            lookahead: settings.lookahead as f32,
            gate: settings.gate,
            idle: settings.idle,
            roam: settings.roam,
            back_off: settings.back_off,
            search: settings.search,
        }
    }
}

/// One actor's progress. All of it belongs to a snapshot.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tracker {
    /// Where this episode is; none before a path has been found.
    at: Option<Place>,
    /// The furthest share of a path in this episode; none before one has been found.
    furthest: Option<f32>,
    /// The furthest share over all episodes, since own paths changed last.
    record: f32,
    /// Whether this episode has extended it.
    news: bool,
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
    /// Times in a row that the guide has let go in this episode, without coming further.
    lapses: u32,
    /// Whether there are own paths.
    own: bool,
    /// Steps before there were own paths.
    sought: u64,
    /// Steps since then in episodes that are guided, and in others.
    led: u64,
    free: u64,
}

impl Tracker {
    /// The probability with which the next episode is guided.
    pub fn chance(&self, pace: &Pace) -> f64 {
        let least = if self.own { 0.0 } else { pace.search };
        match pace.gate {
            true if self.own && self.led > self.sought.saturating_add(self.free.saturating_mul(LED)) => 0.0,
            true => (1.0 / (1.0 + f64::from(self.stuck))).max(least),
            false => 1.0,
        }
    }

    /// Begins an episode; `u`, in [0, 1), decides whether it is guided.
    pub fn begin(&mut self, pace: &Pace, u: f64) {
        self.guided = u < self.chance(pace);
        (self.at, self.furthest, self.news) = (None, None, false);
        (self.steps, self.led_from, self.roaming, self.lapses) = (0, 0, 0, 0);
    }

    /// Whether this episode looks for the first success: it is guided, and there is no own path.
    pub fn searches(&self, pace: &Pace) -> bool {
        self.guided && !self.own && pace.search > 0.0
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
        !success && !self.news
    }

    /// Own paths have changed, and there are some: what was found out about the former ones does not count any more.
    pub fn renew(&mut self) {
        self.at = self.at.filter(|at| !at.own);
        (self.furthest, self.record, self.stuck, self.own) = (None, 0.0, 0, true);
    }

    /// Takes in the place that a step has led to, as [`Tracker::observe`] does.
    pub fn follow(
        &mut self,
        paths: &Paths,
        pace: &Pace,
        place: &[f32],
        stack: &mut Vec<u32>,
        hits: &mut Vec<Hit>,
    ) {
        self.steps += 1;
        *match (self.own, self.guided) {
            (false, _) => &mut self.sought,
            (true, true) => &mut self.led,
            (true, false) => &mut self.free,
        } += 1;
        self.observe(paths, pace, place, stack, hits);
        if self.roaming > 0 {
            self.roaming -= 1;
            if self.roaming == 0 {
                self.led_from = self.steps;
            }
        } else if pace.idle > 0 && self.steps - self.led_from >= pace.idle {
            let longer = if self.own { 1.0 } else { pace.back_off.powi(self.lapses.min(1000) as i32) };
            self.roaming = (pace.roam as f64 * longer).min(MOST_ROAMING) as u64;
            self.lapses = self.lapses.saturating_add(1);
        }
    }

    /// Takes in the place of an episode's first state. `stack` and `hits` are working memory.
    pub fn observe(
        &mut self,
        paths: &Paths,
        pace: &Pace,
        place: &[f32],
        stack: &mut Vec<u32>,
        hits: &mut Vec<Hit>,
    ) {
        let own = paths.near(place, stack, hits);
        let on = self.at.filter(|at| at.own == own).and_then(|at| {
            let (path, at) = (paths.of(at), at.number as usize);
            let near = |m: usize| {
                path.end(m) == path.end(at) && (path.length(m) - path.length(at)).abs() <= pace.window
            };
            hits.iter().map(|hit| hit.state).rfind(|&state| near(state as usize))
        });
        let Some(number) = on.or_else(|| nearest(hits).map(|hit| hit.state)) else { return };
        let at = Place { own, number };
        self.at = Some(at);
        let share = paths.of(at).share(number as usize);
        if self.furthest.is_none_or(|furthest| share > furthest) {
            self.furthest = Some(share);
            (self.led_from, self.lapses) = (self.steps, 0);
        }
        if share > self.record {
            (self.record, self.news) = (share, true);
        }
    }

    /// The place that the guide aims at; none where the episode is not guided, the guide lets go, or no path has been found.
    pub fn goal<'a>(&self, paths: &'a Paths, pace: &Pace) -> Option<&'a [f32]> {
        let leads = self.guided && self.roaming == 0 && self.furthest() < 1.0;
        self.at.filter(|_| leads).map(|at| self.aim(paths, pace, at))
    }

    /// The same in an episode that is guided throughout.
    pub fn next<'a>(&self, paths: &'a Paths, pace: &Pace) -> Option<&'a [f32]> {
        self.at.map(|at| self.aim(paths, pace, at))
    }

    fn aim<'a>(&self, paths: &'a Paths, pace: &Pace, at: Place) -> &'a [f32] {
        let path = paths.of(at);
        path.place(path.ahead(at.number as usize, pace.lookahead))
    }

    /// Where this episode is; none before a path has been found.
    pub fn at(&self) -> Option<Place> {
        self.at
    }

    /// The furthest share of a path in this episode, 0 to 1; 0 before one has been found.
    pub fn furthest(&self) -> f32 {
        self.furthest.unwrap_or(0.0)
    }

    /// Guided episodes in a row that got stuck.
    pub fn stuck(&self) -> u32 {
        self.stuck
    }

    /// Whether this episode is guided.
    pub fn guided(&self) -> bool {
        self.guided
    }

    /// Whether the tracker can be one of paths with so many places of the mentor's and of the observer's own.
    pub fn fits(&self, mentor: usize, own: usize) -> bool {
        let there = |at: Place| (at.number as usize) < if at.own { own } else { mentor };
        self.at.is_none_or(there) && self.led_from <= self.steps
    }
}
