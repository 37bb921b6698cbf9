//! What actors act with: the Q-network's weights, and whatever guides their exploration. One value, which travels in one
//! message, so that an actor never has parts of different moments.
//!
//! The payload of the message is, in 32-bit words: the weights, the table of known actions, the parameters of the guiding policy,
//! the options ([`Options`]), the length of each own path, and their places. Parameters of a network are, layer by layer, the weights
//! \[in\]\[out\] row-major and then the bias \[out\], all `f32`.

use crate::annotation::Further;
use crate::limits::MAX_SIZES;
use crate::message::Message;
use crate::round::Round;
use bytemuck::{Pod, Zeroable, cast_slice, cast_slice_mut};
use serde::{Deserialize, Serialize};
use std::fmt;

/// What actors act with.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Acting {
    /// Parameters of the Q-network.
    pub weights: Vec<f32>,
    /// For each mentor transition the action that is known for it, or [`crate::NONE`]; empty unless exploration is guided by
    /// known actions.
    pub known: Vec<u32>,
    /// Parameters of the policy π of learned bridges; empty without them.
    pub policy: Vec<f32>,
    /// How bridges go on whose first actions are known; empty unless whole bridges guide exploration.
    pub options: Options,
    /// Paths of the observer's own, along which learned bridges lead rather than along the mentor's.
    pub own: OwnPlaces,
}

/// Paths as the places that they pass, one path after the other.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OwnPlaces {
    /// Places of each path, 2 or more.
    pub lengths: Vec<u32>,
    /// All places, row-major, of as many numbers each as goals have features.
    pub places: Vec<f32>,
}

/// As derived, but for `clone_from`, which keeps the memory.
impl Clone for OwnPlaces {
    fn clone(&self) -> Self {
        Self { lengths: self.lengths.clone(), places: self.places.clone() }
    }

    fn clone_from(&mut self, other: &Self) {
        self.lengths.clone_from(&other.lengths);
        self.places.clone_from(&other.places);
    }
}

/// Bridges as options: what follows upon the known action of a mentor transition, step by step.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// The mentor transitions with an option, in ascending order.
    pub of: Vec<u32>,
    /// For each of them, where its steps end in the list of all steps.
    pub ends: Vec<u32>,
    /// The action of each step.
    pub actions: Vec<u32>,
    /// The state in which each step is to be taken, row-major.
    pub states: Vec<f32>,
}

/// As derived, but for `clone_from`, which keeps the memory.
impl Clone for Options {
    fn clone(&self) -> Self {
        let Self { of, ends, actions, states } = self;
        Self { of: of.clone(), ends: ends.clone(), actions: actions.clone(), states: states.clone() }
    }

    fn clone_from(&mut self, other: &Self) {
        self.of.clone_from(&other.of);
        self.ends.clone_from(&other.ends);
        self.actions.clone_from(&other.actions);
        self.states.clone_from(&other.states);
    }
}

impl Options {
    /// Forgets all of them.
    pub fn clear(&mut self) {
        self.of.clear();
        self.ends.clear();
        self.actions.clear();
        self.states.clear();
    }

    /// Appends the option of mentor transition `j`, which is above all others, with one step or more.
    pub fn push(&mut self, j: u32, steps: Further<'_>) {
        self.actions.extend_from_slice(steps.actions);
        self.states.extend_from_slice(steps.states);
        self.of.push(j);
        self.ends.push(self.actions.len() as u32);
    }

    /// The option of mentor transition `j`, if it has one.
    pub fn get(&self, j: u32) -> Option<Further<'_>> {
        let at = self.of.binary_search(&j).ok()?;
        let from = at.checked_sub(1).map_or(0, |before| self.ends[before] as usize);
        let steps = from..self.ends[at] as usize;
        let dim = self.states.len() / self.actions.len();
        Some(Further {
            states: &self.states[steps.start * dim..steps.end * dim],
            actions: &self.actions[steps],
        })
    }

    /// Words in a message.
    fn words(&self) -> usize {
        self.of.len() + self.ends.len() + self.actions.len() + self.states.len()
    }
}

