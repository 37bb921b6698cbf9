//! One run: shared memory held, children started and reaped, progress shown, everything cleaned up.
//!
//! A run is one attempt after the other: when a process dies, the others are stopped, and all are started again from
//! the newest complete checkpoint. They have a new identity and share nothing with the attempt before, as if the run were resumed by hand.
//!
//! - `watch`: what is done about whatever happens, as a table;
//! - `drive`: the events of that table, and its actions;
//! - `replacing`: who takes the place of a single process;
//! - `restarts`: whether there is another attempt;
//! - `children`: the processes; `line`: the line to each;
//! - `signals`: what asks the run to end;
//! - `display`: what the user sees meanwhile;
//! - `joined`: a host that lends its actors to a run of another one.

mod children;
pub(crate) mod display;
mod drive;
mod joined;
mod line;
mod replacing;
mod restarts;
mod signals;
#[cfg(test)]
#[path = "../../tests/simulation/mod.rs"]
mod simulation;
mod watch;

use crate::TRANSPORT;
use crate::prepare::Prepared;
use anyhow::{Context, Error, Result, anyhow};
use children::{Child, Death, Role, log_tail};
use display::Display;
pub(crate) use joined::{FAREWELL, GRANTED, HOST, Parted, join};
use replacing::Replacing;
use restarts::{Restarts, Verdict};
pub(crate) use signals::{HeldSignals, Signals, asking};
use std::ops::ControlFlow;
use std::process::ExitStatus;
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use trestle_learner::record::Progress;
use trestle_link::{Host, Transport};
use trestle_proto::limits::GRACE;
use trestle_proto::run_result::RunResult;

/// How a run ended.
pub(crate) enum Ended {
    /// It did what was asked.
    Complete(RunResult),
    /// It was interrupted; there is a result if it had begun to train.
    Interrupted(Option<RunResult>),
}

/// Trains the prepared run in its processes and waits for its end.
pub(crate) fn run(prepared: Prepared, held: HeldSignals, quiet: bool) -> Result<Ended> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let mut prepared = prepared;
        let mut signals = Signals::new()?;
        drop(held);
        let display = Display::new(&prepared.experiment().config.run, quiet);
        let outcome = supervise(&mut prepared, &mut signals, &display).await;
        display.finish();
        outcome
    })
}

/// Starts the run, and again after each death for as long as that promises anything. Several runs can go on at once in one
/// process; a signal reaches each of them.
pub(crate) async fn supervise(
    prepared: &mut Prepared,
    signals: &mut Signals,
    display: &Display,
) -> Result<Ended> {
    let plan = prepared.plan();
    let mut restarts = Restarts::new(plan.experiment.config.supervise.restarts, plan.life.resume_tick);
    loop {
        let death = match attempt(prepared, signals, display).await? {
            ControlFlow::Break(ended) => return Ok(ended),
            ControlFlow::Continue(death) => death,
        };
        let newest = match prepared.newest_checkpoint() {
            Ok(newest) => newest,
            Err(error) => return Err(final_error(prepared, &death, &format!("{error:#}"))),
        };
        let pause = match restarts.after(&death, newest, Instant::now()) {
            Verdict::Again(pause) => pause,
            Verdict::End(reason) => return Err(final_error(prepared, &death, &reason)),
        };
        let from = newest.map_or("the beginning".into(), |tick| format!("the checkpoint of tick {tick}"));
        let said = format!("{death}; starting all processes again from {from}");
        display.say(&said);
        prepared.note(&said);
        tokio::select! {
            () = tokio::time::sleep(pause) => {}
            _ = signals.next() => return Ok(Ended::Interrupted(None)),
        }
        if let Err(error) = prepared.restart_from(newest) {
            return Err(final_error(prepared, &death, &format!("{error:#}")));
        }
    }
}

/// The end of a run that is not started again after `death`.
fn final_error(prepared: &Prepared, death: &Death, reason: &str) -> Error {
    prepared.note(&format!("{death}; not started again: {reason}"));
    let tail = log_tail(prepared.dir(), death.role);
    anyhow!("{death}; not started again: {reason}; the end of its log:\n{tail}")
}

/// All processes once: until the run's end, or the first death, after which the run may continue.
async fn attempt(
    prepared: &mut Prepared,
    signals: &mut Signals,
    display: &Display,
) -> Result<ControlFlow<Ended, Death>> {
    let host = TRANSPORT.host(prepared.plan()).context(
        "cannot create the run's services (`trestle doctor` looks at shared memory and open files)",
    )?;
    let (reports, mut inbox) = mpsc::channel(64);
    let mut children = children::start_all(prepared, &reports)?;
    let mut replacing = Replacing::new(prepared, &host, &reports);
    let outcome = drive::watch(&mut children, &mut inbox, signals, display, &mut replacing).await;
    drop(replacing);
    end_all(&mut children, &mut inbox, &host, prepared).await;
    outcome
}

/// What reaches the supervisor from its children.
enum Report {
    Progress(Progress),
    /// A relay says something.
    Said(String),
    Exited(Role, std::io::Result<ExitStatus>),
}

/// Ends all that still runs: asks it to leave, once the learner has left of itself, or kills it. No child outlives this.
async fn end_all(
    children: &mut [Child],
    inbox: &mut mpsc::Receiver<Report>,
    host: &impl Host,
    prepared: &Prepared,
) {
    let learner_left = children.iter().all(|child| child.role != Role::Learner || !child.running);
    if learner_left {
        children.iter_mut().filter(|child| child.running).for_each(Child::leave);
    } else if let Err(error) = host.remove() {
        // Before they die: if this process is killed, too, while they are dying, nobody is left to remove anything.
        tracing::warn!("{error}");
    }
    // The relay's last words are its counts.
    let mut said = |line: &str| line.strip_prefix(HOST).into_iter().for_each(|row| prepared.tell_host(row));
    until_gone(children, inbox, if learner_left { GRACE } else { Duration::ZERO }, &mut said).await;
}

/// Waits for the end of all that still runs, and kills it after `grace`. `said` is told what a relay still says.
async fn until_gone(
    children: &mut [Child],
    inbox: &mut mpsc::Receiver<Report>,
    grace: Duration,
    said: &mut dyn FnMut(&str),
) {
    let mut deadline = Box::pin(tokio::time::sleep(grace));
    let mut killed = false;
    while children.iter().any(|child| child.running) {
        tokio::select! {
            () = &mut deadline, if !killed => {
                killed = true;
                children.iter().filter(|child| child.running).for_each(Child::kill);
            }
            report = inbox.recv() => match report {
                Some(Report::Exited(role, _)) => {
                    if let Some(child) = children.iter_mut().find(|child| child.role == role) {
                        child.running = false;
                    }
                }
                Some(Report::Said(line)) => said(&line),
                Some(Report::Progress(_)) => {}
                None => return,
            }
        }
    }
}
