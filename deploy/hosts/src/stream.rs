//! Messages of any size in both directions of a session, over accounts of chunks.

use crate::account::{Receiver, Sender};
use crate::frame::{Frame, HEADER, Kind};
use crate::limits::{CHUNK, SIGN};
use std::time::Duration;

/// Part of a message.
#[derive(Clone, Debug, PartialEq)]
struct Chunk {
    bytes: Vec<u8>,
    /// Whether the message ends with it.
    last: bool,
}

/// A message that is longer than any that a sound peer sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a message of more than {0} bytes")]
pub struct TooLong(pub usize);

/// The counts of a session.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Bytes of frames sent and received.
    pub sent: u64,
    /// See `sent`.
    pub received: u64,
    /// Chunks that were sent again.
    pub resent: u64,
    /// Chunks that came once more.
    pub repeated: u64,
}

/// Both directions of a session.
#[derive(Clone, Debug)]
pub struct Stream {
    session: u64,
    sender: Sender<Chunk>,
    receiver: Receiver<Chunk>,
    /// Bytes that are not acknowledged.
    backlog: usize,
    /// The beginning of a message whose end has not come.
    begun: Vec<u8>,
    /// Most bytes of a message.
    most: usize,
    /// Whether the peer is to hear of something that has come, or been taken.
    owes: bool,
    /// When a frame was sent last.
    said: Duration,
    bytes: (u64, u64),
}

impl Stream {
    /// A new session, of which the peer sends messages of up to `most` bytes.
    pub fn new(session: u64, most: usize) -> Self {
        Self {
            session,
            sender: Sender::default(),
            receiver: Receiver::default(),
            backlog: 0,
            begun: Vec::new(),
            most,
            owes: true,
            said: Duration::ZERO,
            bytes: (0, 0),
        }
    }

    /// The session's number.
    pub fn session(&self) -> u64 {
        self.session
    }

    /// From now on messages have up to `most` bytes.
    pub fn expect(&mut self, most: usize) {
        self.most = most;
    }

    /// Adds a message to those that are to be sent.
    pub fn push(&mut self, message: &[u8]) {
        self.backlog += message.len();
        let mut chunks = message.chunks(CHUNK).peekable();
        if chunks.peek().is_none() {
            self.sender.push(Chunk { bytes: Vec::new(), last: true });
        }
        while let Some(bytes) = chunks.next() {
            self.sender.push(Chunk { bytes: bytes.to_vec(), last: chunks.peek().is_none() });
        }
    }

    /// Bytes of messages that have not been acknowledged.
    pub fn backlog(&self) -> usize {
        self.backlog
    }

    /// Whether every message has been acknowledged.
    pub fn is_idle(&self) -> bool {
        self.sender.is_idle()
    }

    /// How long an acknowledgement takes, once one has come.
    pub fn round_trip(&self) -> Option<Duration> {
        self.sender.round_trip()
    }

    /// The counts so far.
    pub fn counts(&self) -> Counts {
        let (sent, received) = self.bytes;
        Counts { sent, received, resent: self.sender.resent(), repeated: self.receiver.repeated() }
    }

    /// Takes in a frame of this session that came at `now`. False: its numbers cannot be right.
    pub fn receive(&mut self, frame: &Frame<'_>, now: Duration) -> bool {
        self.bytes.1 += (frame.bytes.len() + HEADER) as u64;
        let backlog = &mut self.backlog;
        let done = |chunk: Chunk| *backlog -= chunk.bytes.len();
        if !self.sender.acknowledge(frame.acknowledged, frame.room, now, done) {
            return false;
        }
        if let Kind::Chunk | Kind::Last = frame.kind {
            self.receiver
                .receive(frame.number, Chunk { bytes: frame.bytes.to_vec(), last: frame.kind == Kind::Last });
            self.owes = true;
        }
        true
    }

    /// The next whole message, once.
    ///
    /// # Errors
    /// It is longer than expected; the session is of no use any more.
    pub fn take(&mut self) -> Result<Option<Vec<u8>>, TooLong> {
        while let Some(Chunk { bytes, last }) = self.receiver.take() {
            // There is more room from now on. A peer that is not held up by it need not know at once.
            self.owes |= self.receiver.acknowledged() + crate::limits::WINDOW / 2 > self.receiver.room();
            if self.begun.len() + bytes.len() > self.most {
                return Err(TooLong(self.most));
            }
            self.begun.extend_from_slice(&bytes);
            if last {
                return Ok(Some(std::mem::take(&mut self.begun)));
            }
        }
        Ok(None)
    }

