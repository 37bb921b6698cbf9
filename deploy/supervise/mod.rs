//! One run: services held, children started and reaped, progress shown, everything cleaned up.
//!
//! A run is one attempt after the other: when a process dies, the others are stopped, and all are started again from
//! the newest complete checkpoint, under a new identity and with new services, as if the run were resumed by hand.
//!
//! - `restarts`: whether there is another attempt;
//! - `children`: the processes;
//! - `display`: what the user sees meanwhile;
//! - `hold`: what the run keeps to itself.

mod children;
pub(crate) mod display;
pub(crate) mod hold;
mod line;
mod restarts;

use crate::prepare::Prepared;
use anyhow::{Context, Error, Result, anyhow};
use children::{Child, Death, How, Role, log_tail};
use display::Display;
pub(crate) use hold::HeldSignals;
use nix::libc::{SIGBUS, SIGKILL};
use restarts::{Restarts, Verdict};
use std::ops::ControlFlow;
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;
use std::time::Instant;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::mpsc;
use tokio::time::MissedTickBehavior;
use trestle_learner::record::{Progress, RunResult};
use trestle_link::iceoryx::{Domain, Services};
use trestle_proto::config::Mode;
use trestle_proto::limits::{BEAT, BLAME, GRACE, HANDSHAKE, REAP, RESTART_BACKOFF, SETTLE};

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
    runtime.block_on(async {
        let mut prepared = prepared;
        let mut signals = Signals::new()?;
        drop(held);
        let display = Display::new(&prepared.plan().config.run, quiet);
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
    let mut restarts = Restarts::new(plan.config.supervise.restarts, plan.resume_tick);
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
            () = signals.any() => return Ok(Ended::Interrupted(None)),
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
    let cleanup = Cleanup(prepared.create_domain()?);
    let services = Services::create(&cleanup.0, prepared.plan()).context(
        "cannot create the run's services (`trestle doctor` looks at shared memory and open files)",
    )?;
    let (events, mut inbox) = mpsc::channel(64);
    let mut children = children::start_all(prepared, &events)?;
    let mut replacing = Replacing::new(prepared, &services, &events);
    let outcome = watch(&mut children, &mut inbox, signals, display, &mut replacing).await;
    stop_all(&mut children, &mut inbox).await;
    drop(services);
    drop(cleanup);
    outcome
}

/// What replaces single processes of a run in free mode.
struct Replacing<'a> {
    prepared: &'a mut Prepared,
    services: &'a Services,
    events: &'a mpsc::Sender<Event>,
    /// The processes that have died, each with its account and how often it has been replaced since the learner was
    /// started last.
    accounts: Vec<(Role, Restarts, u16)>,
    /// After which deaths somebody is to be started anew, and when; none where only what the dead left is to be removed.
    due: Vec<(tokio::time::Instant, Option<Death>)>,
    /// When a process was started last.
    started: tokio::time::Instant,
    /// Since when what the dead left cannot be removed.
    stuck: Option<tokio::time::Instant>,
}

impl<'a> Replacing<'a> {
    fn new(prepared: &'a mut Prepared, services: &'a Services, events: &'a mpsc::Sender<Event>) -> Self {
        let started = tokio::time::Instant::now();
        Self { prepared, services, events, accounts: Vec::new(), due: Vec::new(), started, stuck: None }
    }

    /// Whether the others can go on without the process that has died until there is another.
    fn replaces(&self, role: Role, how: &How) -> bool {
        let signal = match how {
            How::Exited(status) => status.signal(),
            How::Lingering(_) => Some(SIGKILL),
        };
        match (self.prepared.plan().config.run.mode, role, signal) {
            // There may be no shared memory left for what it does, and a start of all looks for that first.
            (Mode::Free, _, Some(SIGBUS)) => false,
            // A learner that fails by itself may have been brought to it by what the others hold or send.
            (Mode::Free, Role::Learner, signal) => signal.is_some(),
            (Mode::Free, ..) => true,
            _ => false,
        }
    }

    /// Whether the learner is to be started anew.
    fn awaits_learner(&self) -> bool {
        self.deaths().any(|death| death.role == Role::Learner)
    }

    /// The deaths after which somebody is to be started anew.
    fn deaths(&self) -> impl Iterator<Item = &Death> {
        self.due.iter().filter_map(|(_, death)| death.as_ref())
    }

