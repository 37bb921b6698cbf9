//! One run: services held, children started and reaped, progress shown, everything cleaned up.
//!
//! - [`prepare`]: from a configuration to a run directory and its plan, or a refusal with nothing left behind;
//! - `children`: the processes;
//! - `display`: what the user sees meanwhile;
//! - `hold`: what the run keeps to itself.

mod children;
pub(crate) mod display;
mod hold;
pub(crate) mod prepare;

use anyhow::{Context, Result, bail};
use children::{Child, Role, log_tail};
use display::Display;
pub(crate) use hold::HeldSignals;
use prepare::Prepared;
use std::process::ExitStatus;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::mpsc;
use trestle_learner::record::{Progress, RunResult};
use trestle_proto::limits::{GRACE, REAP};
use trestle_proto::transport::iceoryx::{Domain, Services};

/// How a run ended.
pub(crate) enum Ended {
    /// It did what was asked.
    Complete(RunResult),
    /// It was interrupted; there is a result if it had begun to train.
    Interrupted(Option<RunResult>),
}

/// Removes the run's shared memory when it goes, on whichever way.
struct Cleanup(Domain);

impl Drop for Cleanup {
    fn drop(&mut self) {
        if let Err(error) = self.0.remove() {
            tracing::error!("cannot remove what the run shared: {error}; `trestle doctor --fix` can");
        }
    }
}

/// Trains the prepared run in its processes and waits for its end.
pub(crate) fn run(prepared: Prepared, held: HeldSignals, quiet: bool) -> Result<Ended> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(supervise(prepared, held, quiet))
}

async fn supervise(prepared: Prepared, held: HeldSignals, quiet: bool) -> Result<Ended> {
    let mut signals = Signals::new()?;
    drop(held);
    let cleanup = Cleanup(prepared.create_domain()?);
    let services = Services::create(&cleanup.0, prepared.plan()).context(
        "cannot create the run's services (`trestle doctor` looks at shared memory and open files)",
    )?;
    let display = Display::new(prepared.plan(), quiet);
    let (events, mut inbox) = mpsc::channel(64);
    let mut children = children::start_all(&prepared, &events)?;
    let outcome = watch(&mut children, &mut inbox, &mut signals, &display, &prepared, &services).await;
    display.finish();
    stop_all(&mut children, &mut inbox).await;
    drop(services);
    drop(cleanup);
    outcome
}

/// What reaches the supervisor from its children.
enum Event {
    Progress(Progress),
    Exited(Role, std::io::Result<ExitStatus>),
}

struct Signals {
    interrupt: Signal,
    terminate: Signal,
    /// None for a run that is to outlive its terminal.
    hangup: Option<Signal>,
}

impl Signals {
    fn new() -> Result<Self> {
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
            hangup: if hold::ignores_hangup() { None } else { Some(signal(SignalKind::hangup())?) },
        })
    }

    async fn any(&mut self) {
        let hangup = async {
            match &mut self.hangup {
                Some(hangup) => hangup.recv().await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
            _ = hangup => {}
        }
    }
}

/// Waits until the learner has left, a child has failed, or the user has interrupted twice.
async fn watch(
    children: &mut [Child],
    inbox: &mut mpsc::Receiver<Event>,
    signals: &mut Signals,
    display: &Display,
    prepared: &Prepared,
    services: &Services,
) -> Result<Ended> {
    let (mut interrupted, mut began) = (false, false);
    let mut reap = tokio::time::interval_at(tokio::time::Instant::now() + REAP, REAP);
    loop {
        tokio::select! {
            _ = reap.tick() => services.reap(),
            () = signals.any() => {
                if interrupted {
                    tracing::warn!("interrupted twice: stopping at once");
                    return Ok(Ended::Interrupted(None));
                }
                interrupted = true;
                display.say("interrupted: finishing the tick and saving; once more to stop at once");
                children.iter().filter(|c| c.role == Role::Learner).for_each(Child::terminate);
            }
            event = inbox.recv() => match event {
                Some(Event::Progress(progress)) => {
                    if !began {
                        began = true;
                        prepared.commit()?;
                    }
                    display.update(&progress);
                }
                Some(Event::Exited(role, status)) => {
                    if let Some(child) = children.iter_mut().find(|c| c.role == role) {
                        child.running = false;
                    }
                    let status = status.with_context(|| format!("cannot wait for {role}"))?;
                    match (role, status.success()) {
                        (Role::Learner, true) => {
                            let result = prepared.read_result()?;
                            return Ok(if result.interrupted {
                                Ended::Interrupted(Some(result))
                            } else {
                                Ended::Complete(result)
                            });
                        }
                        (_, true) => {}
                        (_, false) if interrupted && !began => return Ok(Ended::Interrupted(None)),
                        (_, false) => {
                            let tail = log_tail(prepared.dir(), role);
                            bail!("{role} ended with {status}; the end of its log:\n{tail}");
                        }
                    }
                }
                None => bail!("all processes of the run are gone without a result"),
            }
        }
    }
}

/// Asks what still runs to leave, once the learner has left of itself, and ends what does not. No child outlives this.
async fn stop_all(children: &mut [Child], inbox: &mut mpsc::Receiver<Event>) {
    let learner_left = children.iter().all(|c| c.role != Role::Learner || !c.running);
    if learner_left {
        children.iter().filter(|c| c.running).for_each(Child::terminate);
    }
    let mut deadline = Box::pin(tokio::time::sleep(if learner_left { GRACE } else { Default::default() }));
    let mut killed = false;
    while children.iter().any(|c| c.running) {
        tokio::select! {
            () = &mut deadline, if !killed => {
                killed = true;
                children.iter().filter(|c| c.running).for_each(Child::kill);
            }
            event = inbox.recv() => match event {
                Some(Event::Exited(role, _)) => {
                    if let Some(child) = children.iter_mut().find(|c| c.role == role) {
                        child.running = false;
                    }
                }
                Some(Event::Progress(_)) => {}
                None => return,
            }
        }
    }
}
