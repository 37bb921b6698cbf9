//! Potential-based shaping towards the mentor's states: the simplest rival of a mentor's losses, for `dqn`. Ours, not
//! the paper's.
//!
//! Φ(s) = potential * max over mentor states m of progress(m) exp(-KL(s, m)): it rises along the mentor's path and falls
//! off beside it, as in reinforcement learning from demonstration through shaping (Brys et al. 2015). To the reward of
//! s -> s' is added F = γ Φ(s') - Φ(s), with Φ = 0 for a terminal s'. Whatever Φ, the best policy stays the best (Ng,
//! Harada and Russell 1999), for episodes that end in a terminal state because of that 0 (Grzes 2017); one that a step
//! limit cut off bootstraps and so counts Φ(s') as it is.

use crate::replay::{Entry, Replay};
use crate::similarity::metric::{Metric, MetricError, kl};
use trestle_proto::batch::Transition;
use trestle_proto::experiment::Experiment;

/// Beyond this KL divergence exp(-KL) is taken for 0; it is 1.1e-7 there.
const FAR: f32 = 16.0;

/// Potentials of states, and what they add to the reward of each stored transition.
#[derive(Clone, Debug)]
pub struct Shaping {
    potential: f32,
    gamma: f32,
    metric: Metric,
    whitened: Vec<f32>,
    progress: Vec<f32>,
    /// F of the transition in each slot of the replay.
    added: Vec<f32>,
    state: Vec<f32>,
    scratch: Vec<f64>,
}

impl Shaping {
    /// The shaping of `experiment`'s run; none without one.
    ///
    /// # Errors
    /// Settings that give no state distance.
    pub fn new(experiment: &Experiment) -> Result<Option<Self>, MetricError> {
        let (config, mentor) = (&experiment.config, &experiment.config.mentor);
        let Some(waypoints) = experiment.waypoints.as_ref().filter(|_| config.shaped()) else {
            return Ok(None);
        };
        let metric = Metric::of(mentor, &experiment.spec, &waypoints.states)?;
        Ok(Some(Self {
            potential: config.shaping.potential as f32,
            gamma: config.learner.gamma as f32,
            whitened: metric.whiten_all(&waypoints.states),
            progress: waypoints.progress.clone(),
            added: vec![0.0; config.learner.replay],
            state: Vec::new(),
            scratch: Vec::new(),
            metric,
        }))
    }

    /// Φ of `obs`. Looks at every mentor state.
    pub fn potential(&mut self, obs: &[f32]) -> f32 {
        let Self { metric, whitened, progress, state, scratch, .. } = self;
        state.clear();
        metric.whiten(obs, scratch, state);
        let mut best = 0.0f32;
        for (mentor, &progress) in whitened.chunks_exact(metric.dim()).zip(&*progress) {
            let kl = kl(state, mentor);
            // e^-KL is at most 1: a state that is not further along cannot be better.
            if kl <= FAR && progress > best {
                best = best.max(progress * libm::expf(-kl));
            }
        }
        self.potential * best
    }

    /// F of `transition`.
    pub fn of(&mut self, transition: &Transition<'_>) -> f32 {
        let next = if transition.terminated() { 0.0 } else { self.potential(transition.next_obs) };
        self.gamma * next - self.potential(transition.obs)
    }

    /// Remembers F of the transition in `slot` of `replay`.
    pub fn store(&mut self, replay: &Replay, slot: usize) {
        let (mut s, mut next) = (Vec::new(), Vec::new());
        let Entry { action, reward, flags, .. } = replay.get(slot);
        let (obs, next_obs) = (replay.obs(slot).wide(&mut s), replay.next_obs(slot).wide(&mut next));
        self.added[slot] = self.of(&Transition { obs, next_obs, action, reward, flags });
    }

    /// Remembers F of all that `replay` holds.
    pub fn store_all(&mut self, replay: &Replay) {
        for index in replay.first_index()..replay.next_index() {
            self.store(replay, replay.slot(index));
        }
    }

    /// F of the transition in each slot.
    pub fn added(&self) -> &[f32] {
        &self.added
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::testing::experiment;
    use proptest::prelude::*;
    use trestle_proto::batch::{TERMINATED, TRUNCATED};
    use trestle_proto::waypoints::Waypoints;

    /// Waypoints (0, 0), (1, 1), (2, 2), and Φ up to 3.
    fn shaping() -> Shaping {
        let mut experiment = experiment(&["run.algo=dqn", "shaping.potential=3", "learner.gamma=0.9"]);
        experiment.waypoints = Some(Waypoints {
            states: vec![0.0, 0.0, 1.0, 1.0, 2.0, 2.0],
            transition_of: vec![0, 1, trestle_proto::NONE],
            progress: vec![0.0, 0.5, 1.0],
        });
        Shaping::new(&experiment).unwrap().unwrap()
    }

    #[test]
    fn potentials_by_hand() {
        let mut shaping = shaping();
        let mut close = |obs: &[f32; 2], expected: f32| {
            let found = shaping.potential(obs);
            assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        };
        close(&[2.0, 2.0], 3.0);
        // KL 1 to the last waypoint: e^-1 is less than the half of the one here.
        close(&[1.0, 1.0], 1.5);
        close(&[2.0, 3.0], 3.0 * (-0.5f32).exp());
        close(&[-4.0, -4.0], 0.0);
    }

    #[test]
    fn without_a_potential_there_is_no_shaping() {
        assert!(Shaping::new(&experiment(&["run.algo=dqn"])).unwrap().is_none());
    }

    proptest! {
        /// The discounted sum of F over an episode is what its ends say, however it went: a terminal end leaves
        /// -Φ(s_0) alone.
        #[test]
        fn an_episode_adds_nothing_but_its_ends(
            path in proptest::collection::vec([-4i8..=4, -4i8..=4], 2..30), terminal: bool,
        ) {
            let mut shaping = shaping();
            let path: Vec<[f32; 2]> = path.iter().map(|p| p.map(f32::from)).collect();
            let (mut sum, mut discount) = (0.0f32, 1.0f32);
            for (at, pair) in path.windows(2).enumerate() {
                let last = at + 2 == path.len();
                let flags = if !last { 0 } else if terminal { TERMINATED } else { TRUNCATED };
                let t = Transition { obs: &pair[0], next_obs: &pair[1], action: 0, reward: 0.0, flags };
                sum += discount * shaping.of(&t);
                discount *= 0.9;
            }
            let end = if terminal { 0.0 } else { discount * shaping.potential(path.last().unwrap()) };
            let expected = end - shaping.potential(&path[0]);
            prop_assert!((sum - expected).abs() < 1e-4, "{} {}", sum, expected);
        }
    }
}
