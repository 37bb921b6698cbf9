//! The mentor's path as a guide sees it: points among goals, the way covered up to each, and the state to aim at.
//!
//! All lengths are Euclidean in the chosen features, each in units of its scale. One trajectory's lengths begin at 0.

use super::goal::Goal;
use crate::similarity::{Hit, Similarity};
use trestle_proto::NONE;
use trestle_proto::waypoints::Waypoints;

/// The states of all demonstrations, ready for a tracker.
#[derive(Clone, Debug)]
pub struct MentorPath {
    dim: usize,
    states: Vec<f32>,
    index: Similarity,
    /// The way covered from the beginning of its trajectory to each state.
    length: Vec<f32>,
    /// The last state of each state's trajectory.
    end: Vec<u32>,
}

impl MentorPath {
    /// The path of `waypoints`, states of `dim` features, at least one. A state of the observer is on it within `radius`
    /// (above 0).
    pub fn new(waypoints: &Waypoints, dim: usize, goal: &Goal, radius: f32) -> Self {
        let mut places = Vec::new();
        waypoints.states.chunks_exact(dim).for_each(|state| goal.place(state, &mut places));
        let place = |m: usize| &places[m * goal.dim()..][..goal.dim()];
        let count = waypoints.transition_of.len();
        let (mut length, mut end) = (vec![0.0; count], vec![0; count]);
        for m in 1..count {
            if waypoints.transition_of[m - 1] != NONE {
                length[m] = length[m - 1] + distance(place(m - 1), place(m));
            }
        }
        for m in (0..count).rev() {
            let last = waypoints.transition_of[m] == NONE || m + 1 == count;
            end[m] = if last { m as u32 } else { end[m + 1] };
        }
        // KL with unit variances is half the squared distance.
        let index = Similarity::new(places, goal.dim(), 0.5 * radius * radius);
        Self { dim, states: waypoints.states.clone(), index, length, end }
    }

    /// Number of mentor states.
    pub fn len(&self) -> usize {
        self.length.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.length.is_empty()
    }

    /// Mentor state `m`, whole.
    pub fn state(&self, m: usize) -> &[f32] {
        &self.states[m * self.dim..][..self.dim]
    }

    /// The way covered up to mentor state `m`.
    pub fn length(&self, m: usize) -> f32 {
        self.length[m]
    }

    /// The last state of `m`'s trajectory.
    pub fn end(&self, m: usize) -> usize {
        self.end[m] as usize
    }

    /// Share of its trajectory's way that is covered at mentor state `m`, 0 to 1; 1 at the end of one that goes nowhere.
    pub fn share(&self, m: usize) -> f32 {
        let whole = self.length[self.end(m)];
        if whole > 0.0 { self.length[m] / whole } else { 1.0 }
    }

    /// The state to aim at from mentor state `m`: the first of its trajectory that lies at least `ahead` further along,
    /// else the last one.
    pub fn ahead(&self, m: usize, ahead: f32) -> usize {
        let rest = &self.length[m..=self.end(m)];
        let goal = m + rest.partition_point(|&length| length < self.length[m] + ahead);
        goal.min(self.end(m))
    }

    /// Fills `hits` with the mentor states within the radius of `place`, in ascending order.
    pub fn near(&self, place: &[f32], stack: &mut Vec<u32>, hits: &mut Vec<Hit>) {
        self.index.states(place, stack, hits);
    }
}

/// The Euclidean distance of two places.
pub(super) fn distance(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum::<f32>().sqrt()
}