    /// Plans the replacement of the process that has died, or says why there is to be none.
    fn plan(&mut self, death: &Death, display: &Display) -> Result<()> {
        let newest = self.prepared.last_checkpoint();
        let at = match self.accounts.iter().position(|(role, ..)| *role == death.role) {
            Some(at) => at,
            None => {
                let allowed = self.prepared.plan().config.supervise.restarts;
                self.accounts.push((death.role, Restarts::of_process(allowed, newest), 0));
                self.accounts.len() - 1
            }
        };
        let pause = match self.accounts[at].1.after(death, newest, Instant::now()) {
            Verdict::Again(pause) => pause,
            Verdict::End(reason) => return Err(final_error(self.prepared, death, &reason)),
        };
        let said = format!("{death}; replacing it");
        display.say(&said);
        self.prepared.note(&said);
        self.due.push((tokio::time::Instant::now() + pause, Some(death.clone())));
        Ok(())
    }

    /// Plans nothing but that what a dead process left is removed.
    fn tidy(&mut self) {
        self.due.push((tokio::time::Instant::now(), None));
    }

    /// Removes what dead processes left, unless one has been started so shortly before that it might still be making its
    /// place: that could be mistaken for a dead one's. False: something is left.
    fn reap(&self) -> bool {
        self.started.elapsed() >= SETTLE && self.services.reap()
    }

    /// Waits until the next replacement is due, for ever if there is none.
    async fn next(&self) {
        match self.due.iter().map(|(at, _)| *at).min() {
            Some(at) => tokio::time::sleep_until(at.max(self.started + SETTLE)).await,
            None => std::future::pending().await,
        }
    }

    /// Starts those whose time has come; returns whether the learner is one of them.
    fn start(&mut self, children: &mut [Child]) -> Result<bool> {
        let now = tokio::time::Instant::now();
        // They need the dead ones' places among the services.
        if !self.reap() {
            if now - *self.stuck.get_or_insert(now) > HANDSHAKE {
                return Err(anyhow!(
                    "what a dead process left in shared memory cannot be removed (`trestle doctor`)"
                ));
            }
            self.due.iter_mut().for_each(|(at, _)| *at = (*at).max(now + RESTART_BACKOFF));
            return Ok(false);
        }
        self.stuck = None;
        let mut learner = false;
        while let Some(at) = self.due.iter().position(|(at, _)| *at <= now) {
            // Kept until it is done: if it cannot be, the run may begin anew.
            if let Some(role) = self.due[at].1.as_ref().map(|death| death.role) {
                self.replace(role, children)?;
                learner |= role == Role::Learner;
            }
            self.due.swap_remove(at);
        }
        Ok(learner)
    }

    fn replace(&mut self, role: Role, children: &mut [Child]) -> Result<()> {
        if role == Role::Learner {
            let newest = self.prepared.newest_checkpoint()?;
            self.prepared.replace_learner(newest)?;
            self.accounts.iter_mut().for_each(|(_, _, count)| *count = 0);
        } else if let Err(error) = self.prepared.count_restart() {
            // It is counted again at the next occasion.
            tracing::warn!("{error:#}");
        }
        let account = self.accounts.iter_mut().find(|(of, ..)| *of == role);
        let (_, _, count) = account.context("a process is to be replaced that has not died")?;
        *count = count.checked_add(1).with_context(|| format!("{role} has been replaced 65535 times"))?;
        let child = children::start(self.prepared, role, *count, self.events)?;
        if let Some(place) = children.iter_mut().find(|child| child.role == role) {
            *place = child;
        }
        self.started = tokio::time::Instant::now();
        Ok(())
    }
}

/// What reaches the supervisor from its children.
enum Event {
    Progress(Progress),
    Exited(Role, std::io::Result<ExitStatus>),
}

/// What asks a run to end early.
pub(crate) struct Signals {
    interrupt: Signal,
    terminate: Signal,
    /// None for a run that is to outlive its terminal.
    hangup: Option<Signal>,
}

