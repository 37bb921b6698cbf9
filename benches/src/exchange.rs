//! The learner's side of a lockstep tick with peers that do nothing but answer: over shared memory, and over Unix
//! sockets with the same messages and the same checks. The peers are processes of their own ([`super::peer`]).

use super::program::Scratch;
use anyhow::{Context, Result, bail, ensure};
use bytemuck::{bytes_of, bytes_of_mut, cast_slice, cast_slice_mut};
use nix::sched::{CpuSet, sched_getaffinity, sched_getcpu, sched_setaffinity};
use nix::unistd::Pid;
use signal_hook::consts::{SIGINT, SIGTERM};
use std::io::{Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;
use trestle_bench::walk::World;
use trestle_link::iceoryx::{self, IceoryxHost, IceoryxLearner};
use trestle_link::{FromActor, LearnerLink, Transport};
use trestle_proto::acting::{Acting, ActingHeader};
use trestle_proto::batch::{Batch, BatchHeader, Checked, words};
use trestle_proto::config;
use trestle_proto::experiment::{Experiment, MentorPart};
use trestle_proto::observe::{Answers, OBSERVE, ObserveAnswer, ObserveRequest, Part};
use trestle_proto::orders::{Orders, Share};
use trestle_proto::plan::{Life, RunPlan};
use trestle_proto::reply::JOINED;
use trestle_proto::round::Round;
use trestle_proto::rundir::{Durable, RunDir, write_atomically};

/// Mentor transitions of the plan: they only say how large an answer may get.
const MENTOR: usize = 100;
/// How long to wait for a batch before looking whether the peers still live.
pub(super) const PATIENCE: Duration = Duration::from_millis(200);

/// What is exchanged.
#[derive(Clone, Copy)]
pub(super) struct Setup {
    pub(super) actors: u32,
    /// Transitions in a batch.
    pub(super) rollout: u32,
    /// Batches that each actor sends a tick.
    pub(super) burst: u32,
    /// Whether a mentor-server is asked about the batches.
    pub(super) mentor: bool,
    /// Whether actors stream, as in free mode.
    pub(super) free: bool,
}

/// Where the learner and its peers run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Placement {
    /// All on one processor, so that no other one has to be woken.
    OneProcessor,
    /// Where the scheduler puts them, as those of a run.
    Scheduler,
}

impl Placement {
    /// Its name in rows.
    pub(super) fn name(self) -> &'static str {
        match self {
            Placement::OneProcessor => "one processor",
            Placement::Scheduler => "scheduler",
        }
    }
}

/// One way to exchange messages.
pub(super) trait Exchange {
    /// One tick: weights if `publish`, orders, batches from every actor, and the mentor-server's answer to the last one of
    /// each actor.
    fn tick(&mut self, publish: bool) -> Result<()>;

    /// The processes at the other end, in the order in which they were started.
    fn peers(&self) -> Vec<u32>;
}

/// Both ways, one as the other.
pub(super) struct Both {
    /// In the order in which they are compared: shared memory, Unix sockets.
    pub(super) ways: [Box<dyn Exchange>; 2],
    _cpu: Option<OneCpu>,
}

impl Both {
    /// With peers of their own.
    pub(super) fn new(setup: Setup, placement: Placement) -> Result<Self> {
        let cpu = if placement == Placement::OneProcessor { Some(OneCpu::take()?) } else { None };
        Ok(Self {
            ways: [Box::new(SharedMemory::with_own_peers(setup)?), Box::new(Sockets::new(setup)?)],
            _cpu: cpu,
        })
    }
}

/// Keeps this thread, and the processes that it starts meanwhile, on the processor that it is on.
struct OneCpu {
    before: CpuSet,
}

impl OneCpu {
    fn take() -> Result<Self> {
        let before = sched_getaffinity(Pid::from_raw(0))?;
        let mut one = CpuSet::new();
        one.set(sched_getcpu()?)?;
        sched_setaffinity(Pid::from_raw(0), &one)?;
        Ok(Self { before })
    }
}

