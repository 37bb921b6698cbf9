//! The learner's end of the transport.

use super::bell::{Consumer, Ear, HELLO, READY, ROLL_CALL, WELCOME, bit};
use super::client::{self, ask};
use super::services::{MENTOR_PEER, Services};
use super::{Ipc, Wire, failed, give_up_in_time};
use crate::pulse;
use crate::{FromActor, LearnerLink, LinkError, Stop};
use iceoryx2::port::client::Client;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use std::time::{Duration, Instant};
use trestle_proto::acting::{Acting, ActingHeader};
use trestle_proto::batch::{Batch, BatchHeader, Checked};
use trestle_proto::limits::{ASSEMBLY, MAX_REPLY_BYTES, OBSERVE_DEADLINE, QUERY_DEADLINE, WAIT_SLICE};
use trestle_proto::observe::{Answers, ObserveAnswer, ObserveRequest, Part};
use trestle_proto::orders::Orders;
use trestle_proto::query::{QueryAnswer, QueryRequest, status_text};
use trestle_proto::reply::{Reply, ReplyHeader};
use trestle_proto::round::Round;

/// The learner over shared memory.
#[derive(Debug)]
pub struct IceoryxLearner {
    transitions: Subscriber<Ipc, [u32], Wire<BatchHeader>>,
    replies: Subscriber<Ipc, [u8], Wire<ReplyHeader>>,
    weights: Publisher<Ipc, [u32], Wire<ActingHeader>>,
    orders: Publisher<Ipc, [u8], Wire<Orders>>,
    /// As given last.
    given: Orders,
    observe: Client<Ipc, [u32], Wire<ObserveRequest>, [u32], Wire<ObserveAnswer>>,
    query: client::Port,
    ear: Ear,
    mentor_waits: bool,
    generation: u16,
    /// Whether a message to all actors must reach as many as the run has.
    strict: bool,
    services: Services,
}

impl IceoryxLearner {
    /// Creates the learner's ports.
    pub(super) fn new(services: Services, generation: u16) -> Result<Self, LinkError> {
        let sizes = &services.sizes;
        let weights = services
            .weights
            .publisher_builder()
            .initial_max_slice_len(sizes.acting_words())
            .max_loaned_samples(1)
            .create()
            .map_err(failed("creating the publisher of weights"))?;
        let orders = services
            .orders
            .publisher_builder()
            .max_loaned_samples(1)
            .create()
            .map_err(failed("creating the publisher of orders"))?;
        let observe = services
            .observe
            .client_builder()
            .initial_max_slice_len(sizes.observe_request_words())
            .set_backpressure_handler(give_up_in_time)
            .create()
            .map_err(failed("creating the client of mentor/observe"))?;
        Ok(Self {
            transitions: services
                .transitions
                .subscriber_builder()
                .create()
                .map_err(failed("creating the subscriber of transitions"))?,
            replies: services
                .replies
                .subscriber_builder()
                .create()
                .map_err(failed("creating the subscriber of replies"))?,
            weights,
            orders,
            given: Orders::default(),
            observe,
            query: client::port(&services)?,
            ear: services.bells.ear(Consumer::Learner),
            mentor_waits: false,
            generation,
            // Where processes are replaced, some may have just died.
            strict: !services.sizes.replaces,
            services,
        })
    }

    /// As [`new`](Self::new), on a host with only some of the run's actors.
    pub(super) fn of_some(services: Services, generation: u16) -> Result<Self, LinkError> {
        Ok(Self { strict: false, ..Self::new(services, generation)? })
    }

    /// From now on orders and weights are of the learner's start `generation`.
    pub fn set_generation(&mut self, generation: u16) {
        self.generation = generation;
    }

    /// Sleeps until something has come since this end looked for messages last, or it is woken, or `timeout` is over; or for no reason
    /// at all.
    pub fn sleep(&self, timeout: Duration) -> Result<(), LinkError> {
        self.ear.sleep(1, timeout)
    }

