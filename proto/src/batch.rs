//! A batch of transitions: what an actor sends in each round, and what the replay and the mentor-server read.
//!
//! Layout of the payload, `count` transitions of `w` words a state ([`crate::row`]), in 32-bit words, as a structure of arrays:
//!
//! | words | what |
//! |---|---|
//! | `count * w` | observations s: `obs_dim` numbers, `f32` or `u8` |
//! | `count * w` | next observations s', likewise (the state reached, also where the episode ends) |
//! | `count` | actions, `u32` |
//! | `count` | rewards, `f32` |
//! | `count` | flags, `u32`: [`TERMINATED`], [`TRUNCATED`], [`FIRST`], [`SUCCEEDED`] |

use crate::incarnation::Incarnation;
use crate::limits::MAX_ROLLOUT;
use crate::message::Message;
use crate::round::Round;
use crate::row::{Element, RowKind};
use bytemuck::{Pod, Zeroable, cast_slice};
use serde::{Deserialize, Serialize};
use std::ops::Deref;

/// The episode ended in a terminal state: its value is 0.
pub const TERMINATED: u32 = 1;
/// The episode was cut off by a limit: its last state still has a value.
pub const TRUNCATED: u32 = 2;
/// The transition is the first of its episode (or of its actor's life).
pub const FIRST: u32 = 4;
/// The environment says that the episode has succeeded with this transition.
pub const SUCCEEDED: u32 = 8;
/// All flags that a transition can have.
pub const KNOWN_FLAGS: u32 = TERMINATED | TRUNCATED | FIRST | SUCCEEDED;

/// Words that a batch of `count` transitions between states of kind `row` takes.
pub fn words(count: usize, row: impl Into<RowKind>) -> usize {
    count * (2 * row.into().words() + 3)
}

/// What a guide that leads along the mentor's path did, for people to look at; all 0 without one.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable, Serialize, Deserialize)]
pub struct Tally {
    /// Steps that took an action of the guide's.
    pub steps: u64,
    /// Episodes that ended.
    pub episodes: u64,
    /// Those of them that were guided.
    pub guided: u64,
    /// Those of the guided ones that got stuck.
    pub stuck: u64,
    /// Sum over the episodes of the furthest share of the mentor's path that each came to, 0 to 1.
    pub progress: f64,
}

impl Tally {
    /// Adds `other`'s sums.
    pub fn merge(&mut self, other: &Self) {
        self.steps += other.steps;
        self.episodes += other.episodes;
        self.guided += other.guided;
        self.stuck += other.stuck;
        self.progress += other.progress;
    }
}

/// What is sent beside a batch's payload.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct BatchHeader {
    /// Identity of the run: batches of another run are refused.
    pub run: u64,
    /// The round whose orders granted this batch; in lockstep the tick.
    pub round: Round,
    /// The actor's own number of the first transition, counted from 0.
    pub first_seq: u64,
    /// Version of the weights that chose the actions.
    pub weights_version: Round,
    /// Index of the actor, from 0.
    pub actor: u32,
    /// How often this actor has been replaced, from 0.
    pub incarnation: Incarnation,
    /// Transitions in the batch.
    pub count: u32,
    /// Features of an observation.
    pub obs_dim: u32,
    /// [`Element::code`] of their type.
    pub element: u32,
    /// 0.
    pub reserved: u32,
    /// What the guide did meanwhile.
    pub guide: Tally,
}

impl BatchHeader {
    /// The kind of its states; any unknown type counts as `f32`.
    fn row(&self) -> RowKind {
        let element = if self.element == Element::U8.code() { Element::U8 } else { Element::F32 };
        RowKind { dim: self.obs_dim as usize, element }
    }
}

impl Message for BatchHeader {
    const TYPE_NAME: &'static str = "trestle.BatchHeader.v4";
}

/// What a run's transitions can be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Spaces {
    /// Actors of the run.
    pub actors: u32,
    /// Features of a state, and how they are sent.
    pub row: RowKind,
    /// Size of the action space, 1 or more.
    pub n_actions: usize,
}