/// How many options a message may have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OptionRoom {
    /// Mentor transitions; 0 without options.
    pub mentor: usize,
    /// Steps of one option at most.
    pub steps: usize,
    /// Features of a state.
    pub obs_dim: usize,
    /// Actions of the environment.
    pub n_actions: usize,
}

impl OptionRoom {
    /// Words of all options at most.
    pub fn words(&self) -> usize {
        self.mentor.saturating_mul(2 + self.steps * (1 + self.obs_dim))
    }

    /// Words of `options` options with so many `steps` together; none if they do not fit in.
    fn of(&self, options: u32, steps: u32) -> Option<usize> {
        let (options, steps) = (options as usize, steps as usize);
        let fits = options <= self.mentor && steps <= options * self.steps;
        fits.then_some(2 * options + steps * (1 + self.obs_dim))
    }

    /// Whether `options` fit in, each of a mentor transition of its own, with whole steps of actions and finite states.
    pub fn holds(&self, options: &Options) -> bool {
        let Options { of, ends, actions, states } = options;
        let starts = std::iter::once(&0).chain(ends);
        of.len() == ends.len()
            && of.is_sorted_by(|a, b| a < b)
            && of.last().is_none_or(|&j| (j as usize) < self.mentor)
            && starts.zip(ends).all(|(&start, &end)| start < end && (end - start) as usize <= self.steps)
            && ends.last().map_or(0, |&end| end as usize) == actions.len()
            && actions.iter().all(|&action| (action as usize) < self.n_actions)
            && states.len() == actions.len() * self.obs_dim
            && states.iter().all(|x| x.is_finite())
    }
}

/// How large the parts of a message may be that are not always as long.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rooms {
    /// Options.
    pub options: OptionRoom,
    /// Own paths.
    pub own: Room,
}

impl Rooms {
    /// Words of all of them at most.
    pub fn words(&self) -> usize {
        self.options.words() + self.own.words()
    }
}

/// How many own paths a message may have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Room {
    /// Numbers of a place; 0 without own paths.
    pub dim: usize,
    /// Paths at most.
    pub paths: usize,
    /// Places of one path at most.
    pub places: usize,
}

impl Room {
    /// Words of all paths at most.
    pub fn words(&self) -> usize {
        self.paths * (1 + self.places * self.dim)
    }

    /// Whether `own` fits in, with whole paths of finite numbers.
    pub fn holds(&self, own: &OwnPlaces) -> bool {
        let places: usize = own.lengths.iter().map(|&length| length as usize).sum();
        own.lengths.len() <= self.paths
            && own.lengths.iter().all(|&length| (2..=self.places).contains(&(length as usize)))
            && own.places.len() == places * self.dim
            && own.places.iter().all(|x| x.is_finite())
    }
}

/// Entries of each part of an [`Acting`] that has always as many.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lengths {
    /// Parameters of the Q-network.
    pub weights: usize,
    /// Known actions.
    pub known: usize,
    /// Parameters of π.
    pub policy: usize,
}

impl Lengths {
    /// Words of these parts.
    pub fn words(&self) -> usize {
        self.weights + self.known + self.policy
    }
}

impl fmt::Display for Lengths {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { weights, known, policy } = self;
        write!(f, "{weights} weights, {known} known actions and {policy} parameters of a guiding policy")
    }
}

/// As derived, but for `clone_from`, which allocates nothing where the lengths are the same.
impl Clone for Acting {
    fn clone(&self) -> Self {
        let Self { weights, known, policy, options, own } = self;
        Self {
            weights: weights.clone(),
            known: known.clone(),
            policy: policy.clone(),
            options: options.clone(),
            own: own.clone(),
        }
    }

    fn clone_from(&mut self, other: &Self) {
        self.weights.clone_from(&other.weights);
        self.known.clone_from(&other.known);
        self.policy.clone_from(&other.policy);
        self.options.clone_from(&other.options);
        self.own.clone_from(&other.own);
    }
}

impl Acting {
    /// All zero, with parts of these lengths, no option and no own path.
    pub fn zeros(lengths: Lengths) -> Self {
        Self {
            weights: vec![0.0; lengths.weights],
            known: vec![0; lengths.known],
            policy: vec![0.0; lengths.policy],
            options: Options::default(),
            own: OwnPlaces::default(),
        }
    }

