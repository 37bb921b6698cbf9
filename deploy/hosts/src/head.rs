//! The relay of the head, the host of learner and mentor-server. To the learner it is the actors of all other hosts.
//!
//! A host that says hello is given seats, the run's plan, and what its actors go on from. The learner hears of an actor only when the
//! actor itself has announced itself on its host: so the handshake of shared memory goes all the way.
//!
//! In lockstep the run cannot go on without one of its hosts. When one is lost this relay ends with the reason, and the supervisor
//! starts the run again from its newest checkpoint. In free mode the seats of a lost host are free for the next one.

use crate::RelayError;
use crate::frame::{Frame, Kind};
use crate::limits::{FAREWELL, FAREWELLS, LAST_WORDS, MAX_HOSTS, TOLD_EVERY};
use crate::message::{self, FromHost, Grant, HELLO_KIND, Hello, Seat};
use crate::silence::{Change, Silence};
use crate::stream::{Counts, Stream};
use crate::wire::Program;
use std::cell::Cell;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::time::{Duration, Instant};
use trestle_link::iceoryx::IceoryxActor;
use trestle_link::iceoryx::relay::{self, Whom};
use trestle_link::{ActorLink, LinkError, Stop, logging, pulse};
use trestle_proto::acting::ActingHeader;
use trestle_proto::batch::{self, Batch, BatchHeader, Checked, Spaces};
use trestle_proto::codec;
use trestle_proto::config::Mode;
use trestle_proto::hosts_file::{HostRow, HostState, MAX_NAME, is_name};
use trestle_proto::incarnation::Incarnation;
use trestle_proto::limits::{MAX_REPLY_BYTES, WAIT_SLICE};
use trestle_proto::orders::Orders;
use trestle_proto::plan::RunPlan;
use trestle_proto::reply::{JOINED, Reply, ReplyHeader};
use trestle_proto::round::Round;

/// The relay's arguments beside the plan.
#[derive(Clone, Debug)]
pub struct Options {
    /// The sources that the program was built from.
    pub build: String,
    /// A number that no other relay has had, drawn for this one.
    pub session: u64,
    /// The actors that are on other hosts: the last ones of the run.
    pub actors: Range<u32>,
    /// After how long without a sign of life a host counts as lost.
    pub silence: Duration,
    /// How often a relay has taken the place of another since the learner was started.
    pub replacements: u16,
    /// Files of the checkpoint that the run goes on from, by name, that actors read.
    pub files: Vec<(String, Vec<u8>)>,
}

/// A host that has been let in.
struct Host {
    name: String,
    stream: Stream,
    actors: Vec<u32>,
    /// How many orders there had been when it was given some last.
    given: u64,
    /// Generation and version of the weights that it was given last.
    acting: Option<(u16, Round)>,
    /// A message that the learner could not be given yet.
    waiting: Option<FromHost>,
    /// When something came from it last.
    heard: Duration,
    silence: Silence,
    /// When its counts were told last.
    told: Duration,
}

impl Host {
    /// What is known of it, as `peer`.
    fn row(&self, peer: u64, state: HostState) -> HostRow {
        let Counts { sent, received, resent, repeated } = self.stream.counts();
        HostRow {
            peer,
            host: self.name.clone(),
            actors: self.actors.clone(),
            state,
            round_trip_ms: self.stream.round_trip().map(|time| 1e3 * time.as_secs_f64()),
            bytes_sent: sent,
            bytes_received: received,
            resent,
            repeated,
        }
    }
}

/// What a head has to tell its supervisor.
#[derive(Clone, Debug, PartialEq)]
pub enum News<'a> {
    /// A sentence for people.
    Words(&'a str),
    /// What is known of a host by now. It comes when the host joins, every second from then on, and when it is gone.
    Host(HostRow),
}

/// What became of a message to the learner.
enum Delivery {
    Done,
    /// There is nobody to take it yet.
    Later(FromHost),
    /// It cannot be right.
    Wrong(String),
}

