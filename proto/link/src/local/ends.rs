//! The roles' ends of a [`Wire`].

use super::wire::{Answer, Place, Request, ToLearner, Want, Wire};
use crate::{ActorLink, ClientLink, FromActor, LearnerLink, LinkError, MentorHandler, MentorLink, Stop};
use std::time::Duration;
use trestle_proto::acting::{Acting, ActingHeader, Rooms};
use trestle_proto::batch::{Batch, Checked, Spaces};
use trestle_proto::limits::{BACKPRESSURE, OBSERVE_DEADLINE, QUERY_DEADLINE, WAIT_SLICE};
use trestle_proto::observe::{Answers, ObserveAnswer, ObserveRequest, Part};
use trestle_proto::orders::Orders;
use trestle_proto::plan::RunPlan;
use trestle_proto::query::{OK, QueryAnswer, QueryRequest, status_text};
use trestle_proto::reply::Reply;
use trestle_proto::round::Round;

/// An actor's end.
#[derive(Debug)]
pub struct LocalActor<P> {
    place: P,
    run: u64,
    index: usize,
    sizes: Vec<u32>,
    rooms: Rooms,
    /// The weights that were received last.
    copy: Acting,
    /// How many orders there had been when some were received last.
    received: u64,
}

/// The learner's end.
#[derive(Debug)]
pub struct LocalLearner<P> {
    place: P,
    run: u64,
    generation: u16,
    sizes: Vec<u32>,
    record_words: usize,
    spaces: Spaces,
    mentor_len: usize,
}

/// The mentor-server's end.
#[derive(Debug)]
pub struct LocalMentor<P> {
    place: P,
}

/// A client's end.
#[derive(Debug)]
pub struct LocalClient<P> {
    place: P,
    run: u64,
}

fn gone(what: &'static str) -> LinkError {
    LinkError::Receivers { what, found: 0, expected: 1 }
}

fn layers(plan: &RunPlan) -> Vec<u32> {
    plan.experiment.sizes().into_iter().map(|n| n as u32).collect()
}

/// Waits for `want` until the learner has let this process in.
fn announce<P: Place>(place: &P, stop: Stop<'_>, enter: impl FnOnce(&mut Wire)) -> Result<(), LinkError> {
    place.step()?;
    place.with(|wire, _| enter(wire))?;
    loop {
        place.wait(Want::Welcome, WAIT_SLICE)?;
        if stop() {
            return Err(LinkError::Interrupted("the learner"));
        }
        if place.with(|wire, _| wire.welcomed)? {
            return Ok(());
        }
    }
}

/// Asks the mentor-server and waits for its answer.
fn ask<P: Place>(
    place: &P,
    request: Request,
    what: &'static str,
    deadline: Duration,
) -> Result<Answer, LinkError> {
    place.step()?;
    let number = place.with(|wire, alive| {
        if !wire.mentor.is_some_and(alive) {
            return None;
        }
        wire.asked += 1;
        wire.requests.push_back((wire.asked, request));
        wire.answers.insert(wire.asked, None);
        Some(wire.asked)
    })?;
    let number = number.ok_or_else(|| gone(what))?;
    place.wait(Want::Answer(number), deadline)?;
    let (answer, there) =
        place.with(|wire, alive| (wire.answers.remove(&number), wire.mentor.is_some_and(alive)))?;
    answer.flatten().ok_or_else(|| match there {
        true => LinkError::Deadline { peer: "mentor-server".into(), what, waited_ms: deadline.as_millis() },
        false => gone(what),
    })
}

/// A query, and its answer's payload in place of `into`.
fn query<P: Place>(
    place: &P,
    request: &QueryRequest,
    payload: &[f32],
    into: &mut Vec<u32>,
    deadline: Duration,
) -> Result<QueryAnswer, LinkError> {
    const WHAT: &str = "a query";
    match ask(place, Request::Query(*request, payload.to_vec()), WHAT, deadline)? {
        Answer::Query(header, words) if header.status == OK => {
            *into = words;
            Ok(header)
        }
        Answer::Query(header, _) => {
            Err(LinkError::Refused { what: WHAT, reason: status_text(header.status) })
        }
        Answer::Observe(..) => Err(LinkError::Unexpected("an answer to another question".into())),
    }
}