    /// Weights alone.
    pub fn of_weights(weights: Vec<f32>) -> Self {
        Self { weights, ..Self::default() }
    }

    /// Words of the message's payload.
    pub fn words(&self) -> usize {
        self.lengths().words() + self.options.words() + self.own.lengths.len() + self.own.places.len()
    }

    /// The length of each part but for options and own paths.
    pub fn lengths(&self) -> Lengths {
        Lengths { weights: self.weights.len(), known: self.known.len(), policy: self.policy.len() }
    }

    /// Writes the message's payload into `out`, which has [`Acting::words`] words.
    ///
    /// # Panics
    /// If it has not.
    pub fn write(&self, out: &mut [u32]) {
        let (weights, rest) = out.split_at_mut(self.weights.len());
        let (known, rest) = rest.split_at_mut(self.known.len());
        let (policy, rest) = rest.split_at_mut(self.policy.len());
        let (of, rest) = rest.split_at_mut(self.options.of.len());
        let (ends, rest) = rest.split_at_mut(self.options.ends.len());
        let (actions, rest) = rest.split_at_mut(self.options.actions.len());
        let (states, rest) = rest.split_at_mut(self.options.states.len());
        let (lengths, places) = rest.split_at_mut(self.own.lengths.len());
        weights.copy_from_slice(cast_slice(&self.weights));
        known.copy_from_slice(&self.known);
        policy.copy_from_slice(cast_slice(&self.policy));
        of.copy_from_slice(&self.options.of);
        ends.copy_from_slice(&self.options.ends);
        actions.copy_from_slice(&self.options.actions);
        states.copy_from_slice(cast_slice(&self.options.states));
        lengths.copy_from_slice(&self.own.lengths);
        places.copy_from_slice(cast_slice(&self.own.places));
    }

    /// Copies a payload with this one's lengths, and behind these as many options and own paths as `header` says. States have
    /// `obs_dim` features.
    fn read(&mut self, payload: &[u32], header: &ActingHeader, obs_dim: usize) {
        let [options, steps, paths] = [header.options, header.steps, header.paths].map(|n| n as usize);
        let (weights, rest) = payload.split_at(self.weights.len());
        let (known, rest) = rest.split_at(self.known.len());
        let (policy, rest) = rest.split_at(self.policy.len());
        let (of, rest) = rest.split_at(options);
        let (ends, rest) = rest.split_at(options);
        let (actions, rest) = rest.split_at(steps);
        let (states, rest) = rest.split_at(steps * obs_dim);
        let (lengths, places) = rest.split_at(paths);
        cast_slice_mut(&mut self.weights).copy_from_slice(weights);
        self.known.copy_from_slice(known);
        cast_slice_mut(&mut self.policy).copy_from_slice(policy);
        self.options.clear();
        self.options.of.extend_from_slice(of);
        self.options.ends.extend_from_slice(ends);
        self.options.actions.extend_from_slice(actions);
        self.options.states.extend(states.iter().map(|&word| f32::from_bits(word)));
        self.own.lengths.clear();
        self.own.lengths.extend_from_slice(lengths);
        self.own.places.clear();
        self.own.places.extend(places.iter().map(|&word| f32::from_bits(word)));
    }

    /// CRC-32C of the payload's bytes.
    fn checksum(&self) -> u32 {
        let crc = crc32c::crc32c(cast_slice(&self.weights));
        let crc = crc32c::crc32c_append(crc, cast_slice(&self.known));
        let crc = crc32c::crc32c_append(crc, cast_slice(&self.policy));
        let crc = crc32c::crc32c_append(crc, cast_slice(&self.options.of));
        let crc = crc32c::crc32c_append(crc, cast_slice(&self.options.ends));
        let crc = crc32c::crc32c_append(crc, cast_slice(&self.options.actions));
        let crc = crc32c::crc32c_append(crc, cast_slice(&self.options.states));
        let crc = crc32c::crc32c_append(crc, cast_slice(&self.own.lengths));
        crc32c::crc32c_append(crc, cast_slice(&self.own.places))
    }
}

