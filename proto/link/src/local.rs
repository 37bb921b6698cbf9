//! The transport within one process: bounded channels between threads. For tests of the roles' loops, and the proof
//! that the interfaces do not depend on shared memory.
//!
//! Messages are checked by the same code as those of shared memory.

use crate::{ActorLink, FromActor, LearnerLink, LinkError, MentorHandler, MentorLink, Stop};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;
use trestle_proto::acting::{Acting, ActingHeader, Room};
use trestle_proto::batch::{Batch, BatchHeader, Checked, Spaces};
use trestle_proto::limits::{OBSERVE_DEADLINE, QUERY_DEADLINE, REPLIES_BUFFER, TRANSITIONS_BUFFER};
use trestle_proto::observe::{Answers, ObserveAnswer, ObserveRequest, Part};
use trestle_proto::orders::Orders;
use trestle_proto::plan::RunPlan;
use trestle_proto::query::{OK, QueryAnswer, QueryRequest, status_text};
use trestle_proto::reply::Reply;

type Published = Arc<Mutex<Option<(ActingHeader, Vec<u32>)>>>;

/// The newest orders and how many there have been.
#[derive(Default)]
struct Newest {
    orders: Mutex<(u64, Orders)>,
    changed: Condvar,
}

enum ToLearner {
    Batch(BatchHeader, Vec<u32>),
    Reply(Reply),
}

enum Request {
    Observe(ObserveRequest, Vec<u32>, SyncSender<(ObserveAnswer, Vec<u32>)>),
    Query(QueryRequest, Vec<f32>, SyncSender<(QueryAnswer, Vec<u32>)>),
}

/// An actor over channels.
pub struct LocalActor {
    run: u64,
    sizes: Vec<u32>,
    room: Room,
    published: Published,
    /// What was received last.
    copy: Acting,
    orders: Arc<Newest>,
    /// How many orders there had been when some were received last.
    received: u64,
    learner: SyncSender<ToLearner>,
}

/// The learner over channels.
pub struct LocalLearner {
    run: u64,
    generation: u16,
    sizes: Vec<u32>,
    obs_dim: usize,
    spaces: Spaces,
    mentor_len: usize,
    published: Published,
    orders: Arc<Newest>,
    inbox: Receiver<ToLearner>,
    mentor: SyncSender<Request>,
}

/// The mentor-server over channels.
pub struct LocalMentor {
    requests: Receiver<Request>,
}

/// The connected ends of `plan`'s run: learner, mentor-server, and one end for each actor.
pub fn connect(plan: &RunPlan) -> (LocalLearner, LocalMentor, Vec<LocalActor>) {
    let RunPlan { life, experiment } = plan;
    let actors = experiment.config.run.actors as usize;
    let sizes: Vec<u32> = experiment.sizes().into_iter().map(|n| n as u32).collect();
    let published = Published::default();
    let orders = Arc::<Newest>::default();
    let (to_learner, inbox) = sync_channel(actors * (TRANSITIONS_BUFFER + REPLIES_BUFFER));
    let (to_mentor, requests) = sync_channel(1);
    let ends = (0..actors)
        .map(|_| LocalActor {
            run: life.run,
            sizes: sizes.clone(),
            room: experiment.own_room(),
            published: published.clone(),
            copy: Acting::zeros(experiment.acting()),
            orders: orders.clone(),
            received: 0,
            learner: to_learner.clone(),
        })
        .collect();
    let learner = LocalLearner {
        run: life.run,
        generation: life.generation,
        sizes,
        obs_dim: experiment.spec.obs_dim(),
        spaces: experiment.spaces(),
        mentor_len: experiment.mentor_len(),
        published,
        orders,
        inbox,
        mentor: to_mentor,
    };
    (learner, LocalMentor { requests }, ends)
}

fn gone(what: &'static str) -> LinkError {
    LinkError::Receivers { what, found: 0, expected: 1 }
}

/// A timeout is no message; a closed channel is an error.
fn waited<T>(result: Result<T, RecvTimeoutError>, what: &'static str) -> Result<Option<T>, LinkError> {
    match result {
        Ok(message) => Ok(Some(message)),
        Err(RecvTimeoutError::Timeout) => Ok(None),
        Err(RecvTimeoutError::Disconnected) => Err(gone(what)),
    }
}

impl LocalActor {
    /// Takes over what was published last; returns its generation and version.
    fn update(&mut self) -> Result<Option<(u32, u64)>, LinkError> {
        let newest = self.published.lock().unwrap_or_else(PoisonError::into_inner);
        let Some((header, payload)) = newest.as_ref() else { return Ok(None) };
        header.receive(self.run, &self.sizes, payload, &self.room, &mut self.copy)?;
        Ok(Some((header.generation, header.version)))
    }
}

