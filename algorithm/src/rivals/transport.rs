//! Rewards by optimal transport: how well an episode as a whole covers the mentor's trajectory, shared out among its steps.
//!
//! As in OTR (Luo, Jiang, Cohen, Grefenstette and Deisenroth 2023), with states alone. When an episode of T steps ends, the plan μ
//! between the T states that its steps led to and the states of a trajectory of the mentor's is found by [`super::sinkhorn`]. A
//! step's cost is c_t = T Σ_j μ_tj C_tj. To the reward of each step -α c_t is added, or α e^(-β c_t). Of several trajectories that
//! counts which gives the episode the highest sum.
//!
//! C is the Euclidean distance of whitened states, in units of the extent of the mentor's trajectory: the largest distance of a
//! state of it from its first. So the weight means the same on small maps and on large ones.

use super::distance;
use super::sinkhorn::Sinkhorn;
use crate::replay::Replay;
use crate::similarity::metric::{Metric, MetricError};
use trestle_proto::config::{SquashKind, Transport as Settings};
use trestle_proto::experiment::Experiment;

/// Most pairs of a state of the longest episode and one of the mentor's: 128 MiB of costs and kernels.
pub const MAX_PAIRS: usize = 1 << 23;

/// What optimal transport adds to the rewards.
#[derive(Clone, Debug)]
pub struct Transport {
    settings: Settings,
    metric: Metric,
    /// The states of each trajectory, whitened, and its extent.
    trajectories: Vec<(Vec<f32>, f64)>,
    /// What is added to the reward of the transition in each slot of the replay: 0 until its episode has ended.
    added: Vec<f32>,
    sinkhorn: Sinkhorn,
    slots: Vec<usize>,
    /// The states of an episode, whitened.
    states: Vec<f32>,
    cost: Vec<f64>,
    shares: Vec<f64>,
    rewards: Vec<f64>,
    best: Vec<f64>,
    scratch: Vec<f64>,
}

impl Transport {
    /// For `experiment`; none without the mentor's states.
    ///
    /// # Errors
    /// Settings that give no state distance.
    pub fn new(experiment: &Experiment) -> Result<Option<Self>, MetricError> {
        let Some(waypoints) = &experiment.waypoints else { return Ok(None) };
        let metric = Metric::of(&experiment.config.mentor, &experiment.spec, &waypoints.states)?;
        let whitened = metric.whiten_all(&waypoints.states);
        let mut rest = &whitened[..];
        let trajectories = waypoints.lengths().map(|states| {
            let (own, after) = rest.split_at(states * metric.dim());
            rest = after;
            let far =
                own.chunks_exact(metric.dim()).map(|state| f64::from(distance(&own[..metric.dim()], state)));
            (own.to_vec(), far.fold(0.0, f64::max))
        });
        Ok(Some(Self {
            settings: experiment.config.rival.transport.clone(),
            trajectories: trajectories.collect(),
            metric,
            added: vec![0.0; experiment.config.learner.replay],
            sinkhorn: Sinkhorn::default(),
            slots: Vec::new(),
            states: Vec::new(),
            cost: Vec::new(),
            shares: Vec::new(),
            rewards: Vec::new(),
            best: Vec::new(),
            scratch: Vec::new(),
        }))
    }

    /// A transition has been stored in `slot`.
    pub fn store(&mut self, slot: usize) {
        self.added[slot] = 0.0;
    }

    /// An episode has ended: its `length` transitions in `replay`, the first of which has global index `first`. One that the replay
    /// no longer holds whole is left as it is.
    pub fn finish(&mut self, replay: &Replay, first: u64, length: u64) {
        let most = usize::try_from(length).unwrap_or(usize::MAX);
        self.slots.clear();
        if first >= replay.first_index() {
            self.slots.extend(replay.path(replay.slot(first), most));
        }
        if self.slots.len() != most {
            return;
        }
        self.states.clear();
        let mut wide = Vec::new();
        for &slot in &self.slots {
            self.metric.whiten(replay.next_obs(slot).wide(&mut wide), &mut self.scratch, &mut self.states);
        }
        self.judge();
        for (&slot, &reward) in self.slots.iter().zip(&self.best) {
            self.added[slot] = reward as f32;
        }
    }

    /// The rewards of the states of an episode, by the trajectory that gives the highest sum, into `best`.
    fn judge(&mut self) {
        let Self { settings, trajectories, states, cost, shares, rewards, best, sinkhorn, metric, .. } = self;
        let dim = metric.dim();
        let steps = states.len() / dim;
        let mut highest = f64::NEG_INFINITY;
        for (mentor, extent) in &*trajectories {
            // A mentor that stays where it is has no extent: then one unit of scale is as good as any.
            let unit = if *extent > 0.0 { *extent } else { 1.0 };
            cost.clear();
            for state in states.chunks_exact(dim) {
                cost.extend(mentor.chunks_exact(dim).map(|other| f64::from(distance(state, other)) / unit));
            }
            shares.clear();
            shares.resize(steps, 0.0);
            sinkhorn.shares(cost, settings.epsilon, settings.rounds, shares);
            rewards.clear();
            rewards.extend(shares.iter().map(|share| squashed(settings, steps as f64 * share)));
            let sum = rewards.iter().sum();
            if sum > highest {
                highest = sum;
                std::mem::swap(rewards, best);
            }
        }
    }

