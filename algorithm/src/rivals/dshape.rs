//! D-Shape: the mentor's states are goals that come one after the other, whether the observer gets there or not.
//!
//! After Wang, Warnell and Stone (2023). The actor appends the goal to what it observes (`trestle-actor`, `rivals`): in the t-th state
//! of an episode that is the mentor's (t+1)-th, and at last the mentor's last. So a stored transition is ([s, g], a, r, [s', g']),
//! and its features are those of s and behind them those of g.
//!
//! *Reward.* F = γ φ(s', g') - φ(s, g) is added, with φ(s, g) = -weight |s - g|, and φ = 0 in a terminal state.
//!
//! *Relabelling.* When an episode ends, for each of its transitions pairs of successive states of this episode are drawn
//! uniformly. They are further transitions with (g, g') in the place of the mentor's and with the F of these. Instead of storing
//! them, a sample is one of the stored transition and its relabelled ones, each as likely: a draw from a replay with all of them.

use super::distance;
use crate::replay::Replay;
use crate::similarity::metric::{Metric, MetricError};
use rand::Rng;
use serde::{Deserialize, Serialize};
use trestle_proto::experiment::Experiment;
use trestle_proto::rng::{Purpose, Stream, stream};

/// No pair of goals.
const NO_PAIR: u64 = u64::MAX;

/// What takes the place of a batch's stored transitions.
#[derive(Clone, Debug, Default)]
pub struct View {
    width: usize,
    from: Vec<f32>,
    to: Vec<f32>,
    added: Vec<f32>,
}

impl View {
    /// The first state of sample `at`.
    pub fn from(&self, at: usize) -> &[f32] {
        &self.from[at * self.width..][..self.width]
    }

    /// The last state of sample `at`'s path.
    pub fn to(&self, at: usize) -> &[f32] {
        &self.to[at * self.width..][..self.width]
    }

    /// What is added to the discounted sum of the rewards of sample `at`'s path.
    pub fn added(&self, at: usize) -> f32 {
        self.added[at]
    }
}

/// All that a checkpoint has to keep of [`DShape`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DShapeState {
    rng: Stream,
    /// For each slot the global indices of the transitions that lead to the first state of each drawn pair.
    pairs: Vec<u64>,
}

/// Goals, and what follows from them.
#[derive(Clone, Debug)]
pub struct DShape {
    weight: f32,
    gamma: f32,
    /// Features of a state without its goal.
    dim: usize,
    /// Pairs of a transition.
    goals: usize,
    metric: Metric,
    state: DShapeState,
    view: View,
    slots: Vec<usize>,
    scratch: Vec<f64>,
    whitened: Vec<f32>,
}

impl DShape {
    /// For `experiment`; none without the mentor's states.
    ///
    /// # Errors
    /// Settings that give no state distance.
    pub fn new(experiment: &Experiment) -> Result<Option<Self>, MetricError> {
        let Some(waypoints) = &experiment.waypoints else { return Ok(None) };
        let (config, settings, width) =
            (&experiment.config, &experiment.config.rival.dshape, experiment.spec.obs_dim());
        let dim = width / 2;
        let states: Vec<f32> =
            waypoints.states.chunks_exact(width).flat_map(|row| &row[..dim]).copied().collect();
        Ok(Some(Self {
            weight: settings.weight as f32,
            gamma: config.learner.gamma as f32,
            dim,
            goals: settings.goals,
            metric: Metric::of(&config.mentor, &experiment.spec.without_goals(), &states)?,
            state: DShapeState {
                rng: stream(config.run.seed, Purpose::RivalReplay, 0),
                pairs: vec![NO_PAIR; config.learner.replay * settings.goals],
            },
            view: View { width, ..View::default() },
            slots: Vec::new(),
            scratch: Vec::new(),
            whitened: Vec::new(),
        }))
    }

    /// A transition has been stored in `slot`.
    pub fn store(&mut self, slot: usize) {
        self.state.pairs[slot * self.goals..][..self.goals].fill(NO_PAIR);
    }

