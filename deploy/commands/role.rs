//! `trestle actor | learner | mentor-server`: what the supervisor starts, usable by hand in a run directory whose
//! services a supervisor holds.

use crate::TRANSPORT;
use crate::cli::{ActorRole, Role};
use crate::itself;
use crate::output::say;
use crate::status::{ExitCode, LOST_PEER, ORPHANED, TOLD};
use crate::supervise::asking;
use anyhow::{Context, Result};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use rustix::stdio::dup2_stdin;
use signal_hook::consts::{SIGINT, SIGTERM};
use std::fs::File;
use std::io::{self, ErrorKind, Read, Write, stdin, stdout};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::panic::{PanicHookInfo, set_hook, take_hook};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use trestle_actor::worker::Worker;
use trestle_learner::checkpoint;
use trestle_learner::record::Progress;
use trestle_link::log_file::OwnLog;
use trestle_link::{LinkError, Transport};
use trestle_link::{logging, pulse};
use trestle_mentor_server::demo_file;
use trestle_proto::config::Mode;
use trestle_proto::limits::BEAT;
use trestle_proto::plan::RunPlan;
use trestle_proto::rundir::RunDir;

/// What every role begins with.
pub(super) struct Start {
    pub(super) dir: RunDir,
    pub(super) plan: RunPlan,
    orders: Arc<Orders>,
}

/// The orders of the supervisor.
#[derive(Debug, Default)]
struct Orders {
    stop: Arc<AtomicBool>,
    go: AtomicBool,
}

/// The supervisor's orders to this process.
#[derive(Clone, Debug)]
pub(super) struct Ordered(Arc<Orders>);

impl Ordered {
    /// Begins process `role` of the run `run`, whose directory `args` names.
    pub(super) fn new(args: &Role, role: &str, run: u64) -> Result<Self> {
        logging::init(run, role, "info");
        let usual = take_hook();
        set_hook(Box::new(move |panic| {
            usual(panic);
            last_words(panic);
        }));
        let orders = Arc::<Orders>::default();
        if args.watch_stdin {
            let (log, theirs) = (OwnLog::at(RunDir::new(&args.run).log(role)), orders.clone());
            // A signal that asks this process to leave asks the run: the supervisor decides what becomes of it.
            let asked = Arc::new(AtomicBool::new(false));
            for signal in asking() {
                signal_hook::flag::register(signal, asked.clone()).context("cannot handle signals")?;
            }
            let line = take_stdin().context("cannot take standard input")?;
            let watch = move || leave_with_supervisor(line, run, &asked, &theirs, log.as_ref());
            thread::Builder::new().name("watch".into()).spawn(watch)?;
        } else {
            for signal in [SIGTERM, SIGINT] {
                // The second signal ends the process at once.
                signal_hook::flag::register_conditional_default(signal, orders.stop.clone())
                    .and_then(|_| signal_hook::flag::register(signal, orders.stop.clone()))
                    .context("cannot handle signals")?;
            }
        }
        Ok(Self(orders))
    }

    /// Whether it is to leave.
    pub(super) fn stop(&self) -> impl Fn() -> bool + use<> {
        let orders = self.0.clone();
        move || orders.stop.load(Ordering::Relaxed)
    }

    /// Whether the run's services are there, for a process that was started before.
    pub(super) fn go(&self) -> impl Fn() -> bool + use<> {
        let orders = self.0.clone();
        move || orders.go.load(Ordering::Relaxed)
    }
}

impl Start {
    pub(super) fn new(args: &Role, role: &str) -> Result<Self> {
        let dir = RunDir::new(&args.run);
        let plan = dir.read_plan()?;
        let Ordered(orders) = Ordered::new(args, role, plan.life.run)?;
        Ok(Self { dir, plan, orders })
    }

    pub(super) fn stop(&self) -> impl Fn() -> bool + use<> {
        Ordered(self.orders.clone()).stop()
    }
}

/// Ends the report of a panic with its own words on one line, as every error ends: by the last line of the log the supervisor
/// tells whether a process has failed in the same way before, and a hint about backtraces is the same for all.
fn last_words(panic: &PanicHookInfo<'_>) {
    let payload = panic.payload();
    let text =
        payload.downcast_ref::<&str>().copied().or(payload.downcast_ref::<String>().map(String::as_str));
    let place = panic.location().map_or_else(String::new, |at| format!(" at {at}"));
    say(&format!("error: panicked{place}: {}", text.unwrap_or("(no message)").replace('\n', " ")));
}

/// Gives signs of life on standard input, where that is a socket, and takes the order to leave from there, until it is
/// closed, which only the end of the supervisor does; then removes what the run shared, in its stead, and ends this process.
///
/// This thread shows that the process is run at all, and says of the others whether they get ahead: a gradient phase
/// may take as long as it likes.
///
/// The removal is done by this program begun anew in this process ([`orphaned`]): that ends all other threads, which
/// could otherwise go on making files. So whichever of the run's processes comes last removes everything.
///
/// It also sees to it that this process's log stays within its limit.
fn leave_with_supervisor(line: OwnedFd, run: u64, asked: &AtomicBool, orders: &Orders, log: Option<&OwnLog>) {
    if let Err(error) = beat_until_closed(line, asked, orders, log) {
        tracing::error!("standard input: {error}");
    }
    tracing::error!("the supervisor is gone: leaving");
    let error = itself::again().arg("orphaned").arg(run.to_string()).exec();
    tracing::error!("cannot begin anew: {error}");
    std::process::exit(ORPHANED.into());
}

