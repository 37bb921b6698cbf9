//! The learner's side of a lockstep tick with peers that do nothing but answer: over shared memory, and over Unix
//! sockets with the same messages and the same checks. The peers are processes of their own ([`super::peer`]).

use super::cases::walk::World;
use crate::machine::{one_processor, own_processors};
use anyhow::{Context, Result, bail, ensure};
use bytemuck::{bytes_of, bytes_of_mut, cast_slice, cast_slice_mut};
use nix::sched::{CpuSet, sched_getcpu, sched_setaffinity};
use nix::unistd::Pid;
use signal_hook::consts::{SIGINT, SIGTERM};
use std::fs;
use std::io::{Read, Write};
use std::os::unix::fs::DirBuilderExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;
use trestle_proto::batch::{Batch, BatchHeader, words};
use trestle_proto::config;
use trestle_proto::observe::{OBSERVE, ObserveAnswer, ObserveRequest, Observed};
use trestle_proto::plan::{MentorPart, RunPlan};
use trestle_proto::rundir::{RunDir, write_atomically};
use trestle_proto::tick::{COLLECT, Tick};
use trestle_proto::transport::iceoryx::{Domain, IceoryxLearner, Services};
use trestle_proto::transport::{FromActor, LearnerLink};
use trestle_proto::weights::WeightsHeader;

/// Mentor transitions of the plan: they only say how large an answer may get.
const MENTOR: usize = 100;
/// How long to wait for a batch before looking whether the peers still live.
const PATIENCE: Duration = Duration::from_millis(200);

/// What is exchanged.
#[derive(Clone, Copy)]
pub(super) struct Setup {
    pub(super) actors: u32,
    /// Most transitions in a batch.
    pub(super) rollout: u32,
    /// Batches that each actor sends a tick.
    pub(super) burst: u32,
    /// Whether a mentor-server is asked about each batch.
    pub(super) mentor: bool,
}

/// One way to exchange messages.
pub(super) trait Exchange {
    /// One tick: weights if `publish`, the tick itself, batches of `amount` transitions from every actor, and the
    /// mentor-server's answer to each.
    fn tick(&mut self, amount: u32, publish: bool) -> Result<()>;
}

/// Both ways, one as the other.
pub(super) struct Both {
    /// In the order in which they are compared: shared memory, Unix sockets.
    pub(super) ways: [Box<dyn Exchange>; 2],
    _cpu: Option<OneCpu>,
}

impl Both {
    /// With peers of their own. If there is one actor and one batch a tick, they and the learner take turns, and have one
    /// processor as such processes of a run do.
    pub(super) fn new(setup: Setup) -> Result<Self> {
        let turns = setup.actors == 1 && setup.burst == 1;
        let cpu = if turns { Some(OneCpu::take()?) } else { None };
        Ok(Self { ways: [Box::new(SharedMemory::new(setup)?), Box::new(Sockets::new(setup)?)], _cpu: cpu })
    }
}

/// Keeps this thread, and the processes that it starts meanwhile, on the processor that it is on.
struct OneCpu {
    before: CpuSet,
}

impl OneCpu {
    fn take() -> Result<Self> {
        let before = own_processors()?;
        sched_setaffinity(Pid::from_raw(0), &one_processor(sched_getcpu()?)?)?;
        Ok(Self { before })
    }
}

impl Drop for OneCpu {
    fn drop(&mut self) {
        if let Err(error) = sched_setaffinity(Pid::from_raw(0), &self.before) {
            crate::output::say(&format!("this process keeps to one processor: {error}"));
        }
    }
}

/// The learner's own side, whichever way.
struct Learner {
    plan: RunPlan,
    setup: Setup,
    weights: Vec<f32>,
    /// The last tick, and the last one that published weights.
    number: u64,
    version: u64,
    /// Transitions taken in.
    index: u64,
    batches: Vec<Batch>,
    observed: Observed,
    interrupted: Arc<AtomicBool>,
}