impl Drop for OneCpu {
    fn drop(&mut self) {
        if let Err(error) = sched_setaffinity(Pid::from_raw(0), &self.before) {
            eprintln!("this process keeps to one processor: {error}");
        }
    }
}

impl Setup {
    /// The plan of a run with the world of [`World`], for the mentor's sake, and a network of two hidden layers.
    fn plan(self) -> Result<RunPlan> {
        let sets = [
            "run.episodes=1".into(),
            format!("run.actors={}", self.actors),
            format!("run.rollout={}", self.rollout),
            "learner.hidden=[128, 128]".into(),
            format!("run.mode={}", if self.free { "free" } else { "lockstep" }),
        ];
        // Process ids have 22 bits, and a run's identity 32: none meets this one.
        static NEXT: AtomicU32 = AtomicU32::new(16);
        let run = u64::from(std::process::id()) << 32 | u64::from(NEXT.fetch_add(1, Ordering::Relaxed));
        let mentors = self.mentor.then(|| MentorPart { name: "walk".into(), transitions: MENTOR });
        Ok(RunPlan {
            life: Life { run, ..Life::default() },
            experiment: Experiment {
                config: config::from_table(&(), config::Table::new(), &sets)?,
                spec: World::new(2, MENTOR, 0.0).spec(),
                mentors: mentors.into_iter().collect(),
                waypoints: None,
            },
        })
    }

    /// The commands of its peers, actors first: this program with roles that begin with `prefix`. They read the plan in `dir`.
    fn peers(self, prefix: &str, dir: &Path) -> Result<Vec<Command>> {
        let program = std::env::current_exe().context("cannot find the program itself")?;
        let roles = (0..self.actors).map(|index| ("actor", index));
        let roles = roles.chain(self.mentor.then_some(("mentor-server", 0)));
        let command = |(role, index): (&str, u32)| {
            let mut command = Command::new(&program);
            command.arg("--peer").arg(format!("{prefix}{role}")).arg(dir);
            command.args([index.to_string(), self.burst.to_string()]);
            command
        };
        Ok(roles.map(command).collect())
    }
}

/// The learner's own side, whichever way.
pub(super) struct Learner {
    pub(super) plan: RunPlan,
    /// Batches that each actor sends a tick.
    burst: u32,
    pub(super) acting: Acting,
    /// The last tick, and the last one that published weights.
    pub(super) number: u64,
    version: u64,
    /// Transitions taken in.
    index: u64,
    /// The newest of each actor.
    batches: Vec<Checked<Batch>>,
    pub(super) answers: Answers,
    interrupted: Arc<AtomicBool>,
}

impl Learner {
    /// Of the run with `plan`.
    pub(super) fn new(plan: RunPlan, burst: u32) -> Result<Self> {
        let interrupted = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGTERM] {
            signal_hook::flag::register(signal, interrupted.clone()).context("cannot handle signals")?;
        }
        Ok(Self {
            acting: Acting::of_weights(vec![0.5; plan.experiment.acting().weights]),
            number: 0,
            version: 0,
            index: 0,
            batches: vec![Checked::default(); plan.experiment.config.run.actors as usize],
            answers: Answers::default(),
            interrupted,
            plan,
            burst,
        })
    }

    /// The orders of the next tick.
    fn next(&mut self, publish: bool) -> Result<Orders> {
        ensure!(!self.interrupted.load(Ordering::Relaxed), "interrupted");
        self.number += 1;
        // There are weights before the first tick in any case.
        if publish || self.version == 0 {
            self.version = self.number;
        }
        let (run, round, weights_version) =
            (self.plan.life.run, Round::from(self.number), Round::from(self.version));
        let mut orders = Orders { run, round, weights_version, ..Orders::default() };
        let granted = self.number * u64::from(self.burst);
        orders.shares[..self.batches.len()].fill(Share { granted, ..Share::default() });
        Ok(orders)
    }

    /// The question about `batches`.
    pub(super) fn question(&mut self, batches: &[Checked<Batch>]) -> ObserveRequest {
        let first_index = self.index;
        self.index += batches.iter().map(|batch| batch.len() as u64).sum::<u64>();
        ObserveRequest {
            run: self.plan.life.run,
            round: self.number.into(),
            first_index,
            op: OBSERVE,
            count: batches.len() as u32,
            obs_dim: self.plan.experiment.spec.obs_dim() as u32,
            reserved: 0,
        }
    }
}