    /// Maps the processes that have come and unmaps those that have gone: mapped memory of a dead process stays in use.
    fn connect(&mut self) -> Result<(), LinkError> {
        self.observe.update_connections().map_err(failed("mapping the mentor-server"))?;
        self.query.update_connections().map_err(failed("mapping the mentor-server"))?;
        self.transitions.update_connections().map_err(failed("mapping an actor"))?;
        self.replies.update_connections().map_err(failed("mapping an actor"))?;
        self.weights.update_connections().map_err(failed("mapping an actor"))?;
        self.orders.update_connections().map_err(failed("mapping an actor"))
    }

    /// Waits until each of `missing` has announced itself, `patience` at the most, and maps all peers. In free mode it calls
    /// the mentor-server, which may have been let in by another learner before.
    fn let_in(
        &mut self,
        mut missing: Vec<usize>,
        patience: Duration,
        stop: Stop<'_>,
    ) -> Result<(), LinkError> {
        let start = Instant::now();
        let mut calling = self.services.sizes.replaces;
        while !missing.is_empty() {
            if stop() {
                return Err(LinkError::Interrupted("actors and mentor-server"));
            }
            if calling {
                self.services.bells.call(Consumer::Mentor, ROLL_CALL)?;
            }
            if start.elapsed() > patience {
                let name = |p: &usize| {
                    if *p == MENTOR_PEER { "mentor-server".into() } else { format!("actor {p}") }
                };
                return Err(LinkError::Deadline {
                    peer: missing.iter().map(name).collect::<Vec<_>>().join(", "),
                    what: "welcome",
                    waited_ms: patience.as_millis(),
                });
            }
            pulse::step();
            self.ear.listen();
            let (hello, ready) = self.take_calls();
            missing.retain(|peer| !ready.contains(peer));
            for &peer in &hello {
                calling &= peer != MENTOR_PEER;
                self.answer_hello(peer)?;
            }
            if !missing.is_empty() {
                self.ear.sleep(1, WAIT_SLICE)?;
            }
        }
        // A last hello may have come together with the ready that follows it.
        self.ear.take(|_| {});
        self.mentor_waits = false;
        // Peers that became ready have created nothing since, so this maps all of them.
        self.connect()
    }

    /// Whether `found` receivers are enough for a message to all actors. In lockstep, where no process is replaced, all of
    /// them must have it.
    fn reached(&self, what: &'static str, found: usize) -> Result<(), LinkError> {
        if self.strict { delivered(what, found, self.services.sizes.actors) } else { Ok(()) }
    }

    fn answer_hello(&mut self, peer: usize) -> Result<(), LinkError> {
        self.connect()?;
        let consumer = if peer == MENTOR_PEER { Consumer::Mentor } else { Consumer::Actors };
        self.services.bells.call(consumer, WELCOME + peer)
    }

    /// The peers that have said hello, and those that are ready, since the last time.
    fn take_calls(&self) -> (Vec<usize>, Vec<usize>) {
        let (mut hello, mut ready) = (Vec::new(), Vec::new());
        self.ear.take(|call| match call {
            HELLO..READY => hello.push(call - HELLO),
            READY..ROLL_CALL => ready.push(call - READY),
            _ => {}
        });
        (hello, ready)
    }

    /// Lets actors in that come late. A mentor-server that does so has no history, and must wait until it can be given one.
    fn let_late_in(&mut self) -> Result<(), LinkError> {
        let (hello, ready) = self.take_calls();
        for peer in hello {
            if peer == MENTOR_PEER {
                self.mentor_waits = self.services.sizes.replaces;
            } else {
                self.answer_hello(peer)?;
            }
        }
        if ready.is_empty() { Ok(()) } else { self.connect() }
    }

