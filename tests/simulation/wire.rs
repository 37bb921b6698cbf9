//! Messages between simulated processes: the three interfaces of `trestle_link` over queues that live in the world.
//!
//! A model of what shared memory does, not the code that does it. Messages are checked by the same code. What a process has sent
//! is there whatever becomes of the process; to send to one that has ended fails.

use super::world::{On, World, here, is_over};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use trestle_link::{ActorLink, FromActor, LearnerLink, LinkError, MentorHandler, MentorLink, Stop};
use trestle_proto::acting::{Acting, ActingHeader, Room};
use trestle_proto::batch::{Batch, BatchHeader, Checked};
use trestle_proto::limits::{OBSERVE_DEADLINE, WAIT_SLICE};
use trestle_proto::observe::{Answers, ObserveAnswer, ObserveRequest, Part};
use trestle_proto::orders::Orders;
use trestle_proto::plan::RunPlan;
use trestle_proto::query::{OK, QueryAnswer, QueryRequest, status_text};
use trestle_proto::reply::Reply;

pub(super) enum ToLearner {
    Batch(BatchHeader, Vec<u32>),
    Reply(Reply),
}

pub(super) enum Request {
    Observe(ObserveRequest, Vec<u32>),
    Query(QueryRequest, Vec<f32>),
}

pub(super) enum Answer {
    Observe(ObserveAnswer, Vec<u32>),
    Query(QueryAnswer, Vec<u32>),
}

/// What the processes of one identity of a run share.
#[derive(Default)]
pub(super) struct Wire {
    pub(super) orders: (u64, Orders),
    published: Option<(ActingHeader, Vec<u32>)>,
    pub(super) to_learner: VecDeque<ToLearner>,
    pub(super) requests: VecDeque<Request>,
    pub(super) answer: Option<Answer>,
    pub(super) learner: Option<usize>,
    pub(super) mentor: Option<usize>,
    actors: Vec<Option<usize>>,
    has_mentor: bool,
    pub(super) welcomed: bool,
}

impl Wire {
    pub(super) fn of(plan: &RunPlan) -> Self {
        let actors = vec![None; plan.experiment.config.run.actors as usize];
        Self { actors, has_mentor: plan.experiment.mentor_len() > 0, ..Self::default() }
    }

    pub(super) fn is_gathered(&self) -> bool {
        self.actors.iter().all(Option::is_some) && (self.mentor.is_some() || !self.has_mentor)
    }
}

/// One process's end.
pub(super) struct End {
    world: Arc<World>,
    process: usize,
    plan: RunPlan,
    sizes: Vec<u32>,
    room: Room,
    copy: Acting,
    received: u64,
    index: u32,
}

fn broken(what: &'static str) -> LinkError {
    LinkError::Transport { what, message: "the process has ended".into() }
}

fn gone(what: &'static str) -> LinkError {
    LinkError::Receivers { what, found: 0, expected: 1 }
}

fn nanoseconds(time: Duration) -> u64 {
    time.as_nanos() as u64
}

impl End {
    /// The end of actor `index`, which the other roles do not need.
    pub(super) fn new(plan: &RunPlan, index: u32) -> Option<Self> {
        let place = here()?;
        let process = place.world.lock().process_of(place.thread);
        Some(Self {
            world: place.world.clone(),
            process,
            sizes: plan.experiment.sizes().into_iter().map(|n| n as u32).collect(),
            room: plan.experiment.own_room(),
            copy: Acting::zeros(plan.experiment.acting()),
            received: 0,
            index,
            plan: plan.clone(),
        })
    }

    /// Does `work` with the run's queues, and with a list of the processes that live.
    fn with<R>(&self, work: impl FnOnce(&mut Wire, &dyn Fn(usize) -> bool) -> R) -> Option<R> {
        if is_over() {
            return None;
        }
        let mut state = self.world.lock();
        let alive: Vec<bool> = state.processes.iter().map(|process| process.end.is_none()).collect();
        let wire = state.wires.get_mut(&self.plan.life.run)?;
        Some(work(wire, &|process| alive[process]))
    }

    fn wait(&self, on: On, time: Duration) -> Result<(), LinkError> {
        let Some(place) = here() else { return Err(broken("waiting")) };
        match self.world.wait(place.thread, on, Some(nanoseconds(time))) {
            true => Ok(()),
            false => Err(broken("waiting")),
        }
    }

    fn step(&self) -> Result<(), LinkError> {
        let there = here().is_some_and(|place| self.world.step(place.thread, "message"));
        if there { Ok(()) } else { Err(broken("a message")) }
    }