/// Over iceoryx2, through the very ports that a run uses.
pub(super) struct SharedMemory {
    pub(super) link: IceoryxLearner,
    pub(super) learner: Learner,
    pub(super) peers: Peers,
}

impl SharedMemory {
    /// With the peers of this program, which do no work.
    pub(super) fn with_own_peers(setup: Setup) -> Result<Self> {
        let (plan, dir) = prepared(setup)?;
        let peers = setup.peers("", &dir.0)?;
        Self::new(Learner::new(plan, setup.burst)?, peers, dir)
    }

    /// With the processes that `peers` start, all of the run's actors and its mentor-server, which need `dir`.
    pub(super) fn new(learner: Learner, peers: Vec<Command>, dir: Scratch) -> Result<Self> {
        let host = iceoryx::SharedMemory.host(&learner.plan)?;
        let mut own = Peers { children: Vec::new(), _host: Some(host), _dir: dir };
        peers.into_iter().try_for_each(|peer| own.start(peer))?;
        let mut link = iceoryx::SharedMemory.learner(&learner.plan)?;
        link.welcome(&|| learner.interrupted.load(Ordering::Relaxed))?;
        Ok(Self { link, learner, peers: own })
    }
}

impl Exchange for SharedMemory {
    fn tick(&mut self, publish: bool) -> Result<()> {
        let Self { link, learner, peers } = self;
        let orders = learner.next(publish)?;
        if orders.weights_version == orders.round {
            link.send_acting(orders.weights_version, &learner.acting)?;
        }
        link.send_orders(&orders)?;
        let mut spare = Checked::default();
        let mut missing = learner.batches.len() * learner.burst as usize;
        while missing > 0 {
            match link.recv(&mut spare, missing as u32, PATIENCE)? {
                Some(FromActor::Batch) => {
                    missing -= 1;
                    let actor = spare.header.actor as usize;
                    std::mem::swap(&mut spare, &mut learner.batches[actor]);
                }
                Some(FromActor::Reply(reply)) if reply.header.kind == JOINED => {}
                Some(FromActor::Reply(reply)) => bail!("a reply that nobody asked for: {:?}", reply.header),
                None => peers.check()?,
            }
        }
        if !learner.plan.experiment.mentors.is_empty() {
            let batches = std::mem::take(&mut learner.batches);
            let question = learner.question(&batches);
            let parts: Vec<Part<'_>> = batches.iter().map(|batch| Part::of(batch)).collect();
            link.observe(&question, &parts, &mut learner.answers)?;
            learner.batches = batches;
        }
        Ok(())
    }

    fn peers(&self) -> Vec<u32> {
        self.peers.ids()
    }
}

/// Over a Unix stream socket to each peer.
struct Sockets {
    actors: Vec<UnixStream>,
    mentor: Option<UnixStream>,
    learner: Learner,
    payload: Vec<u32>,
    peers: Peers,
}

impl Sockets {
    fn new(setup: Setup) -> Result<Self> {
        let (plan, dir) = prepared(setup)?;
        let (listener, commands) = (UnixListener::bind(socket(&dir.0))?, setup.peers("socket-", &dir.0)?);
        let mut peers = Peers { children: Vec::new(), _host: None, _dir: dir };
        let mut actors = Vec::new();
        for command in commands {
            peers.start(command)?;
            actors.push(listener.accept()?.0);
        }
        let mentor = if setup.mentor { actors.pop() } else { None };
        let learner = Learner::new(plan, setup.burst)?;
        Ok(Self { actors, mentor, learner, payload: Vec::new(), peers })
    }
}

