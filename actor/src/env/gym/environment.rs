//! A Gymnasium environment as an environment of a run.
//!
//! Gymnasium has no way to save an environment. A snapshot is the seed of the episode's reset and the actions since then. To
//! restore it, the episode is played again, and a digest of everything that the agent has seen of it must come out the same.

use super::host::{Simulator, host};
use super::{Found, GymError, Settings};
use crate::env::{EnvError, Environment, Frame, Impossible, Step};
use rand::RngCore;
use serde::{Deserialize, Serialize};
use trestle_link::pulse;
use trestle_proto::codec::{self, Kind};
use trestle_proto::config;
use trestle_proto::rng::{Stream, mix};
use trestle_proto::space::EnvSpec;

const KIND: Kind = Kind { magic: *b"TRGYM\0\0\0", version: 1 };

/// An environment of Gymnasium's interface. It is made when it is first reset.
pub struct Gym {
    spec: EnvSpec,
    settings: Settings,
    found: Found,
    step_limit: u32,
    simulator: Option<Box<dyn Simulator>>,
    episode: Episode,
}

/// What has happened since the last reset: a snapshot.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Episode {
    /// Seed of the reset.
    seed: u32,
    actions: Vec<u32>,
    /// Of every observation and reward.
    digest: u64,
    running: bool,
}

impl Episode {
    fn begun(seed: u32) -> Self {
        Self { seed, running: true, ..Self::default() }
    }

    fn see(&mut self, obs: &[f32], reward: f32) {
        let all = obs.iter().chain([&reward]);
        self.digest = all.fold(self.digest, |digest, value| mix(digest ^ u64::from(value.to_bits())));
    }
}

impl Gym {
    /// The environment of resolved settings, not yet made.
    ///
    /// # Errors
    /// Settings that were never resolved.
    pub(super) fn of(settings: &Settings, env: &config::Env) -> Result<Self, GymError> {
        let found = Found::parse(settings.found.as_deref().ok_or(GymError::Unresolved)?)?;
        Ok(Self {
            spec: found.spec(),
            settings: settings.clone(),
            found,
            step_limit: env.step_limit,
            simulator: None,
            episode: Episode::default(),
        })
    }

    fn begin(&mut self, seed: u32, obs: &mut [f32]) -> Result<(), EnvError> {
        self.episode = Episode::default();
        let simulator = match &mut self.simulator {
            Some(simulator) => simulator,
            none => {
                let host = host().ok_or(GymError::NoPython)?;
                none.insert((host.make)(&self.settings, &self.found)?)
            }
        };
        simulator.reset(seed, obs)?;
        self.episode = Episode::begun(seed);
        self.episode.see(obs, 0.0);
        Ok(())
    }
}

impl Environment for Gym {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, rng: &mut Stream, obs: &mut [f32]) -> Result<(), EnvError> {
        // Some environments take only seeds that a signed number of 32 bits can hold.
        self.begin(rng.next_u32() >> 1, obs)
    }

    fn step(&mut self, action: u32, obs: &mut [f32]) -> Result<Step, EnvError> {
        let (Some(simulator), true) = (&mut self.simulator, self.episode.running) else {
            return Err(EnvError::Ended);
        };
        if action as usize >= self.spec.n_actions() {
            return Err(EnvError::Action { action, last: self.spec.n_actions() - 1 });
        }
        let outcome = simulator.step(action as usize, obs)?;
        self.episode.actions.push(action);
        self.episode.see(obs, outcome.reward);
        let terminated = outcome.terminated;
        let cut = outcome.truncated || self.episode.actions.len() >= self.step_limit as usize;
        let truncated = cut && !terminated;
        self.episode.running = !(terminated || truncated);
        Ok(Step {
            reward: outcome.reward,
            terminated,
            truncated,
            success: self.found.success && outcome.success,
        })
    }

    fn snapshot(&self) -> Result<Vec<u8>, EnvError> {
        Ok(codec::encode(KIND, &self.episode)?)
    }

    /// Plays the episode of the snapshot again.
    fn restore(&mut self, bytes: &[u8]) -> Result<(), EnvError> {
        let saved: Episode = codec::decode(KIND, bytes)?;
        let foreign = |what| EnvError::Foreign { name: self.spec.name.clone(), what };
        if saved.actions.len() > self.step_limit as usize {
            return Err(foreign("the number of steps"));
        }
        if saved.actions.iter().any(|&action| action as usize >= self.spec.n_actions()) {
            return Err(foreign("an action"));
        }
        if saved == Episode::default() {
            self.episode = saved;
            return Ok(());
        }
        let mut obs = vec![0.0; self.spec.obs_dim()];
        self.begin(saved.seed, &mut obs)?;
        for &action in &saved.actions {
            pulse::step();
            match self.step(action, &mut obs) {
                Err(EnvError::Ended) => break,
                played => _ = played?,
            }
        }
        if self.episode != saved {
            let steps = saved.actions.len();
            self.episode = Episode::default();
            return Err(GymError::Replay { name: self.found.name.clone(), seed: saved.seed, steps }.into());
        }
        Ok(())
    }

    fn features(&self) -> Vec<&str> {
        self.found.features.names.iter().map(String::as_str).collect()
    }

    fn repeats(&self) -> bool {
        !self.settings.nondeterministic
    }

    fn frame(&mut self) -> Result<Option<Frame>, EnvError> {
        match &mut self.simulator {
            Some(simulator) => Ok(simulator.frame()?),
            None => Ok(None),
        }
    }

    /// Bounds are those of the space: the ranges of the spaces scale the network's input, and nothing more.
    fn can_be_in(&self, state: &[f32]) -> Result<(), Impossible> {
        let f = &self.found.features;
        for (feature, (&value, bounds)) in state.iter().zip(&f.bounds).enumerate() {
            let [low, high] = [bounds[0].unwrap_or(f64::MIN) as f32, bounds[1].unwrap_or(f64::MAX) as f32];
            // What has been written as text and read again may be off by the last digit.
            let slack = 1e-5 * low.abs().max(high.abs()).min(1e6);
            let integral = f.integral || f.categories.contains(&feature);
            if !(low - slack..=high + slack).contains(&value) || (integral && value.fract() != 0.0) {
                return Err(Impossible::Range { feature, value, low, high, integral });
            }
        }
        Ok(())
    }
}