/// What is sent beside an [`Acting`].
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct ActingHeader {
    /// Identity of the run.
    pub run: u64,
    /// The round after which these weights stood; 0 for the initial ones.
    pub version: Round,
    /// The learner's start that they are of ([`crate::plan::Life::generation`]).
    pub generation: u16,
    /// 0.
    pub reserved: u16,
    /// CRC-32C of the payload's bytes.
    pub checksum: u32,
    /// Entries of the table of known actions.
    pub known: u32,
    /// Parameters of the guiding policy.
    pub policy: u32,
    /// How many of `sizes` are used.
    pub n_sizes: u32,
    /// Own paths.
    pub paths: u32,
    /// Options.
    pub options: u32,
    /// Steps of all options together.
    pub steps: u32,
    /// Units of the Q-network's input, of each hidden layer and of its output.
    pub sizes: [u32; MAX_SIZES],
}

impl Message for ActingHeader {
    const TYPE_NAME: &'static str = "trestle.ActingHeader.v3";
}

/// A message that cannot be acted with.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ActingError {
    /// Another run's.
    #[error("weights are of run {found:016x}; this is run {expected:016x}")]
    Run {
        /// Their run.
        found: u64,
        /// This run.
        expected: u64,
    },
    /// Another network's.
    #[error("weights are of a network {found:?}; this run's is {expected:?}")]
    Sizes {
        /// Sizes in the header.
        found: Vec<u32>,
        /// Sizes of this run.
        expected: Vec<u32>,
    },
    /// Parts of other lengths.
    #[error(
        "a message of {words} words has {known} known actions and {policy} parameters of a guiding policy; this run's have \
         {expected}"
    )]
    Lengths {
        /// Words of the payload.
        words: usize,
        /// Known actions by the header.
        known: u32,
        /// Parameters of the policy by the header.
        policy: u32,
        /// Lengths in this run.
        expected: Lengths,
    },
    /// Options that cannot be this run's.
    #[error(
        "{options} options with {steps} steps; accepted: whole ones in ascending order, with actions of the environment and finite \
         states, {room:?}"
    )]
    Options {
        /// Options.
        options: u32,
        /// Steps of all of them.
        steps: u32,
        /// What is accepted.
        room: OptionRoom,
    },
    /// Own paths that cannot be this run's.
    #[error("own paths have lengths {lengths:?} and {numbers} numbers; accepted: finite ones, {room:?}")]
    Own {
        /// Places of each, the first ones.
        lengths: Vec<u32>,
        /// Numbers of all places.
        numbers: usize,
        /// What is accepted.
        room: Room,
    },
    /// Torn or damaged.
    #[error("weights version {version} have checksum {found:08x}; their header says {expected:08x}")]
    Checksum {
        /// Their version.
        version: Round,
        /// What was computed.
        found: u32,
        /// What was announced.
        expected: u32,
    },
}

impl ActingHeader {
    /// The header of `acting`, whose network has `sizes` (at most [`MAX_SIZES`]).
    pub fn new(run: u64, generation: u16, version: Round, sizes: &[u32], acting: &Acting) -> Self {
        let Lengths { known, policy, .. } = acting.lengths();
        let mut header = Self {
            run,
            version,
            generation,
            checksum: acting.checksum(),
            known: known as u32,
            policy: policy as u32,
            n_sizes: sizes.len() as u32,
            paths: acting.own.lengths.len() as u32,
            options: acting.options.of.len() as u32,
            steps: acting.options.actions.len() as u32,
            ..Self::default()
        };
        header.sizes[..sizes.len()].copy_from_slice(sizes);
        header
    }

