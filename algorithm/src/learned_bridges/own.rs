//! Own paths: how the observer itself once came to success, without the loops.
//!
//! When an episode succeeds, its steps are taken from the replay. A state whose place is within a fifteenth of the radius of an earlier
//! one takes that one's place, and what lies between is cut out. So every pair of state and action on an own path is one that
//! was walked; where something was cut out, the action before leads next to the state after.
//!
//! One path covers another if it passes within the radius of the other's beginning and needs no more steps from there. A new path
//! is dropped if a kept path covers it. Else it displaces the paths that it covers itself, and the oldest path where the set is
//! full.

use super::goal::Goal;
use super::path::distance;
use crate::replay::Replay;
use serde::{Deserialize, Serialize};
use trestle_proto::acting::{OwnPlaces, Room};

/// States, the actions taken in them, and the places passed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OwnPath {
    /// The states but for the last one, row-major.
    states: Vec<f32>,
    /// The action in each.
    actions: Vec<u32>,
    /// The place of each, and of the last one, row-major.
    places: Vec<f32>,
}

impl OwnPath {
    /// Steps, 1 or more on a path that is kept.
    pub fn steps(&self) -> usize {
        self.actions.len()
    }

    /// State `i` and the action in it.
    fn step(&self, i: usize) -> (&[f32], u32) {
        let dim = self.states.len() / self.steps();
        (&self.states[i * dim..][..dim], self.actions[i])
    }

    /// Whether it covers `other`, whose places have `dim` numbers.
    fn covers(&self, other: &Self, dim: usize, radius: f32) -> bool {
        // No later place needs more steps.
        let mut rest = self.places.chunks_exact(dim).enumerate();
        rest.any(|(i, place)| {
            self.steps() - i <= other.steps() && distance(place, &other.places[..dim]) <= radius
        })
    }
}

/// The own paths that are kept, and how they are made.
#[derive(Clone, Debug)]
pub struct OwnPaths {
    goal: Goal,
    room: Room,
    radius: f32,
    /// Places of the ends of the mentor's trajectories, row-major.
    ends: Vec<f32>,
    /// The oldest first.
    paths: Vec<OwnPath>,
    place: Vec<f32>,
}