    fn ask(&self, request: Request) -> Result<Answer, LinkError> {
        const WHAT: &str = "a request to the mentor-server";
        self.step()?;
        let sent = self.with(|wire, alive| {
            wire.answer = None;
            let there = wire.mentor.is_some_and(alive);
            if there {
                wire.requests.push_back(request);
            }
            there
        });
        match sent {
            None => return Err(broken(WHAT)),
            Some(false) => return Err(gone(WHAT)),
            Some(true) => self.wait(On::Answer(self.plan.life.run), OBSERVE_DEADLINE)?,
        }
        self.with(|wire, _| wire.answer.take()).flatten().ok_or_else(|| gone(WHAT))
    }

    fn ask_history(
        &self,
        request: &ObserveRequest,
        words: Vec<u32>,
    ) -> Result<(ObserveAnswer, Vec<u32>), LinkError> {
        const WHAT: &str = "a batch for its history";
        match self.ask(Request::Observe(*request, words))? {
            Answer::Observe(header, _) if header.status != OK => {
                Err(LinkError::Refused { what: WHAT, reason: status_text(header.status) })
            }
            Answer::Observe(header, words) => Ok((header, words)),
            Answer::Query(..) => Err(LinkError::Unexpected("an answer to another question".into())),
        }
    }
}

impl ActorLink for End {
    fn hello(&mut self, stop: Stop<'_>) -> Result<(), LinkError> {
        self.step()?;
        let (index, process) = (self.index as usize, self.process);
        self.with(|wire, _| wire.actors[index] = Some(process)).ok_or_else(|| broken("hello"))?;
        loop {
            self.wait(On::Welcome(self.plan.life.run), WAIT_SLICE)?;
            if stop() {
                return Err(LinkError::Interrupted("the learner"));
            }
            if self.with(|wire, _| wire.welcomed).ok_or_else(|| broken("hello"))? {
                return Ok(());
            }
        }
    }

    fn recv_orders(&mut self, timeout: Duration) -> Result<Option<Orders>, LinkError> {
        self.wait(On::Orders(self.plan.life.run, self.received), timeout)?;
        let (count, orders) = self.with(|wire, _| wire.orders).ok_or_else(|| broken("orders"))?;
        if count == self.received {
            return Ok(None);
        }
        self.received = count;
        orders.validate(self.plan.life.run)?;
        Ok(Some(orders))
    }

    fn acting(&mut self, generation: u16, at_least: u64) -> Result<Option<(u64, &Acting)>, LinkError> {
        self.step()?;
        let published = self.with(|wire, _| wire.published.clone()).ok_or_else(|| broken("weights"))?;
        let Some((header, payload)) = published else { return Ok(None) };
        header.receive(self.plan.life.run, &self.sizes, &payload, &self.room, &mut self.copy)?;
        let wanted = header.generation == u32::from(generation) && header.version >= at_least;
        Ok(wanted.then_some((header.version, &self.copy)))
    }

    fn send_batch(&mut self, batch: &Batch) -> Result<(), LinkError> {
        self.to_learner(ToLearner::Batch(batch.header, batch.payload().to_vec()))
    }

    fn send_reply(&mut self, reply: &Reply) -> Result<(), LinkError> {
        self.to_learner(ToLearner::Reply(reply.clone()))
    }
}

impl End {
    fn to_learner(&self, message: ToLearner) -> Result<(), LinkError> {
        self.step()?;
        let sent = self.with(|wire, alive| {
            let there = wire.learner.is_some_and(alive);
            if there {
                wire.to_learner.push_back(message);
            }
            there
        });
        match sent {
            None => Err(broken("a message")),
            Some(false) => Err(gone("a message")),
            Some(true) => Ok(()),
        }
    }
}

impl LearnerLink for End {
    fn welcome(&mut self, stop: Stop<'_>) -> Result<(), LinkError> {
        self.step()?;
        let process = self.process;
        self.with(|wire, _| wire.learner = Some(process)).ok_or_else(|| broken("the handshake"))?;
        loop {
            self.wait(On::Gathered(self.plan.life.run), WAIT_SLICE)?;
            if stop() {
                return Err(LinkError::Interrupted("the others"));
            }
            let gathered = self.with(|wire, _| {
                wire.welcomed = wire.is_gathered();
                wire.welcomed
            });
            if gathered.ok_or_else(|| broken("the handshake"))? {
                return Ok(());
            }
        }
    }

