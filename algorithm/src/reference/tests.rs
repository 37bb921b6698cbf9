//! The loop around actors that are made up.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::agent::AgentError;
use crate::demonstration::Demonstration;
use crate::testing::{MENTOR_LEN, World, demonstration, experiment};
use trestle_proto::config::Algo;

#[derive(Debug)]
enum Fault {
    Agent,
    Mentor,
    Batch,
}

impl From<AgentError> for Fault {
    fn from(_: AgentError) -> Self {
        Self::Agent
    }
}

impl From<MentorError> for Fault {
    fn from(_: MentorError) -> Self {
        Self::Mentor
    }
}

impl From<BatchError> for Fault {
    fn from(_: BatchError) -> Self {
        Self::Batch
    }
}

/// Draws its steps at random, and remembers the weights and the orders that it was given.
struct Drawing {
    world: World,
    index: u32,
    acted: Vec<(Collect, Vec<f32>)>,
    evaluated: Vec<(u64, Vec<f32>)>,
}

impl Actor for Drawing {
    type Error = AgentError;

    fn collect(&mut self, acting: &Acting, order: &Collect, batch: &mut Batch) -> Result<(), AgentError> {
        *batch = self.world.batch(self.index, order.steps).0.into_inner();
        self.acted.push((*order, acting.weights.clone()));
        Ok(())
    }

    fn evaluate(&mut self, acting: &Acting, number: u64, _: u32) -> Result<Evaluation, AgentError> {
        self.evaluated.push((number, acting.weights.clone()));
        Ok(Evaluation { evaluation: number, episodes: Vec::new(), guide_return: None })
    }
}

/// An agent that is evaluated after every tick; the weights after each tick, and the evaluations that it was told of.
struct Bare {
    agent: Agent,
    weights: Vec<Vec<f32>>,
    told: u64,
}

impl Learner for Bare {
    type Error = AgentError;

    fn agent(&self) -> &Agent {
        &self.agent
    }

    fn done(&self) -> bool {
        self.agent.done()
    }

    fn ingest(&mut self, batch: &Checked<Batch>, observed: Option<&Observed>) -> Result<(), AgentError> {
        self.agent.ingest(batch, observed).map(|_| ())
    }

    fn train(&mut self, _: Round) -> Result<(), AgentError> {
        self.agent.train(|| ())?;
        self.weights.push(self.agent.weights().to_vec());
        Ok(())
    }

    fn evaluation_due(&mut self) -> Option<(u64, u32)> {
        Some((self.told, 1))
    }

    fn evaluated(&mut self, evaluation: &Evaluation) -> Result<(), AgentError> {
        self.told = evaluation.evaluation + 1;
        Ok(())
    }
}

/// Runs 6 ticks of two actors.
fn ran(sets: &[&str]) -> (Bare, Vec<Drawing>, Vec<f32>) {
    let few = ["run.actors=2", "run.rollout=8", "run.env_steps=90"];
    let experiment = experiment(&[&few[..], sets].concat());
    let actor = |index| Drawing {
        world: World::new(&experiment, 5 + u64::from(index)),
        index,
        acted: Vec::new(),
        evaluated: Vec::new(),
    };
    let mut actors = vec![actor(0), actor(1)];
    let (config, transitions) = (&experiment.config, demonstration(&experiment));
    let mentor = transitions.as_ref().map(|_| {
        let states: Vec<f32> = (0..=MENTOR_LEN).map(|m| m as f32 - 3.0).flat_map(|x| [x, 0.5 * x]).collect();
        let mut demo = Demonstration::new(vec!["x".into(), "y".into()]).unwrap();
        demo.push_trajectory(&states, true).unwrap();
        let (algo, replay, seed) = (config.run.algo, config.learner.replay, config.run.seed);
        Mentor::new(&demo, &config.mentor, algo, &experiment.spec, replay, seed).unwrap()
    });
    assert_eq!(mentor.is_some(), config.run.algo != Algo::Dqn);
    let agent = Agent::new(&experiment, transitions).unwrap();
    let mut learner = Bare { weights: vec![agent.weights().to_vec()], agent, told: 0 };
    let collected = |_: &mut Bare, actors: &[Drawing], batches: &[Batch]| {
        assert_eq!(actors.len(), batches.len());
        Ok::<(), Fault>(())
    };
    let acting = run(&experiment, &mut actors, mentor, &mut learner, collected, || false).unwrap();
    (learner, actors, acting.weights)
}

#[test]
fn actors_act_with_the_newest_weights_or_with_a_lag_the_ones_before() {
    for (lag, algo) in [(0, "dqn"), (1, "dqn"), (0, "ha-diiqn"), (1, "ha-diiqn")] {
        let (learner, actors, next) = ran(&[&format!("run.lag={lag}"), &format!("run.algo={algo}")]);
        assert_eq!((learner.weights.len(), learner.agent.counters().env_steps), (7, 90));
        assert!(learner.weights.windows(2).skip(2).all(|pair| pair[0] != pair[1]), "it learns");
        for actor in &actors {
            assert_eq!(actor.acted.len(), 6);
            for (at, (order, weights)) in actor.acted.iter().enumerate() {
                assert_eq!(
                    (u64::from(order.round), order.env_steps, order.steps),
                    (at as u64 + 1, 16 * at as u64, 8)
                );
                assert_eq!(*weights, learner.weights[at.saturating_sub(lag)], "tick {}", order.round);
            }
        }
        assert_eq!(next, learner.weights[6 - lag]);
        // Evaluations are played by the first actor, with the newest weights in either case.
        let played: Vec<_> = (0..6).map(|at| (at as u64, learner.weights[at + 1].clone())).collect();
        assert_eq!((&actors[0].evaluated, actors[1].evaluated.len()), (&played, 0));
    }
}

#[test]
fn the_mentor_sees_what_the_learner_drops() {
    let (learner, ..) = ran(&["run.algo=ha-diiqn"]);
    // 96 transitions were observed, and 90 of them are counted.
    assert_eq!(learner.agent.replay().next_index(), 90);
    let visits: u64 = learner.agent.mentor_rows().unwrap().map(|row| row.visited).sum();
    assert!(visits > 0);
}