impl OwnPaths {
    /// None yet, and as many as `room` has. `ends`: the last states of the mentor's trajectories.
    pub fn new<'a>(goal: Goal, room: Room, radius: f32, ends: impl Iterator<Item = &'a [f32]>) -> Self {
        let mut places = Vec::new();
        ends.for_each(|state| goal.place(state, &mut places));
        let place = Vec::with_capacity(goal.dim());
        Self { goal, room, radius, ends: places, paths: Vec::new(), place }
    }

    /// The paths, the oldest first.
    pub fn paths(&self) -> &[OwnPath] {
        &self.paths
    }

    /// How many are kept at most.
    pub fn most(&self) -> usize {
        self.room.paths
    }

    /// Goes on with `paths` that another one kept. Whether they can be such.
    #[must_use]
    pub fn restore(&mut self, paths: &[OwnPath], obs_dim: usize) -> bool {
        let whole = |path: &OwnPath| {
            let steps = path.steps();
            (1..self.room.places).contains(&steps)
                && path.states.len() == steps * obs_dim
                && path.places.len() == (steps + 1) * self.goal.dim()
        };
        let fits = paths.len() <= self.room.paths && paths.iter().all(whole);
        if fits {
            self.paths = paths.to_vec();
        }
        fits
    }

    /// Steps of all paths.
    pub fn steps(&self) -> usize {
        self.paths.iter().map(OwnPath::steps).sum()
    }

    /// Step `i` of all paths, one path after the other: a state and the action in it.
    pub fn step(&self, mut i: usize) -> Option<(&[f32], u32)> {
        for path in &self.paths {
            if i < path.steps() {
                return Some(path.step(i));
            }
            i -= path.steps();
        }
        None
    }

    /// What actors get of them, into `out`.
    pub fn publish(&self, out: &mut OwnPlaces) {
        out.lengths.clear();
        out.places.clear();
        for path in &self.paths {
            out.lengths.push(path.steps() as u32 + 1);
            out.places.extend_from_slice(&path.places);
        }
    }

    /// Takes in an episode that has ended: its `length` steps in `replay`, the first of which has global index `first`. It
    /// succeeded or not; where success is not defined, coming to the end of the mentor's path is one. Returns whether the paths
    /// have changed.
    pub fn take(&mut self, replay: &Replay, first: u64, length: u64, success: Option<bool>) -> bool {
        if success == Some(false) || first < replay.first_index() {
            return false;
        }
        let most = usize::try_from(length).unwrap_or(usize::MAX);
        let slots = replay.path(replay.slot(first), most);
        let Some(path) = self.walked(replay, slots, most, success.is_none()) else { return false };
        self.add(path)
    }

    /// The path over the transitions in `slots`, `length` of them; up to the end of the mentor's path where only that counts.
    /// None if it does not come there, is too long, or there are fewer transitions.
    fn walked(
        &mut self,
        replay: &Replay,
        slots: impl Iterator<Item = usize>,
        length: usize,
        to_end: bool,
    ) -> Option<OwnPath> {
        let near = self.radius / 15.0;
        let (mut s, mut next) = (Vec::new(), Vec::new());
        let mut path = OwnPath::default();
        for (before, slot) in slots.enumerate() {
            let obs = replay.obs(slot).wide(&mut s);
            self.visit(&mut path, obs, near);
            path.states.extend_from_slice(obs);
            path.actions.push(replay.get(slot).action);
            // One more place is still to come.
            if path.actions.len() >= self.room.places {
                return None;
            }
            let next_obs = replay.next_obs(slot).wide(&mut next);
            let arrived = if to_end { self.is_end(next_obs) } else { before + 1 == length };
            if arrived {
                self.goal.place(next_obs, &mut path.places);
                return Some(path);
            }
        }
        None
    }

    /// Goes on along `path` to `state`, which is none of its states yet: back to an earlier place if that is `near`.
    fn visit(&mut self, path: &mut OwnPath, state: &[f32], near: f32) {
        let dim = self.goal.dim();
        self.place.clear();
        self.goal.place(state, &mut self.place);
        let earlier = path.places.chunks_exact(dim).position(|place| distance(place, &self.place) < near);
        if let Some(earlier) = earlier {
            path.places.truncate(earlier * dim);
            path.states.truncate(earlier * state.len());
            path.actions.truncate(earlier);
        }
        path.places.extend_from_slice(&self.place);
    }

    /// Whether `state` is at the end of one of the mentor's trajectories.
    fn is_end(&mut self, state: &[f32]) -> bool {
        self.place.clear();
        self.goal.place(state, &mut self.place);
        self.ends.chunks_exact(self.goal.dim()).any(|end| distance(end, &self.place) <= self.radius)
    }

    /// Keeps `path` unless one that is kept covers it. Whether it is kept.
    fn add(&mut self, path: OwnPath) -> bool {
        let (dim, radius) = (self.goal.dim(), self.radius);
        if self.paths.iter().any(|own| own.covers(&path, dim, radius)) {
            return false;
        }
        self.paths.retain(|own| !path.covers(own, dim, radius));
        if self.paths.len() == self.room.paths {
            self.paths.remove(0);
        }
        self.paths.push(path);
        true
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;
    use trestle_proto::NONE;
    use trestle_proto::batch::{FIRST, TERMINATED, Transition};
    use trestle_qnet::Encoding;

    /// None yet, of up to three paths over cells and of up to `places` places each; the mentor's path ends in (9, 9).
    fn none(places: usize) -> OwnPaths {
        let encoding = Encoding::Scale { low: vec![-50.0; 2], high: vec![50.0; 2] };
        let goal = Goal::new(encoding, &[0, 1], &[1.0; 2]);
        OwnPaths::new(goal, Room { dim: 2, paths: 3, places }, 1.5, [&[9.0, 9.0][..]].into_iter())
    }

    /// An episode over `cells`, its action in each being its number; another actor's steps lie in between.
    fn episode(replay: &mut Replay, cells: &[[f32; 2]]) -> u64 {
        let first = replay.next_index();
        for (i, pair) in cells.windows(2).enumerate() {
            let ends = if i + 2 == cells.len() { TERMINATED } else { 0 };
            let flags = ends | if i == 0 { FIRST } else { 0 };
            let (obs, next_obs) = (&pair[0], &pair[1]);
            replay.push(&Transition { obs, next_obs, action: i as u32, reward: 0.0, flags }, 0, NONE);
            replay.push(&Transition { obs, next_obs, action: 77, reward: 0.0, flags: FIRST | ends }, 1, NONE);
        }
        first
    }

    fn taken(own: &mut OwnPaths, cells: &[[f32; 2]], success: Option<bool>) -> bool {
        let mut replay = Replay::new(500, 2).unwrap();
        let first = episode(&mut replay, cells);
        own.take(&replay, first, cells.len() as u64 - 1, success)
    }

    fn line(from: i8, to: i8) -> Vec<[f32; 2]> {
        (from..=to).map(|x| [f32::from(x), 0.0]).collect()
    }

    proptest! {
        /// What is left of a walk begins and ends as it did, goes by steps of the walk, and passes no cell twice but where it ends.
        #[test]
        fn loops_are_cut_out(steps in prop::collection::vec(0usize..4, 1..60)) {
            let mut cells = vec![[0.0f32; 2]];
            for step in steps {
                let [x, y] = cells[cells.len() - 1];
                cells.push([[x + 1.0, y], [x - 1.0, y], [x, y + 1.0], [x, y - 1.0]][step]);
            }
            let mut own = none(100);
            prop_assert!(taken(&mut own, &cells, Some(true)));
            let path = &own.paths()[0];
            let places: Vec<[f32; 2]> = path.places.as_chunks::<2>().0.to_vec();
            prop_assert_eq!((places[0], places.last()), (cells[0], cells.last()));
            prop_assert_eq!(own.steps(), places.len() - 1);
            for i in 0..own.steps() {
                let (state, action) = own.step(i).unwrap();
                prop_assert_eq!((state, &cells[action as usize][..]), (&places[i][..], state));
                prop_assert_eq!(cells[action as usize + 1], places[i + 1]);
                prop_assert_eq!(places[..places.len() - 1].iter().filter(|place| **place == places[i]).count(), 1);
            }
            prop_assert!(own.step(own.steps()).is_none());
        }
    }

    #[test]
    fn only_what_is_better_somewhere_is_kept_and_not_too_much_of_it() {
        let mut own = none(100);
        assert!(!taken(&mut own, &line(0, 5), Some(false)));
        assert!(taken(&mut own, &line(0, 5), Some(true)));
        // It begins in the second cell, and needs as many steps from there.
        assert!(!taken(&mut own, &line(1, 5), Some(true)));
        let elsewhere: Vec<[f32; 2]> = (1..=3).map(|x| [x as f32, 2.0]).collect();
        assert!(taken(&mut own, &elsewhere, Some(true)));
        assert_eq!(own.paths().len(), 2);
        // From further back, and no slower: it covers the first one.
        assert!(taken(&mut own, &line(-3, 5), Some(true)));
        let begins = |own: &OwnPaths| own.paths().iter().map(|path| path.places[0]).collect::<Vec<_>>();
        assert_eq!(begins(&own), [1.0, -3.0]);
        for from in [20, 30] {
            assert!(taken(&mut own, &line(from, from + 5), Some(true)));
        }
        assert_eq!(begins(&own), [-3.0, 20.0, 30.0]);
        let mut places = OwnPlaces::default();
        own.publish(&mut places);
        assert_eq!((&places.lengths[..], places.places.len()), (&[9, 6, 6][..], 42));
        let mut again = none(100);
        assert!(again.restore(own.paths(), 2) && again.paths() == own.paths());
        assert!(!none(8).restore(own.paths(), 2) && !none(100).restore(own.paths(), 3));
    }

    #[test]
    fn a_path_must_be_whole_and_not_too_long() {
        let mut own = none(6);
        assert!(taken(&mut own, &line(0, 5), Some(true)));
        assert!(!taken(&mut own, &line(20, 26), Some(true)));
        let mut replay = Replay::new(8, 2).unwrap();
        let first = episode(&mut replay, &line(40, 45));
        assert!(!own.take(&replay, first, 5, Some(true)), "its beginning is gone");
    }

    #[test]
    fn without_successes_the_end_of_the_mentors_path_counts() {
        let mut own = none(100);
        assert!(!taken(&mut own, &line(0, 5), None));
        let up: Vec<[f32; 2]> = (0..=12).map(|y| [9.0, y as f32]).collect();
        assert!(taken(&mut own, &up, None));
        // As far as the first place within the radius of it.
        assert_eq!(own.paths()[0].steps(), 8);
    }
}