    fn send_acting(&mut self, version: u64, acting: &Acting) -> Result<(), LinkError> {
        self.step()?;
        let header =
            ActingHeader::new(self.plan.life.run, self.plan.life.generation, version, &self.sizes, acting);
        let mut payload = vec![0; acting.words()];
        acting.write(&mut payload);
        self.with(|wire, _| wire.published = Some((header, payload))).ok_or_else(|| broken("weights"))
    }

    fn send_orders(&mut self, orders: &Orders) -> Result<(), LinkError> {
        self.step()?;
        let (found, expected) = self
            .with(|wire, alive| {
                wire.orders = (wire.orders.0 + 1, *orders);
                let found = wire.actors.iter().flatten().filter(|actor| alive(**actor)).count();
                (found, wire.actors.len())
            })
            .ok_or_else(|| broken("orders"))?;
        if found < expected { Err(LinkError::Receivers { what: "orders", found, expected }) } else { Ok(()) }
    }

    fn mentor_waits(&self) -> bool {
        false
    }

    fn rejoin_mentor(&mut self, _: Stop<'_>) -> Result<(), LinkError> {
        Err(gone("the mentor-server"))
    }

    fn recv(
        &mut self,
        batch: &mut Checked<Batch>,
        _: u32,
        timeout: Duration,
    ) -> Result<Option<FromActor>, LinkError> {
        self.wait(On::Learner(self.plan.life.run), timeout)?;
        let message = self.with(|wire, _| wire.to_learner.pop_front()).ok_or_else(|| broken("messages"))?;
        match message {
            None => Ok(None),
            Some(ToLearner::Reply(reply)) => Ok(Some(FromActor::Reply(reply))),
            Some(ToLearner::Batch(header, payload)) => {
                batch.receive(header, &payload, &self.plan.experiment.spaces())?;
                Ok(Some(FromActor::Batch))
            }
        }
    }

    fn observe(
        &mut self,
        request: &ObserveRequest,
        parts: &[Part<'_>],
        into: &mut Answers,
    ) -> Result<(), LinkError> {
        let words = parts.iter().flat_map(|part| [&part.header(), part.payload].concat()).collect();
        let (header, payload) = self.ask_history(request, words)?;
        let counts = parts.iter().map(|part| part.count as usize);
        Ok(into.receive(
            &header,
            &payload,
            counts,
            self.plan.experiment.spec.obs_dim(),
            self.plan.experiment.mentor_len(),
        )?)
    }

    fn teach(&mut self, request: &ObserveRequest, payload: &[u32]) -> Result<(), LinkError> {
        self.ask_history(request, payload.to_vec()).map(|_| ())
    }

    fn query(
        &mut self,
        request: &QueryRequest,
        payload: &[f32],
        into: &mut Vec<u32>,
    ) -> Result<QueryAnswer, LinkError> {
        match self.ask(Request::Query(*request, payload.to_vec()))? {
            Answer::Query(header, words) if header.status == OK => {
                *into = words;
                Ok(header)
            }
            Answer::Query(header, _) => {
                Err(LinkError::Refused { what: "a query", reason: status_text(header.status) })
            }
            Answer::Observe(..) => Err(LinkError::Unexpected("an answer to another question".into())),
        }
    }
}

impl MentorLink for End {
    fn hello(&mut self, handler: &mut dyn MentorHandler, stop: Stop<'_>) -> Result<(), LinkError> {
        self.step()?;
        let process = self.process;
        self.with(|wire, _| wire.mentor = Some(process)).ok_or_else(|| broken("hello"))?;
        while !stop() {
            self.serve(handler, WAIT_SLICE)?;
            if self.with(|wire, _| wire.welcomed).ok_or_else(|| broken("hello"))? {
                break;
            }
        }
        Ok(())
    }

    fn serve(&mut self, handler: &mut dyn MentorHandler, timeout: Duration) -> Result<usize, LinkError> {
        self.wait(On::Mentor(self.plan.life.run), timeout)?;
        let request = self.with(|wire, _| wire.requests.pop_front()).ok_or_else(|| broken("requests"))?;
        let mut words = Vec::new();
        let answer = match request {
            None => return Ok(0),
            Some(Request::Observe(request, payload)) => {
                Answer::Observe(handler.observe(&request, &payload, &mut words), words)
            }
            Some(Request::Query(request, payload)) => {
                Answer::Query(handler.query(&request, &payload, &mut words), words)
            }
        };
        self.step()?;
        self.with(|wire, _| wire.answer = Some(answer)).ok_or_else(|| broken("an answer"))?;
        Ok(1)
    }
}
