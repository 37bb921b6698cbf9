//! The account of one direction of a session: which chunks have been sent, which have come, and which must be sent again.
//!
//! Chunks are numbered from 0. The receiver acknowledges all below the first missing one, keeps later ones that have come, and says
//! up to where it has room. The sender keeps a chunk until it is acknowledged. If no acknowledgement gets ahead for a while, the
//! sender sends the oldest chunks again: first one, and with each step ahead twice as many.
//!
//! Time is an argument, measured from any fixed moment. Nothing here sends, waits or looks at a clock.

use crate::limits::{FIRST_PATIENCE, LEAST_PATIENCE, MOST_PATIENCE, WINDOW};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// A chunk that is not acknowledged yet.
#[derive(Clone, Debug)]
struct Waiting<T> {
    chunk: T,
    /// When it was sent, if it was sent once alone: only then its acknowledgement tells how long one takes.
    sent: Option<Duration>,
}

/// The sending side.
#[derive(Clone, Debug)]
pub struct Sender<T> {
    /// From number `base` on.
    waiting: VecDeque<Waiting<T>>,
    base: u64,
    /// The first that has never been sent.
    next: u64,
    /// The receiver has room for those below.
    room: u64,
    /// Those below this one, which had been sent when patience ran out, are sent again; and how far that is.
    lost_below: u64,
    resend: u64,
    /// How many may be sent again before the next step ahead.
    allowance: u64,
    patience: Duration,
    /// How often patience has run out since the last step ahead.
    doublings: u32,
    /// Since when there has been no step ahead.
    since: Duration,
    round_trip: Option<Duration>,
    resent: u64,
}

impl<T> Default for Sender<T> {
    fn default() -> Self {
        Self {
            waiting: VecDeque::new(),
            base: 0,
            next: 0,
            room: WINDOW,
            lost_below: 0,
            resend: 0,
            allowance: 0,
            patience: FIRST_PATIENCE,
            doublings: 0,
            since: Duration::ZERO,
            round_trip: None,
            resent: 0,
        }
    }
}

impl<T> Sender<T> {
    /// Adds the next chunk.
    pub fn push(&mut self, chunk: T) {
        self.waiting.push_back(Waiting { chunk, sent: None });
    }

    /// Whether every chunk has been acknowledged.
    pub fn is_idle(&self) -> bool {
        self.waiting.is_empty()
    }

    /// The smoothed time from a chunk to its acknowledgement, once there is one.
    pub fn round_trip(&self) -> Option<Duration> {
        self.round_trip
    }

    /// Chunks that were sent again.
    pub fn resent(&self) -> u64 {
        self.resent
    }

    /// The next chunk to be sent at `now`, and its number, if there is one.
    pub fn poll(&mut self, now: Duration) -> Option<(u64, &T)> {
        if self.due().is_some_and(|due| now >= due) {
            (self.lost_below, self.resend, self.allowance) = (self.next, self.base, 1);
            self.doublings += 1;
            self.since = now;
        }
        let again = self.allowance > 0 && self.resend < self.lost_below;
        let number = match again {
            true => self.resend,
            // While something is being sent again nothing new is added to what may be lost.
            false if self.resend < self.lost_below => return None,
            false => self.next,
        };
        if number >= self.room || number >= self.base + WINDOW {
            return None;
        }
        let waiting = self.waiting.get_mut((number - self.base) as usize)?;
        if again {
            (self.resend, self.allowance) = (number + 1, self.allowance - 1);
            waiting.sent = None;
            self.resent += 1;
        } else {
            if self.next == self.base {
                self.since = now;
            }
            self.next = number + 1;
            waiting.sent = Some(now);
        }
        Some((number, &waiting.chunk))
    }

    /// When [`Sender::poll`] is to be asked again, if nothing comes before.
    pub fn due(&self) -> Option<Duration> {
        let under_way = self.next > self.base;
        let patience = self.patience.saturating_mul(1 << self.doublings.min(10)).min(MOST_PATIENCE);
        under_way.then_some(self.since + patience)
    }

    /// Takes note of an acknowledgement; hands each acknowledged chunk to `done`. False: it cannot be right, and was ignored.
    pub fn acknowledge(
        &mut self,
        acknowledged: u64,
        room: u64,
        now: Duration,
        mut done: impl FnMut(T),
    ) -> bool {
        if acknowledged > self.next || room > acknowledged.saturating_add(2 * WINDOW) {
            return false;
        }
        // An acknowledgement that comes late says less than an earlier one did.
        self.room = self.room.max(room);
        let ahead = acknowledged.saturating_sub(self.base);
        for _ in 0..ahead {
            let Some(Waiting { chunk, sent }) = self.waiting.pop_front() else { break };
            if let Some(took) = sent.map(|sent| now.saturating_sub(sent)) {
                self.measure(took);
            }
            done(chunk);
        }
        if ahead > 0 {
            self.base = acknowledged;
            self.resend = self.resend.max(acknowledged);
            self.allowance = 2 * ahead.min(WINDOW);
            self.since = now;
            self.doublings = 0;
        }
        true
    }

