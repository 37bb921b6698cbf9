//! D-Shape's observations: behind the state stands the goal, the mentor's state after as many steps of its own and one more.

use crate::env::{EnvError, Environment, Frame, Impossible, Step};
use serde::{Deserialize, Serialize};
use trestle_proto::codec::{self, Kind};
use trestle_proto::rng::Stream;
use trestle_proto::space::EnvSpec;
use trestle_proto::waypoints::Waypoints;

const KIND: Kind = Kind { magic: *b"TRGOALS\0", version: 1 };

/// An environment whose observations have goals.
pub(super) struct Goals {
    env: Box<dyn Environment>,
    spec: EnvSpec,
    /// Features without the goal.
    dim: usize,
    /// The mentor's states without their goals, row-major.
    states: Vec<f32>,
    /// Of each trajectory its first state and the one after its last.
    trajectories: Vec<[usize; 2]>,
    /// The trajectory of the episode, and its steps so far.
    at: At,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct At {
    trajectory: usize,
    steps: usize,
}

/// What a snapshot holds.
#[derive(Serialize, Deserialize)]
struct State {
    env: Vec<u8>,
    at: At,
}

impl Goals {
    /// `env` with goals of `waypoints`, whose states have theirs.
    pub(super) fn new(env: Box<dyn Environment>, waypoints: &Waypoints) -> Self {
        let dim = env.spec().obs_dim();
        let mut first = 0;
        let trajectories = waypoints.lengths().map(|length| {
            first += length;
            [first - length, first]
        });
        Self {
            spec: env.spec().with_goals(),
            dim,
            states: waypoints.states.chunks_exact(2 * dim).flat_map(|row| &row[..dim]).copied().collect(),
            trajectories: trajectories.collect(),
            at: At::default(),
            env,
        }
    }

    fn state(&self, m: usize) -> &[f32] {
        &self.states[m * self.dim..][..self.dim]
    }

    /// The trajectory that begins nearest to `obs`, in units of the features' scales; the first of several.
    fn nearest(&self, obs: &[f32]) -> usize {
        let (mut best, mut least) = (0, f32::INFINITY);
        for (trajectory, &[first, _]) in self.trajectories.iter().enumerate() {
            let away = self.state(first).iter().zip(obs).zip(&self.spec.scale);
            let squares: f32 = away.map(|((m, s), scale)| ((m - s) / scale).powi(2)).sum();
            if squares < least {
                (best, least) = (trajectory, squares);
            }
        }
        best
    }

    /// Writes the goal of the present state behind it.
    fn aim(&self, obs: &mut [f32]) {
        let [first, end] = self.trajectories[self.at.trajectory];
        let goal = first.saturating_add(self.at.steps).saturating_add(1).min(end - 1);
        obs[self.dim..].copy_from_slice(self.state(goal));
    }
}

impl Environment for Goals {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, rng: &mut Stream, obs: &mut [f32]) -> Result<(), EnvError> {
        self.env.reset(rng, &mut obs[..self.dim])?;
        self.at = At { trajectory: self.nearest(&obs[..self.dim]), steps: 0 };
        self.aim(obs);
        Ok(())
    }

    fn step(&mut self, action: u32, obs: &mut [f32]) -> Result<Step, EnvError> {
        let step = self.env.step(action, &mut obs[..self.dim])?;
        self.at.steps += 1;
        self.aim(obs);
        Ok(step)
    }

    fn snapshot(&self) -> Result<Vec<u8>, EnvError> {
        Ok(codec::encode(KIND, &State { env: self.env.snapshot()?, at: self.at })?)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), EnvError> {
        let State { env, at } = codec::decode(KIND, bytes)?;
        if at.trajectory >= self.trajectories.len() {
            return Err(EnvError::Foreign {
                name: self.spec.name.clone(),
                what: "the trajectory of its goals",
            });
        }
        self.env.restore(&env)?;
        self.at = at;
        Ok(())
    }

    fn features(&self) -> Vec<&str> {
        let own = self.env.features();
        // The goal's have the same names.
        [&own[..], &own[..]].concat()
    }

    fn repeats(&self) -> bool {
        self.env.repeats()
    }

    fn frame(&mut self) -> Result<Option<Frame>, EnvError> {
        self.env.frame()
    }

    fn can_be_in(&self, state: &[f32]) -> Result<(), Impossible> {
        self.env.can_be_in(&state[..self.dim])
    }
}
