//! `trestle actor | learner | mentor-server`: what the supervisor starts, usable by hand in a run directory whose
//! services a supervisor holds.

use crate::cli::{ActorRole, Role};
use anyhow::{Context, Result};
use std::io::{Read, Write, stdin, stdout};
use std::os::unix::process::CommandExt;
use std::process::{Command, ExitCode};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use trestle_actor::run::Left;
use trestle_actor::worker::Worker;
use trestle_learner::checkpoint;
use trestle_learner::record::Progress;
use trestle_mentor_server::demo_file;
use trestle_proto::logging;
use trestle_proto::plan::RunPlan;
use trestle_proto::rundir::RunDir;
use trestle_proto::transport::iceoryx::{Domain, IceoryxActor, IceoryxLearner, IceoryxMentor};

/// Exit status of a process whose supervisor is gone.
const ORPHANED: i32 = 3;
/// Exit status of a process that was told to leave, as shells have it: 128 + SIGTERM. It is what a mentor-server ends
/// with; before the learner's end it is a failure of the run.
const TOLD: u8 = 143;

/// What every role begins with.
struct Start {
    dir: RunDir,
    plan: RunPlan,
    domain: Domain,
    stop: Arc<AtomicBool>,
}

impl Start {
    fn new(args: &Role, role: &str) -> Result<Self> {
        let dir = RunDir::new(&args.run);
        let plan = dir.read_plan()?;
        logging::init(plan.run, role, "info");
        let domain = Domain::of(plan.run);
        let stop = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
            // The second signal ends the process at once.
            signal_hook::flag::register_conditional_default(signal, stop.clone())
                .and_then(|_| signal_hook::flag::register(signal, stop.clone()))
                .context("cannot handle signals")?;
        }
        if args.watch_stdin {
            let domain = domain.clone();
            thread::Builder::new().name("watch".into()).spawn(move || leave_with_supervisor(&domain))?;
        }
        Ok(Self { dir, plan, domain, stop })
    }

    fn stop(&self) -> impl Fn() -> bool + use<> {
        let stop = self.stop.clone();
        move || stop.load(Ordering::Relaxed)
    }
}

/// Waits until standard input is closed, which only the end of the supervisor does; then removes what the run
/// shared, in its stead, and ends this process.
///
/// The removal is done by this program begun anew in this process ([`orphaned`]): that ends all other threads, which
/// could otherwise go on making files. So whichever of the run's processes comes last removes everything.
fn leave_with_supervisor(domain: &Domain) {
    let mut byte = [0];
    // Nothing is ever written: an answer, whichever, is the end.
    while matches!(stdin().read(&mut byte), Ok(1)) {}
    tracing::error!("the supervisor is gone: leaving");
    let program = std::env::current_exe().unwrap_or_else(|_| "/proc/self/exe".into());
    let error = Command::new(program).arg("orphaned").arg(domain.run().to_string()).exec();
    tracing::error!("cannot begin anew: {error}");
    std::process::exit(ORPHANED);
}

/// `trestle orphaned`: the end of a process whose supervisor is gone.
pub(super) fn orphaned(run: u64) -> Result<ExitCode> {
    Domain::of(run).remove()?;
    Ok(ExitCode::from(ORPHANED as u8))
}

pub(super) fn actor(args: &ActorRole) -> Result<ExitCode> {
    let start = Start::new(&args.role, &format!("actor-{}", args.index))?;
    let mut worker = Worker::new(&start.plan, args.index)?;
    if let Some(tick) = start.plan.resume_tick {
        let states = checkpoint::load_actors(&checkpoint::directory(start.dir.root(), tick))?;
        let state = states.get(args.index as usize).context("the checkpoint has no state of this actor")?;
        worker.restore(state)?;
    }
    let mut link = IceoryxActor::new(&start.domain, &start.plan, args.index)?;
    let rollout = start.plan.config.run.rollout as usize;
    match trestle_actor::run::run(&mut link, &mut worker, rollout, &start.stop())? {
        Left::Stopped => Ok(ExitCode::SUCCESS),
        Left::Told => Ok(ExitCode::from(TOLD)),
    }
}

pub(super) fn learner(args: &Role) -> Result<ExitCode> {
    let start = Start::new(args, "learner")?;
    let mut link = IceoryxLearner::new(&start.domain, &start.plan)?;
    let progress = |progress: &Progress| {
        // One line of JSON. Nobody may be listening any more.
        if let Ok(line) = serde_json::to_string(progress) {
            let _ = writeln!(stdout().lock(), "{line}");
        }
    };
    trestle_learner::run::run(&mut link, &start.plan, &start.dir, &start.stop(), progress)?;
    Ok(ExitCode::SUCCESS)
}

pub(super) fn mentor_server(args: &Role) -> Result<ExitCode> {
    let start = Start::new(args, "mentor-server")?;
    let demonstration = demo_file::read(&start.dir.demonstration())?;
    let mut mentor = trestle_mentor_server::run::mentor_of(&start.plan, &demonstration)?;
    let mut link = IceoryxMentor::new(&start.domain, &start.plan)?;
    trestle_mentor_server::run::run(&mut link, &start.plan, &mut mentor, &start.stop())?;
    Ok(ExitCode::from(TOLD))
}