impl Signals {
    /// From here on they do not end the process by themselves.
    pub(crate) fn new() -> Result<Self> {
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
            hangup: if hold::ignores_hangup() { None } else { Some(signal(SignalKind::hangup())?) },
        })
    }

    /// Waits for the next one.
    pub(crate) async fn any(&mut self) {
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

/// Waits until the learner has left, a child has died, or the user has interrupted twice.
async fn watch(
    children: &mut [Child],
    inbox: &mut mpsc::Receiver<Event>,
    signals: &mut Signals,
    display: &Display,
    replacing: &mut Replacing<'_>,
) -> Result<ControlFlow<Ended, Death>> {
    let (mut interrupted, mut began) = (false, false);
    let now = tokio::time::Instant::now();
    let mut reap = tokio::time::interval_at(now + REAP, REAP);
    let mut beat = tokio::time::interval_at(now + BEAT, BEAT);
    // Beats that this process has missed are nobody's silence.
    beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
    // The ends of processes that have lost another, which is to blame and whose end may not have been noticed yet.
    let mut consequences: Vec<Death> = Vec::new();
    let blame = tokio::time::sleep(BLAME);
    tokio::pin!(blame);
    let death = loop {
        tokio::select! {
            _ = reap.tick() => drop(replacing.reap()),
            _ = beat.tick() => {
                let deadlines = &replacing.prepared.plan().config.supervise;
                let mut living = children.iter_mut().filter(|c| c.running && c.fault.is_none());
                let found = living.find_map(|c| c.line.beat(deadlines).map(|fault| (c.role, fault)));
                if let Some((role, fault)) = found {
                    let how = How::Lingering(fault);
                    if !replacing.replaces(role, &how) {
                        break Death::new(replacing.prepared.dir(), role, how);
                    }
                    // Its end, which will be noticed in its turn, is what it is replaced after.
                    for child in children.iter_mut().filter(|child| child.role == role) {
                        child.fault = Some(fault);
                        child.kill();
                    }
                }
            }
            () = replacing.next() => {
                match replacing.start(children) {
                    // Until its first progress a learner has nothing that an interrupted run could save.
                    Ok(learner) => began &= !learner,
                    Err(error) => {
                        let Some(death) = replacing.deaths().next().cloned() else { return Err(error) };
                        let said = format!("{} cannot be replaced: {error:#}", death.role);
                        display.say(&said);
                        replacing.prepared.note(&said);
                        break death;
                    }
                }
            }
            () = signals.any() => {
                if interrupted {
                    tracing::warn!("interrupted twice: stopping at once");
                    return Ok(ControlFlow::Break(Ended::Interrupted(None)));
                }
                interrupted = true;
                if replacing.awaits_learner() {
                    return Ok(ControlFlow::Break(Ended::Interrupted(None)));
                }
                display.say("interrupted: finishing the tick and saving; once more to stop at once");
                children.iter().filter(|c| c.role == Role::Learner).for_each(Child::terminate);
            }
            () = &mut blame, if !consequences.is_empty() => {
                let last = |death: &Death| !replacing.replaces(death.role, &death.how);
                if let Some(at) = consequences.iter().position(last) {
                    break consequences.swap_remove(at);
                }
                for death in consequences.drain(..).filter(|_| !interrupted) {
                    replacing.plan(&death, display)?;
                }
            }
            event = inbox.recv() => match event {
                Some(Event::Progress(progress)) => {
                    if !began {
                        began = true;
                        replacing.prepared.commit()?;
                    }
                    display.update(&progress);
                }
                Some(Event::Exited(role, status)) => {
                    let mut fault = None;
                    if let Some(child) = children.iter_mut().find(|c| c.role == role) {
                        child.running = false;
                        fault = child.fault.take();
                    }
                    let status = status.with_context(|| format!("cannot wait for {role}"))?;
                    if status.success() {
                        if role == Role::Learner {
                            return Ok(ControlFlow::Break(ended(replacing.prepared)?));
                        }
                        continue;
                    }
                    let how = fault.map_or(How::Exited(status), How::Lingering);
                    let death = Death::new(replacing.prepared.dir(), role, how);
                    if !death.is_consequence() {
                        let ending = interrupted && role == Role::Learner;
                        if ending || !replacing.replaces(role, &death.how) {
                            break death;
                        }
                        // A run that is ending can do without it, and must learn that it is gone.
                        if interrupted {
                            replacing.tidy();
                        } else {
                            replacing.plan(&death, display)?;
                        }
                        continue;
                    }
                    consequences.push(death);
                    if consequences.len() == 1 {
                        blame.as_mut().reset(tokio::time::Instant::now() + BLAME);
                    }
                }
                // The other end is held by the caller.
                None => return Err(anyhow!("all processes of the run are gone without a result")),
            }
        }
    };
    match interrupted {
        true if !began => Ok(ControlFlow::Break(Ended::Interrupted(None))),
        true => Err(final_error(replacing.prepared, &death, "the run was interrupted")),
        false => Ok(ControlFlow::Continue(death)),
    }
}

/// How the run ended whose learner has left.
fn ended(prepared: &Prepared) -> Result<Ended> {
    let result = prepared.read_result()?;
    Ok(if result.interrupted { Ended::Interrupted(Some(result)) } else { Ended::Complete(result) })
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