    /// Looks by `poll` until it gives something or `timeout` is over, asleep in between until `wanted` messages have come.
    fn wait<T>(
        &mut self,
        wanted: u32,
        timeout: Duration,
        mut poll: impl FnMut(&Self) -> Result<Option<T>, LinkError>,
    ) -> Result<Option<T>, LinkError> {
        let start = Instant::now();
        loop {
            self.ear.listen();
            if let Some(found) = poll(self)? {
                return Ok(Some(found));
            }
            let left = timeout.saturating_sub(start.elapsed());
            self.ear.sleep(wanted, left.min(WAIT_SLICE))?;
            // Also without time to wait: a learner that is always busy must hear its peers, too.
            self.let_late_in()?;
            if left.is_zero() {
                return poll(self);
            }
        }
    }

    fn try_recv(&self, batch: &mut Checked<Batch>) -> Result<Option<FromActor>, LinkError> {
        let Services { run, sizes, .. } = &self.services;
        // Replies first: an actor answers an evaluation before it sends the next batch.
        if let Some(sample) = self.replies.receive().map_err(failed("receiving a reply"))? {
            let header = sample.user_header().0;
            let known = header.run == *run && (header.actor as usize) < sizes.actors;
            if !known || sample.payload().len() > MAX_REPLY_BYTES {
                return Err(LinkError::Unexpected(format!("reply {header:?}")));
            }
            return Ok(Some(FromActor::Reply(Reply { header, payload: sample.payload().to_vec() })));
        }
        let Some(sample) = self.transitions.receive().map_err(failed("receiving a batch"))? else {
            return Ok(None);
        };
        let header = sample.user_header().0;
        if header.run != *run {
            return Err(LinkError::Unexpected(format!("batch {header:?}")));
        }
        batch.receive(header, sample.payload(), &sizes.spaces)?;
        Ok(Some(FromActor::Batch))
    }

    /// Sends a request of `parts` parts and `words` words, which `fill` writes, to `mentor/observe`, waits for the answer, and hands its
    /// header and payload to `take`.
    fn ask_history<T>(
        &mut self,
        request: &ObserveRequest,
        parts: usize,
        words: usize,
        fill: impl FnOnce(&mut [u32]),
        take: impl FnOnce(&ObserveAnswer, &[u32], &Services) -> Result<T, LinkError>,
    ) -> Result<T, LinkError> {
        const WHAT: &str = "a batch for its history";
        const REQUEST: &str = "a request to mentor/observe";
        const LOST: LinkError = LinkError::Receivers { what: REQUEST, found: 0, expected: 1 };
        if self.mentor_waits {
            return Err(LOST);
        }
        let deadline = OBSERVE_DEADLINE * parts as u32;
        let mut sending = self.observe.loan_slice(words).map_err(failed("loaning memory for a request"))?;
        fill(sending.payload_mut());
        sending.user_header_mut().0 = *request;
        let pending = sending.send().map_err(failed("sending a request to mentor/observe"))?;
        delivered(REQUEST, pending.number_of_server_connections(), 1)?;
        self.services.bells.ring(Consumer::Mentor)?;
        let start = Instant::now();
        let answer = loop {
            let answer = self.wait(1, WAIT_SLICE, |link| {
                // Asked first: an answer may come, and end the connection, in between.
                let connected = pending.is_connected() && !link.mentor_waits;
                let answer = pending.receive().map_err(failed("receiving from mentor/observe"))?;
                if answer.is_none() && !connected { Err(LOST) } else { Ok(answer) }
            })?;
            if let Some(answer) = answer {
                break answer;
            }
            // In free mode it is the supervisor that notices when it hangs, and replaces it.
            if !self.services.sizes.replaces && start.elapsed() > deadline {
                return Err(LinkError::Deadline {
                    peer: "mentor-server".into(),
                    what: WHAT,
                    waited_ms: deadline.as_millis(),
                });
            }
            pulse::step();
        };
        let header = answer.user_header().0;
        if header.status != trestle_proto::query::OK {
            return Err(LinkError::Refused { what: WHAT, reason: status_text(header.status) });
        }
        take(&header, answer.payload(), &self.services)
    }
}