impl<P: Place> LocalActor<P> {
    /// The end of actor `index` of `plan`'s run.
    pub fn new(place: P, plan: &RunPlan, index: u32) -> Self {
        Self {
            place,
            run: plan.life.run,
            index: index as usize,
            sizes: layers(plan),
            rooms: plan.experiment.rooms(),
            copy: Acting::zeros(plan.experiment.acting()),
            received: 0,
        }
    }

    /// Takes over the weights that were published last; returns their generation and version.
    fn update(&mut self) -> Result<Option<(u16, Round)>, LinkError> {
        let Self { place, run, sizes, rooms, copy, .. } = self;
        place.with(|wire, _| {
            let Some((header, payload)) = &wire.published else { return Ok(None) };
            header.receive(*run, sizes, payload, rooms, copy)?;
            Ok(Some((header.generation, header.version)))
        })?
    }

    fn send(&self, what: &'static str, message: ToLearner) -> Result<(), LinkError> {
        self.place.step()?;
        // Looked for first: mostly there is room.
        if !self.place.with(|wire, _| wire.has_room())? {
            self.place.wait(Want::Room, BACKPRESSURE)?;
        }
        self.place.with(|wire, alive| {
            if !wire.learner.is_some_and(alive) {
                return Err(gone(what));
            }
            if !wire.has_room() {
                let waited_ms = BACKPRESSURE.as_millis();
                return Err(LinkError::Deadline { peer: "learner".into(), what, waited_ms });
            }
            wire.to_learner.push_back(message);
            Ok(())
        })?
    }
}

impl<P: Place> ActorLink for LocalActor<P> {
    fn hello(&mut self, stop: Stop<'_>) -> Result<(), LinkError> {
        let (index, process) = (self.index, self.place.process());
        announce(&self.place, stop, |wire| wire.actors[index] = Some(process))
    }

    fn recv_orders(&mut self, timeout: Duration) -> Result<Option<Orders>, LinkError> {
        self.place.wait(Want::Orders(self.received), timeout)?;
        let (count, orders) = self.place.with(|wire, _| wire.orders)?;
        if count == self.received {
            return Ok(None);
        }
        self.received = count;
        orders.validate(self.run)?;
        Ok(Some(orders))
    }

    fn acting(&mut self, generation: u16, at_least: Round) -> Result<Option<(Round, &Acting)>, LinkError> {
        self.place.step()?;
        let newest = self.update()?;
        let newest = newest.filter(|(of, version)| *of == generation && *version >= at_least);
        Ok(newest.map(|(_, version)| (version, &self.copy)))
    }

    fn send_batch(&mut self, batch: &Batch) -> Result<(), LinkError> {
        self.send("a batch", ToLearner::Batch(batch.header, batch.payload().to_vec()))
    }

    fn send_reply(&mut self, reply: &Reply) -> Result<(), LinkError> {
        self.send("a reply", ToLearner::Reply(reply.clone()))
    }
}

impl<P: Place> LocalLearner<P> {
    /// The learner's end of `plan`'s run.
    pub fn new(place: P, plan: &RunPlan) -> Self {
        let RunPlan { life, experiment } = plan;
        Self {
            place,
            run: life.run,
            generation: life.generation,
            sizes: layers(plan),
            record_words: experiment.record_words(),
            spaces: experiment.spaces(),
            mentor_len: experiment.mentor_len(),
        }
    }

    fn ask_history(
        &self,
        request: &ObserveRequest,
        words: Vec<u32>,
    ) -> Result<(ObserveAnswer, Vec<u32>), LinkError> {
        const WHAT: &str = "a batch for its history";
        match ask(&self.place, Request::Observe(*request, words), WHAT, OBSERVE_DEADLINE)? {
            Answer::Observe(header, _) if header.status != OK => {
                Err(LinkError::Refused { what: WHAT, reason: status_text(header.status) })
            }
            Answer::Observe(header, words) => Ok((header, words)),
            Answer::Query(..) => Err(LinkError::Unexpected("an answer to another question".into())),
        }
    }
}