    /// As TCP does it, without the deviation: four times the smoothed round trip.
    fn measure(&mut self, took: Duration) {
        let smoothed = self.round_trip.map_or(took, |before| (7 * before + took) / 8);
        self.round_trip = Some(smoothed);
        self.patience = (4 * smoothed).clamp(LEAST_PATIENCE, MOST_PATIENCE);
    }
}

/// The receiving side.
#[derive(Clone, Debug)]
pub struct Receiver<T> {
    /// Chunks that have come and have not been taken.
    came: BTreeMap<u64, T>,
    /// All below have come.
    next: u64,
    /// All below have been taken.
    taken: u64,
    /// How many came that had come before.
    repeated: u64,
}

impl<T> Default for Receiver<T> {
    fn default() -> Self {
        Self { came: BTreeMap::new(), next: 0, taken: 0, repeated: 0 }
    }
}

impl<T> Receiver<T> {
    /// Takes in chunk `number`. A chunk that has come before, or for which there is no room, is dropped.
    pub fn receive(&mut self, number: u64, chunk: T) {
        if number >= self.room() {
            return;
        }
        if number < self.next || self.came.contains_key(&number) {
            self.repeated += 1;
            return;
        }
        self.came.insert(number, chunk);
        while self.came.contains_key(&self.next) {
            self.next += 1;
        }
    }

    /// The next chunk in order, once.
    pub fn take(&mut self) -> Option<T> {
        let chunk = self.came.remove(&self.taken).filter(|_| self.taken < self.next)?;
        self.taken += 1;
        Some(chunk)
    }

    /// All chunks below this number have come. A frame acknowledges them.
    pub fn acknowledged(&self) -> u64 {
        self.next
    }

    /// Chunks below may be sent.
    pub fn room(&self) -> u64 {
        self.taken + WINDOW
    }

    /// Chunks that came once more.
    pub fn repeated(&self) -> u64 {
        self.repeated
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    const MS: Duration = Duration::from_millis(1);

    /// The channel's treatment of a message.
    #[derive(Clone, Copy, Debug)]
    enum Fate {
        Deliver(u32),
        Lose,
        Repeat(u32, u32),
    }

    fn fate(loss: u32) -> impl Strategy<Value = Fate> {
        prop_oneof![
            6 => (1..40u32).prop_map(Fate::Deliver),
            loss => Just(Fate::Lose),
            1 => (1..40u32, 1..400u32).prop_map(|(a, b)| Fate::Repeat(a, b)),
        ]
    }

    enum Sent {
        Chunk(u64, u32),
        Ack(u64, u64),
    }

    /// Sends `count` chunks over a channel that treats messages as `fates` say, over and over, and cuts everything between two
    /// moments. Returns the chunks that were taken, and how long it took.
    fn carry(count: u32, fates: &[Fate], cut: std::ops::Range<u32>, slow: bool) -> (Vec<u32>, u32) {
        let (mut sender, mut receiver) = (Sender::default(), Receiver::default());
        (0..count).for_each(|chunk| sender.push(chunk));
        let mut channel: BTreeMap<(u32, u32), Sent> = BTreeMap::new();
        let (mut taken, mut done, mut nth) = (Vec::new(), Vec::new(), 0);
        for now in 0..4_000_000u32 {
            if sender.is_idle() {
                assert_eq!(done, (0..count).collect::<Vec<_>>(), "each is acknowledged once, in order");
                while let Some(chunk) = receiver.take() {
                    taken.push(chunk);
                }
                return (taken, now);
            }
            let mut put = |sent: fn(u64, u64) -> Sent, a, b, channel: &mut BTreeMap<_, _>| {
                let fate = if cut.contains(&now) { Fate::Lose } else { fates[nth as usize % fates.len()] };
                let mut at = |after| {
                    nth += 1;
                    channel.insert((now + after, nth), sent(a, b));
                };
                match fate {
                    Fate::Deliver(after) => at(after),
                    Fate::Repeat(one, two) => {
                        at(one);
                        at(two);
                    }
                    Fate::Lose => nth += 1,
                }
            };
            let mut came = false;
            while channel.first_key_value().is_some_and(|((at, _), _)| *at <= now) {
                match channel.pop_first().unwrap().1 {
                    Sent::Chunk(number, chunk) => {
                        receiver.receive(number, chunk);
                        came = true;
                    }
                    Sent::Ack(acknowledged, room) => {
                        assert!(sender.acknowledge(acknowledged, room, now * MS, |chunk| done.push(chunk)));
                    }
                }
            }
            // A slow process takes a chunk now and then.
            if (!slow || now % 7 == 0)
                && let Some(chunk) = receiver.take()
            {
                taken.push(chunk);
                came = true;
            }
            assert!(receiver.came.len() as u64 <= WINDOW, "what waits is bounded");
            // Frames with nothing but an acknowledgement are also sent now and then.
            if came || now % 1000 == 0 {
                put(Sent::Ack, receiver.acknowledged(), receiver.room(), &mut channel);
            }
            while let Some((number, &chunk)) = sender.poll(now * MS) {
                put(|a, b| Sent::Chunk(a, b as u32), number, u64::from(chunk), &mut channel);
            }
        }
        panic!("{} of {count} chunks were acknowledged", done.len());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]

        /// Whatever is lost, repeated or reordered: each chunk is taken once, in order.
        #[test]
        fn every_chunk_comes_once_and_in_order(
            count in 1..400u32, slow in any::<bool>(),
            fates in (0..5u32).prop_flat_map(|loss| prop::collection::vec(fate(loss), 50..300)),
            from in 0..3000u32, long in 0..60_000u32,
        ) {
            // A channel that loses everything delivers nothing.
            prop_assume!(fates.iter().filter(|fate| matches!(fate, Fate::Lose)).count() * 2 < fates.len());
            let (taken, _) = carry(count, &fates, from..from + long, slow);
            prop_assert_eq!(taken, (0..count).collect::<Vec<_>>());
        }

        /// Numbers of a peer that lies neither panic nor make anything grow.
        #[test]
        fn nonsense_is_bounded(numbers in prop::collection::vec(any::<(u64, u64)>(), 0..100)) {
            let (mut sender, mut receiver) = (Sender::default(), Receiver::default());
            (0..10).for_each(|chunk: u32| sender.push(chunk));
            while sender.poll(Duration::ZERO).is_some() {}
            for (at, (a, b)) in numbers.into_iter().enumerate() {
                let (a, b) = if at % 2 == 0 { (a, b) } else { (a % 100, b % 200) };
                receiver.receive(a, 1);
                sender.acknowledge(a, b, at as u32 * MS, drop);
                sender.poll(at as u32 * MS);
                let _ = receiver.take();
                prop_assert!(receiver.came.len() as u64 <= WINDOW);
            }
        }
    }