/// Standard input, which is empty from now on: an environment, or what it starts, must not read the supervisor's orders.
fn take_stdin() -> io::Result<OwnedFd> {
    let line = stdin().as_fd().try_clone_to_owned()?;
    dup2_stdin(File::open("/dev/null")?)?;
    Ok(line)
}

fn beat_until_closed(
    line: OwnedFd,
    asked: &AtomicBool,
    orders: &Orders,
    log: Option<&OwnLog>,
) -> io::Result<()> {
    let stop = &orders.stop;
    let mut line = UnixStream::from(line);
    // A pipe has no timeouts: then nobody wants signs of life.
    if line.set_read_timeout(Some(BEAT)).and_then(|()| line.set_write_timeout(Some(BEAT))).is_err() {
        let mut byte = [0];
        let mut line = File::from(OwnedFd::from(line));
        while line.read(&mut byte)? > 0 {}
        return Ok(());
    }
    let (mut byte, mut seen) = ([0], 0);
    loop {
        match line.read(&mut byte) {
            Ok(0) => return Ok(()),
            Ok(_) if byte == [pulse::LEAVE] => {
                stop.store(true, Ordering::Relaxed);
                // A process that waits for a message looks up.
                kill(Pid::this(), Signal::SIGTERM)?;
            }
            Ok(_) if byte == [pulse::GO] => orders.go.store(true, Ordering::Relaxed),
            Ok(_) => {}
            // Interrupted: it was stopped and goes on. If that happens again and again, no read ever comes to its end.
            Err(error)
                if matches!(
                    error.kind(),
                    ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
                ) =>
            {
                let steps = pulse::steps();
                // A supervisor that does not read is stopped itself; one that is gone is noticed by the next read.
                let _ = line.write(&[if steps == seen { pulse::IDLE } else { pulse::BUSY }]);
                if asked.load(Ordering::Relaxed) && !stop.load(Ordering::Relaxed) {
                    let _ = line.write(&[pulse::ASKED]);
                }
                seen = steps;
                if let Some(Err(error)) = log.map(OwnLog::keep_bounded) {
                    tracing::debug!("the log grows on: {error}");
                }
            }
            // The supervisor went before it had read all.
            Err(error) if error.kind() == ErrorKind::ConnectionReset => return Ok(()),
            Err(error) => return Err(error),
        }
    }
}

/// `trestle orphaned`: the end of a process whose supervisor is gone.
pub(super) fn orphaned(run: u64) -> Result<ExitCode> {
    TRANSPORT.remove(run)?;
    Ok(ExitCode::from(ORPHANED))
}

pub(super) fn actor(args: &ActorRole) -> Result<ExitCode> {
    let start = Start::new(&args.role, &format!("actor-{}", args.index))?;
    let RunPlan { life, experiment } = &start.plan;
    let (index, free) = (args.index, experiment.config.run.mode == Mode::Free);
    let mut worker = Worker::replacing(experiment, index, args.incarnation)?;
    if let Some(tick) = life.resume_tick.filter(|_| !free) {
        let states = checkpoint::load_actors(&checkpoint::directory(start.dir.root(), tick))?;
        let state = states.get(index as usize).context("the checkpoint has no state of this actor")?;
        worker.restore(state)?;
    }
    let mut link = TRANSPORT.actor(&start.plan, index)?;
    match trestle_actor::run::run(&mut link, &start.plan, &mut worker, &start.stop()) {
        Ok(()) => Ok(ExitCode::from(TOLD)),
        Err(trestle_actor::run::RunError::Link(error)) => unlinked(error),
        Err(error) => Err(error.into()),
    }
}

pub(super) fn learner(args: &Role) -> Result<ExitCode> {
    let start = Start::new(args, "learner")?;
    let mut link = TRANSPORT.learner(&start.plan)?;
    let progress = Box::new(|progress: &Progress| {
        // One line of JSON. Nobody may be listening any more.
        if let Ok(line) = serde_json::to_string(progress) {
            let _ = writeln!(stdout().lock(), "{line}");
        }
    });
    match trestle_learner::run::run(&mut link, &start.plan, &start.dir, &start.stop(), progress) {
        Ok(_) => Ok(ExitCode::SUCCESS),
        Err(trestle_learner::run::RunError::Link(error)) => unlinked(error),
        Err(error) => Err(error.into()),
    }
}

pub(super) fn mentor_server(args: &Role) -> Result<ExitCode> {
    let start = Start::new(args, "mentor-server")?;
    let demonstration = demo_file::read(&start.dir.demonstration())?;
    let mut link = TRANSPORT.mentor(&start.plan)?;
    match trestle_mentor_server::run::run(&mut link, &start.plan.experiment, &demonstration, &start.stop()) {
        Ok(()) => Ok(ExitCode::from(TOLD)),
        Err(trestle_mentor_server::run::RunError::Link(error)) => unlinked(error),
        Err(error) => Err(error.into()),
    }
}

/// The end of a process whose link to the others failed: their fault, where they are gone.
fn unlinked(error: LinkError) -> Result<ExitCode> {
    if !error.is_lost_peer() {
        return Err(error.into());
    }
    say(&format!("error: {error}"));
    Ok(ExitCode::from(LOST_PEER))
}