impl Learner {
    fn new(setup: Setup) -> Result<Self> {
        let sets = [
            format!("run.actors={}", setup.actors),
            format!("run.rollout={}", setup.rollout),
            "learner.hidden=[128, 128]".into(),
        ];
        // Process ids have 22 bits, and a run's identity 32: none meets this one.
        static NEXT: AtomicU32 = AtomicU32::new(16);
        let run = u64::from(std::process::id()) << 32 | u64::from(NEXT.fetch_add(1, Ordering::Relaxed));
        let mentors = setup.mentor.then(|| MentorPart { name: "walk".into(), transitions: MENTOR });
        let plan = RunPlan {
            run,
            config: config::load("maze30", &sets)?,
            spec: World::new(2, MENTOR, 0.0).spec(),
            mentors: mentors.into_iter().collect(),
            waypoints: None,
            resume_tick: None,
            restarts: 0,
            generation: 0,
        };
        let interrupted = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGTERM] {
            signal_hook::flag::register(signal, interrupted.clone()).context("cannot handle signals")?;
        }
        let n_params = trestle_qnet::Layout::new(&plan.sizes())?.n_params();
        Ok(Self {
            weights: vec![0.5; n_params],
            number: 0,
            version: 0,
            index: 0,
            batches: vec![Batch::default(); setup.actors as usize],
            observed: Observed::default(),
            interrupted,
            plan,
            setup,
        })
    }

    /// The next tick.
    fn next(&mut self, amount: u32, publish: bool) -> Result<Tick> {
        ensure!(!self.interrupted.load(Ordering::Relaxed), "interrupted");
        self.number += 1;
        // There are weights before the first tick in any case.
        if publish || self.version == 0 {
            self.version = self.number;
        }
        Ok(Tick {
            run: self.plan.run,
            tick: self.number,
            weights_version: self.version,
            kind: COLLECT,
            amount,
            ..Tick::default()
        })
    }

    /// The question about `batch`.
    fn question(&mut self, actor: usize) -> ObserveRequest {
        let batch = &self.batches[actor];
        let first_index = self.index;
        self.index += batch.len() as u64;
        ObserveRequest {
            run: self.plan.run,
            tick: self.number,
            first_index,
            op: OBSERVE,
            actor: batch.header.actor,
            count: batch.header.count,
            obs_dim: batch.header.obs_dim,
        }
    }
}

/// Over iceoryx2, through the very ports that a run uses.
pub(super) struct SharedMemory {
    link: IceoryxLearner,
    learner: Learner,
    peers: Peers,
}

impl SharedMemory {
    /// The processes at the other end: the actors, then the mentor-server.
    pub(super) fn peers(&self) -> Vec<u32> {
        self.peers.children.iter().map(Child::id).collect()
    }

    pub(super) fn new(setup: Setup) -> Result<Self> {
        let learner = Learner::new(setup)?;
        let mut peers = Peers::new(&learner.plan)?;
        let domain = Domain::create(learner.plan.run)?;
        peers.domain = Some(domain.clone());
        peers.services = Some(Services::create(&domain, &learner.plan)?);
        for index in 0..setup.actors {
            peers.start("actor", index, setup.burst)?;
        }
        if setup.mentor {
            peers.start("mentor-server", 0, 1)?;
        }
        let mut link = IceoryxLearner::new(&domain, &learner.plan)?;
        link.welcome(&|| learner.interrupted.load(Ordering::Relaxed))?;
        Ok(Self { link, learner, peers })
    }
}

impl Exchange for SharedMemory {
    fn tick(&mut self, amount: u32, publish: bool) -> Result<()> {
        let Self { link, learner, peers } = self;
        let tick = learner.next(amount, publish)?;
        if tick.weights_version == tick.tick {
            link.send_weights(tick.weights_version, &learner.weights)?;
        }
        link.send_tick(&tick)?;
        let mut missing = learner.setup.actors * learner.setup.burst;
        while missing > 0 {
            match link.recv(&mut learner.batches, PATIENCE)? {
                Some(FromActor::Batch(_)) => missing -= 1,
                Some(FromActor::Reply(reply)) => bail!("a reply that nobody asked for: {:?}", reply.header),
                None => peers.check()?,
            }
        }
        for actor in 0..learner.batches.len() * usize::from(learner.setup.mentor) {
            let question = learner.question(actor);
            link.observe(&question, learner.batches[actor].payload(), &mut learner.observed)?;
        }
        Ok(())
    }
}

/// Over a Unix stream socket to each peer.
struct Sockets {
    actors: Vec<UnixStream>,
    mentor: Option<UnixStream>,
    learner: Learner,
    payload: Vec<u32>,
    _peers: Peers,
}

impl Sockets {
    fn new(setup: Setup) -> Result<Self> {
        let learner = Learner::new(setup)?;
        let mut peers = Peers::new(&learner.plan)?;
        let listener = UnixListener::bind(socket(&peers.dir))?;
        let mut connect = |role: &str, index, burst| -> Result<UnixStream> {
            peers.start(role, index, burst)?;
            Ok(listener.accept()?.0)
        };
        let actors = (0..setup.actors)
            .map(|index| connect("socket-actor", index, setup.burst))
            .collect::<Result<_>>()?;
        let mentor = if setup.mentor { Some(connect("socket-mentor-server", 0, 1)?) } else { None };
        Ok(Self { actors, mentor, learner, payload: Vec::new(), _peers: peers })
    }
}

