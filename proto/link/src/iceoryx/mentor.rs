//! The mentor-server's end of the transport.

use super::bell::{Consumer, Ear, HELLO, READY, ROLL_CALL, WELCOME};
use super::services::{MENTOR_PEER, Services};
use super::{Ipc, Wire, announce, failed, give_up_in_time};
use crate::{LinkError, MentorHandler, MentorLink, Stop};
use iceoryx2::port::server::Server;
use iceoryx2::prelude::AllocationStrategy;
use std::time::{Duration, Instant};
use trestle_proto::limits::HELLO_INTERVAL;
use trestle_proto::observe::{ObserveAnswer, ObserveRequest};
use trestle_proto::query::{MALFORMED, NOT_READY, QueryAnswer, QueryRequest};

/// The mentor-server over shared memory.
#[derive(Debug)]
pub struct IceoryxMentor {
    observe: Server<Ipc, [u32], Wire<ObserveRequest>, [u32], Wire<ObserveAnswer>>,
    query: Server<Ipc, [f32], Wire<QueryRequest>, [u32], Wire<QueryAnswer>>,
    ear: Ear,
    /// Whether the learner has let this process in.
    welcome: bool,
    /// Private copies of a request's payload (a peer could still write to its message) and of an answer's payload.
    words: Vec<u32>,
    state: Vec<f32>,
    answer: Vec<u32>,
    services: Services,
}

impl IceoryxMentor {
    /// Creates the mentor-server's ports.
    pub(super) fn new(services: Services) -> Result<Self, LinkError> {
        let observe = services
            .observe
            .server_builder()
            .initial_max_slice_len(services.sizes.observe_answer_words())
            .allocation_strategy(AllocationStrategy::PowerOfTwo)
            .set_backpressure_handler(give_up_in_time)
            .create()
            .map_err(failed("creating the server of mentor/observe"))?;
        let query = services
            .query
            .server_builder()
            .initial_max_slice_len(services.sizes.query_answer_words())
            .allocation_strategy(AllocationStrategy::PowerOfTwo)
            .set_backpressure_handler(give_up_in_time)
            .create()
            .map_err(failed("creating the server of mentor/query"))?;
        Ok(Self {
            observe,
            query,
            ear: services.bells.ear(Consumer::Mentor),
            welcome: false,
            words: Vec::new(),
            state: Vec::new(),
            answer: Vec::new(),
            services,
        })
    }

    /// Takes what the learner has called: it may let this process in, or want it to forget and to announce itself anew.
    fn take_calls(&mut self, handler: &mut dyn MentorHandler) -> Result<(), LinkError> {
        let (mut welcome, mut called) = (false, false);
        self.ear.take(|call| {
            welcome |= call == WELCOME + MENTOR_PEER;
            called |= call == ROLL_CALL;
        });
        // In lockstep no learner calls.
        if self.welcome && called && self.services.sizes.replaces {
            self.welcome = false;
            handler.forget();
            tracing::info!("another learner has come");
        } else if !self.welcome && welcome {
            self.welcome = true;
            self.services.bells.call(Consumer::Learner, READY + MENTOR_PEER)?;
        }
        Ok(())
    }

    /// Answers everything that has come.
    fn answer_all(&mut self, handler: &mut dyn MentorHandler) -> Result<usize, LinkError> {
        let mut answered = 0;
        while let Some(request) = self.observe.receive().map_err(failed("receiving on mentor/observe"))? {
            let header = request.user_header().0;
            self.words.clear();
            self.words.extend_from_slice(request.payload());
            self.answer.clear();
            let answer = if !self.welcome {
                // Of a former mentor-server's time: this one has no history yet, and the learner does not know of it.
                ObserveAnswer { status: NOT_READY, ..ObserveAnswer::default() }
            } else if header.run == self.services.run {
                handler.observe(&header, &self.words, &mut self.answer)
            } else {
                ObserveAnswer { status: MALFORMED, ..ObserveAnswer::default() }
            };
            let mut sending = request
                .loan_slice_uninit(self.answer.len())
                .map_err(failed("loaning memory for an answer"))?
                .write_from_slice(&self.answer);
            sending.user_header_mut().0 = answer;
            match sending.send() {
                // The learner is gone, and another will come.
                Err(e) if self.services.sizes.replaces => {
                    tracing::warn!("an answer on mentor/observe was not delivered: {e}");
                }
                sent => sent.map_err(failed("answering on mentor/observe"))?,
            }
            self.services.bells.ring(Consumer::Learner)?;
            answered += 1;
        }
        while let Some(request) = self.query.receive().map_err(failed("receiving on mentor/query"))? {
            let header = request.user_header().0;
            self.state.clear();
            self.state.extend_from_slice(request.payload());
            self.answer.clear();
            let answer = if header.run == self.services.run {
                handler.query(&header, &self.state, &mut self.answer)
            } else {
                QueryAnswer { status: MALFORMED, count: 0 }
            };
            let mut sending = request
                .loan_slice_uninit(self.answer.len())
                .map_err(failed("loaning memory for an answer"))?
                .write_from_slice(&self.answer);
            sending.user_header_mut().0 = answer;
            // A client that is gone, or that reads nothing, is its own affair.
            if let Err(e) = sending.send() {
                tracing::warn!("an answer on mentor/query was not delivered: {e}");
            }
            self.services.bells.ring(Consumer::Learner)?;
            self.services.bells.ring_clients()?;
            answered += 1;
        }
        Ok(answered)
    }
}

impl MentorLink for IceoryxMentor {
    fn hello(&mut self, handler: &mut dyn MentorHandler, stop: Stop<'_>) -> Result<(), LinkError> {
        if self.welcome {
            return Ok(());
        }
        let (bells, replaces) = (self.services.bells.clone(), self.services.sizes.replaces);
        announce(&bells, replaces, MENTOR_PEER, stop, |interval| {
            self.ear.listen();
            // Before a welcome that may have come: requests until then were meant for another mentor-server.
            self.answer_all(handler)?;
            self.ear.sleep(1, interval)?;
            self.take_calls(handler)?;
            Ok(self.welcome)
        })
    }

    fn serve(&mut self, handler: &mut dyn MentorHandler, timeout: Duration) -> Result<usize, LinkError> {
        let start = Instant::now();
        loop {
            self.ear.listen();
            self.take_calls(handler)?;
            if !self.welcome {
                self.services.bells.call(Consumer::Learner, HELLO + MENTOR_PEER)?;
            }
            let answered = self.answer_all(handler)?;
            let left = timeout.saturating_sub(start.elapsed());
            if answered > 0 || left.is_zero() {
                return Ok(answered);
            }
            self.ear.sleep(1, if self.welcome { left } else { left.min(HELLO_INTERVAL) })?;
        }
    }
}
