//! The other end of [`super::exchange`]: an actor that sends what it has had ready from the start, and a mentor-server
//! that knows no mentor state.

use super::exchange::socket;
use anyhow::{Result, bail};
use bytemuck::{bytes_of, bytes_of_mut, cast_slice, cast_slice_mut};
use nix::unistd::getppid;
use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use trestle_bench::walk::{Walk, World};
use trestle_link::iceoryx::SharedMemory;
use trestle_link::{ActorLink, MentorHandler, MentorLink, Transport};
use trestle_proto::NONE;
use trestle_proto::acting::{Acting, ActingHeader, Rooms};
use trestle_proto::batch::{Batch, BatchHeader};
use trestle_proto::incarnation::Incarnation;
use trestle_proto::limits::WAIT_SLICE;
use trestle_proto::observe::{ObserveAnswer, ObserveRequest, Part};
use trestle_proto::orders::Orders;
use trestle_proto::plan::RunPlan;
use trestle_proto::query::{QueryAnswer, QueryRequest, UNKNOWN_OP};
use trestle_proto::round::Round;
use trestle_proto::rundir::RunDir;

/// Serves a benchmark until its process is gone. `args`: the role, the directory with the plan, the actor's index, and
/// how many batches it sends a tick.
pub(super) fn run(args: &[String]) -> Result<()> {
    let [role, dir, index, burst] = args else { bail!("{} values; accepted: 4", args.len()) };
    let (dir, index, burst) = (Path::new(dir), index.parse()?, burst.parse()?);
    let plan = RunDir::new(dir).read_plan()?;
    let benchmark = getppid();
    let stop = move || getppid() != benchmark;
    match role.as_str() {
        "actor" => act(SharedMemory.actor(&plan, index)?, &mut Actor::new(&plan, index), &stop),
        "mentor-server" => {
            let mut link = SharedMemory.mentor(&plan)?;
            link.hello(&mut Ignorant, &stop)?;
            while !stop() {
                link.serve(&mut Ignorant, WAIT_SLICE)?;
            }
            Ok(())
        }
        "socket-actor" => until_closed(act_by_socket(&socket(dir), &plan, index, burst)),
        "socket-mentor-server" => until_closed(answer_by_socket(&socket(dir))),
        _ => bail!("--peer {role}; accepted: actor, mentor-server, socket-actor, socket-mentor-server"),
    }
}

/// What an actor keeps ready.
struct Actor {
    index: u32,
    walk: Walk,
    batch: Batch,
    acting: Acting,
    sizes: Vec<u32>,
    rollout: u32,
}

impl Actor {
    fn new(plan: &RunPlan, index: u32) -> Self {
        let sizes = plan.experiment.sizes();
        Self {
            index,
            walk: World::new(plan.experiment.spec.obs_dim(), plan.experiment.mentor_len().max(2), 0.0).walk(),
            batch: Batch::default(),
            acting: Acting::zeros(plan.experiment.acting()),
            sizes: sizes.iter().map(|&n| n as u32).collect(),
            rollout: plan.experiment.config.run.rollout,
        }
    }

    /// The batch for `orders`. Its content is made once: making it is not what is measured.
    fn answer(&mut self, orders: &Orders) -> &Batch {
        let header = BatchHeader {
            run: orders.run,
            round: orders.round,
            weights_version: orders.weights_version,
            actor: self.index,
            count: self.rollout,
            obs_dim: self.walk.dim() as u32,
            ..BatchHeader::default()
        };
        if self.batch.header.count == self.rollout {
            self.batch.header = header;
        } else {
            self.walk.fill(header, &mut self.batch);
        }
        &self.batch
    }
}

fn act(mut link: impl ActorLink, actor: &mut Actor, stop: &dyn Fn() -> bool) -> Result<()> {
    link.hello(stop)?;
    let mut sent = 0;
    while !stop() {
        let Some(orders) = link.recv_orders(WAIT_SLICE)? else { continue };
        link.acting(0, orders.weights_version)?;
        let granted = orders.granted(actor.index, Incarnation::default());
        let batch = actor.answer(&orders);
        while sent < granted {
            link.send_batch(batch)?;
            sent += 1;
        }
    }
    Ok(())
}

fn act_by_socket(path: &Path, plan: &RunPlan, index: u32, burst: u32) -> Result<()> {
    let mut learner = UnixStream::connect(path)?;
    let mut actor = Actor::new(plan, index);
    let (mut version, mut received) = (Round::default(), vec![0; actor.acting.lengths().words()]);
    loop {
        let mut orders = Orders::default();
        learner.read_exact(bytes_of_mut(&mut orders))?;
        orders.validate(plan.life.run)?;
        if orders.weights_version != version {
            version = orders.weights_version;
            let mut header = ActingHeader::default();
            learner.read_exact(bytes_of_mut(&mut header))?;
            learner.read_exact(cast_slice_mut(&mut received))?;
            header.receive(plan.life.run, &actor.sizes, &received, &Rooms::default(), &mut actor.acting)?;
        }
        let batch = actor.answer(&orders);
        for _ in 0..burst {
            learner.write_all(bytes_of(&batch.header))?;
            learner.write_all(cast_slice(batch.payload()))?;
        }
    }
}

fn answer_by_socket(path: &Path) -> Result<()> {
    let mut learner = UnixStream::connect(path)?;
    let (mut payload, mut out) = (Vec::new(), Vec::new());
    loop {
        let mut request = ObserveRequest::default();
        learner.read_exact(bytes_of_mut(&mut request))?;
        let mut words = [0u32];
        learner.read_exact(cast_slice_mut(&mut words))?;
        payload.resize(words[0] as usize, 0);
        learner.read_exact(cast_slice_mut(&mut payload))?;
        out.clear();
        let answer = Ignorant.observe(&request, &payload, &mut out);
        learner.write_all(bytes_of(&answer))?;
        learner.write_all(cast_slice(&[out.len() as u32]))?;
        learner.write_all(cast_slice(&out))?;
    }
}

/// The benchmark closes its sockets when it is done.
fn until_closed(outcome: Result<()>) -> Result<()> {
    match outcome {
        Err(error) => match error.downcast_ref::<std::io::Error>() {
            Some(io) if matches!(io.kind(), ErrorKind::UnexpectedEof | ErrorKind::BrokenPipe) => Ok(()),
            _ => Err(error),
        },
        Ok(()) => Ok(()),
    }
}

/// Finds no observation similar to anything.
struct Ignorant;

impl MentorHandler for Ignorant {
    fn forget(&mut self) {}

    fn observe(&mut self, request: &ObserveRequest, mut words: &[u32], out: &mut Vec<u32>) -> ObserveAnswer {
        while let Some(part) = Part::take(&mut words, request.obs_dim as usize) {
            out.resize(out.len() + part.count as usize, NONE);
            // Annotations that have changed.
            out.push(0);
        }
        ObserveAnswer { first_index: request.first_index, ..ObserveAnswer::default() }
    }

    fn query(&mut self, _: &QueryRequest, _: &[f32], _: &mut Vec<u32>) -> QueryAnswer {
        QueryAnswer { status: UNKNOWN_OP, count: 0 }
    }
}
