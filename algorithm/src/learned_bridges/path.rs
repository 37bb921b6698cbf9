//! The paths that a guide leads along: points among goals, the way covered up to each, and the one to aim at.
//!
//! All lengths are Euclidean in the chosen features, each in units of its scale. A change of a category is as long as one unit, but
//! places of different categories are never near. One trajectory's lengths begin at 0.

use super::goal::Goal;
use crate::similarity::metric::APART;
use crate::similarity::{Hit, Similarity};
use serde::{Deserialize, Serialize};
use trestle_proto::NONE;
use trestle_proto::acting::OwnPlaces;
use trestle_proto::waypoints::Waypoints;

/// Trajectories of places, ready for a tracker.
#[derive(Clone, Debug)]
pub struct Path {
    index: Similarity,
    /// The way covered from the beginning of its trajectory to each place.
    length: Vec<f32>,
    /// The last place of each place's trajectory.
    end: Vec<u32>,
}

impl Path {
    /// The trajectories with so many places each, one after the other in `places` (row-major, `dim` numbers, at least one
    /// place). The observer is at a place within `radius` (above 0).
    pub fn new(places: Vec<f32>, dim: usize, trajectories: &[u32], radius: f32) -> Self {
        let place = |m: usize| &places[m * dim..][..dim];
        let (mut length, mut end): (Vec<f32>, Vec<u32>) = (Vec::new(), Vec::new());
        for &count in trajectories {
            let (first, count) = (length.len(), count as usize);
            end.resize(first + count, (first + count - 1) as u32);
            let mut covered = 0.0;
            for m in first..first + count {
                if m > first {
                    covered += stride(place(m - 1), place(m));
                }
                length.push(covered);
            }
        }
        Self { index: Similarity::new(places, dim, kl_within(radius)), length, end }
    }

    /// The mentor's path: that of `waypoints`, states of `dim` features, at least one.
    pub fn of_mentor(waypoints: &Waypoints, dim: usize, goal: &Goal, radius: f32) -> Self {
        let mut places = Vec::new();
        waypoints.states.chunks_exact(dim).for_each(|state| goal.place(state, &mut places));
        let last = |transition: &u32| *transition == NONE;
        let trajectories: Vec<u32> =
            waypoints.transition_of.split_inclusive(last).map(|states| states.len() as u32).collect();
        Self::new(places, goal.dim(), &trajectories, radius)
    }

    /// Number of places.
    pub fn len(&self) -> usize {
        self.length.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.length.is_empty()
    }

    /// Place `m`.
    pub fn place(&self, m: usize) -> &[f32] {
        self.index.state(m)
    }

    /// The way covered up to place `m`.
    pub fn length(&self, m: usize) -> f32 {
        self.length[m]
    }

    /// The last place of `m`'s trajectory.
    pub fn end(&self, m: usize) -> usize {
        self.end[m] as usize
    }

    /// Share of its trajectory's way that is covered at place `m`, 0 to 1; 1 at the end of one that goes nowhere.
    pub fn share(&self, m: usize) -> f32 {
        let whole = self.length[self.end(m)];
        if whole > 0.0 { self.length[m] / whole } else { 1.0 }
    }

    /// The place to aim at from place `m`: the first of its trajectory that lies at least `ahead` further along, else the last
    /// one.
    pub fn ahead(&self, m: usize, ahead: f32) -> usize {
        let rest = &self.length[m..=self.end(m)];
        let goal = m + rest.partition_point(|&length| length < self.length[m] + ahead);
        goal.min(self.end(m))
    }

    /// Fills `hits` with the places within the radius of `place`, in ascending order. `stack` is working memory.
    pub fn near(&self, place: &[f32], stack: &mut Vec<u32>, hits: &mut Vec<Hit>) {
        self.index.states(place, stack, hits);
    }
}

/// A place on one of the paths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Place {
    /// Whether it is on an own path rather than the mentor's.
    pub own: bool,
    /// Its number there.
    pub number: u32,
}

/// The mentor's path, and the observer's own, which go before it.
#[derive(Clone, Debug)]
pub struct Paths {
    mentor: Path,
    own: Option<Path>,
    radius: f32,
    dim: usize,
}

impl Paths {
    /// The mentor's alone, of places with `dim` numbers and reached within `radius`.
    pub fn new(mentor: Path, dim: usize, radius: f32) -> Self {
        Self { mentor, own: None, radius, dim }
    }

    /// Takes these own paths.
    pub fn set_own(&mut self, own: &OwnPlaces) {
        let some = !own.lengths.is_empty();
        self.own = some.then(|| Path::new(own.places.clone(), self.dim, &own.lengths, self.radius));
    }

    /// The path that the place is on.
    pub fn of(&self, place: Place) -> &Path {
        self.own.as_ref().filter(|_| place.own).unwrap_or(&self.mentor)
    }

    /// The mentor's path.
    pub fn mentor(&self) -> &Path {
        &self.mentor
    }

    /// Fills `hits` with the places of own paths within the radius of `place`, in ascending order, or if there are none with those
    /// of the mentor's path. Returns which they are.
    pub(super) fn near(&self, place: &[f32], stack: &mut Vec<u32>, hits: &mut Vec<Hit>) -> bool {
        if let Some(own) = &self.own {
            own.near(place, stack, hits);
            if !hits.is_empty() {
                return true;
            }
        }
        self.mentor.near(place, stack, hits);
        false
    }
}

/// The KL of two places that are `radius` apart: with unit variances it is half the squared distance.
pub(super) fn kl_within(radius: f32) -> f32 {
    0.5 * radius * radius
}

/// The nearest of `hits`, the first one of several; none of none.
pub(super) fn nearest(hits: &[Hit]) -> Option<&Hit> {
    hits.iter().min_by(|a, b| a.kl.total_cmp(&b.kl))
}

/// The Euclidean distance of two places.
pub(super) fn distance(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum::<f32>().sqrt()
}

/// The length of a step between two places.
pub(super) fn stride(a: &[f32], b: &[f32]) -> f32 {
    let square = |(x, y): (&f32, &f32)| {
        let way = x - y;
        if way.abs() < APART { way * way } else { 1.0 }
    };
    a.iter().zip(b).map(square).sum::<f32>().sqrt()
}
