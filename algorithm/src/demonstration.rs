//! A demonstration: what was recorded of a mentor. Ordered states in trajectories, and for each trajectory whether it
//! ended in a terminal state. Never actions, never rewards.

use crate::similarity::Hit;
use std::ops::Range;
use trestle_proto::NONE;
use trestle_proto::limits::{MAX_MENTOR_TRANSITIONS, MAX_OBS_DIM};
use trestle_proto::mentor::MentorTransitions;
use trestle_proto::waypoints::Waypoints;

/// States that cannot be a demonstration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DemonstrationError {
    /// The number of features.
    #[error("a demonstration's states have {0} features; accepted: 1 to {MAX_OBS_DIM}")]
    Dim(usize),
    /// A trajectory that holds no transition, or not whole states.
    #[error(
        "a trajectory has {numbers} numbers for states of {dim} features; accepted: 2 states or more, whole ones"
    )]
    Length {
        /// Numbers given.
        numbers: usize,
        /// Features of a state.
        dim: usize,
    },
    /// Too long.
    #[error("a demonstration has {0} transitions; accepted: up to {MAX_MENTOR_TRANSITIONS}")]
    TooLong(usize),
    /// A feature that is NaN or infinite.
    #[error("feature {feature} of state {state} is {value}; accepted: finite numbers")]
    NotFinite {
        /// Position of the state in its trajectory.
        state: usize,
        /// Which feature.
        feature: usize,
        /// Its value.
        value: f32,
    },
}

/// The recorded states of a mentor. State `m` counts through all trajectories.
#[derive(Clone, Debug, PartialEq)]
pub struct Demonstration {
    names: Vec<String>,
    states: Vec<f32>,
    trajectories: Vec<Trajectory>,
}

#[derive(Clone, Debug, PartialEq)]
struct Trajectory {
    states: Range<usize>,
    terminal: bool,
}

impl Demonstration {
    /// No trajectory yet, of states with these features.
    ///
    /// # Errors
    /// Not 1 to [`MAX_OBS_DIM`] features.
    pub fn new(names: Vec<String>) -> Result<Self, DemonstrationError> {
        if names.is_empty() || names.len() > MAX_OBS_DIM {
            return Err(DemonstrationError::Dim(names.len()));
        }
        Ok(Self { names, states: Vec::new(), trajectories: Vec::new() })
    }

    /// Appends a trajectory of `states` (row-major, two or more); `terminal` where its last state ended the mentor's
    /// episode in a terminal state.
    ///
    /// # Errors
    /// Nothing is appended if the length does not fit, a feature is not finite, or the limit would be exceeded.
    pub fn push_trajectory(&mut self, states: &[f32], terminal: bool) -> Result<(), DemonstrationError> {
        let dim = self.dim();
        if states.len() < 2 * dim || !states.len().is_multiple_of(dim) {
            return Err(DemonstrationError::Length { numbers: states.len(), dim });
        }
        if let Some((at, &value)) = states.iter().enumerate().find(|(_, x)| !x.is_finite()) {
            return Err(DemonstrationError::NotFinite { state: at / dim, feature: at % dim, value });
        }
        let count = states.len() / dim;
        let transitions = self.n_transitions() + count - 1;
        if transitions > MAX_MENTOR_TRANSITIONS {
            return Err(DemonstrationError::TooLong(transitions));
        }
        let first = self.n_states();
        self.states.extend_from_slice(states);
        self.trajectories.push(Trajectory { states: first..first + count, terminal });
        Ok(())
    }

    /// Appends all trajectories of `other`, a demonstration of as many features. Names of features stay.
    ///
    /// # Errors
    /// Nothing is appended if the numbers of features differ or the limit would be exceeded.
    pub fn append(&mut self, other: &Self) -> Result<(), DemonstrationError> {
        if other.dim() != self.dim() {
            return Err(DemonstrationError::Length { numbers: other.dim(), dim: self.dim() });
        }
        let transitions = self.n_transitions() + other.n_transitions();
        if transitions > MAX_MENTOR_TRANSITIONS {
            return Err(DemonstrationError::TooLong(transitions));
        }
        let first = self.n_states();
        self.states.extend_from_slice(&other.states);
        self.trajectories.extend(other.trajectories.iter().map(|t| Trajectory {
            states: first + t.states.start..first + t.states.end,
            terminal: t.terminal,
        }));
        Ok(())
    }

