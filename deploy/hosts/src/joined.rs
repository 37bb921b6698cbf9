//! The relay of a host that has joined. To its own actors it is the learner.
//!
//! 1. [`join`] says hello until the head answers, and waits for the plan and the files with which the host begins.
//! 2. The supervisor makes the shared memory and starts the actors. [`Joined::idle`] keeps the session alive meanwhile.
//! 3. [`Joined::serve`] hands on the messages of the actors and of the head.
//!
//! The run has another identity here than on its head: two hosts may be one machine. So headers are changed on the way.

use crate::RelayError;
use crate::frame::{Frame, Kind};
use crate::head::{Clock, counted};
use crate::limits::{BACKLOG, FAREWELLS, HELLO};
use crate::message::{self, FromHead, Grant, HELLO_KIND, Hello};
use crate::stream::Stream;
use crate::wire::Program;
use std::time::Duration;
use trestle_link::iceoryx::IceoryxLearner;
use trestle_link::iceoryx::relay::{self, Whom};
use trestle_link::{FromActor, LearnerLink, Stop, logging, pulse};
use trestle_proto::acting::{Acting, ActingHeader, Rooms};
use trestle_proto::batch::{Batch, BatchHeader, Checked};
use trestle_proto::codec::{self, MAX_BODY};
use trestle_proto::limits::WAIT_SLICE;
use trestle_proto::orders::Orders;
use trestle_proto::plan::RunPlan;

/// The head, as its only peer.
const HEAD: u64 = 0;

/// The relay's arguments.
#[derive(Clone, Debug)]
pub struct Options {
    /// This host's description of itself.
    pub hello: Hello,
    /// After how long without a sign of life the head counts as lost.
    pub silence: Duration,
    /// How long the head may leave a hello unanswered.
    pub patience: Duration,
}

/// The head's answer to a host that wants to join.
pub enum Answer {
    /// It is let in.
    In(Box<Joined>, Grant),
    /// The run is over, as the head says.
    Over(String),
    /// This relay was told to leave before there was an answer.
    Told,
}

/// How a session ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ended {
    /// The run is over, as the head says.
    Over(String),
    /// The session is over; the run may take this host again.
    Session(String),
    /// This relay was told to leave.
    Told,
}

/// A session with the head.
pub struct Joined {
    stream: Stream,
    silence: Duration,
    heard: Duration,
    clock: Clock,
    ended: Option<Ended>,
}

/// Says hello until the head lets this host in and sends its grant. `say` is told the news for people.
///
/// # Errors
/// The head refuses this host, says nothing for too long, or ends the session at once; the wire carries nothing any more.
pub fn join(
    wire: &mut Program,
    options: &Options,
    stop: Stop<'_>,
    say: &mut dyn FnMut(&str),
) -> Result<Answer, RelayError> {
    let hello = codec::encode(HELLO_KIND, &options.hello)?;
    let hello = Frame::bare(Kind::Hello, 0, &hello).encode();
    let mut clock = Clock::new();
    let (mut heard, mut said) = (Duration::ZERO, None::<Duration>);
    let mut told = None;
    let session = loop {
        if stop() {
            return Ok(Answer::Told);
        }
        pulse::step();
        while let Some(trouble) = wire.news() {
            say(&format!("trestle-relay says: {trouble}; asking again"));
        }
        let now = clock.look();
        if said.is_none_or(|said| now >= said + HELLO) {
            wire.send(HEAD, hello.clone());
            said = Some(now);
        }
        if now.saturating_sub(heard) > options.patience {
            let seconds = options.patience.as_secs();
            let trouble =
                wire.trouble().map_or_else(String::new, |trouble| format!("; trestle-relay says: {trouble}"));
            return Err(RelayError::Lost(format!("the head has not answered for {seconds} s{trouble}")));
        }
        wire.wait(HELLO);
        let Some((_, bytes)) = wire.recv()? else { continue };
        match Frame::decode(&bytes) {
            Some(frame) if frame.kind == Kind::Welcome => break frame.session,
            // While this host waited for a place.
            Some(frame) if frame.kind == Kind::Over => return Ok(Answer::Over(frame.text())),
            Some(frame) if frame.kind == Kind::Refused => {
                heard = now;
                let text = frame.text();
                match text.strip_prefix('?') {
                    // It may be another answer later.
                    Some(reason) if told.as_deref() != Some(reason) => {
                        say(&format!("waiting: {reason}"));
                        told = Some(reason.to_string());
                    }
                    Some(_) => {}
                    None => return Err(RelayError::Refused(text.trim_start_matches('!').into())),
                }
            }
            _ => {}
        }
    };
    let stream = Stream::new(session, MAX_BODY + 64);
    let heard = clock.look();
    let mut joined = Joined { stream, silence: options.silence, heard, clock, ended: None };
    loop {
        if stop() {
            joined.farewell(wire, "told to leave");
            return Ok(Answer::Told);
        }
        pulse::step();
        joined.pump(wire)?;
        match joined.ended.take() {
            Some(Ended::Over(reason)) => return Ok(Answer::Over(reason)),
            Some(Ended::Session(reason)) => return Err(RelayError::Lost(reason)),
            Some(Ended::Told) | None => {}
        }
        if let Some(message) = joined.take()? {
            match FromHead::decode(&message, &[]) {
                Ok(FromHead::Grant(grant)) => return Ok(Answer::In(Box::new(joined), grant)),
                _ => {
                    return Err(RelayError::Lost("the head does not begin with what this host needs".into()));
                }
            }
        }
        let due = joined.flush(wire);
        wire.wait(due);
    }
}

