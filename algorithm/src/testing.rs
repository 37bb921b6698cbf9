//! A small made-up run for tests: an experiment, a demonstration, and random batches with the mentor-server's answers.

#![allow(clippy::unwrap_used)]

use rand::{Rng, RngCore, SeedableRng};
use trestle_proto::NONE;
use trestle_proto::annotation::{AnnotationTable, Bridge, Estimate};
use trestle_proto::batch::{
    Batch, BatchHeader, Checked, FIRST, SUCCEEDED, TERMINATED, TRUNCATED, Transition,
};
use trestle_proto::config::{Config, Table, from_table};
use trestle_proto::experiment::{Experiment, MentorPart};
use trestle_proto::mentor::MentorTransitions;
use trestle_proto::observe::Observed;
use trestle_proto::rng::Stream;
use trestle_proto::row::Element;
use trestle_proto::space::EnvSpec;

pub(crate) const MENTOR_LEN: usize = 6;
pub(crate) const N_ACTIONS: u32 = 3;

/// An environment with two features and three actions.
pub(crate) fn spec() -> EnvSpec {
    EnvSpec {
        name: "test".into(),
        element: Element::F32,
        shape: Vec::new(),
        low: vec![-4.0; 2],
        high: vec![4.0; 2],
        scale: vec![1.0; 2],
        integral: true,
        categories: Vec::new(),
        velocities: Vec::new(),
        actions: ["a", "b", "c"].map(String::from).to_vec(),
        best_return: None,
        threshold: None,
        goal_bonus: 0.0,
        defines_success: true,
    }
}

/// An experiment with a small network and two features, `sets` being overrides as a user would type them.
pub(crate) fn experiment(sets: &[&str]) -> Experiment {
    let small = [
        "run.env_steps=100000",
        "run.episodes=1000000",
        "learner.hidden=[9, 7]",
        "learner.batch=8",
        "learner.warmup=16",
        "learner.train_every=2",
        "learner.replay=50",
        "learner.lr=0.01",
    ];
    let sets: Vec<String> = small.iter().chain(sets).map(ToString::to_string).collect();
    let config: Config = from_table(&(), Table::new(), &sets).unwrap();
    let spec = spec();
    let part = MentorPart { name: "mentor".into(), transitions: MENTOR_LEN };
    let mentors = if config.run.algo.has_mentor() { vec![part] } else { Vec::new() };
    Experiment { config, spec, mentors, waypoints: None }
}

/// The demonstration of [`experiment`]; none for `dqn`.
pub(crate) fn demonstration(experiment: &Experiment) -> Option<MentorTransitions> {
    let mut transitions = MentorTransitions::new(2);
    for j in 0..experiment.mentor_len() {
        let x = j as f32 - 3.0;
        transitions.push(&[x, 0.5 * x], &[x + 1.0, 0.5 * x + 0.5], j + 1 == experiment.mentor_len());
    }
    (experiment.mentor_len() > 0).then_some(transitions)
}

/// What actors and mentor-server would send, drawn at random.
pub(crate) struct World {
    rng: Stream,
    /// The table that the mentor-server would have.
    table: AnnotationTable,
    experiment: Experiment,
    /// Where each actor is, while its episode lasts.
    places: Vec<Option<[f32; 2]>>,
    /// All transitions of each actor, in order.
    pub(crate) walked: Vec<Vec<Walked>>,
}

/// A transition that was made up.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Walked {
    pub(crate) obs: [f32; 2],
    pub(crate) next_obs: [f32; 2],
    pub(crate) action: u32,
    pub(crate) reward: f32,
    pub(crate) flags: u32,
}

impl Walked {
    pub(crate) fn transition(&self) -> Transition<'_> {
        let Self { obs, next_obs, action, reward, flags } = self;
        Transition { obs, next_obs, action: *action, reward: *reward, flags: *flags }
    }
}

impl World {
    pub(crate) fn new(experiment: &Experiment, seed: u64) -> Self {
        let table = AnnotationTable::new(experiment.mentor_len(), 2, N_ACTIONS as usize)
            .keeping(experiment.further());
        let actors = experiment.config.run.actors as usize;
        let (places, walked) = (vec![None; actors], vec![Vec::new(); actors]);
        Self { rng: Stream::seed_from_u64(seed), table, experiment: experiment.clone(), places, walked }
    }

    fn state(&mut self) -> [f32; 2] {
        [0; 2].map(|_| self.rng.random_range(-4..=4) as f32)
    }

    /// A batch of `count` transitions of `actor`, and the answer to it.
    pub(crate) fn batch(&mut self, actor: u32, count: u32) -> (Checked<Batch>, Option<Observed>) {
        let mut batch = Batch::default();
        batch.prepare(BatchHeader { actor, count, obs_dim: 2, ..BatchHeader::default() });
        for index in 0..count as usize {
            let place = self.places[actor as usize].filter(|_| self.rng.random_range(0..10) > 0);
            let obs = place.unwrap_or_else(|| self.state());
            let next_obs = self.state();
            let ends = match self.rng.random_range(0..10) {
                0 => TERMINATED | SUCCEEDED,
                1 => TRUNCATED,
                _ => 0,
            };
            let flags = ends | if place.is_none() { FIRST } else { 0 };
            let action = self.rng.random_range(0..N_ACTIONS);
            let reward = self.rng.random_range(-3..=3) as f32 * 0.5;
            let walked = Walked { obs, next_obs, action, reward, flags };
            batch.set(index, &walked.transition());
            self.walked[actor as usize].push(walked);
            self.places[actor as usize] = (ends == 0).then_some(next_obs);
        }
        let observed = (self.experiment.mentor_len() > 0).then(|| self.answer(count));
        (batch.check(&self.experiment.spaces()).unwrap(), observed)
    }

    fn answer(&mut self, count: u32) -> Observed {
        let len = self.experiment.mentor_len() as u32;
        let mut observed = Observed::default();
        for _ in 0..count {
            let j = self.rng.random_range(0..len + 2);
            observed.mentor.push(if j < len { j } else { NONE });
        }
        let j = self.rng.random_range(0..len) as usize;
        let (action, reward) = (self.rng.random_range(0..N_ACTIONS), self.rng.random_range(-2..=2) as f32);
        if self.rng.random() {
            let e_kl = self.rng.random_range(0.0f32..0.3).min(self.table.errors()[j]);
            self.table.set_estimate(j, &Estimate { action, e_kl, start_kl: 0.0, reward });
        } else {
            let (next_obs, terminated) = (self.state(), self.rng.next_u32().is_multiple_of(4));
            let bridge =
                Bridge { action, length: 2, reward, end_kl: 0.0, next_obs: &next_obs, terminated, ahead: 1 };
            self.table.set_bridge(j, &bridge);
            self.table.set_further(j, [(N_ACTIONS - 1 - action, &next_obs[..])].into_iter());
        }
        self.table.encode(j, &mut observed.changed);
        observed
    }
}