impl Exchange for Sockets {
    fn tick(&mut self, amount: u32, publish: bool) -> Result<()> {
        let Self { actors, mentor, learner, payload, .. } = self;
        let tick = learner.next(amount, publish)?;
        let fresh = tick.weights_version == tick.tick;
        let sizes: Vec<u32> = learner.plan.sizes().iter().map(|&n| n as u32).collect();
        let header = WeightsHeader::new(learner.plan.run, 0, tick.weights_version, &sizes, &learner.weights);
        for actor in actors.iter_mut() {
            actor.write_all(bytes_of(&tick))?;
            if fresh {
                actor.write_all(bytes_of(&header))?;
                actor.write_all(cast_slice(&learner.weights))?;
            }
        }
        let (obs_dim, n_actions) = (learner.plan.spec.obs_dim(), learner.plan.spec.n_actions());
        for (actor, batch) in actors.iter_mut().zip(&mut learner.batches) {
            for _ in 0..learner.setup.burst {
                let mut header = BatchHeader::default();
                actor.read_exact(bytes_of_mut(&mut header))?;
                payload.resize(words(header.count as usize, header.obs_dim as usize), 0);
                actor.read_exact(cast_slice_mut(payload))?;
                batch.receive(header, payload, obs_dim, n_actions)?;
            }
        }
        for actor in 0..learner.batches.len() {
            let Some(mentor) = mentor else { break };
            let question = learner.question(actor);
            mentor.write_all(bytes_of(&question))?;
            mentor.write_all(cast_slice(learner.batches[actor].payload()))?;
            let mut answer = ObserveAnswer::default();
            mentor.read_exact(bytes_of_mut(&mut answer))?;
            payload.resize(answer.count as usize, 0);
            mentor.read_exact(cast_slice_mut(payload))?;
            learner.observed.receive(&answer, payload, obs_dim, MENTOR)?;
        }
        Ok(())
    }
}

/// The socket in a directory.
pub(super) fn socket(dir: &Path) -> PathBuf {
    dir.join("socket")
}

/// A private directory that goes when this does.
pub(super) fn scratch(name: &str) -> Result<PathBuf> {
    let dir = std::env::temp_dir().join(format!("trestle-bench-{}-{name}", std::process::id()));
    fs::DirBuilder::new()
        .mode(0o700)
        .create(&dir)
        .with_context(|| format!("cannot make {}", dir.display()))?;
    Ok(dir)
}

/// The processes at the other end, and what they share. Nothing of it remains when this goes.
struct Peers {
    dir: PathBuf,
    children: Vec<Child>,
    services: Option<Services>,
    domain: Option<Domain>,
}

impl Peers {
    fn new(plan: &RunPlan) -> Result<Self> {
        let dir = scratch(&format!("{:x}", plan.run & 0xffff_ffff))?;
        let peers = Self { dir, children: Vec::new(), services: None, domain: None };
        write_atomically(&RunDir::new(&peers.dir).plan(), &plan.encode()?)?;
        Ok(peers)
    }

    fn start(&mut self, role: &str, index: u32, burst: u32) -> Result<()> {
        let program = std::env::current_exe().context("cannot find the program itself")?;
        let mut command = Command::new(program);
        command.arg("bench-peer").arg(role).arg(&self.dir).args([index.to_string(), burst.to_string()]);
        // A group of its own, so that Ctrl-C reaches this process alone.
        command.stdin(Stdio::null()).stdout(Stdio::null()).process_group(0);
        self.children.push(command.spawn().with_context(|| format!("cannot start {role} {index}"))?);
        Ok(())
    }

    /// Whether all of them still live.
    fn check(&mut self) -> Result<()> {
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
        for child in &mut self.children {
            // It may have left already.
            let _ = child.kill();
            let _ = child.wait();
        }
        self.services = None;
        let removed = self.domain.iter().try_for_each(Domain::remove);
        if let Err(error) = removed {
            crate::output::say(&format!(
                "cannot remove what the benchmark shared: {error}; `trestle doctor --fix` can"
            ));
        }
        if let Err(error) = fs::remove_dir_all(&self.dir) {
            crate::output::say(&format!("cannot remove {}: {error}", self.dir.display()));
        }
    }
}