/// A batch whose header, size or contents cannot be right.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BatchError {
    /// The run has no such actor.
    #[error("batch of actor {actor}; this run has {actors}")]
    Actor {
        /// The sender.
        actor: u32,
        /// Actors of the run.
        actors: u32,
    },
    /// The number of transitions is out of range.
    #[error("batch of actor {actor} has {count} transitions; accepted: 1 to {MAX_ROLLOUT}")]
    Count {
        /// The sender.
        actor: u32,
        /// What its header says.
        count: u32,
    },
    /// The observation size is not the run's.
    #[error("batch of actor {actor} has observations of {found} features; this run's have {expected}")]
    ObsDim {
        /// The sender.
        actor: u32,
        /// What its header says.
        found: u32,
        /// The run's.
        expected: usize,
    },
    /// The type of the features is not the run's.
    #[error("batch of actor {actor} has features of type {found}; this run's have {expected}")]
    Element {
        /// The sender.
        actor: u32,
        /// What its header says.
        found: u32,
        /// The run's.
        expected: u32,
    },
    /// The payload's size does not follow from the header.
    #[error("batch of actor {actor} has {found} words of payload; its header asks for {expected}")]
    Size {
        /// The sender.
        actor: u32,
        /// Words received.
        found: usize,
        /// Words announced.
        expected: usize,
    },
    /// A number in an observation or a reward is NaN or infinite.
    #[error("transition {index} of actor {actor} has a {what} that is not finite")]
    NotFinite {
        /// The sender.
        actor: u32,
        /// Which transition of the batch.
        index: usize,
        /// `observation`, `next observation` or `reward`.
        what: &'static str,
    },
    /// An action outside the action space.
    #[error("transition {index} of actor {actor} has action {action}; accepted: 0 to {last}")]
    Action {
        /// The sender.
        actor: u32,
        /// Which transition of the batch.
        index: usize,
        /// The action.
        action: u32,
        /// The largest action.
        last: usize,
    },
    /// Unknown flag bits.
    #[error("transition {index} of actor {actor} has flags {flags:#x}; accepted: any of {KNOWN_FLAGS:#x}")]
    Flags {
        /// The sender.
        actor: u32,
        /// Which transition of the batch.
        index: usize,
        /// The flags.
        flags: u32,
    },
}

/// One transition of a batch, by reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transition<'a> {
    /// State s_o before the step, `obs_dim` features.
    pub obs: &'a [f32],
    /// State s'_o after the step.
    pub next_obs: &'a [f32],
    /// Action a_o.
    pub action: u32,
    /// Reward r_o.
    pub reward: f32,
    /// [`TERMINATED`] | [`TRUNCATED`] | [`FIRST`] | [`SUCCEEDED`].
    pub flags: u32,
}

impl Transition<'_> {
    /// Whether the episode ended with this step, for whichever reason.
    pub fn ends_episode(&self) -> bool {
        self.flags & (TERMINATED | TRUNCATED) != 0
    }

    /// Whether s' is terminal and so has no value.
    pub fn terminated(&self) -> bool {
        self.flags & TERMINATED != 0
    }

    /// Whether the environment says that the episode has succeeded with this step.
    pub fn succeeded(&self) -> bool {
        self.flags & SUCCEEDED != 0
    }
}

/// A batch in private memory. An actor fills it; one that comes from elsewhere is a [`Checked`] one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Batch {
    /// The header that travels with it.
    pub header: BatchHeader,
    payload: Vec<u32>,
    /// All s and then all s' as `f32`, where the payload has them as bytes; empty otherwise.
    wide: Vec<f32>,
}

impl Batch {
    /// An empty batch with room for `count` transitions between states of kind `row`.
    pub fn with_capacity(count: usize, row: impl Into<RowKind>) -> Self {
        let row = row.into();
        let payload = Vec::with_capacity(words(count, row));
        Self { header: BatchHeader::default(), payload, wide: Vec::with_capacity(wide_len(count, row)) }
    }

    /// Takes `header` and makes the payload fit it, all zero. Allocates only when the batch has never been so large.
    pub fn prepare(&mut self, header: BatchHeader) {
        self.header = header;
        let (count, row) = (self.len(), header.row());
        self.payload.clear();
        self.payload.resize(words(count, row), 0);
        self.wide.clear();
        self.wide.resize(wide_len(count, row), 0.0);
    }