impl Exchange for Sockets {
    fn tick(&mut self, publish: bool) -> Result<()> {
        let Self { actors, mentor, learner, payload, .. } = self;
        let orders = learner.next(publish)?;
        let fresh = orders.weights_version == orders.round;
        let sizes: Vec<u32> = learner.plan.experiment.sizes().iter().map(|&n| n as u32).collect();
        let header =
            ActingHeader::new(learner.plan.life.run, 0, orders.weights_version, &sizes, &learner.acting);
        for actor in actors.iter_mut() {
            actor.write_all(bytes_of(&orders))?;
            if fresh {
                actor.write_all(bytes_of(&header))?;
                actor.write_all(cast_slice(&learner.acting.weights))?;
            }
        }
        let (spaces, record) = (learner.plan.experiment.spaces(), learner.plan.experiment.record_words());
        for (actor, batch) in actors.iter_mut().zip(&mut learner.batches) {
            for _ in 0..learner.burst {
                let mut header = BatchHeader::default();
                actor.read_exact(bytes_of_mut(&mut header))?;
                payload.resize(words(header.count as usize, header.obs_dim as usize), 0);
                actor.read_exact(cast_slice_mut(payload))?;
                batch.receive(header, payload, &spaces)?;
            }
        }
        if let Some(mentor) = mentor {
            let batches = std::mem::take(&mut learner.batches);
            let question = learner.question(&batches);
            let parts: Vec<Part<'_>> = batches.iter().map(|batch| Part::of(batch)).collect();
            payload.clear();
            parts.iter().for_each(|part| payload.extend(part.header().iter().chain(part.payload)));
            mentor.write_all(bytes_of(&question))?;
            mentor.write_all(cast_slice(&[payload.len() as u32]))?;
            mentor.write_all(cast_slice(payload))?;
            let (mut answer, mut words) = (ObserveAnswer::default(), [0u32]);
            mentor.read_exact(bytes_of_mut(&mut answer))?;
            mentor.read_exact(cast_slice_mut(&mut words))?;
            payload.resize(words[0] as usize, 0);
            mentor.read_exact(cast_slice_mut(payload))?;
            let counts = parts.iter().map(|part| part.count as usize);
            learner.answers.receive(&answer, payload, counts, record, MENTOR)?;
            learner.batches = batches;
        }
        Ok(())
    }

    fn peers(&self) -> Vec<u32> {
        self.peers.ids()
    }
}

/// The socket in a directory.
pub(super) fn socket(dir: &Path) -> PathBuf {
    dir.join("socket")
}

/// The plan of `setup`, and a directory with it.
fn prepared(setup: Setup) -> Result<(RunPlan, Scratch)> {
    let plan = setup.plan()?;
    let dir = Scratch::new(&format!("{:x}", plan.life.run & 0xffff_ffff))?;
    let bytes = plan.encode()?;
    write_atomically(&RunDir::new(&dir.0).plan(), Durable::Later, |file| file.write_all(&bytes))?;
    Ok((plan, dir))
}

/// The processes at the other end, and what they share. Nothing of it remains when this goes.
pub(super) struct Peers {
    children: Vec<Child>,
    _host: Option<IceoryxHost>,
    _dir: Scratch,
}

impl Peers {
    /// Starts one, whose standard input stays open for as long as this process lives.
    fn start(&mut self, mut command: Command) -> Result<()> {
        // A group of its own, so that Ctrl-C reaches this process alone.
        command.stdin(Stdio::piped()).stdout(Stdio::null()).process_group(0);
        self.children.push(command.spawn().with_context(|| format!("cannot start {command:?}"))?);
        Ok(())
    }

    fn ids(&self) -> Vec<u32> {
        self.children.iter().map(Child::id).collect()
    }

    /// Ends all of them.
    fn end(&mut self) {
        for child in &mut self.children {
            // It may have left already.
            let _ = child.kill();
            let _ = child.wait();
        }
    }

    /// Whether all of them still live.
    pub(super) fn check(&mut self) -> Result<()> {
        for child in &mut self.children {
            if let Some(status) = child.try_wait()? {
                bail!("a peer of the benchmark has left: {status}");
            }
        }
        Ok(())
    }
}

impl Drop for Peers {
    fn drop(&mut self) {
        self.end();
    }
}

/// An actor that streams must not find the learner gone.
impl Drop for SharedMemory {
    fn drop(&mut self) {
        self.peers.end();
    }
}
