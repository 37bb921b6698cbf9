//! The single-process loop: the same algorithm without processes, services or messages, to read and to compare with.
//!
//! It calls the very functions that actors, mentor-server and learner call, in the order that lockstep fixes, so the
//! distributed run must end with the same weights, bit for bit. What is missing here is everything that could go
//! wrong between processes.

use crate::prepare::Prepared;
use crate::supervise::display::Display;
use crate::supervise::{Ended, HeldSignals, asking};
use anyhow::{Context, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use trestle_actor::worker::Worker;
use trestle_algorithm::mentor::Mentor;
use trestle_learner::checkpoint::Taken;
use trestle_learner::session::Session;
use trestle_mentor_server::demo_file;
use trestle_mentor_server::run::mentor_of;
use trestle_proto::batch::Batch;
use trestle_proto::observe::Observed;

/// Trains the prepared run in this process.
pub(crate) fn run(prepared: &Prepared, held: HeldSignals, quiet: bool) -> Result<Ended> {
    let (plan, dir) = (prepared.plan(), prepared.dir());
    let experiment = &plan.experiment;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in asking() {
        signal_hook::flag::register(signal, stop.clone()).context("cannot handle signals")?;
    }
    drop(held);

    let mut workers = (0..experiment.config.run.actors)
        .map(|index| Worker::new(experiment, index))
        .collect::<Result<Vec<_>, _>>()?;
    let mut mentor = mentor(prepared)?;
    let display = Display::new(&experiment.config.run, quiet);
    let transitions = mentor.as_ref().map(|mentor| mentor.mentor_transitions().clone());
    let mut session = Session::new(plan, dir, transitions, |progress| display.update(progress))?;
    session.start()?;
    prepared.commit()?;

    let lag = experiment.config.run.lag == 1;
    let mut batches = vec![Batch::default(); workers.len()];
    let mut observed = Observed::default();
    // What the actors act with: the newest, or with a lag that of one tick earlier.
    let mut acting = session.agent().acting().clone();
    let mut tick = 0;
    while !session.done() && !stop.load(Ordering::Relaxed) {
        tick += 1;
        let collect = session.collect(tick, session.tick());
        for (worker, batch) in workers.iter_mut().zip(&mut batches) {
            worker.collect(&acting, &collect, batch)?;
        }
        if lag {
            acting.clone_from(session.agent().acting());
        }
        // Once the run has reached its limits, what the agent drops still counts for the mentor.
        let mut first_index = session.agent().counters().env_steps;
        for batch in &batches {
            let observed = match &mut mentor {
                Some(mentor) => {
                    mentor.observe(first_index, batch.header.actor, batch, &mut observed)?;
                    Some(&observed)
                }
                None => None,
            };
            session.ingest(batch, observed)?;
            first_index += batch.len() as u64;
        }
        session.train(tick)?;
        if !lag {
            acting.clone_from(session.agent().acting());
        }
        if session.done() {
            session.request_final_evaluation();
        }
        if let Some((number, episodes)) = session.evaluate() {
            let acting = session.agent().acting();
            let mut evaluation = workers[0].evaluate(&acting.weights, number, episodes)?;
            evaluation.guide_return = workers[0].evaluate_guide(&acting.policy, number)?;
            session.evaluated(&evaluation)?;
        }
    }
    let snapshots = workers.iter().map(Worker::snapshot).collect::<Result<Vec<_>, _>>()?;
    let interrupted = !session.done();
    let taken = if interrupted { Taken::Amid } else { Taken::Last };
    session.checkpoint(lag.then_some(acting), &snapshots, taken)?;
    let result = session.finish(interrupted)?;
    display.finish();
    Ok(if interrupted { Ended::Interrupted(Some(result)) } else { Ended::Complete(result) })
}

/// The mentor of the run, if its algorithm has one, from the demonstration in the run's directory.
fn mentor(prepared: &Prepared) -> Result<Option<Mentor>> {
    let experiment = prepared.experiment();
    if experiment.mentor_len() == 0 {
        return Ok(None);
    }
    let demonstration = demo_file::read(&prepared.dir().demonstration())?;
    Ok(Some(mentor_of(experiment, &demonstration)?))
}