    /// What is added to the reward of the transition in each slot.
    pub fn added(&self) -> &[f32] {
        &self.added
    }

    /// Goes on with what was `added` to all that `replay` held. Whether it can be.
    #[must_use]
    pub fn restore(&mut self, added: &[f32]) -> bool {
        let fits = added.len() == self.added.len() && added.iter().all(|x| x.is_finite());
        if fits {
            self.added.copy_from_slice(added);
        }
        fits
    }
}

/// The reward of a step whose cost is `cost`.
fn squashed(settings: &Settings, cost: f64) -> f64 {
    match settings.squash {
        SquashKind::Linear => -settings.weight * cost,
        SquashKind::Exponential => settings.weight * libm::exp(-settings.beta * cost),
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

    /// A mentor that goes from 0 to 4 on a line, in two steps, and another that stays at (0, 3).
    fn transport(sets: &[&str]) -> (Transport, Replay) {
        let base = ["run.algo=dqn", "rival.kind=optimal-transport", "rival.transport.weight=1"];
        let sets = [&base[..], sets].concat();
        let mut experiment = experiment(&sets);
        experiment.waypoints = Some(Waypoints {
            states: vec![0.0, 0.0, 2.0, 0.0, 4.0, 0.0, 0.0, 3.0],
            transition_of: vec![0, 1, NONE, NONE],
            progress: vec![0.0, 0.5, 1.0, 0.0],
        });
        (
            Transport::new(&experiment).unwrap().unwrap(),
            Replay::new(experiment.config.learner.replay, 2).unwrap(),
        )
    }

    /// An episode through `places` of actor 0, the first of which is its start. Returns its slots.
    fn walk(transport: &mut Transport, replay: &mut Replay, places: &[[f32; 2]]) -> Vec<usize> {
        let first = replay.next_index();
        let mut slots = Vec::new();
        for (at, pair) in places.windows(2).enumerate() {
            let flags = if at == 0 { FIRST } else { 0 } | if at + 2 == places.len() { TERMINATED } else { 0 };
            let t = Transition { obs: &pair[0], next_obs: &pair[1], action: 0, reward: 0.0, flags };
            let slot = replay.push(&t, 0, NONE);
            transport.store(slot);
            slots.push(slot);
        }
        transport.finish(replay, first, slots.len() as u64);
        slots
    }

    #[test]
    fn rewards_by_hand() {
        // It ends up in the mentor's very states, in another order: each goes to its own, and nothing costs anything.
        let (mut transport, mut replay) = transport(&[]);
        let slots = walk(&mut transport, &mut replay, &[[1.0, 0.0], [4.0, 0.0], [0.0, 0.0], [2.0, 0.0]]);
        assert!(slots.iter().all(|&slot| transport.added()[slot].abs() < 1e-6), "{:?}", transport.added());
        // One unit beside them, of an extent of 4 units: a quarter a step.
        let places = [[0.0, 1.0], [0.0, 1.0], [2.0, 1.0], [4.0, 1.0]];
        let beside = walk(&mut transport, &mut replay, &places);
        assert!(beside.iter().all(|&slot| (transport.added()[slot] + 0.25).abs() < 1e-4));
        // The other trajectory is nearer: a distance of 1, in units of 1.
        let still = walk(&mut transport, &mut replay, &[[0.0, 0.0], [0.0, 4.0]]);
        assert!((transport.added()[still[0]] + 1.0).abs() < 1e-6);
    }

    #[test]
    fn squashed_rewards_are_high_where_costs_are_low() {
        let sets =
            ["rival.transport.weight=3", "rival.transport.squash=exponential", "rival.transport.beta=2"];
        let (mut transport, mut replay) = transport(&sets);
        let places = [[0.0, 1.0], [0.0, 1.0], [2.0, 1.0], [4.0, 1.0]];
        let slots = walk(&mut transport, &mut replay, &places);
        assert!((transport.added()[slots[1]] - 3.0 * (-0.5f32).exp()).abs() < 1e-3);
    }

    #[test]
    fn what_is_not_there_whole_is_left_alone() {
        let (mut transport, mut replay) = transport(&[]);
        let slots = walk(&mut transport, &mut replay, &[[0.0, 1.0], [1.0, 1.0], [4.0, 1.0]]);
        let before = transport.added()[slots[0]];
        assert!(before < 0.0);
        // One more step than are stored, and one that has been overwritten.
        transport.finish(&replay, 0, 3);
        assert_eq!(transport.added()[slots[0]], before);
        let long: Vec<[f32; 2]> = (0..=51).map(|at| [at as f32 * 0.01, 0.0]).collect();
        let slots = walk(&mut transport, &mut replay, &long);
        assert!(slots.iter().all(|&slot| transport.added()[slot] == 0.0));
    }
}