struct Head<'a> {
    wire: &'a mut Program,
    tell: &'a mut dyn FnMut(News<'_>),
    plan: &'a RunPlan,
    options: &'a Options,
    lockstep: bool,
    spaces: Spaces,
    sizes: Vec<u32>,
    /// Most bytes of a host's message.
    most: usize,
    seats: Vec<IceoryxActor>,
    /// The host that has each seat.
    holders: Vec<Option<u64>>,
    /// The last incarnation of each seat that was given away or announced.
    lives: Vec<Option<Incarnation>>,
    hosts: BTreeMap<u64, Host>,
    /// The hosts whose refusal has been said.
    refused: BTreeSet<u64>,
    /// The hosts for which there is no place yet, and when they asked last.
    waiting: BTreeMap<u64, Duration>,
    orders: Box<Orders>,
    /// How many orders there have been.
    ordered: u64,
    batch: Checked<Batch>,
    /// Bounded looks at a clock: time in which this process did not run does not count.
    clock: Clock,
}

/// Time as this process has seen it go by: a gap in which it was not run counts as a second at the most, so that no host
/// seems silent only because nobody listened.
pub(crate) struct Clock {
    last: Instant,
    now: Duration,
}

impl Clock {
    pub(crate) fn new() -> Self {
        Self { last: Instant::now(), now: Duration::ZERO }
    }

    pub(crate) fn look(&mut self) -> Duration {
        let last = std::mem::replace(&mut self.last, Instant::now());
        self.now += (self.last - last).min(Duration::from_secs(1));
        self.now
    }
}

