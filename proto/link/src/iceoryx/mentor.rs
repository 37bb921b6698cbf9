//! The mentor-server's end of the transport.

use super::services::{MENTOR_PEER, Services};
use super::{Domain, Ipc, Wire, failed, give_up_in_time, wake};
use crate::pulse;
use crate::{LinkError, MentorHandler, MentorLink, Stop};
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::server::Server;
use iceoryx2::prelude::AllocationStrategy;
use std::time::{Duration, Instant};
use trestle_proto::limits::{ASSEMBLY, HELLO_INTERVAL};
use trestle_proto::observe::{ObserveAnswer, ObserveRequest};
use trestle_proto::plan::RunPlan;
use trestle_proto::query::{MALFORMED, NOT_READY, QueryAnswer, QueryRequest};

/// The mentor-server over shared memory.
#[derive(Debug)]
pub struct IceoryxMentor {
    observe: Server<Ipc, [u32], Wire<ObserveRequest>, [u32], Wire<ObserveAnswer>>,
    query: Server<Ipc, [f32], Wire<QueryRequest>, [u32], Wire<QueryAnswer>>,
    listener: Listener<Ipc>,
    learner: Notifier<Ipc>,
    clients: Notifier<Ipc>,
    /// Whether the learner has let this process in.
    welcome: bool,
    /// Private copies of a request's payload (a peer could still write to its message) and of an answer's payload.
    words: Vec<u32>,
    state: Vec<f32>,
    answer: Vec<u32>,
    services: Services,
}

impl IceoryxMentor {
    /// Opens the run's services and creates the mentor-server's ports.
    pub fn new(domain: &Domain, plan: &RunPlan) -> Result<Self, LinkError> {
        let services = Services::open(domain, plan)?;
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
            listener: wake::listener(&services.wake_mentor)?,
            learner: wake::notifier(&services.wake_learner)?,
            clients: wake::notifier(&services.wake_clients)?,
            welcome: false,
            words: Vec::new(),
            state: Vec::new(),
            answer: Vec::new(),
            services,
        })
    }

    /// Sleeps until notified or until `timeout` is over; the learner may let this process in meanwhile, or another one may
    /// want it to forget and to announce itself anew.
    fn sleep(&mut self, timeout: Duration, handler: &mut dyn MentorHandler) -> Result<(), LinkError> {
        let (mut welcome, mut called) = (false, false);
        wake::sleep(&self.listener, timeout, |event| {
            welcome |= event == wake::WELCOME + MENTOR_PEER;
            called |= event == wake::ROLL_CALL;
        })?;
        // In lockstep no learner calls.
        if self.welcome && called && self.services.sizes.replaces {
            self.welcome = false;
            handler.forget();
            tracing::info!("another learner has come");
        } else if !self.welcome && welcome {
            self.welcome = true;
            wake::notify(&self.learner, wake::READY + MENTOR_PEER)?;
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
            wake::notify(&self.learner, wake::DATA)?;
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
            wake::notify(&self.learner, wake::DATA)?;
            wake::notify(&self.clients, wake::DATA)?;
            answered += 1;
        }
        Ok(answered)
    }
}

impl MentorLink for IceoryxMentor {
    fn hello(&mut self, handler: &mut dyn MentorHandler, stop: Stop<'_>) -> Result<(), LinkError> {
        let start = Instant::now();
        while !self.welcome {
            if stop() {
                return Err(LinkError::Interrupted("the learner"));
            }
            // In free mode the learner may be busy for long.
            if !self.services.sizes.replaces && start.elapsed() > ASSEMBLY {
                return Err(LinkError::Deadline {
                    peer: "learner".into(),
                    what: "hello",
                    waited_ms: ASSEMBLY.as_millis(),
                });
            }
            pulse::step();
            wake::notify(&self.learner, wake::HELLO + MENTOR_PEER)?;
            // Before a welcome that may have come: requests until then were meant for another mentor-server.
            self.answer_all(handler)?;
            self.sleep(HELLO_INTERVAL, handler)?;
        }
        Ok(())
    }

    fn serve(&mut self, handler: &mut dyn MentorHandler, timeout: Duration) -> Result<usize, LinkError> {
        let start = Instant::now();
        if self.services.sizes.replaces {
            // A mentor-server that is always busy must hear another learner's call, too.
            self.sleep(Duration::ZERO, handler)?;
        }
        loop {
            if !self.welcome {
                wake::notify(&self.learner, wake::HELLO + MENTOR_PEER)?;
            }
            let answered = self.answer_all(handler)?;
            let left = timeout.saturating_sub(start.elapsed());
            if answered > 0 || left.is_zero() {
                return Ok(answered);
            }
            self.sleep(if self.welcome { left } else { left.min(HELLO_INTERVAL) }, handler)?;
        }
    }
}