impl Joined {
    /// Takes in what has come from the head.
    fn pump(&mut self, wire: &mut Program) -> Result<bool, RelayError> {
        let mut came = false;
        while let Some((_, bytes)) = wire.recv()? {
            let Some(frame) = Frame::decode(&bytes) else { continue };
            if frame.session != self.stream.session() {
                continue;
            }
            let now = self.clock.look();
            (self.heard, came) = (now, true);
            match frame.kind {
                Kind::Over | Kind::Farewell => {
                    let text = frame.text();
                    let over = frame.kind == Kind::Over;
                    self.ended = Some(if over { Ended::Over(text) } else { Ended::Session(text) });
                    let returned = Frame::bare(frame.kind, frame.session, b"").encode();
                    (0..FAREWELLS).for_each(|_| wire.send(HEAD, returned.clone()));
                }
                Kind::Hello | Kind::Welcome | Kind::Refused => {}
                Kind::Chunk | Kind::Last | Kind::Sign if self.stream.receive(&frame, now) => {}
                Kind::Chunk | Kind::Last | Kind::Sign => {
                    self.ended = Some(Ended::Session("the head's numbers cannot be right".into()));
                }
            }
        }
        let silent = self.clock.look().saturating_sub(self.heard);
        if silent > self.silence {
            let text = format!("the head has given no sign of life for {} s", silent.as_secs());
            self.ended.get_or_insert(Ended::Session(text));
        }
        Ok(came)
    }

    /// The next message of the head.
    fn take(&mut self) -> Result<Option<Vec<u8>>, RelayError> {
        self.stream.take().map_err(|error| RelayError::Lost(format!("the head sends {error}")))
    }

    /// Sends what is due; returns how long there is nothing more to send.
    fn flush(&mut self, wire: &mut Program) -> Duration {
        let now = self.clock.look();
        while let Some(frame) = self.stream.poll(now) {
            wire.send(HEAD, frame);
        }
        self.stream.due().saturating_sub(now).min(WAIT_SLICE)
    }

    fn farewell(&mut self, wire: &mut Program, reason: &str) {
        let farewell = Frame::bare(Kind::Farewell, self.stream.session(), reason.as_bytes()).encode();
        (0..FAREWELLS).for_each(|_| wire.send(HEAD, farewell.clone()));
    }

    /// Keeps the session alive until `ready` says so. How it has ended, if it has meanwhile.
    ///
    /// # Errors
    /// The wire carries nothing any more.
    pub fn idle(
        &mut self,
        wire: &mut Program,
        ready: &dyn Fn() -> bool,
        stop: Stop<'_>,
        reason: &dyn Fn() -> String,
    ) -> Result<Option<Ended>, RelayError> {
        while !ready() {
            if stop() {
                self.farewell(wire, &reason());
                return Ok(Some(Ended::Told));
            }
            pulse::step();
            self.pump(wire)?;
            if self.ended.is_some() {
                return Ok(self.ended.take());
            }
            let due = self.flush(wire);
            wire.wait(due);
        }
        Ok(None)
    }