    /// An episode has ended: its `length` transitions in `replay`, the first of which has global index `first`. One that the replay
    /// no longer holds whole has no goals of its own.
    pub fn finish(&mut self, replay: &Replay, first: u64, length: u64) {
        let most = usize::try_from(length).unwrap_or(usize::MAX);
        self.slots.clear();
        if first >= replay.first_index() {
            self.slots.extend(replay.path(replay.slot(first), most));
        }
        // A pair takes two transitions: one that leads to its first state, and the next one.
        if self.slots.len() != most || most < 2 {
            return;
        }
        for at in 0..most {
            for pair in 0..self.goals {
                let to = self.slots[self.state.rng.random_range(0..most - 1)];
                self.state.pairs[self.slots[at] * self.goals + pair] = replay.index(to);
            }
        }
    }

    /// Draws what is made of the transitions in `slots`, each the first of a path of at most `steps`.
    pub fn show(&mut self, replay: &Replay, slots: &[u32], steps: usize) {
        self.view.from.clear();
        self.view.to.clear();
        self.view.added.clear();
        for &slot in slots {
            let slot = slot as usize;
            let (mut last, mut discount, mut count) = (slot, 1.0, 0);
            for slot in replay.path(slot, steps) {
                last = slot;
                discount *= self.gamma;
                count += 1;
            }
            let [mut a, mut b, mut c, mut d]: [Vec<f32>; 4] = Default::default();
            let (start, end) = (replay.obs(slot).wide(&mut a), replay.next_obs(last).wide(&mut b));
            let [first, then] = match self.drawn(replay, slot) {
                None => [&start[self.dim..], &end[self.dim..]],
                Some(to) => {
                    // The goal moves on by a state a step, as far as the episode goes.
                    let ahead = replay.path(to, count + 1).last().unwrap_or(to);
                    [replay.next_obs(to).wide(&mut c), replay.next_obs(ahead).wide(&mut d)]
                        .map(|goal| &goal[..self.dim])
                }
            };
            let terminated = replay.get(last).terminated();
            let next = if terminated { 0.0 } else { self.potential(&end[..self.dim], then) };
            let added = discount * next - self.potential(&start[..self.dim], first);
            for (rows, state, goal) in [(&mut self.view.from, start, first), (&mut self.view.to, end, then)] {
                rows.extend_from_slice(&state[..self.dim]);
                rows.extend_from_slice(goal);
            }
            self.view.added.push(added);
        }
    }

    /// The slot of the transition that leads to the goal of the transition in `slot`; none for that which is stored.
    fn drawn(&mut self, replay: &Replay, slot: usize) -> Option<usize> {
        let pair = self.state.rng.random_range(0..=self.goals).checked_sub(1)?;
        let to = self.state.pairs[slot * self.goals + pair];
        // An actor's transitions are overwritten in their order: while the first of a pair is there, the second is.
        (to != NO_PAIR && to >= replay.first_index()).then(|| replay.slot(to))
    }

    /// φ.
    fn potential(&mut self, state: &[f32], goal: &[f32]) -> f32 {
        let Self { metric, whitened, scratch, .. } = self;
        whitened.clear();
        metric.whiten(state, scratch, whitened);
        metric.whiten(goal, scratch, whitened);
        let (state, goal) = whitened.split_at(metric.dim());
        -self.weight * distance(state, goal)
    }

    /// What [`DShape::show`] drew.
    pub fn view(&self) -> &View {
        &self.view
    }

    /// What a checkpoint keeps.
    pub fn state(&self) -> &DShapeState {
        &self.state
    }