    /// The next frame to be sent at `now`, if there is one.
    pub fn poll(&mut self, now: Duration) -> Option<Vec<u8>> {
        let Self { session, receiver, .. } = self;
        let (acknowledged, room) = (receiver.acknowledged(), receiver.room());
        let frame =
            |kind, number, bytes| Frame { kind, session: *session, number, acknowledged, room, bytes };
        let encoded = match self.sender.poll(now) {
            Some((number, chunk)) => {
                let kind = if chunk.last { Kind::Last } else { Kind::Chunk };
                frame(kind, number, &chunk.bytes).encode()
            }
            None if self.owes || now.saturating_sub(self.said) >= SIGN => frame(Kind::Sign, 0, &[]).encode(),
            None => return None,
        };
        (self.owes, self.said) = (false, now);
        self.bytes.0 += encoded.len() as u64;
        Some(encoded)
    }

    /// When [`Stream::poll`] is to be asked again, if nothing comes before.
    pub fn due(&self) -> Duration {
        let sign = self.said + SIGN;
        self.sender.due().map_or(sign, |due| due.min(sign))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    /// Lets two streams talk until both are idle, and loses three frames of ten. A pattern of losses that repeats itself would do no
    /// good: resending repeats itself as well, and the two may fall into step for ever.
    fn talk(a: &mut Stream, b: &mut Stream, losses: u64, mut took: impl FnMut(bool, Vec<u8>)) {
        let mut nth = 0u64;
        for step in 0..200_000u32 {
            let now = step * Duration::from_millis(5);
            let mut moved = false;
            for to_b in [true, false] {
                let (from, to) = if to_b { (&mut *a, &mut *b) } else { (&mut *b, &mut *a) };
                while let Some(frame) = from.poll(now) {
                    nth += 1;
                    moved = true;
                    if crc32c::crc32c(&(losses ^ nth.rotate_left(32)).to_le_bytes()) % 10 >= 3 {
                        assert!(to.receive(&Frame::decode(&frame).unwrap(), now));
                    }
                }
                while let Some(message) = to.take().unwrap() {
                    took(to_b, message);
                }
            }
            if !moved && a.is_idle() && b.is_idle() {
                return;
            }
        }
        panic!("they never came to an end");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(30))]

        #[test]
        fn messages_come_whole_once_and_in_order(
            sizes in prop::collection::vec(prop_oneof![0..300usize, 50_000..200_000usize], 1..12),
            losses: u64,
        ) {
            let (mut a, mut b) = (Stream::new(1, 1 << 20), Stream::new(1, 1 << 20));
            let message = |size: usize, nth: usize| vec![(size + nth) as u8; size];
            let messages: Vec<_> = sizes.iter().enumerate().map(|(nth, &size)| message(size, nth)).collect();
            for message in &messages {
                a.push(message);
                b.push(message);
            }
            let (mut at_a, mut at_b) = (Vec::new(), Vec::new());
            talk(&mut a, &mut b, losses, |to_b, message| if to_b { at_b.push(message) } else { at_a.push(message) });
            prop_assert!(at_a == messages && at_b == messages);
            prop_assert_eq!((a.backlog(), b.backlog()), (0, 0));
        }
    }

    #[test]
    fn a_message_that_is_too_long_ends_the_session() {
        let (mut a, mut b) = (Stream::new(1, 10), Stream::new(1, 100));
        a.push(&[1; 101]);
        let frame = a.poll(Duration::ZERO).unwrap();
        assert!(b.receive(&Frame::decode(&frame).unwrap(), Duration::ZERO));
        assert_eq!(b.take(), Err(TooLong(100)));
    }

    #[test]
    fn one_that_has_nothing_to_say_gives_signs_of_life() {
        let mut stream = Stream::new(1, 10);
        let ms = Duration::from_millis;
        assert!(stream.poll(ms(0)).is_some(), "the first word");
        assert_eq!((stream.poll(ms(1)), stream.due()), (None, SIGN));
        assert!(stream.poll(SIGN).is_some());
        assert!(stream.poll(SIGN).is_none());
    }
}
