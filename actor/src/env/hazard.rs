//! An environment that fails on purpose (`env.hazard`): whatever an environment can do to its process, at a step that is
//! known beforehand.
//!
//! Steps are counted over the life of a process and are no part of a snapshot. So a process that is started in the place of
//! one that has failed gets as far as that one, and, where a checkpoint was taken on the way, past it.

use super::{EnvError, Environment, Frame, Impossible, Step};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::Duration;
use trestle_proto::config::{Hazard, HazardKind, HazardScope};
use trestle_proto::rng::Stream;
use trestle_proto::space::EnvSpec;

/// How long a stalled thread sleeps at a time: nothing wakes it.
const SLEEP: Duration = Duration::from_secs(3600);
/// What a slow step takes more.
const SLOW: Duration = Duration::from_millis(1);

/// The hazard of one process, whose environments fail by one count.
#[derive(Debug)]
pub struct Hazards {
    hazard: Hazard,
    taken: Arc<AtomicU64>,
}

impl Hazards {
    /// Of a process that begins now.
    pub fn new(hazard: Hazard) -> Self {
        Self { hazard, taken: Arc::default() }
    }

    /// `env`, which is for `used` (not for both), as it fails on purpose; `env` itself where it does not.
    pub fn around(&self, env: Box<dyn Environment>, used: HazardScope) -> Box<dyn Environment> {
        let during = self.hazard.during;
        if self.hazard.kind == HazardKind::None || (during != HazardScope::Both && during != used) {
            return env;
        }
        Box::new(Hazardous { env, hazard: self.hazard, taken: self.taken.clone() })
    }
}

/// An environment that is `env` for so many steps.
struct Hazardous {
    env: Box<dyn Environment>,
    hazard: Hazard,
    /// Steps of the process in all environments that fail.
    taken: Arc<AtomicU64>,
}

impl Environment for Hazardous {
    fn spec(&self) -> &EnvSpec {
        self.env.spec()
    }

    fn reset(&mut self, rng: &mut Stream, obs: &mut [f32]) -> Result<(), EnvError> {
        self.env.reset(rng, obs)
    }

    fn step(&mut self, action: u32, obs: &mut [f32]) -> Result<Step, EnvError> {
        let Hazard { kind, after, .. } = self.hazard;
        if self.taken.load(Ordering::Relaxed) < after {
            let step = self.env.step(action, obs)?;
            self.taken.fetch_add(1, Ordering::Relaxed);
            return Ok(step);
        }
        // A slow step does no harm.
        if kind != HazardKind::Slow {
            tracing::warn!(kind = kind.name(), after, "env.hazard strikes");
        }
        match kind {
            HazardKind::None => self.env.step(action, obs),
            HazardKind::Slow => {
                thread::sleep(SLOW);
                self.env.step(action, obs)
            }
            HazardKind::Abort => std::process::abort(),
            HazardKind::Panic => {
                panic!("env.hazard: the panic that was asked for, after {after} steps of the process")
            }
            HazardKind::Error => Err(EnvError::Hazard { after }),
            HazardKind::Stall => loop {
                thread::sleep(SLEEP);
            },
            HazardKind::NanReward => Ok(Step { reward: f32::NAN, ..self.env.step(action, obs)? }),
            HazardKind::NanState => {
                let step = self.env.step(action, obs)?;
                obs.last_mut().into_iter().for_each(|feature| *feature = f32::NAN);
                Ok(step)
            }
        }
    }

    fn snapshot(&self) -> Result<Vec<u8>, EnvError> {
        self.env.snapshot()
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), EnvError> {
        self.env.restore(bytes)
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
#[path = "hazard_tests.rs"]
mod tests;
