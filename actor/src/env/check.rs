//! Whether an environment keeps what runs rely on, for the tests of a program with environments of its own.

use super::{EnvError, Environment, Kind, Registry, Step};
use rand::Rng;
use trestle_proto::config::{self, Table};
use trestle_proto::rng::{Purpose, Stream, stream};

/// Steps that are played on after an episode was saved, at most.
const PLAYED_ON: usize = 300;
/// Steps that are played before the episode is saved, each time.
const SAVED_AFTER: [usize; 5] = [0, 1, 17, 100, 433];

/// Plays the environment `K`, called `name`, with `sets` (`key=value`) at random, and checks that its observations are in its
/// spaces, that the same stream and actions give the same steps, and that an episode that was saved goes on bit for bit in an
/// instance that has another history.
///
/// # Errors
/// The first promise that it breaks, in words, or settings that it refuses.
///
/// # Panics
/// As [`Registry::with`].
pub fn check<K: Kind>(name: &'static str, sets: &[&str]) -> Result<(), String> {
    let registry = Registry::builtin().with::<K>(name);
    let own = [format!("env.name={name}"), "run.episodes=1".into()];
    let sets: Vec<String> = own.into_iter().chain(sets.iter().map(ToString::to_string)).collect();
    let mut env = config::from_table(&registry, Table::new(), &sets).map_err(|error| error.to_string())?.env;
    registry.resolve(&mut env, 0).map_err(|error| error.to_string())?;
    let started = |seed| {
        let env = registry.build(&env).map_err(|error| error.to_string())?;
        Walk::begin(env, stream(seed, Purpose::Environment, 0)).map_err(|error| error.to_string())
    };
    let (mut walk, mut same) = (started(1)?, started(1)?);
    agree(&mut walk, &mut same, "the same stream and actions")?;
    for length in SAVED_AFTER {
        for _ in 0..length {
            walk.step()?;
        }
        let mut other = started(2)?;
        for _ in 0..length / 2 {
            other.step()?;
        }
        let saved = walk.env.snapshot().map_err(|error| format!("snapshot: {error}"))?;
        other.env.restore(&saved).map_err(|error| format!("restore: {error}"))?;
        (other.rng, other.obs) = (walk.rng.clone(), walk.obs.clone());
        if other.env.snapshot().map_err(|error| format!("snapshot: {error}"))? != saved {
            return Err(format!("a restored environment has another snapshot, {length} steps on"));
        }
        agree(&mut walk, &mut other, "an environment and its restored copy")?;
    }
    Ok(())
}

/// Plays `one` and `other` on.
fn agree(one: &mut Walk, other: &mut Walk, what: &str) -> Result<(), String> {
    for played in 1..=PLAYED_ON {
        let (expected, found) = (one.step()?, other.step()?);
        if expected != found {
            return Err(format!("{what} differ after {played} steps: {expected:?} and {found:?}"));
        }
    }
    Ok(())
}

/// An environment that is walked through at random, and reset where an episode ends.
struct Walk {
    env: Box<dyn Environment>,
    rng: Stream,
    obs: Vec<f32>,
}

impl Walk {
    fn begin(mut env: Box<dyn Environment>, mut rng: Stream) -> Result<Self, EnvError> {
        let mut obs = vec![0.0; env.spec().obs_dim()];
        env.reset(&mut rng, &mut obs)?;
        Ok(Self { env, rng, obs })
    }

    fn step(&mut self) -> Result<(u32, Step, Vec<f32>), String> {
        let action = self.rng.random_range(0..self.env.spec().n_actions() as u32);
        let step = self.env.step(action, &mut self.obs).map_err(|error| format!("step: {error}"))?;
        let reached = self.obs.clone();
        if let Err(why) = self.env.can_be_in(&reached) {
            return Err(format!("it is in the state {reached:?}, in which it cannot be: {why}"));
        }
        if !step.reward.is_finite() || (step.terminated && step.truncated) {
            return Err(format!("{step:?}; accepted: a finite reward, and one end of an episode"));
        }
        if step.terminated || step.truncated {
            self.env.reset(&mut self.rng, &mut self.obs).map_err(|error| format!("reset: {error}"))?;
        }
        Ok((action, step, reached))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use trestle_proto::codec;
    use trestle_proto::config::accepts::between;
    use trestle_proto::settings;
    use trestle_proto::space::EnvSpec;

    settings! {
        /// A line's.
        pub struct Settings {
            /// Its last place.
            end: u32 = 20, between(5, 100);
        }
    }

    /// A walk along a line, which forgets where it was unless it `SAVES` that.
    struct Line<const SAVES: bool> {
        spec: EnvSpec,
        end: f32,
        at: f32,
    }

    const SNAPSHOT: codec::Kind = codec::Kind { magic: *b"LINE\0\0\0\0", version: 1 };

    impl<const SAVES: bool> Kind for Line<SAVES> {
        type Settings = Settings;
        const ABOUT: &'static str = "A walk along a line.";

        fn new(settings: &Settings, _env: &config::Env) -> Result<Self, EnvError> {
            let spec = EnvSpec::of("line", &[[0.0, 20.0]], &["back", "on"]);
            Ok(Self { spec, end: settings.end as f32, at: 0.0 })
        }
    }

    impl<const SAVES: bool> Environment for Line<SAVES> {
        fn spec(&self) -> &EnvSpec {
            &self.spec
        }

        fn reset(&mut self, rng: &mut Stream, obs: &mut [f32]) -> Result<(), EnvError> {
            self.at = rng.random_range(0..5) as f32;
            obs[0] = self.at;
            Ok(())
        }

        fn step(&mut self, action: u32, obs: &mut [f32]) -> Result<Step, EnvError> {
            self.at = (self.at + if action == 1 { 1.0 } else { -1.0 }).max(0.0);
            obs[0] = self.at;
            Ok(Step { reward: 0.0, terminated: self.at >= self.end, truncated: false, success: false })
        }

        fn snapshot(&self) -> Result<Vec<u8>, EnvError> {
            Ok(codec::encode(SNAPSHOT, &if SAVES { self.at } else { 0.0 })?)
        }

        fn restore(&mut self, bytes: &[u8]) -> Result<(), EnvError> {
            self.at = codec::decode(SNAPSHOT, bytes)?;
            Ok(())
        }
    }

    #[test]
    fn an_environment_that_forgets_or_leaves_its_spaces_is_found_out() {
        assert_eq!(check::<Line<true>>("line", &[]), Ok(()));
        let error = check::<Line<false>>("line", &[]).unwrap_err();
        assert!(error.starts_with("an environment and its restored copy differ after "), "{error}");
        let error = check::<Line<true>>("line", &["env.end=100"]).unwrap_err();
        assert!(
            error.starts_with("it is in the state [21.0], in which it cannot be: feature 0 is 21"),
            "{error}"
        );
        let error = check::<Line<true>>("line", &["env.endd=9"]).unwrap_err();
        assert!(error.contains("did you mean `env.end`?"), "{error}");
    }
}