impl ActorLink for LocalActor {
    fn hello(&mut self, _: Stop<'_>) -> Result<(), LinkError> {
        Ok(())
    }

    fn recv_orders(&mut self, timeout: Duration) -> Result<Option<Orders>, LinkError> {
        let newest = self.orders.orders.lock().unwrap_or_else(PoisonError::into_inner);
        let received = self.received;
        let waited = self.orders.changed.wait_timeout_while(newest, timeout, |newest| newest.0 == received);
        let (count, orders) = *waited.unwrap_or_else(PoisonError::into_inner).0;
        if count == received {
            return Ok(None);
        }
        self.received = count;
        orders.validate(self.run)?;
        Ok(Some(orders))
    }

    fn acting(&mut self, generation: u16, at_least: u64) -> Result<Option<(u64, &Acting)>, LinkError> {
        let newest = self.update()?;
        let newest = newest.filter(|(of, version)| *of == u32::from(generation) && *version >= at_least);
        Ok(newest.map(|(_, version)| (version, &self.copy)))
    }

    fn send_batch(&mut self, batch: &Batch) -> Result<(), LinkError> {
        self.learner
            .send(ToLearner::Batch(batch.header, batch.payload().to_vec()))
            .map_err(|_| gone("a batch"))
    }

    fn send_reply(&mut self, reply: &Reply) -> Result<(), LinkError> {
        self.learner.send(ToLearner::Reply(reply.clone())).map_err(|_| gone("a reply"))
    }
}

impl LocalLearner {
    fn ask_history(
        &self,
        request: &ObserveRequest,
        words: Vec<u32>,
    ) -> Result<(ObserveAnswer, Vec<u32>), LinkError> {
        const WHAT: &str = "a batch for its history";
        let (answer, answers) = sync_channel(1);
        self.mentor.send(Request::Observe(*request, words, answer)).map_err(|_| gone(WHAT))?;
        let (header, payload) = answers.recv_timeout(OBSERVE_DEADLINE).map_err(|_| gone(WHAT))?;
        if header.status != OK {
            return Err(LinkError::Refused { what: WHAT, reason: status_text(header.status) });
        }
        Ok((header, payload))
    }
}

impl LearnerLink for LocalLearner {
    fn welcome(&mut self, _: Stop<'_>) -> Result<(), LinkError> {
        Ok(())
    }

    fn send_acting(&mut self, version: u64, acting: &Acting) -> Result<(), LinkError> {
        let header = ActingHeader::new(self.run, self.generation, version, &self.sizes, acting);
        let mut payload = vec![0; acting.words()];
        acting.write(&mut payload);
        *self.published.lock().unwrap_or_else(PoisonError::into_inner) = Some((header, payload));
        Ok(())
    }

    fn send_orders(&mut self, orders: &Orders) -> Result<(), LinkError> {
        let mut newest = self.orders.orders.lock().unwrap_or_else(PoisonError::into_inner);
        *newest = (newest.0 + 1, *orders);
        self.orders.changed.notify_all();
        Ok(())
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
        match waited(self.inbox.recv_timeout(timeout), "waiting for actors")? {
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
        Ok(into.receive(&header, &payload, counts, self.obs_dim, self.mentor_len)?)
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
        const WHAT: &str = "a query";
        let (answer, answers) = sync_channel(1);
        self.mentor.send(Request::Query(*request, payload.to_vec(), answer)).map_err(|_| gone(WHAT))?;
        let (header, payload) = answers.recv_timeout(QUERY_DEADLINE).map_err(|_| gone(WHAT))?;
        if header.status != OK {
            return Err(LinkError::Refused { what: WHAT, reason: status_text(header.status) });
        }
        *into = payload;
        Ok(header)
    }
}

impl MentorLink for LocalMentor {
    fn hello(&mut self, _: &mut dyn MentorHandler, _: Stop<'_>) -> Result<(), LinkError> {
        Ok(())
    }

    fn serve(&mut self, handler: &mut dyn MentorHandler, timeout: Duration) -> Result<usize, LinkError> {
        let mut words = Vec::new();
        match waited(self.requests.recv_timeout(timeout), "waiting for requests")? {
            None => Ok(0),
            // A client that no longer waits for its answer is its own affair.
            Some(Request::Observe(request, payload, answer)) => {
                let header = handler.observe(&request, &payload, &mut words);
                let _ = answer.send((header, words));
                Ok(1)
            }
            Some(Request::Query(request, payload, answer)) => {
                let header = handler.query(&request, &payload, &mut words);
                let _ = answer.send((header, words));
                Ok(1)
            }
        }
    }
}