impl<P: Place> LearnerLink for LocalLearner<P> {
    fn welcome(&mut self, stop: Stop<'_>) -> Result<(), LinkError> {
        let process = self.place.process();
        self.place.step()?;
        self.place.with(|wire, _| wire.learner = Some(process))?;
        loop {
            self.place.wait(Want::Gathered, WAIT_SLICE)?;
            if stop() {
                return Err(LinkError::Interrupted("actors and mentor-server"));
            }
            let gathered = self.place.with(|wire, _| {
                wire.welcomed = wire.is_gathered();
                wire.welcomed
            })?;
            if gathered {
                return Ok(());
            }
        }
    }

    fn send_acting(&mut self, version: Round, acting: &Acting) -> Result<(), LinkError> {
        self.place.step()?;
        let header = ActingHeader::new(self.run, self.generation, version, &self.sizes, acting);
        let mut payload = vec![0; acting.words()];
        acting.write(&mut payload);
        self.place.with(|wire, _| wire.published = Some((header, payload)))
    }

    fn send_orders(&mut self, orders: &Orders) -> Result<(), LinkError> {
        self.place.step()?;
        let (found, expected) = self.place.with(|wire, alive| {
            wire.orders = (wire.orders.0 + 1, *orders);
            let found = wire.actors.iter().flatten().filter(|actor| alive(**actor)).count();
            (found, if wire.replaces { 0 } else { wire.actors.len() })
        })?;
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
        self.place.wait(Want::Message, timeout)?;
        match self.place.with(|wire, _| wire.to_learner.pop_front())? {
            None => Ok(None),
            Some(ToLearner::Reply(reply)) => Ok(Some(FromActor::Reply(reply))),
            Some(ToLearner::Batch(header, payload)) => {
                batch.receive(header, &payload, &self.spaces)?;
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
        Ok(into.receive(&header, &payload, counts, self.record_words, self.mentor_len)?)
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
        query(&self.place, request, payload, into, QUERY_DEADLINE)
    }
}

impl<P: Place> LocalMentor<P> {
    /// The mentor-server's end of the run that `place` is in.
    pub fn new(place: P) -> Self {
        Self { place }
    }
}

impl<P: Place> MentorLink for LocalMentor<P> {
    fn hello(&mut self, handler: &mut dyn MentorHandler, stop: Stop<'_>) -> Result<(), LinkError> {
        let process = self.place.process();
        self.place.step()?;
        self.place.with(|wire, _| wire.mentor = Some(process))?;
        while !stop() {
            self.serve(handler, WAIT_SLICE)?;
            if self.place.with(|wire, _| wire.welcomed)? {
                break;
            }
        }
        Ok(())
    }

    fn serve(&mut self, handler: &mut dyn MentorHandler, timeout: Duration) -> Result<usize, LinkError> {
        self.place.wait(Want::Request, timeout)?;
        let Some((number, request)) = self.place.with(|wire, _| wire.requests.pop_front())? else {
            return Ok(0);
        };
        let mut words = Vec::new();
        let answer = match request {
            Request::Observe(request, payload) => {
                Answer::Observe(handler.observe(&request, &payload, &mut words), words)
            }
            Request::Query(request, payload) => {
                Answer::Query(handler.query(&request, &payload, &mut words), words)
            }
        };
        self.place.step()?;
        self.place.with(|wire, _| {
            // Nobody waits for it any more, where there is no place for it.
            if let Some(place) = wire.answers.get_mut(&number) {
                *place = Some(answer);
            }
        })?;
        Ok(1)
    }
}

impl<P: Place> LocalClient<P> {
    /// The end of a client of `plan`'s run.
    pub fn new(place: P, plan: &RunPlan) -> Self {
        Self { place, run: plan.life.run }
    }
}

impl<P: Place> ClientLink for LocalClient<P> {
    fn ask(
        &self,
        request: &QueryRequest,
        payload: &[f32],
        into: &mut Vec<u32>,
        deadline: Duration,
    ) -> Result<QueryAnswer, LinkError> {
        let request = QueryRequest { run: self.run, ..*request };
        query(&self.place, &request, payload, into, deadline)
    }
}
