//! `--mode reference`: the loop of [`trestle_algorithm::reference`] with the run's environments, records and checkpoints.

use crate::prepare::Prepared;
use crate::supervise::display::Display;
use crate::supervise::{Ended, HeldSignals, asking};
use anyhow::{Context, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use trestle_actor::worker::Worker;
use trestle_algorithm::mentor::Mentor;
use trestle_algorithm::reference;
use trestle_learner::checkpoint::Taken;
use trestle_learner::session::Session;
use trestle_mentor_server::demo_file;
use trestle_mentor_server::run::mentor_of;
use trestle_proto::batch::Batch;
use trestle_proto::observe::Part;

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
    let mentor = mentor(prepared)?;
    let display = Display::new(&experiment.config.run, quiet);
    let transitions = mentor.as_ref().map(|mentor| mentor.mentor_transitions().clone());
    let mut session = Session::new(plan, dir, transitions, Box::new(|progress| display.update(progress)))?;
    session.start();
    prepared.commit()?;

    let stopped = || stop.load(Ordering::Relaxed);
    let acting = reference::run(experiment, &mut workers, mentor, &mut session, save_before_last, stopped)?;
    let snapshots = workers.iter().map(Worker::snapshot).collect::<Result<Vec<_>, _>>()?;
    let interrupted = !session.done();
    let taken = if interrupted { Taken::Amid } else { Taken::Last };
    let lag = experiment.config.run.lag == 1;
    session.checkpoint(lag.then_some(acting), &snapshots, taken)?;
    let result = session.finish(interrupted)?;
    display.finish();
    Ok(if interrupted { Ended::Interrupted(Some(result)) } else { Ended::Complete(result) })
}

/// Writes the checkpoint that a longer run goes on from, if the tick of these batches is the run's last: nothing of it has been
/// learnt.
fn save_before_last(session: &mut Session, workers: &[Worker], batches: &[Batch]) -> Result<()> {
    if !session.ends_within(batches.iter()) {
        return Ok(());
    }
    let snapshots = workers.iter().map(Worker::snapshot).collect::<Result<Vec<_>, _>>()?;
    let parts: Vec<Part<'_>> = batches.iter().map(Part::of).collect();
    Ok(session.checkpoint(None, &snapshots, Taken::BeforeLast(&parts))?)
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