    /// Writes transition `index` (below `header.count`) of a prepared batch. The batch's type
    /// [holds](Element::holds) its features.
    pub fn set(&mut self, index: usize, transition: &Transition<'_>) {
        let (n, row) = (self.len(), self.header.row());
        let (d, w) = (row.dim, row.words());
        let (obs, rest) = self.payload.split_at_mut(n * w);
        let (next, rest) = rest.split_at_mut(n * w);
        row.pack(transition.obs, &mut obs[index * w..][..w]);
        row.pack(transition.next_obs, &mut next[index * w..][..w]);
        if row.element != Element::F32 {
            self.wide[index * d..][..d].copy_from_slice(transition.obs);
            self.wide[(n + index) * d..][..d].copy_from_slice(transition.next_obs);
        }
        rest[index] = transition.action;
        rest[n + index] = transition.reward.to_bits();
        rest[2 * n + index] = transition.flags;
    }

    /// Checks all of it, as [`Checked::receive`] does with what a peer sends.
    ///
    /// # Errors
    /// Sizes or contents that are not of a run with these `spaces`.
    pub fn check(self, spaces: &Spaces) -> Result<Checked<Self>, BatchError> {
        check_header(&self.header, self.payload.len(), spaces)?;
        self.transitions().validate(spaces)?;
        Ok(Checked(self))
    }

    /// Its transitions, by reference.
    pub fn transitions(&self) -> Transitions<'_> {
        let (count, row) = (self.len(), self.header.row());
        let (states, rest) = self.payload.split_at(2 * count * row.words());
        let states = if row.element == Element::F32 { cast_slice(states) } else { &self.wide };
        Transitions { actor: self.header.actor, count, obs_dim: row.dim, states, rest }
    }

    /// Number of transitions.
    pub fn len(&self) -> usize {
        self.header.count as usize
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.header.count == 0
    }

    /// Features of an observation.
    pub fn obs_dim(&self) -> usize {
        self.header.obs_dim as usize
    }

    /// The payload as it travels.
    pub fn payload(&self) -> &[u32] {
        &self.payload
    }

    /// Transition `index`, below [`Batch::len`].
    pub fn transition(&self, index: usize) -> Transition<'_> {
        self.transitions().get(index)
    }
}

/// Consecutive transitions of one actor, wherever their memory is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transitions<'a> {
    /// Index of the actor, from 0.
    pub actor: u32,
    count: usize,
    obs_dim: usize,
    /// All s, then all s'.
    states: &'a [f32],
    /// Actions, rewards, flags.
    rest: &'a [u32],
}

impl<'a> Transitions<'a> {
    /// The `count` transitions in `payload`, checked. States of one byte are copied to `wide` as `f32`.
    ///
    /// # Errors
    /// A size, or the first number, that is not of a run with these `spaces`.
    pub(crate) fn check(
        actor: u32,
        count: u32,
        payload: &'a [u32],
        spaces: &Spaces,
        wide: &'a mut Vec<f32>,
    ) -> Result<Checked<Self>, BatchError> {
        let row = spaces.row;
        let header = BatchHeader {
            actor,
            count,
            obs_dim: row.dim as u32,
            element: row.element.code(),
            ..BatchHeader::default()
        };
        check_header(&header, payload.len(), spaces)?;
        let (states, rest) = payload.split_at(2 * count as usize * row.words());
        let states = if row.element == Element::F32 {
            cast_slice(states)
        } else {
            widen(states, row, wide);
            wide
        };
        let transitions = Self { actor, count: count as usize, obs_dim: row.dim, states, rest };
        transitions.validate(spaces)?;
        Ok(Checked(transitions))
    }

    /// Number of transitions.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Transition `index`, below [`Transitions::len`].
    pub fn get(&self, index: usize) -> Transition<'a> {
        let (n, d) = (self.count, self.obs_dim);
        let [obs, next_obs] = [index * d, (n + index) * d].map(|at| &self.states[at..][..d]);
        let rest = self.rest;
        let (action, reward, flags) = (rest[index], f32::from_bits(rest[n + index]), rest[2 * n + index]);
        Transition { obs, next_obs, action, reward, flags }
    }

    fn validate(&self, spaces: &Spaces) -> Result<(), BatchError> {
        let actor = self.actor;
        for index in 0..self.len() {
            let t = self.get(index);
            let fault = if !t.obs.iter().all(|x| x.is_finite()) {
                Some("observation")
            } else if !t.next_obs.iter().all(|x| x.is_finite()) {
                Some("next observation")
            } else if !t.reward.is_finite() {
                Some("reward")
            } else {
                None
            };
            if let Some(what) = fault {
                return Err(BatchError::NotFinite { actor, index, what });
            }
            if t.action as usize >= spaces.n_actions {
                return Err(BatchError::Action {
                    actor,
                    index,
                    action: t.action,
                    last: spaces.n_actions - 1,
                });
            }
            if t.flags & !KNOWN_FLAGS != 0 {
                return Err(BatchError::Flags { actor, index, flags: t.flags });
            }
        }
        Ok(())
    }
}

