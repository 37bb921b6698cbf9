//! An environment from outside this crate: registered, configured, trained in and evaluated without a map, a planner or a
//! picture, and with episodes that end by failing.

#![allow(clippy::unwrap_used)]

use rand::Rng;
use trestle_actor::env::{EnvError, Environment, Kind, Registry, Step, install, registry};
use trestle_actor::worker::Worker;
use trestle_proto::acting::Acting;
use trestle_proto::batch::Batch;
use trestle_proto::codec;
use trestle_proto::config::accepts::between;
use trestle_proto::config::{self, Environments, Table};
use trestle_proto::experiment::Experiment;
use trestle_proto::orders::Collect;
use trestle_proto::plan::{Life, RunPlan};
use trestle_proto::rng::Stream;
use trestle_proto::row::Element;
use trestle_proto::settings;
use trestle_proto::space::{EnvSpec, Success};

settings! {
    /// `[env.balance]`
    pub struct Settings {
        /// How far from the middle the episode ends.
        width: u32 = 3, between(1, 100);
    }
}

/// One steps to the left or to the right, and falls at either end. Every step is worth 1.
struct Balance {
    spec: EnvSpec,
    width: i32,
    limit: u32,
    at: i32,
    steps: u32,
}

impl Kind for Balance {
    type Settings = Settings;

    const ABOUT: &'static str = "A plank between two drops.";

    fn new(settings: &Settings, env: &config::Env) -> Result<Self, EnvError> {
        let width = settings.width as i32;
        let spec = EnvSpec {
            name: "balance".into(),
            element: Element::F32,
            shape: Vec::new(),
            low: vec![-(settings.width as f32)],
            high: vec![settings.width as f32],
            scale: vec![1.0],
            integral: true,
            categories: Vec::new(),
            velocities: Vec::new(),
            actions: vec!["left".into(), "right".into()],
            best_return: None,
            threshold: None,
            goal_bonus: 0.0,
            defines_success: false,
        };
        Ok(Self { spec, width, limit: env.step_limit, at: width, steps: 0 })
    }
}

impl Environment for Balance {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, rng: &mut Stream, obs: &mut [f32]) -> Result<(), EnvError> {
        self.at = rng.random_range(0..2) - 1;
        self.steps = 0;
        obs[0] = self.at as f32;
        Ok(())
    }

    fn step(&mut self, action: u32, obs: &mut [f32]) -> Result<Step, EnvError> {
        if self.at.abs() >= self.width || self.steps >= self.limit {
            return Err(EnvError::Ended);
        }
        self.at += if action == 0 { -1 } else { 1 };
        self.steps += 1;
        obs[0] = self.at as f32;
        let terminated = self.at.abs() >= self.width;
        let truncated = !terminated && self.steps >= self.limit;
        Ok(Step { reward: 1.0, terminated, truncated, success: false })
    }

    fn snapshot(&self) -> Result<Vec<u8>, EnvError> {
        Ok(codec::encode(codec::Kind { magic: *b"BALANCE\0", version: 1 }, &(self.at, self.steps))?)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), EnvError> {
        (self.at, self.steps) = codec::decode(codec::Kind { magic: *b"BALANCE\0", version: 1 }, bytes)?;
        Ok(())
    }
}

/// A run in it with `sets`.
fn experiment(sets: &[&str]) -> Experiment {
    let sets =
        ["env.name=balance", "run.algo=dqn", "run.episodes=1", "learner.hidden=[4]"].iter().chain(sets);
    let sets: Vec<String> = sets.map(ToString::to_string).collect();
    let mut config = config::from_table(registry(), Table::new(), &sets).unwrap();
    registry().resolve(&mut config.env, 0).unwrap();
    let spec = registry().build(&config.env).unwrap().spec().clone();
    let (mentors, waypoints) = (Vec::new(), None);
    Experiment { config, spec, mentors, waypoints }
}

#[test]
fn an_environment_of_another_crate_is_one_like_the_others() {
    assert!(install(Registry::builtin().with::<Balance>("balance")).is_ok());
    assert!(install(Registry::builtin()).is_err(), "there is one already");
    assert_eq!(registry().names(), ["maze", "point-maze", "gym", "balance"]);
    assert_eq!(registry().declared("balance")[0].key, "env.balance.width");
    let wrong = Table::from_iter([("width".to_string(), 0.into())]);
    let error = registry().complete("balance", wrong).unwrap_err().to_string();
    assert_eq!(error, "env.width = 0; accepted: 1 to 100");

    let experiment = experiment(&["env.width=2", "env.step_limit=5"]);
    // It has no map, no drawing and no planner, and none of these is missed before it is asked for.
    assert!(registry().draw(&experiment.config.env, &[]).unwrap().is_none());
    assert!(registry().ground(&experiment.config.env).unwrap().is_none());
    assert!(registry().engine(&experiment.config.env).unwrap().is_none());
    let error = registry().plan_states(&experiment.config.env, "any").unwrap_err().to_string();
    assert!(error.contains("the environment balance has no planner; accepted: a CSV file"), "{error}");
    let plan = RunPlan { life: Life::default(), experiment: experiment.clone() };
    assert_eq!(RunPlan::decode(&plan.encode().unwrap()).unwrap(), plan);

    // A batch of training, and a snapshot in the middle of an episode.
    let mut worker = Worker::new(&experiment, 0).unwrap();
    let acting = Acting::zeros(worker.lengths());
    let order = Collect { run: 1, round: 1.into(), steps: 23, ..Collect::default() };
    let mut batch = Batch::default();
    worker.collect(&acting, &order, &mut batch).unwrap();
    assert!((0..23).any(|i| batch.transition(i).terminated()));
    assert!((0..23).all(|i| !batch.transition(i).succeeded()));
    worker.restore(&worker.snapshot().unwrap()).unwrap();

    // Always to the left: every episode ends by falling, after one step or two. That is no success.
    let played = worker.evaluate(&acting.weights, 0, 20).unwrap().episodes;
    assert!(played.iter().all(|played| played.terminated && played.episode.length <= 2));
    assert_eq!(experiment.success(), Success::Undefined);
    assert!(played.iter().all(|played| played.episode.success.is_none()));
}

#[test]
fn a_threshold_defines_success_where_the_environment_does_not() {
    // The registry is that of the process, and so the other test's: this one needs the spaces alone.
    let mut config = config::Config::default();
    config.eval.threshold = Some(5.0);
    config.eval.tolerance = 1.0;
    let spec = Balance::new(&Settings::default(), &config::Env::default()).unwrap().spec;
    let (mentors, waypoints) = (Vec::new(), None);
    let experiment = Experiment { config, spec, mentors, waypoints };
    let success = experiment.success();
    assert_eq!([3.9, 4.0, 5.0].map(|total| success.of(true, total)), [Some(false), Some(true), Some(true)]);
}