    /// Names of the features.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Features of a state.
    pub fn dim(&self) -> usize {
        self.names.len()
    }

    /// Number of trajectories.
    pub fn n_trajectories(&self) -> usize {
        self.trajectories.len()
    }

    /// Number of states.
    pub fn n_states(&self) -> usize {
        self.states.len() / self.dim()
    }

    /// Number of transitions: the last state of a trajectory begins none.
    pub fn n_transitions(&self) -> usize {
        self.n_states() - self.n_trajectories()
    }

    /// All states, row-major.
    pub fn states(&self) -> &[f32] {
        &self.states
    }

    /// State `m`.
    pub fn state(&self, m: usize) -> &[f32] {
        &self.states[m * self.dim()..][..self.dim()]
    }

    /// The states of trajectory `i`.
    pub fn trajectory(&self, i: usize) -> Range<usize> {
        self.trajectories[i].states.clone()
    }

    /// Whether trajectory `i` ended in a terminal state.
    pub fn terminal(&self, i: usize) -> bool {
        self.trajectories[i].terminal
    }

    /// All transitions in order, as the learner sees them.
    pub fn transitions(&self) -> MentorTransitions {
        let mut out = MentorTransitions::new(self.dim());
        for t in &self.trajectories {
            out.begin_trajectory();
            for m in t.states.start..t.states.end - 1 {
                out.push(self.state(m), self.state(m + 1), t.terminal && m + 2 == t.states.end);
            }
        }
        out
    }

    /// The states as actors and learner need them beside the mentor-server.
    pub fn waypoints(&self) -> Waypoints {
        let order = self.order();
        let mut progress = Vec::with_capacity(self.n_states());
        for t in &self.trajectories {
            let steps = t.states.len() - 1;
            progress.extend((0..=steps).map(|step| step as f32 / steps as f32));
        }
        Waypoints { states: self.states.clone(), transition_of: order.transition_of, progress }
    }

    /// Which states belong to which transitions.
    pub fn order(&self) -> Order {
        let mut order = Order::default();
        for t in &self.trajectories {
            for m in t.states.clone() {
                if m + 1 == t.states.end {
                    order.transition_of.push(NONE);
                } else {
                    order.transition_of.push(order.state_of.len() as u32);
                    order.state_of.push(m as u32);
                    order.last_of.push(t.states.end as u32 - 1);
                }
            }
        }
        order
    }
}

/// The order of a demonstration in numbers: states, transitions, and where trajectories end.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Order {
    transition_of: Vec<u32>,
    state_of: Vec<u32>,
    last_of: Vec<u32>,
}

impl Order {
    /// Number of transitions.
    pub fn n_transitions(&self) -> usize {
        self.state_of.len()
    }

    /// Number of states.
    pub fn n_states(&self) -> usize {
        self.transition_of.len()
    }

    /// The transition that begins in state `m`; none for the last state of a trajectory.
    pub fn transition_of(&self, m: usize) -> Option<usize> {
        let j = self.transition_of[m];
        (j != NONE).then_some(j as usize)
    }

    /// The state in which transition `j` begins.
    pub fn state_of(&self, j: usize) -> usize {
        self.state_of[j] as usize
    }

    /// The states 1 to `n` mentor steps after the beginning of transition `j`, cut off where its trajectory ends:
    /// where a bridge from s_m of `j` may arrive.
    pub fn ahead(&self, j: usize, n: usize) -> Range<usize> {
        let m = self.state_of(j);
        m + 1..(m + n).min(self.last_of[j] as usize) + 1
    }

    /// The transitions that state `m` is [`Order::ahead`] of, nearest first.
    pub fn behind(&self, m: usize, n: usize) -> impl Iterator<Item = usize> + '_ {
        (m.saturating_sub(n)..m).rev().map_while(|before| self.transition_of(before))
    }
}