/// Serves the learner of `plan`'s run, and the hosts at the other ends of `wire`, until `stop` says so. `tell` is given the news.
///
/// # Errors
/// A host that a run in lockstep cannot go on without is lost; the learner is; or the wire carries nothing any more.
pub fn run(
    wire: &mut Program,
    plan: &RunPlan,
    options: &Options,
    stop: Stop<'_>,
    tell: &mut dyn FnMut(News<'_>),
) -> Result<(), RelayError> {
    let RunPlan { life, experiment } = plan;
    let seats = relay::seats(plan, options.actors.clone())?;
    wire.wake_by(relay::waker(life.run, Whom::Actors(options.actors.clone()))?);
    let words = batch::words(experiment.config.run.rollout as usize, experiment.spec.row());
    let batch_bytes = size_of::<BatchHeader>() + 4 * words;
    let remote = seats.len();
    let mut head = Head {
        wire,
        tell,
        plan,
        options,
        lockstep: experiment.config.run.mode == Mode::Lockstep,
        spaces: experiment.spaces(),
        sizes: experiment.sizes().into_iter().map(|n| n as u32).collect(),
        most: 1 + batch_bytes.max(size_of::<ReplyHeader>() + MAX_REPLY_BYTES),
        seats,
        holders: vec![None; remote],
        lives: vec![None; remote],
        hosts: BTreeMap::new(),
        refused: BTreeSet::new(),
        waiting: BTreeMap::new(),
        orders: Box::default(),
        ordered: 0,
        batch: Checked::default(),
        clock: Clock::new(),
    };
    let actors = match options.actors {
        Range { start, end } if end - start == 1 => format!("actor {start}"),
        Range { start, end } => format!("actors {start} to {}", end - 1),
    };
    head.say(&format!("waiting for other hosts, which are to run {actors}"));
    let ended = head.serve(stop);
    head.farewell(&ended);
    ended
}

impl Head<'_> {
    /// Says something to people.
    fn say(&mut self, text: &str) {
        (self.tell)(News::Words(text));
    }

    fn serve(&mut self, stop: Stop<'_>) -> Result<(), RelayError> {
        while !stop() {
            pulse::step();
            let mut busy = self.hear_orders()?;
            while let Some((peer, bytes)) = self.wire.recv()? {
                busy = true;
                self.receive(peer, &bytes)?;
            }
            let now = self.clock.look();
            while let Some(trouble) = self.wire.news() {
                self.say(&format!("trestle-relay says: {trouble}"));
            }
            self.look_for_the_lost(now)?;
            self.tell_of_silence(now);
            self.give_orders()?;
            busy |= self.deliver()?;
            self.tell_counts(now);
            let due = self.flush(now);
            if !busy {
                self.seats[0].sleep(due.saturating_sub(now).min(WAIT_SLICE))?;
            }
        }
        Ok(())
    }

    /// Takes in the learner's newest orders. All seats are given the same.
    fn hear_orders(&mut self) -> Result<bool, RelayError> {
        let Some(orders) = self.seats[0].recv_orders(Duration::ZERO)? else { return Ok(false) };
        if orders.generation < self.orders.generation {
            return Ok(false);
        }
        logging::set_tick(orders.round);
        *self.orders = orders;
        self.ordered += 1;
        Ok(true)
    }

    fn receive(&mut self, peer: u64, bytes: &[u8]) -> Result<(), RelayError> {
        let Some(frame) = Frame::decode(bytes) else { return Ok(()) };
        let now = self.clock.look();
        if frame.kind == Kind::Hello {
            return self.hello(peer, frame.bytes, now);
        }
        let session = self.options.session;
        let Some(host) = self.hosts.get_mut(&peer).filter(|_| frame.session == session) else {
            // A host that was let in by another relay, or was given up.
            if !matches!(frame.kind, Kind::Farewell | Kind::Over | Kind::Refused) {
                let answer = Frame::bare(Kind::Farewell, frame.session, b"this session is over");
                self.wire.send(peer, answer.encode());
            }
            return Ok(());
        };
        host.heard = now;
        match frame.kind {
            Kind::Farewell | Kind::Over => {
                let reason = format!("left: {}", frame.text());
                self.lose(peer, HostState::Left, &reason)
            }
            _ if host.stream.receive(&frame, now) => Ok(()),
            _ => self.expel(peer, "its numbers cannot be right"),
        }
    }

    /// A host wants to join.
    fn hello(&mut self, peer: u64, bytes: &[u8], now: Duration) -> Result<(), RelayError> {
        let welcome = Frame::bare(Kind::Welcome, self.options.session, &[]).encode();
        if self.hosts.contains_key(&peer) {
            // It has not heard the answer.
            self.wire.send(peer, welcome);
            return Ok(());
        }
        let Ok(hello) = codec::decode::<Hello>(HELLO_KIND, bytes) else {
            self.refuse(
                peer,
                "a host",
                "its hello cannot be read: it may be another version of Trestle",
                false,
            );
            return Ok(());
        };
        if !is_name(&hello.name) {
            let reason = format!("its name is not made of 1 to {MAX_NAME} letters, digits, `-`, `_` and `.`");
            self.refuse(peer, "a host", &reason, false);
            return Ok(());
        }
        if hello.build != self.options.build {
            let reason = format!(
                "its program was built from other sources ({}) than the run's ({}); accepted: the same program on all hosts",
                printable(&hello.build),
                self.options.build
            );
            self.refuse(peer, &hello.name, &reason, false);
            return Ok(());
        }
        let free: Vec<usize> = (0..self.holders.len()).filter(|&seat| self.holders[seat].is_none()).collect();
        if hello.actors == 0 || free.is_empty() {
            let taken: Vec<String> =
                self.hosts.values().map(|host| format!("{} has {}", host.name, host.actors.len())).collect();
            let reason =
                format!("all {} places for actors are taken ({})", self.seats.len(), taken.join(", "));
            self.wait_with(peer, now);
            self.refuse(peer, &hello.name, &reason, true);
            return Ok(());
        }
        let mut stream = Stream::new(self.options.session, self.most);
        let mut actors = Vec::new();
        let mut grant =
            Grant { plan: self.plan.encode()?, seats: Vec::new(), files: self.options.files.clone() };
        for &seat in free.iter().take(hello.actors as usize) {
            let actor = self.options.actors.start + seat as u32;
            let incarnation = self.next_life(seat, actor);
            self.holders[seat] = Some(peer);
            self.lives[seat] = Some(incarnation);
            grant.seats.push(Seat { actor, incarnation });
            actors.push(actor);
        }
        stream.push(&message::grant(&grant)?);
        self.wire.send(peer, welcome);
        let name = hello.name;
        let missing = self.holders.iter().filter(|holder| holder.is_none()).count();
        let rest =
            if missing > 0 { format!("; {missing} more actors are waited for") } else { String::new() };
        self.say(&format!("host {name} has joined with {}{rest}", of(&actors)));
        tracing::info!(host = name, peer = format!("{peer:016x}"), ?actors, "a host has joined");
        let host = Host {
            name,
            stream,
            actors,
            given: 0,
            acting: None,
            waiting: None,
            heard: now,
            silence: Silence::default(),
            told: now,
        };
        (self.tell)(News::Host(host.row(peer, HostState::Joined)));
        self.hosts.insert(peer, host);
        self.waiting.remove(&peer);
        Ok(())
    }

    /// The incarnation that the next actor in `seat` begins as. In lockstep all begin as the first.
    fn next_life(&self, seat: usize, actor: u32) -> Incarnation {
        if self.lockstep {
            return Incarnation::default();
        }
        let generation = self.orders.generation.max(self.plan.life.generation);
        let share = self.orders.shares[actor as usize];
        let counted = (share.granted > 0).then_some(share.incarnation);
        // A former relay may have given lives away of which the learner has not heard.
        let least = Incarnation::new(generation, self.options.replacements.saturating_mul(256));
        let last = self.lives[seat].max(counted).filter(|life| life.generation() == generation);
        last.map_or(least, |life| life.next().max(least))
    }

    /// Answers a hello with a refusal; with `later` it may be another answer later.
    fn refuse(&mut self, peer: u64, name: &str, reason: &str, later: bool) {
        let class = if later { "?" } else { "!" };
        let text = format!("{class}{reason}");
        let refusal = Frame::bare(Kind::Refused, self.options.session, text.as_bytes());
        self.wire.send(peer, refusal.encode());
        if self.refused.len() < MAX_HOSTS && self.refused.insert(peer) {
            self.say(&format!("host {name} is refused: {reason}"));
        }
    }

    /// Notes that a host waits for a place, and forgets the one that has been silent for longest where there are too many.
    fn wait_with(&mut self, peer: u64, now: Duration) {
        self.waiting.insert(peer, now);
        if self.waiting.len() > MAX_HOSTS
            && let Some((&silent, _)) = self.waiting.iter().min_by_key(|(_, asked)| **asked)
        {
            self.waiting.remove(&silent);
        }
    }

    /// Tells the counts of each host, now and then.
    fn tell_counts(&mut self, now: Duration) {
        for (&peer, host) in &mut self.hosts {
            if now >= host.told + TOLD_EVERY {
                host.told = now;
                (self.tell)(News::Host(host.row(peer, HostState::Joined)));
            }
        }
    }

    /// Sends away a host whose message no sound host would send.
    fn expel(&mut self, peer: u64, reason: &str) -> Result<(), RelayError> {
        let farewell = Frame::bare(Kind::Farewell, self.options.session, reason.as_bytes());
        self.wire.send(peer, farewell.encode());
        self.lose(peer, HostState::Lost, &format!("is sent away: {reason}"))
    }

    fn look_for_the_lost(&mut self, now: Duration) -> Result<(), RelayError> {
        let silent = |host: &Host| now.saturating_sub(host.heard) > self.options.silence;
        let lost = self.hosts.iter().find(|(_, host)| silent(host)).map(|(&peer, _)| peer);
        match lost {
            Some(peer) => {
                let seconds = self.options.silence.as_secs();
                let how = format!("has given no sign of life for {seconds} s (--host-silence)");
                self.lose(peer, HostState::Lost, &how)
            }
            None => Ok(()),
        }
    }

    /// Tells people which hosts are silent, and which are back.
    fn tell_of_silence(&mut self, now: Duration) {
        let limit = self.options.silence.as_secs();
        for host in self.hosts.values_mut() {
            let Some(change) = host.silence.look(host.heard, now) else { continue };
            let who = format!("host {} with {}", host.name, of(&host.actors));
            let text = match change {
                Change::Silent(time) => {
                    let meanwhile = match self.lockstep {
                        true => format!("the run waits for it, until {limit} s have passed"),
                        false => format!("the run goes on, and gives it up when {limit} s have passed"),
                    };
                    let seconds = time.as_secs();
                    format!("{who} has given no sign of life for {seconds} s; {meanwhile} (--host-silence)")
                }
                Change::Back(time) => format!("{who} is back after {} s", time.as_secs()),
            };
            (self.tell)(News::Words(&text));
        }
    }

    /// A host is gone.
    fn lose(&mut self, peer: u64, state: HostState, how: &str) -> Result<(), RelayError> {
        let Some(host) = self.hosts.remove(&peer) else { return Ok(()) };
        let said = format!("host {} with {} {how}", host.name, of(&host.actors));
        tracing::warn!("{said}; {}", counted(host.stream.counts(), host.stream.round_trip()));
        (self.tell)(News::Host(host.row(peer, state)));
        if self.lockstep {
            return Err(RelayError::Lost(said));
        }
        self.say(&format!("{said}; the run goes on, and takes it back when it returns"));
        self.holders.iter_mut().filter(|holder| **holder == Some(peer)).for_each(|holder| *holder = None);
        Ok(())
    }

    /// Gives each host the newest orders, and what to act with, unless it has not acknowledged earlier ones yet: only the
    /// newest count.
    fn give_orders(&mut self) -> Result<(), RelayError> {
        if self.ordered == 0 || self.hosts.values().all(|host| host.given == self.ordered) {
            return Ok(());
        }
        let (generation, wanted) = (self.orders.generation, self.orders.weights_version);
        let Some((version, acting)) = self.seats[0].acting(generation, wanted)? else { return Ok(()) };
        let newest = (generation, version);
        let mut header = None;
        for host in self.hosts.values_mut() {
            if host.given == self.ordered || !host.stream.is_idle() {
                continue;
            }
            let news = (host.acting != Some(newest)).then(|| {
                let run = self.plan.life.run;
                &*header
                    .get_or_insert_with(|| ActingHeader::new(run, generation, version, &self.sizes, acting))
            });
            let message = message::orders(&self.orders, &host.actors, news.map(|header| (header, acting)));
            host.stream.push(&message);
            (host.given, host.acting) = (self.ordered, Some(newest));
        }
        Ok(())
    }

    /// Hands on the messages that have come for the learner.
    fn deliver(&mut self) -> Result<bool, RelayError> {
        let mut delivered = false;
        let peers: Vec<u64> = self.hosts.keys().copied().collect();
        for peer in peers {
            let fault = loop {
                let Some(host) = self.hosts.get_mut(&peer) else { break None };
                let message = match host.waiting.take() {
                    Some(message) => message,
                    None => match host.stream.take() {
                        Ok(None) => break None,
                        Err(error) => break Some(error.to_string()),
                        Ok(Some(bytes)) => match FromHost::decode(&bytes) {
                            Ok(message) => message,
                            Err(error) => break Some(error.to_string()),
                        },
                    },
                };
                match self.hand_on(peer, message)? {
                    Delivery::Done => delivered = true,
                    Delivery::Wrong(reason) => break Some(reason),
                    Delivery::Later(message) => {
                        if let Some(host) = self.hosts.get_mut(&peer) {
                            host.waiting = Some(message);
                        }
                        break None;
                    }
                }
            };
            if let Some(reason) = fault {
                self.expel(peer, &reason)?;
            }
        }
        Ok(delivered)
    }

    /// The seat of `actor`, if it is `peer`'s.
    fn seat(&self, peer: u64, actor: u32) -> Option<usize> {
        let seat = actor.checked_sub(self.options.actors.start)? as usize;
        (self.holders.get(seat)? == &Some(peer)).then_some(seat)
    }

    fn hand_on(&mut self, peer: u64, message: FromHost) -> Result<Delivery, RelayError> {
        let run = self.plan.life.run;
        let (of, actor) = match &message {
            FromHost::Batch(header, _) => (header.run, header.actor),
            FromHost::Reply(Reply { header, .. }) => (header.run, header.actor),
        };
        let Some(seat) = self.seat(peer, actor).filter(|_| of == run) else {
            return Ok(Delivery::Wrong(format!("a message of actor {actor}, which is not its own")));
        };
        let sent = match &message {
            FromHost::Batch(header, payload) => {
                if let Err(error) = self.batch.receive(**header, payload, &self.spaces) {
                    return Ok(Delivery::Wrong(error.to_string()));
                }
                self.seats[seat].send_batch(&self.batch)
            }
            FromHost::Reply(reply) if reply.header.kind == JOINED => {
                let name = self.hosts.get(&peer).map(|host| host.name.clone()).unwrap_or_default();
                // The actor is there: now the learner is to hear of it. It may be busy for a while.
                let asked = Cell::new(false);
                match self.seats[seat].hello(&|| asked.replace(true)) {
                    Err(LinkError::Interrupted(_)) => return Ok(Delivery::Later(message)),
                    said => said?,
                }
                self.lives[seat] = self.lives[seat].max(Some(reply.header.incarnation));
                self.seats[seat].send_reply(&Reply { header: reply.header, payload: name.into() })
            }
            FromHost::Reply(reply) => self.seats[seat].send_reply(reply),
        };
        match sent {
            Err(LinkError::Receivers { found: 0, .. }) => Ok(Delivery::Later(message)),
            sent => Ok(sent.map(|()| Delivery::Done)?),
        }
    }

    /// Sends the frames that are due; returns when there is more to be sent.
    fn flush(&mut self, now: Duration) -> Duration {
        let mut due = now + WAIT_SLICE;
        for (&peer, host) in &mut self.hosts {
            while let Some(frame) = host.stream.poll(now) {
                self.wire.send(peer, frame);
            }
            due = due.min(host.stream.due());
        }
        due
    }

    /// Tells all hosts that this is the end, and whether the run has ended, too, until each has said so itself or there is no more
    /// time.
    fn farewell(&mut self, ended: &Result<(), RelayError>) {
        // The order to leave may have been quicker than the learner's last orders.
        if let Err(error) = self.hear_orders() {
            tracing::debug!("{error}");
        }
        let (kind, text) = match ended {
            Ok(()) if self.orders.stop == 1 => (Kind::Over, "the run is over".to_string()),
            Ok(()) => (Kind::Farewell, "the run has stopped".into()),
            Err(error) => (Kind::Farewell, error.to_string()),
        };
        let farewell = Frame::bare(kind, self.options.session, text.as_bytes()).encode();
        for (&peer, host) in &self.hosts {
            let counts = counted(host.stream.counts(), host.stream.round_trip());
            tracing::info!(host = host.name, "{counts}");
            (self.tell)(News::Host(host.row(peer, HostState::Left)));
        }
        if kind == Kind::Over {
            // They need not wait any longer.
            let waiting = self.waiting.keys().flat_map(|&peer| (0..FAREWELLS).map(move |_| peer));
            waiting.for_each(|peer| self.wire.send(peer, farewell.clone()));
        }
        let last = Instant::now() + LAST_WORDS;
        while !self.hosts.is_empty() && Instant::now() < last {
            self.hosts.keys().for_each(|&peer| self.wire.send(peer, farewell.clone()));
            let until = Instant::now() + FAREWELL;
            while !self.hosts.is_empty() && Instant::now() < until {
                self.wire.wait(until.saturating_duration_since(Instant::now()));
                let Ok(came) = self.wire.recv() else { return };
                let Some((peer, bytes)) = came else { continue };
                let said = Frame::decode(&bytes).filter(|frame| frame.session == self.options.session);
                if said.is_some_and(|frame| matches!(frame.kind, Kind::Farewell | Kind::Over)) {
                    self.hosts.remove(&peer);
                }
            }
        }
    }
}

/// The counts of a session, in words.
pub(crate) fn counted(counts: Counts, round_trip: Option<Duration>) -> String {
    let Counts { sent, received, resent, repeated } = counts;
    let round_trip =
        round_trip.map_or("unknown".into(), |time| format!("{:.1} ms", 1e3 * time.as_secs_f64()));
    format!(
        "{sent} bytes sent and {received} received, {resent} pieces sent again, {repeated} received again, round trip {round_trip}"
    )
}

/// The actors of a host, in words.
fn of(actors: &[u32]) -> String {
    match actors {
        [one] => format!("actor {one}"),
        actors => {
            let names: Vec<String> = actors.iter().map(u32::to_string).collect();
            format!("actors {}", names.join(", "))
        }
    }
}

/// A stranger's text, for a person to read.
fn printable(text: &str) -> String {
    text.chars().filter(char::is_ascii_graphic).take(40).collect()
}
