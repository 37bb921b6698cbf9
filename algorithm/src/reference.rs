//! The whole algorithm in one loop, without processes, services or messages: to read, and to compare with.
//!
//! The loop calls the very functions that actors, mentor-server and learner call, in the order that lockstep fixes. A
//! distributed run must therefore end with the same weights, bit for bit. The loop lacks everything that could go wrong
//! between processes.

use crate::agent::Agent;
use crate::mentor::{Mentor, MentorError};
use trestle_proto::acting::Acting;
use trestle_proto::batch::{Batch, BatchError, Checked};
use trestle_proto::experiment::Experiment;
use trestle_proto::observe::Observed;
use trestle_proto::orders::Collect;
use trestle_proto::reply::Evaluation;
use trestle_proto::round::Round;

/// An environment with a policy in it.
pub trait Actor {
    /// Why the environment or the policy cannot go on.
    type Error;

    /// Takes the steps that `order` asks for, acting with `acting`, and writes them to `batch`.
    ///
    /// # Errors
    /// The environment fails.
    fn collect(&mut self, acting: &Acting, order: &Collect, batch: &mut Batch) -> Result<(), Self::Error>;

    /// Plays the greedy episodes of the evaluation with this number, from 0, by the weights in `acting`.
    ///
    /// # Errors
    /// The environment fails.
    fn evaluate(&mut self, acting: &Acting, number: u64, episodes: u32) -> Result<Evaluation, Self::Error>;
}

/// An agent, and what decides around it when to evaluate and when to stop.
pub trait Learner {
    /// Why learning cannot go on.
    type Error;

    /// The agent.
    fn agent(&self) -> &Agent;

    /// Whether the run is over.
    fn done(&self) -> bool;

    /// Takes in one actor's batch, with the mentor's answer to it where there is a mentor.
    ///
    /// # Errors
    /// The batch is not one of this run.
    fn ingest(&mut self, batch: &Checked<Batch>, observed: Option<&Observed>) -> Result<(), Self::Error>;

    /// Takes the gradient steps that tick number `tick` makes due.
    ///
    /// # Errors
    /// Training diverges.
    fn train(&mut self, tick: Round) -> Result<(), Self::Error>;

    /// Number, from 0, and episodes of the evaluation that is due after a tick, if one is.
    fn evaluation_due(&mut self) -> Option<(u64, u32)>;

    /// Takes note of the evaluation that was due.
    ///
    /// # Errors
    /// It is not the one that was due.
    fn evaluated(&mut self, evaluation: &Evaluation) -> Result<(), Self::Error>;
}

/// Trains the run of `experiment` with `actors` until `learner` is done or `stop` says so. `mentor` is there exactly where the algorithm
/// has one. In each tick `collected` sees learner, actors and batches before anything is learnt of them. Returns what the actors
/// would act with in the next tick.
///
/// # Errors
/// Whatever actors, learner, mentor or `collected` refuse.
pub fn run<A, L, E>(
    experiment: &Experiment,
    actors: &mut [A],
    mut mentor: Option<Mentor>,
    learner: &mut L,
    mut collected: impl FnMut(&mut L, &[A], &[Batch]) -> Result<(), E>,
    stop: impl Fn() -> bool,
) -> Result<Acting, E>
where
    A: Actor,
    L: Learner,
    E: From<A::Error> + From<L::Error> + From<MentorError> + From<BatchError>,
{
    let (spaces, lag) = (experiment.spaces(), experiment.config.run.lag == 1);
    let mut batches = vec![Batch::default(); actors.len()];
    let mut observed = Observed::default();
    // The newest, or with a lag that of one tick earlier.
    let mut acting = learner.agent().acting().clone();
    let mut tick = Round::default();
    while !learner.done() && !stop() {
        tick = tick.next();
        // The actors take their steps.
        for (actor, batch) in actors.iter_mut().zip(&mut batches) {
            actor.collect(&acting, &order(experiment, tick), batch)?;
        }
        collected(learner, actors, &batches)?;
        if lag {
            acting.clone_from(learner.agent().acting());
        }
        // The mentor sees each transition before the learner does: action inference, bridges, a similar mentor transition.
        // Once the run has reached its limits, what the learner drops still counts for the mentor.
        let mut first = learner.agent().counters().env_steps;
        for batch in &mut batches {
            let checked = std::mem::take(batch).check(&spaces)?;
            let answer = match &mut mentor {
                Some(mentor) => {
                    mentor.observe(first, checked.transitions(), &mut observed)?;
                    Some(&observed)
                }
                None => None,
            };
            learner.ingest(&checked, answer)?;
            first += checked.len() as u64;
            *batch = checked.into_inner();
        }
        // The gradient steps that are due.
        learner.train(tick)?;
        if !lag {
            acting.clone_from(learner.agent().acting());
        }
        if let Some((number, episodes)) = learner.evaluation_due() {
            let evaluation = actors[0].evaluate(learner.agent().acting(), number, episodes)?;
            learner.evaluated(&evaluation)?;
        }
    }
    Ok(acting)
}

/// What each actor is to do in tick `tick`, from 1.
fn order(experiment: &Experiment, tick: Round) -> Collect {
    let before = tick.before(1);
    Collect {
        run: 0,
        round: tick,
        weights_version: before,
        // Every earlier tick gave as many: the same number whether or not they have been trained on yet.
        env_steps: u64::from(before) * experiment.steps_per_tick(),
        steps: experiment.config.run.rollout,
    }
}

#[cfg(test)]
mod tests;