/// Transitions of which everything has been checked against a run's [`Spaces`]: sizes, actor, actions, flags, and that all
/// numbers are finite. Only this module makes one, so nobody further inside needs to check again.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Checked<T>(T);

impl<T> Deref for Checked<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.0
    }
}

impl Checked<Batch> {
    /// An empty batch with room for `count` transitions between states of kind `row`.
    pub fn with_capacity(count: usize, row: impl Into<RowKind>) -> Self {
        Self(Batch::with_capacity(count, row))
    }

    /// Copies what a peer sent and checks all of it. On an error the batch is empty.
    ///
    /// # Errors
    /// Sizes or contents that are not of a run with these `spaces`.
    pub fn receive(
        &mut self,
        header: BatchHeader,
        payload: &[u32],
        spaces: &Spaces,
    ) -> Result<(), BatchError> {
        self.0.prepare(BatchHeader::default());
        check_header(&header, payload.len(), spaces)?;
        self.0.header = header;
        self.0.payload.extend_from_slice(payload);
        let (count, row) = (self.0.len(), spaces.row);
        if row.element != Element::F32 {
            widen(&payload[..2 * count * row.words()], row, &mut self.0.wide);
        }
        let sound = self.0.transitions().validate(spaces);
        if sound.is_err() {
            self.0.prepare(BatchHeader::default());
        }
        sound
    }

    /// Its transitions, by reference.
    pub fn transitions(&self) -> Checked<Transitions<'_>> {
        Checked(self.0.transitions())
    }

    /// The batch, to be written again.
    pub fn into_inner(self) -> Batch {
        self.0
    }
}

/// Numbers of all states of `count` transitions beside the payload.
fn wide_len(count: usize, row: RowKind) -> usize {
    if row.element == Element::F32 { 0 } else { 2 * count * row.dim }
}

/// Puts the states of kind `row` in `words` into `wide`, in place of its old contents.
fn widen(words: &[u32], row: RowKind, wide: &mut Vec<f32>) {
    wide.clear();
    wide.resize(words.len() / row.words() * row.dim, 0.0);
    let states = words.chunks_exact(row.words()).zip(wide.chunks_exact_mut(row.dim));
    states.for_each(|(words, wide)| row.row(words).write(wide));
}