    /// Copies what a peer sent into `into`, which has this run's lengths, and checks the copy, whose options and own paths must fit
    /// into `rooms`. A table of known actions is taken as it is: who follows it checks each action.
    ///
    /// # Errors
    /// A payload of another run or network, of other lengths, or a damaged one.
    pub fn receive(
        &self,
        run: u64,
        sizes: &[u32],
        payload: &[u32],
        rooms: &Rooms,
        into: &mut Acting,
    ) -> Result<(), ActingError> {
        if self.run != run {
            return Err(ActingError::Run { found: self.run, expected: run });
        }
        let found = &self.sizes[..(self.n_sizes as usize).min(MAX_SIZES)];
        if found != sizes {
            return Err(ActingError::Sizes { found: found.to_vec(), expected: sizes.to_vec() });
        }
        let expected = into.lengths();
        let own = (self.known as usize, self.policy as usize) == (expected.known, expected.policy);
        let Rooms { options: option_room, own: room } = rooms;
        let no_options =
            ActingError::Options { options: self.options, steps: self.steps, room: *option_room };
        let Some(options) = option_room.of(self.options, self.steps) else { return Err(no_options) };
        let (paths, least) = (self.paths as usize, expected.words() + options);
        let most = least + room.words();
        if !own || paths > room.paths || !(least + paths..=most).contains(&payload.len()) {
            let (words, known, policy) = (payload.len(), self.known, self.policy);
            return Err(ActingError::Lengths { words, known, policy, expected });
        }
        into.read(payload, self, option_room.obs_dim);
        let computed = into.checksum();
        if computed != self.checksum {
            return Err(ActingError::Checksum {
                version: self.version,
                found: computed,
                expected: self.checksum,
            });
        }
        if !option_room.holds(&into.options) {
            into.options.clear();
            return Err(no_options);
        }
        if !room.holds(&into.own) {
            let (lengths, numbers) = (into.own.lengths.clone(), into.own.places.len());
            into.own = OwnPlaces::default();
            return Err(ActingError::Own { lengths, numbers, room: *room });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NONE;

    #[test]
    fn a_message_is_taken_whole_or_not_at_all() {
        let options = OptionRoom { mentor: 3, steps: 2, obs_dim: 2, n_actions: 4 };
        let (sizes, room) = ([1, 2], Rooms { options, own: Room { dim: 2, paths: 2, places: 3 } });
        let acting = Acting {
            weights: vec![0.5, -1.0, 2.0, 3.0],
            known: vec![7, NONE, 0],
            policy: vec![0.25, -8.0],
            options: options_of(&[0, 2], &[1, 3], &[3, 0, 1]),
            own: OwnPlaces { lengths: vec![2, 3], places: vec![0.5; 10] },
        };
        let mut words = vec![0; acting.words()];
        acting.write(&mut words);
        let header = ActingHeader::new(9, 0, 4.into(), &sizes, &acting);
        let mut into = Acting::zeros(acting.lengths());
        assert_eq!(header.receive(9, &sizes, &words, &room, &mut into), Ok(()));
        assert_eq!(into, acting);
        let refused = |header: &ActingHeader, run, sizes: &[u32], words: &[u32]| {
            header.receive(run, sizes, words, &room, &mut Acting::zeros(acting.lengths())).err()
        };
        assert!(matches!(refused(&header, 8, &sizes, &words), Some(ActingError::Run { .. })));
        assert!(matches!(refused(&header, 9, &[2, 1], &words), Some(ActingError::Sizes { .. })));
        let long = [&words[..], &[0; 9]].concat();
        for words in [&words[..23], &long] {
            assert!(matches!(refused(&header, 9, &sizes, words), Some(ActingError::Lengths { .. })));
        }
        assert!(matches!(refused(&header, 9, &sizes, &words[1..]), Some(ActingError::Checksum { .. })));
        // As long in all, but cut at another place.
        let other = ActingHeader { known: 2, policy: 3, ..header };
        assert!(matches!(refused(&other, 9, &sizes, &words), Some(ActingError::Lengths { .. })));
        for at in 0..words.len() {
            let mut words = words.clone();
            words[at] ^= 1 << 20;
            assert!(matches!(refused(&header, 9, &sizes, &words), Some(ActingError::Checksum { .. })));
        }
    }

    /// Options of states with two features.
    fn options_of(of: &[u32], ends: &[u32], actions: &[u32]) -> Options {
        let states = (0..2 * actions.len()).map(|i| i as f32).collect();
        Options { of: of.to_vec(), ends: ends.to_vec(), actions: actions.to_vec(), states }
    }

    #[test]
    fn options_are_found_by_their_mentor_transition() {
        let mut options = Options::default();
        for (j, actions, states) in [(1, &[3][..], &[0.0, 1.0][..]), (4, &[0, 1], &[2.0, 3.0, 4.0, 5.0])] {
            options.push(j, Further { actions, states });
        }
        assert_eq!(options, options_of(&[1, 4], &[1, 3], &[3, 0, 1]));
        assert_eq!(options.get(1), Some(Further { actions: &[3], states: &[0.0, 1.0] }));
        assert_eq!(options.get(4), Some(Further { actions: &[0, 1], states: &[2.0, 3.0, 4.0, 5.0] }));
        assert_eq!((options.get(0), options.get(5), Options::default().get(0)), (None, None, None));
    }

    #[test]
    fn options_must_be_whole_and_fit_in() {
        let options = OptionRoom { mentor: 3, steps: 2, obs_dim: 2, n_actions: 4 };
        let rooms = Rooms { options, ..Rooms::default() };
        let refused = |options: Options| {
            let acting = Acting { options, ..Acting::default() };
            let mut words = vec![0; acting.words()];
            acting.write(&mut words);
            let header = ActingHeader::new(9, 0, 4.into(), &[], &acting);
            let mut into = Acting::default();
            let error = header.receive(9, &[], &words, &rooms, &mut into).err();
            assert!(error.is_none() || into == Acting::default(), "nothing is acted with");
            error.is_some()
        };
        let of = options_of;
        assert!(!refused(of(&[], &[], &[])) && !refused(of(&[0, 1, 2], &[2, 3, 5], &[0, 1, 2, 3, 0])));
        // Out of order, beyond the demonstration, without steps, with too many, or with fewer than there are.
        assert!(refused(of(&[1, 0], &[1, 2], &[0, 0])) && refused(of(&[1, 1], &[1, 2], &[0, 0])));
        assert!(refused(of(&[3], &[1], &[0])) && refused(of(&[0, 1], &[1, 1], &[0])));
        assert!(refused(of(&[0, 1], &[2, 1], &[0, 0])) && refused(of(&[0, 1], &[3, 4], &[0; 4])));
        assert!(refused(of(&[0], &[1], &[0, 0])) && refused(of(&[0], &[2], &[0])));
        // An action that nobody has, and a state that is none.
        assert!(refused(of(&[0], &[1], &[4])));
        assert!(refused(Options { states: vec![0.0, f32::NAN], ..of(&[0], &[1], &[0]) }));
        // More than there may be, by the header alone.
        let header = |options, steps| ActingHeader { options, steps, ..ActingHeader::default() };
        for header in [header(4, 0), header(1, 3), header(u32::MAX, u32::MAX)] {
            let error = header.receive(0, &[], &[], &rooms, &mut Acting::default());
            assert!(matches!(error, Err(ActingError::Options { .. })), "{error:?}");
        }
    }

    #[test]
    fn own_paths_must_be_whole_and_fit_in() {
        let room = Rooms { own: Room { dim: 2, paths: 2, places: 3 }, ..Rooms::default() };
        let refused = |lengths: &[u32], places: &[f32]| {
            let own = OwnPlaces { lengths: lengths.to_vec(), places: places.to_vec() };
            let acting = Acting { own, ..Acting::default() };
            let mut words = vec![0; acting.words()];
            acting.write(&mut words);
            let header = ActingHeader::new(9, 0, 4.into(), &[], &acting);
            header.receive(9, &[], &words, &room, &mut Acting::default()).is_err()
        };
        assert!(!refused(&[], &[]) && !refused(&[3], &[1.0; 6]) && !refused(&[3, 3], &[1.0; 12]));
        assert!(refused(&[1], &[1.0; 2]) && refused(&[4], &[1.0; 8]) && refused(&[2, 2, 2], &[1.0; 12]));
        assert!(refused(&[2], &[1.0; 5]) && refused(&[2], &[1.0, 1.0, f32::NAN, 1.0]));
    }

    #[test]
    fn copying_over_keeps_the_memory() {
        let own = OwnPlaces { lengths: vec![2], places: vec![5.0; 2] };
        let options = options_of(&[1], &[1], &[0]);
        let acting = Acting { weights: vec![1.0; 3], known: vec![2; 2], policy: vec![3.0; 4], options, own };
        let mut copy = Acting::zeros(acting.lengths());
        let before = copy.weights.as_ptr();
        copy.clone_from(&acting);
        assert_eq!((copy.weights.as_ptr(), &copy, &acting.clone()), (before, &acting, &acting));
    }
}
