//! A curriculum of resets: episodes begin in the mentor's states, at first near the end of its trajectory and then further and further
//! back (Salimans and Chen 2018). The actor's environment alone knows of it.

use crate::env::{EnvError, Environment, Frame, Impossible, Step};
use rand::Rng;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use trestle_proto::codec::{self, Kind};
use trestle_proto::config::Resets as Settings;
use trestle_proto::rng::Stream;
use trestle_proto::space::EnvSpec;
use trestle_proto::waypoints::Waypoints;

const KIND: Kind = Kind { magic: *b"TRRESETS", version: 1 };

/// An environment whose episodes begin in states of a mentor.
pub(super) struct Resets {
    env: Box<dyn Environment>,
    settings: Settings,
    /// Of each trajectory the states in which an episode can begin, in order.
    trajectories: Vec<Vec<Vec<f32>>>,
    progress: Progress,
}

/// How far the curriculum has come.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Progress {
    /// From which share of a trajectory on episodes begin; 0 once they begin where the environment's own do.
    from: f64,
    /// Whether each of the newest episodes since it last moved has succeeded.
    succeeded: VecDeque<bool>,
}

/// What a snapshot holds.
#[derive(Serialize, Deserialize)]
struct State {
    env: Vec<u8>,
    progress: Progress,
}

impl Resets {
    /// `env` with beginnings among `waypoints`. States in which the environment cannot begin an episode are left out.
    ///
    /// # Errors
    /// An environment that cannot be put into any state.
    pub(super) fn new(
        mut env: Box<dyn Environment>,
        settings: &Settings,
        waypoints: &Waypoints,
    ) -> Result<Self, EnvError> {
        if !env.can_be_put() {
            return Err(EnvError::CannotBePut { env: env.spec().name.clone() });
        }
        let mut obs = vec![0.0; env.spec().obs_dim()];
        let mut states = waypoints.states.chunks_exact(obs.len());
        let mut trajectories = Vec::new();
        for length in waypoints.lengths() {
            let mut trajectory = Vec::new();
            for state in states.by_ref().take(length) {
                if env.put(state, &mut obs)? {
                    trajectory.push(state.to_vec());
                }
            }
            if !trajectory.is_empty() {
                trajectories.push(trajectory);
            }
        }
        // With nowhere to begin there is no curriculum.
        let from = if trajectories.is_empty() { 0.0 } else { (1.0 - settings.shift).max(0.0) };
        let progress = Progress { from, succeeded: VecDeque::new() };
        Ok(Self { env, settings: settings.clone(), trajectories, progress })
    }

    /// Takes in how an episode has ended, and moves the beginning where enough of the newest have succeeded.
    fn ended(&mut self, success: bool) {
        let Progress { from, succeeded } = &mut self.progress;
        let most = self.settings.episodes as usize;
        if *from == 0.0 {
            return;
        }
        if succeeded.len() == most {
            succeeded.pop_front();
        }
        succeeded.push_back(success);
        let share = succeeded.iter().filter(|&&success| success).count() as f64 / most as f64;
        if share >= self.settings.share {
            succeeded.clear();
            // A rest that is due to rounding would cost a stage.
            *from -= self.settings.shift;
            if *from < self.settings.shift * 1e-6 {
                *from = 0.0;
            }
        }
    }
}

impl Environment for Resets {
    fn spec(&self) -> &EnvSpec {
        self.env.spec()
    }

    fn reset(&mut self, rng: &mut Stream, obs: &mut [f32]) -> Result<(), EnvError> {
        let Progress { from, .. } = self.progress;
        if from == 0.0 {
            return self.env.reset(rng, obs);
        }
        let trajectory = &self.trajectories[rng.random_range(0..self.trajectories.len())];
        let last = trajectory.len() - 1;
        let least = (from * last as f64) as usize;
        // As wide as the last move, so that what was learnt there is not forgotten.
        let most = (((from + self.settings.shift) * last as f64) as usize).clamp(least, last);
        let state = &trajectory[rng.random_range(least..=most)];
        self.env.put(state, obs)?;
        Ok(())
    }

    fn step(&mut self, action: u32, obs: &mut [f32]) -> Result<Step, EnvError> {
        let step = self.env.step(action, obs)?;
        if step.terminated || step.truncated {
            self.ended(step.success);
        }
        Ok(step)
    }

    fn snapshot(&self) -> Result<Vec<u8>, EnvError> {
        Ok(codec::encode(KIND, &State { env: self.env.snapshot()?, progress: self.progress.clone() })?)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), EnvError> {
        let State { env, progress } = codec::decode(KIND, bytes)?;
        let sound = (0.0..=1.0).contains(&progress.from)
            && (progress.from == 0.0 || !self.trajectories.is_empty())
            && progress.succeeded.len() <= self.settings.episodes as usize;
        if !sound {
            let name = self.env.spec().name.clone();
            return Err(EnvError::Foreign { name, what: "the place where episodes begin" });
        }
        self.env.restore(&env)?;
        self.progress = progress;
        Ok(())
    }

    fn features(&self) -> Vec<&str> {
        self.env.features()
    }

    fn repeats(&self) -> bool {
        self.env.repeats()
    }

    fn frame(&mut self) -> Result<Option<Frame>, EnvError> {
        self.env.frame()
    }

    fn can_be_in(&self, state: &[f32]) -> Result<(), Impossible> {
        self.env.can_be_in(state)
    }
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