    /// Goes on as another one of the same run did. Whether the state is one of this run.
    #[must_use]
    pub fn restore(&mut self, state: &DShapeState) -> bool {
        let fits = state.pairs.len() == self.state.pairs.len();
        if fits {
            self.state.clone_from(state);
        }
        fits
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::testing::experiment;
    use trestle_proto::NONE;
    use trestle_proto::batch::{FIRST, TERMINATED, Transition};
    use trestle_proto::waypoints::Waypoints;

    /// One feature, and a mentor that goes from 0 to 3 in steps of 1.
    fn world(sets: &[&str]) -> (DShape, Replay) {
        let base = ["run.algo=dqn", "rival.kind=d-shape", "rival.dshape.weight=2", "learner.gamma=0.5"];
        let mut experiment = experiment(&[&base, sets].concat());
        experiment.waypoints = Some(Waypoints {
            states: vec![0.0, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 3.0],
            transition_of: vec![0, 1, 2, NONE],
            progress: vec![0.0, 0.3, 0.6, 1.0],
        });
        (
            DShape::new(&experiment).unwrap().unwrap(),
            Replay::new(experiment.config.learner.replay, 2).unwrap(),
        )
    }

    /// The observer goes back and forth: 0, -1, 0, 1, and is done.
    fn walk(dshape: &mut DShape, replay: &mut Replay) {
        let rows = [[0.0, 1.0], [-1.0, 2.0], [0.0, 3.0], [1.0, 3.0f32]];
        for at in 0..3 {
            let flags = [FIRST, 0, TERMINATED][at];
            let t = Transition { obs: &rows[at], next_obs: &rows[at + 1], action: 0, reward: 0.0, flags };
            let slot = replay.push(&t, 0, NONE);
            dshape.store(slot);
        }
    }

    #[test]
    fn what_is_stored_by_hand() {
        let (mut dshape, mut replay) = world(&["rival.dshape.goals=0"]);
        walk(&mut dshape, &mut replay);
        dshape.finish(&replay, 0, 3);
        dshape.show(&replay, &[0, 1, 2], 1);
        // φ is -2 times the distances 1, 3, 3 and, at the end, 0.
        let added: Vec<f32> = (0..3).map(|at| dshape.view().added(at)).collect();
        assert_eq!(added, [-3.0 + 2.0, -3.0 + 6.0, 6.0]);
        assert_eq!((dshape.view().from(1), dshape.view().to(1)), (&[-1.0, 2.0][..], &[0.0, 3.0][..]));
        // Over two steps: 0.25 φ(0, 3) - φ(0, 1).
        dshape.show(&replay, &[0], 2);
        assert_eq!((dshape.view().added(0), dshape.view().to(0)), (-1.5 + 2.0, &[0.0, 3.0][..]));
    }

    #[test]
    fn a_relabelled_transition_has_successive_states_of_its_episode_as_goals() {
        let (mut dshape, mut replay) = world(&["rival.dshape.goals=2"]);
        walk(&mut dshape, &mut replay);
        dshape.finish(&replay, 0, 3);
        let mut seen = std::collections::BTreeSet::new();
        for _ in 0..200 {
            dshape.show(&replay, &[0], 1);
            let (from, to) = (dshape.view().from(0).to_vec(), dshape.view().to(0).to_vec());
            assert_eq!((from[0], to[0]), (0.0, -1.0), "the states stay what they were");
            let expected = 0.5 * -2.0 * (to[0] - to[1]).abs() + 2.0 * (from[0] - from[1]).abs();
            assert!((dshape.view().added(0) - expected).abs() < 1e-6);
            seen.insert([from[1] as i32, to[1] as i32]);
        }
        // The mentor's pair (1, 2), and of the episode's own (-1, 0) and (0, 1) those that were drawn at its end.
        assert!(seen.contains(&[1, 2]) && seen.len() >= 2, "{seen:?}");
        assert!(seen.iter().all(|pair| [[1, 2], [-1, 0], [0, 1]].contains(pair)), "{seen:?}");
    }

    /// The shares of the stored transition and of the relabelled ones.
    #[test]
    fn one_of_four_samples_is_what_is_stored() {
        let (mut dshape, mut replay) = world(&["rival.dshape.goals=3"]);
        walk(&mut dshape, &mut replay);
        dshape.finish(&replay, 0, 3);
        dshape.show(&replay, &[0; 4000], 1);
        let stored = (0..4000).filter(|&at| dshape.view().from(at)[1] == 1.0).count();
        // The standard deviation is 27.
        assert!((840..1160).contains(&stored), "{stored}");
        // An episode that has not ended has no goals of its own.
        walk(&mut dshape, &mut replay);
        dshape.show(&replay, &[3; 50], 1);
        assert!((0..50).all(|at| dshape.view().from(at)[1] == 1.0));
    }

    #[test]
    fn goals_that_are_overwritten_are_not_taken() {
        let (mut dshape, mut replay) = world(&["learner.replay=8", "learner.warmup=8", "learner.batch=4"]);
        walk(&mut dshape, &mut replay);
        dshape.finish(&replay, 0, 3);
        (0..2).for_each(|_| walk(&mut dshape, &mut replay));
        // Two transitions of the first episode are left: its last, whose goals may be lost.
        for _ in 0..100 {
            dshape.show(&replay, &[1, 2], 1);
            let goals = [0, 1].map(|at| dshape.view().from(at)[1] as i32);
            assert!([0, 2].contains(&goals[0]) && [0, 3].contains(&goals[1]), "{goals:?}");
        }
    }
}