fn check_header(header: &BatchHeader, found: usize, spaces: &Spaces) -> Result<(), BatchError> {
    let BatchHeader { actor, count, obs_dim, element, .. } = *header;
    if actor >= spaces.actors {
        return Err(BatchError::Actor { actor, actors: spaces.actors });
    }
    if count == 0 || count > MAX_ROLLOUT {
        return Err(BatchError::Count { actor, count });
    }
    if obs_dim as usize != spaces.row.dim {
        return Err(BatchError::ObsDim { actor, found: obs_dim, expected: spaces.row.dim });
    }
    if element != spaces.row.element.code() {
        return Err(BatchError::Element { actor, found: element, expected: spaces.row.element.code() });
    }
    let expected = words(count as usize, spaces.row);
    if found != expected { Err(BatchError::Size { actor, found, expected }) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    const ROW: RowKind = RowKind { dim: 2, element: Element::F32 };
    const SPACES: Spaces = Spaces { actors: 2, row: ROW, n_actions: 4 };

    fn sample(count: u32, obs_dim: u32) -> Batch {
        let mut batch = Batch::default();
        batch.prepare(BatchHeader { count, obs_dim, ..BatchHeader::default() });
        for i in 0..count as usize {
            let obs: Vec<f32> = (0..obs_dim).map(|k| (i * 100) as f32 + k as f32).collect();
            let next: Vec<f32> = obs.iter().map(|x| x + 0.5).collect();
            let flags = if i == 0 { FIRST } else { 0 };
            batch.set(
                i,
                &Transition { obs: &obs, next_obs: &next, action: i as u32 % 4, reward: -(i as f32), flags },
            );
        }
        batch
    }

    #[test]
    fn what_is_sent_arrives() {
        let sent = sample(5, 3);
        let mut got = Checked::<Batch>::default();
        let spaces = Spaces { row: 3.into(), ..SPACES };
        got.receive(sent.header, sent.payload(), &spaces).unwrap();
        assert_eq!(*got, sent);
        assert_eq!(sent.clone().check(&spaces).unwrap(), got);
        let last = got.transition(4);
        assert_eq!(last.obs, [400.0, 401.0, 402.0]);
        assert_eq!(last.next_obs, [400.5, 401.5, 402.5]);
        assert_eq!((last.action, last.reward, last.flags), (0, -4.0, 0));
    }

    #[test]
    fn each_fault_is_named() {
        let sent = sample(2, 2);
        let mut got = Checked::<Batch>::default();
        let mut check = |edit: &dyn Fn(&mut BatchHeader, &mut Vec<u32>)| {
            let (mut header, mut payload) = (sent.header, sent.payload().to_vec());
            edit(&mut header, &mut payload);
            let message = got.receive(header, &payload, &SPACES).unwrap_err().to_string();
            assert!(got.is_empty() && got.payload().is_empty());
            if (header.obs_dim, header.element) == (2, 0) {
                let mut wide = Vec::new();
                let part = Transitions::check(header.actor, header.count, &payload, &SPACES, &mut wide);
                assert_eq!(part.unwrap_err().to_string(), message);
            }
            message
        };
        assert!(check(&|h, _| h.actor = 2).contains("actor 2; this run has 2"));
        assert!(check(&|h, _| h.count = 0).contains("0 transitions"));
        assert!(check(&|h, _| h.count = 1 << 20).contains("1048576 transitions"));
        assert!(check(&|h, _| h.obs_dim = 9).contains("9 features"));
        assert!(check(&|h, _| h.element = 1).contains("of type 1"));
        assert!(check(&|_, p| _ = p.pop()).contains("13 words"));
        assert!(check(&|_, p| p[0] = f32::NAN.to_bits()).contains("observation that is not finite"));
        assert!(check(&|_, p| p[5] = f32::INFINITY.to_bits()).contains("next observation"));
        assert!(check(&|_, p| p[8] = 4).contains("action 4"));
        assert!(check(&|_, p| p[10] = f32::NAN.to_bits()).contains("reward"));
        assert!(check(&|_, p| p[13] = 64).contains("flags 0x40"));
    }

    proptest! {
        /// The same transitions as bytes and as `f32`: a quarter of the words, and the same numbers.
        #[test]
        fn bytes_give_the_numbers_that_words_give(
            states in prop::collection::vec(prop::array::uniform5(any::<u8>()), 2..12),
        ) {
            let states: Vec<[f32; 5]> = states.iter().map(|state| state.map(f32::from)).collect();
            let count = (states.len() - 1) as u32;
            let [wide, bytes] = [Element::F32, Element::U8].map(|element| {
                let header =
                    BatchHeader { count, obs_dim: 5, element: element.code(), ..BatchHeader::default() };
                let mut batch = Batch::default();
                batch.prepare(header);
                for (i, pair) in states.windows(2).enumerate() {
                    let (obs, next_obs) = (&pair[0], &pair[1]);
                    batch.set(i, &Transition { obs, next_obs, action: 1, reward: 0.5, flags: 0 });
                }
                let spaces = Spaces { row: RowKind { dim: 5, element }, ..SPACES };
                let (mut got, mut scratch) = (Checked::<Batch>::default(), vec![7.0]);
                got.receive(batch.header, batch.payload(), &spaces).unwrap();
                assert_eq!(*got, batch);
                let part = Transitions::check(0, count, batch.payload(), &spaces, &mut scratch).unwrap();
                assert_eq!(part, got.transitions());
                got
            });
            prop_assert_eq!(bytes.payload().len(), words(count as usize, 2));
            for i in 0..count as usize {
                prop_assert_eq!(bytes.transition(i), wide.transition(i));
            }
        }

        #[test]
        fn arbitrary_bytes_never_panic(
            header in any::<[u8; std::mem::size_of::<BatchHeader>()]>(),
            payload in proptest::collection::vec(any::<u32>(), 0..64),
        ) {
            let header: BatchHeader = bytemuck::pod_read_unaligned(&header);
            let _ = Checked::<Batch>::default().receive(header, &payload, &SPACES);
        }
    }
}