impl LearnerLink for IceoryxLearner {
    fn welcome(&mut self, stop: Stop<'_>) -> Result<(), LinkError> {
        let mut missing: Vec<usize> = Vec::new();
        if self.services.sizes.mentor_len > 0 {
            missing.push(MENTOR_PEER);
        }
        if self.services.sizes.replaces {
            return self.let_in(missing, Duration::MAX, stop);
        }
        missing.extend(0..self.services.sizes.actors);
        self.let_in(missing, ASSEMBLY, stop)
    }

    fn mentor_waits(&self) -> bool {
        self.mentor_waits
    }

    fn rejoin_mentor(&mut self, stop: Stop<'_>) -> Result<(), LinkError> {
        self.let_in(vec![MENTOR_PEER], Duration::MAX, stop)
    }

    fn send_orders(&mut self, orders: &Orders) -> Result<(), LinkError> {
        let mut sample = self.orders.loan_slice(1).map_err(failed("loaning memory for orders"))?;
        sample.user_header_mut().0 = *orders;
        let found = sample.send().map_err(failed("sending orders"))?;
        self.reached("orders", found)?;
        let given = std::mem::replace(&mut self.given, *orders);
        let concerned = orders.concern(&given).fold(0, |whom, actor| whom | bit(actor));
        self.services.bells.ring_actors(concerned)
    }

    fn send_acting(&mut self, version: Round, acting: &Acting) -> Result<(), LinkError> {
        let words = acting.words();
        let mut sample = self.weights.loan_slice(words).map_err(failed("loaning memory for weights"))?;
        acting.write(sample.payload_mut());
        let sizes = &self.services.sizes;
        sample.user_header_mut().0 =
            ActingHeader::new(self.services.run, self.generation, version, &sizes.network, acting);
        let found = sample.send().map_err(failed("sending weights"))?;
        self.reached("a set of weights", found)
    }

    fn recv(
        &mut self,
        batch: &mut Checked<Batch>,
        wanted: u32,
        timeout: Duration,
    ) -> Result<Option<FromActor>, LinkError> {
        self.wait(wanted, timeout, |link| link.try_recv(batch))
    }

    fn observe(
        &mut self,
        request: &ObserveRequest,
        parts: &[Part<'_>],
        into: &mut Answers,
    ) -> Result<(), LinkError> {
        let words = parts.iter().map(Part::words).sum();
        let fill = |mut room: &mut [u32]| {
            for part in parts {
                let (header, rest) = room.split_at_mut(part.header().len());
                header.copy_from_slice(&part.header());
                let (payload, rest) = rest.split_at_mut(part.payload.len());
                payload.copy_from_slice(part.payload);
                room = rest;
            }
        };
        self.ask_history(request, parts.len(), words, fill, |answer, payload, Services { sizes, .. }| {
            let counts = parts.iter().map(|part| part.count as usize);
            Ok(into.receive(answer, payload, counts, sizes.record_words, sizes.mentor_len)?)
        })
    }

    fn teach(&mut self, request: &ObserveRequest, payload: &[u32]) -> Result<(), LinkError> {
        let fill = |room: &mut [u32]| room.copy_from_slice(payload);
        self.ask_history(request, 1, payload.len(), fill, |_, _, _| Ok(()))
    }

    fn query(
        &mut self,
        request: &QueryRequest,
        payload: &[f32],
        into: &mut Vec<u32>,
    ) -> Result<QueryAnswer, LinkError> {
        ask(&self.query, &self.services.bells, &self.ear, request, payload, into, QUERY_DEADLINE)
    }
}

/// Fewer receivers than processes means that one of them is gone. Further listeners do not concern the run.
fn delivered(what: &'static str, found: usize, expected: usize) -> Result<(), LinkError> {
    if found >= expected { Ok(()) } else { Err(LinkError::Receivers { what, found, expected }) }
}