    /// Serves the actors of this host, by the indices in `actors`, with this host's `plan`, which is the head's but for the run's identity:
    /// that is `run` there. `reason` is what the head is told when `stop` says that this is the end.
    ///
    /// # Errors
    /// Messages of the head that cannot be right; a transport that fails; the wire carries nothing any more.
    pub fn serve(
        &mut self,
        wire: &mut Program,
        plan: &RunPlan,
        run: u64,
        actors: &[u32],
        stop: Stop<'_>,
        reason: &dyn Fn() -> String,
    ) -> Result<Ended, RelayError> {
        let experiment = &plan.experiment;
        let mut link = relay::learner(plan)?;
        wire.wake_by(relay::waker(plan.life.run, Whom::Learner)?);
        let mut serving = Serving {
            link: &mut link,
            run,
            here: plan.life.run,
            actors,
            sizes: experiment.sizes().into_iter().map(|n| n as u32).collect(),
            rooms: experiment.rooms(),
            copy: Acting::zeros(experiment.acting()),
            batch: Checked::default(),
        };
        let most = size_of::<ActingHeader>()
            + size_of::<Orders>()
            + 4 * (experiment.acting().words() + serving.rooms.words());
        self.stream.expect(1 + most);
        let ended = loop {
            if stop() {
                self.farewell(wire, &reason());
                break Ended::Told;
            }
            pulse::step();
            let mut busy = false;
            // With more than that under way the actors wait.
            while self.stream.backlog() < BACKLOG
                && let Some(message) = serving.next()?
            {
                busy = true;
                self.stream.push(&message);
            }
            busy |= self.pump(wire)?;
            while let Some(message) = self.take()? {
                busy = true;
                if let Err(error) = serving.obey(&message) {
                    let text = error.to_string();
                    self.farewell(wire, &text);
                    return Err(error);
                }
            }
            if let Some(ended) = self.ended.take() {
                break ended;
            }
            let due = self.flush(wire);
            if !busy {
                serving.link.sleep(due)?;
            }
        };
        tracing::info!("{}", counted(self.stream.counts(), self.stream.round_trip()));
        Ok(ended)
    }
}

/// The learner's place on a joined host.
struct Serving<'a> {
    link: &'a mut IceoryxLearner,
    /// The run's identity on its head, and here.
    run: u64,
    here: u64,
    actors: &'a [u32],
    sizes: Vec<u32>,
    rooms: Rooms,
    copy: Acting,
    batch: Checked<Batch>,
}

impl Serving<'_> {
    /// The next message of an actor, as the head is to have it.
    fn next(&mut self) -> Result<Option<Vec<u8>>, RelayError> {
        Ok(match self.link.recv(&mut self.batch, 1, Duration::ZERO)? {
            None => None,
            Some(FromActor::Batch) => {
                let header = BatchHeader { run: self.run, ..self.batch.header };
                Some(message::batch(&header, self.batch.payload()))
            }
            Some(FromActor::Reply(mut reply)) => {
                reply.header.run = self.run;
                Some(message::reply(&reply))
            }
        })
    }

    /// Hands a message of the head on to the actors.
    fn obey(&mut self, message: &[u8]) -> Result<(), RelayError> {
        let wrong = |error: &dyn std::fmt::Display| {
            RelayError::Lost(format!("the head sends what cannot be right: {error}"))
        };
        match FromHead::decode(message, self.actors).map_err(|error| wrong(&error))? {
            FromHead::Grant(_) => Err(RelayError::Lost("the head begins anew".into())),
            FromHead::Orders(mut orders, acting) => {
                orders.validate(self.run).map_err(|error| wrong(&error))?;
                if let Some((header, payload)) = acting {
                    header
                        .receive(self.run, &self.sizes, &payload, &self.rooms, &mut self.copy)
                        .map_err(|error| wrong(&error))?;
                    self.link.set_generation(header.generation);
                    self.link.send_acting(header.version, &self.copy)?;
                }
                logging::set_tick(orders.round);
                orders.run = self.here;
                Ok(self.link.send_orders(&orders)?)
            }
        }
    }
}