    #[test]
    fn a_sound_channel_carries_everything_once() {
        let (taken, took) = carry(1000, &[Fate::Deliver(10)], 0..0, false);
        assert_eq!(taken, (0..1000).collect::<Vec<_>>());
        // 64 chunks in 20 ms; it takes one each millisecond here.
        assert!(took < 1100, "{took} ms");
    }

    #[test]
    fn what_was_lost_is_sent_again_and_the_sender_grows_patient() {
        let mut sender = Sender::default();
        (0..3).for_each(|chunk| sender.push(chunk));
        let sent = |sender: &mut Sender<i32>, now| {
            std::iter::from_fn(|| sender.poll(now).map(|(number, _)| number)).collect::<Vec<_>>()
        };
        assert_eq!(sent(&mut sender, Duration::ZERO), [0, 1, 2]);
        assert_eq!(sent(&mut sender, FIRST_PATIENCE - MS), []);
        assert_eq!(sent(&mut sender, FIRST_PATIENCE), [0], "one, to see whether anybody is there");
        assert_eq!(sent(&mut sender, 3 * FIRST_PATIENCE - MS), [], "twice as long");
        assert_eq!(sent(&mut sender, 3 * FIRST_PATIENCE), [0]);
        assert!(sender.acknowledge(1, 65, 3 * FIRST_PATIENCE + MS, drop));
        assert_eq!(sent(&mut sender, 3 * FIRST_PATIENCE + 2 * MS), [1, 2], "it got ahead");
        assert_eq!(
            (sender.resent(), sender.round_trip()),
            (4, None),
            "such a chunk does not tell how long it took"
        );
        assert!(!sender.acknowledge(4, 68, 4 * FIRST_PATIENCE, drop), "of a chunk that was never sent");
        assert!(sender.acknowledge(3, 67, 4 * FIRST_PATIENCE, drop));
        assert!(sender.is_idle() && sender.due().is_none());
    }

    #[test]
    fn a_receiver_that_takes_nothing_stops_the_sender() {
        let (mut sender, mut receiver) = (Sender::default(), Receiver::default());
        (0..1000u64).for_each(|chunk| sender.push(chunk));
        for now in 0..10 {
            while let Some((number, &chunk)) = sender.poll(now * MS) {
                receiver.receive(number, chunk);
            }
            sender.acknowledge(receiver.acknowledged(), receiver.room(), now * MS, drop);
        }
        assert_eq!((receiver.acknowledged(), receiver.came.len()), (WINDOW, WINDOW as usize));
        assert_eq!(receiver.take(), Some(0));
        sender.acknowledge(receiver.acknowledged(), receiver.room(), 20 * MS, drop);
        assert_eq!(sender.poll(20 * MS), Some((WINDOW, &WINDOW)));
    }
}
