//! An actor's end of the transport.

use super::bell::{Consumer, Ear, READY, WELCOME, bit};
use super::services::Services;
use super::{Ipc, Wire, announce, failed, give_up_in_time};
use crate::{ActorLink, LinkError, Stop};
use iceoryx2::port::backpressure_strategy::BackpressureStrategy;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::AllocationStrategy;
use std::rc::Rc;
use std::time::Duration;
use trestle_proto::acting::{Acting, ActingHeader};
use trestle_proto::batch::{Batch, BatchHeader};
use trestle_proto::orders::Orders;
use trestle_proto::reply::{Reply, ReplyHeader};
use trestle_proto::round::Round;

/// Room made in advance for a reply, bytes; a larger one makes the memory grow.
const REPLY_BYTES: usize = 4096;

/// An actor over shared memory.
#[derive(Debug)]
pub struct IceoryxActor {
    index: usize,
    weights: Subscriber<Ipc, [u32], Wire<ActingHeader>>,
    /// Generation and version of the newest weights received, and they themselves, kept because they may be acted with again.
    newest: Option<(u16, Round)>,
    copy: Acting,
    orders: Subscriber<Ipc, [u8], Wire<Orders>>,
    transitions: Publisher<Ipc, [u32], Wire<BatchHeader>>,
    replies: Publisher<Ipc, [u8], Wire<ReplyHeader>>,
    ear: Ear,
    services: Rc<Services>,
}

impl IceoryxActor {
    /// Creates the ports of actor `index`.
    pub(super) fn new(services: Services, index: u32) -> Result<Self, LinkError> {
        Self::within(Rc::new(services), index, bit(index as usize))
    }

    /// Creates the ports of actor `index` within `services`. Rings for any actor of `whom` ([`bit`]) wake it.
    pub(super) fn within(services: Rc<Services>, index: u32, whom: u32) -> Result<Self, LinkError> {
        let transitions = services
            .transitions
            .publisher_builder()
            .initial_max_slice_len(services.sizes.batch_words)
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::RetryUntilDelivered)
            .set_backpressure_handler(give_up_in_time)
            .create()
            .map_err(failed("creating the publisher of transitions"))?;
        let replies = services
            .replies
            .publisher_builder()
            .initial_max_slice_len(REPLY_BYTES)
            .allocation_strategy(AllocationStrategy::PowerOfTwo)
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::RetryUntilDelivered)
            .set_backpressure_handler(give_up_in_time)
            .create()
            .map_err(failed("creating the publisher of replies"))?;
        Ok(Self {
            index: index as usize,
            weights: services
                .weights
                .subscriber_builder()
                .create()
                .map_err(failed("creating the subscriber of weights"))?,
            newest: None,
            copy: Acting::zeros(services.sizes.acting),
            orders: services
                .orders
                .subscriber_builder()
                .create()
                .map_err(failed("creating the subscriber of orders"))?,
            transitions,
            replies,
            ear: services.bells.ear_of_actors(whom),
            services,
        })
    }

    /// Sleeps until something has come since this end looked for orders last, or it is woken, or `timeout` is over; or for no reason
    /// at all.
    pub fn sleep(&self, timeout: Duration) -> Result<(), LinkError> {
        self.ear.sleep(1, timeout)
    }

    fn try_orders(&self) -> Result<Option<Orders>, LinkError> {
        let Some(sample) = self.orders.receive().map_err(failed("receiving orders"))? else {
            return Ok(None);
        };
        let orders = sample.user_header().0;
        orders.validate(self.services.run)?;
        Ok(Some(orders))
    }

    /// Takes over the weights that have come since the last time.
    fn update_weights(&mut self) -> Result<(), LinkError> {
        while let Some(sample) = self.weights.receive().map_err(failed("receiving weights"))? {
            let header = sample.user_header().0;
            // Weights that a learner published before it died may come after its successor's.
            if self.newest.is_some_and(|(generation, _)| generation > header.generation) {
                continue;
            }
            let (run, sizes) = (self.services.run, &self.services.sizes);
            header.receive(run, &sizes.network, sample.payload(), &sizes.rooms, &mut self.copy)?;
            self.newest = Some((header.generation, header.version));
        }
        Ok(())
    }
}

impl ActorLink for IceoryxActor {
    fn hello(&mut self, stop: Stop<'_>) -> Result<(), LinkError> {
        let (ear, welcome) = (&self.ear, WELCOME + self.index);
        let Services { bells, sizes, .. } = &*self.services;
        // One from before does not count.
        ear.take_one(welcome);
        announce(bells, sizes.replaces, self.index, stop, |interval| {
            Ok(ear.wait(interval, || Ok(ear.take_one(welcome).then_some(())))?.is_some())
        })?;
        self.weights.update_connections().map_err(failed("mapping the weights"))?;
        self.orders.update_connections().map_err(failed("mapping the orders"))?;
        self.transitions.update_connections().map_err(failed("mapping the learner"))?;
        self.replies.update_connections().map_err(failed("mapping the learner"))?;
        bells.call(Consumer::Learner, READY + self.index)
    }

    fn recv_orders(&mut self, timeout: Duration) -> Result<Option<Orders>, LinkError> {
        self.ear.wait(timeout, || self.try_orders())
    }

    fn acting(&mut self, generation: u16, at_least: Round) -> Result<Option<(Round, &Acting)>, LinkError> {
        self.update_weights()?;
        let newest = self.newest.filter(|(of, version)| *of == generation && *version >= at_least);
        Ok(newest.map(|(_, version)| (version, &self.copy)))
    }

    fn send_batch(&mut self, batch: &Batch) -> Result<(), LinkError> {
        let mut sample = self
            .transitions
            .loan_slice_uninit(batch.payload().len())
            .map_err(failed("loaning memory for a batch"))?
            .write_from_slice(batch.payload());
        sample.user_header_mut().0 = batch.header;
        let found = sample.send().map_err(failed("sending a batch"))?;
        delivered("a batch", found)?;
        self.services.bells.ring(Consumer::Learner)
    }

    fn send_reply(&mut self, reply: &Reply) -> Result<(), LinkError> {
        let mut sample = self
            .replies
            .loan_slice_uninit(reply.payload.len())
            .map_err(failed("loaning memory for a reply"))?
            .write_from_slice(&reply.payload);
        sample.user_header_mut().0 = reply.header;
        let found = sample.send().map_err(failed("sending a reply"))?;
        delivered("a reply", found)?;
        self.services.bells.ring(Consumer::Learner)
    }
}

/// A message to the learner has one receiver; with none the learner is gone.
fn delivered(what: &'static str, found: usize) -> Result<(), LinkError> {
    if found == 1 { Ok(()) } else { Err(LinkError::Receivers { what, found, expected: 1 }) }
}