/// The transitions that begin in one of `hits`, each with the KL divergence of its first state, in the order of `hits`.
pub fn transitions<'a>(hits: &'a [Hit], order: &'a Order) -> impl Iterator<Item = (usize, f32)> + 'a {
    hits.iter().filter_map(|hit| Some((order.transition_of(hit.state as usize)?, hit.kl)))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::similarity::Similarity;

    #[test]
    fn last_states_are_found_but_begin_nothing() {
        let mut demo = Demonstration::new(vec!["x".into()]).unwrap();
        demo.push_trajectory(&[0.0, 1.0], true).unwrap();
        demo.push_trajectory(&[1.0, 0.0], true).unwrap();
        let index = Similarity::new(demo.states().to_vec(), 1, 0.5);
        let (mut hits, order) = (Vec::new(), demo.order());
        index.states(&[0.25], &mut Vec::new(), &mut hits);
        assert_eq!(hits.iter().map(|h| h.state).collect::<Vec<_>>(), [0, 1, 2, 3]);
        assert_eq!(transitions(&hits, &order).collect::<Vec<_>>(), [(0, 0.03125), (1, 0.28125)]);
        index.states(&[2.5], &mut Vec::new(), &mut hits);
        assert_eq!(hits, []);
    }

    #[test]
    fn waypoints_know_their_transition_and_how_far_along_they_are() {
        let waypoints = two_trajectories().waypoints();
        assert_eq!(waypoints.states, [0.0, 1.0, 2.0, 5.0, 6.0]);
        assert_eq!(waypoints.transition_of, [0, 1, NONE, 2, NONE]);
        assert_eq!(waypoints.progress, [0.0, 0.5, 1.0, 0.0, 1.0]);
    }

    fn two_trajectories() -> Demonstration {
        let mut demo = Demonstration::new(vec!["x".into()]).unwrap();
        demo.push_trajectory(&[0.0, 1.0, 2.0], true).unwrap();
        demo.push_trajectory(&[5.0, 6.0], false).unwrap();
        demo
    }

    #[test]
    fn transitions_never_cross_the_end_of_a_trajectory() {
        let demo = two_trajectories();
        let t = demo.transitions();
        let pairs: Vec<_> =
            (0..t.len()).map(|j| (t.state(j)[0], t.next_state(j)[0], t.terminal(j))).collect();
        assert_eq!(pairs, [(0.0, 1.0, false), (1.0, 2.0, true), (5.0, 6.0, false)]);
        let order = demo.order();
        let of: Vec<_> = (0..5).map(|m| order.transition_of(m)).collect();
        assert_eq!(of, [Some(0), Some(1), None, Some(2), None]);
        assert_eq!([0, 1, 2].map(|j| order.state_of(j)), [0, 1, 3]);
        assert_eq!([0, 1, 2].map(|j| order.ahead(j, 4)), [1..3, 2..3, 4..5]);
        assert_eq!(order.ahead(0, 1), 1..2);
        for (m, n) in (0..5).flat_map(|m| (1..5).map(move |n| (m, n))) {
            let expected: Vec<_> = (0..3).rev().filter(|&j| order.ahead(j, n).contains(&m)).collect();
            assert_eq!(order.behind(m, n).collect::<Vec<_>>(), expected);
        }
    }

    #[test]
    fn one_after_the_other() {
        let (mut both, other) = (two_trajectories(), two_trajectories());
        both.append(&other).unwrap();
        assert_eq!((both.n_trajectories(), both.n_states(), both.n_transitions()), (4, 10, 6));
        assert_eq!(both.trajectory(3), 8..10);
        assert!(both.terminal(2) && !both.terminal(3));
        let transitions = both.transitions();
        assert_eq!((0..6).filter(|&j| transitions.first(j)).collect::<Vec<_>>(), [0, 2, 3, 5]);
        let wide = Demonstration::new(vec!["x".into(), "y".into()]).unwrap();
        assert!(both.append(&wide).is_err());
    }

    #[test]
    fn what_cannot_be_a_trajectory_is_refused_and_changes_nothing() {
        let mut demo = two_trajectories();
        let before = demo.clone();
        assert!(matches!(demo.push_trajectory(&[1.0], false), Err(DemonstrationError::Length { .. })));
        let error = demo.push_trajectory(&[1.0, f32::NAN], false).unwrap_err();
        assert_eq!(error.to_string(), "feature 0 of state 1 is NaN; accepted: finite numbers");
        assert_eq!(demo, before);
        assert!(matches!(Demonstration::new(vec![]), Err(DemonstrationError::Dim(0))));
    }
}
