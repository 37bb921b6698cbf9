//! How large the messages of a run are.

use trestle_proto::acting::{Lengths, Rooms};
use trestle_proto::batch::{self, Spaces};
use trestle_proto::config::Mode;
use trestle_proto::experiment::Experiment;
use trestle_proto::limits::{HISTORY_WORDS, MAX_QUERY_ROWS, TRANSITIONS_BUFFER};
use trestle_proto::mentor::transition_words;
use trestle_proto::observe::PART_WORDS;

/// Shared memory that the buffered batches of one actor may take, bytes; fewer are buffered if they are larger.
const TRANSITIONS_BYTES: usize = 32 << 20;

/// The sizes of a run's messages, derived from its experiment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Sizes {
    /// Actors.
    pub(super) actors: usize,
    /// Features of an observation.
    pub(super) obs_dim: usize,
    /// What transitions can be.
    pub(super) spaces: Spaces,
    /// Units of the network's layers.
    pub(super) network: Vec<u32>,
    /// Words of a batch.
    pub(super) batch_words: usize,
    /// Entries of what actors act with.
    pub(super) acting: Lengths,
    /// Options and own paths that they may get beside.
    pub(super) rooms: Rooms,
    /// Words of an annotation record.
    pub(super) record_words: usize,
    /// Transitions of the demonstration; 0 without a mentor.
    pub(super) mentor_len: usize,
    /// Batches of an actor that may be on their way.
    pub(super) window: usize,
    /// Whether a process that dies is replaced while the others go on: in free mode.
    pub(super) replaces: bool,
}

impl Sizes {
    /// The sizes of the messages of `experiment`'s run.
    pub(super) fn of(experiment: &Experiment) -> Self {
        let network = experiment.sizes();
        Self {
            actors: experiment.config.run.actors as usize,
            obs_dim: experiment.spec.obs_dim(),
            spaces: experiment.spaces(),
            network: network.into_iter().map(|n| n as u32).collect(),
            batch_words: batch::words(experiment.config.run.rollout as usize, experiment.spec.row()),
            acting: experiment.acting(),
            rooms: experiment.rooms(),
            record_words: experiment.record_words(),
            mentor_len: experiment.mentor_len(),
            window: experiment.window() as usize,
            replaces: experiment.config.run.mode == Mode::Free,
        }
    }

    /// Words of what actors act with, at most.
    pub(super) fn acting_words(&self) -> usize {
        self.acting.words() + self.rooms.words()
    }

    /// Batches of an actor that may wait for the learner.
    pub(super) fn transitions_buffer(&self) -> usize {
        if self.replaces {
            return self.window;
        }
        (TRANSITIONS_BYTES / (4 * self.batch_words)).clamp(2, TRANSITIONS_BUFFER)
    }

    /// Words of the largest request to `mentor/observe`.
    pub(super) fn observe_request_words(&self) -> usize {
        let history = HISTORY_WORDS.max(PART_WORDS + batch::words(1, self.spaces.row));
        (self.actors * (self.batch_words + PART_WORDS))
            .max(self.annotation_rows() * self.record_words)
            .max(history)
    }

    /// Words of an answer of `mentor/observe` for which room is made in advance; a larger one makes the memory grow.
    pub(super) fn observe_answer_words(&self) -> usize {
        let rollout = self.batch_words / batch::words(1, self.spaces.row);
        self.actors * (rollout + 1) + self.annotation_rows() * self.record_words
    }

    /// Words of the largest answer of `mentor/query`.
    pub(super) fn query_answer_words(&self) -> usize {
        let row = self.record_words.max(transition_words(self.obs_dim)).max(8);
        self.annotation_rows() * row
    }

    /// Annotations or mentor transitions that travel in one message.
    pub(super) fn annotation_rows(&self) -> usize {
        self.mentor_len.clamp(1, MAX_QUERY_ROWS as usize)
    }

    /// The largest of the run's files in shared memory, bytes, iceoryx2's own books aside.
    pub(super) fn largest_segment_bytes(&self) -> u64 {
        let batches = (self.transitions_buffer() + 2) * self.batch_words * 4;
        let mentor = match self.mentor_len {
            0 => 0,
            _ => self.observe_request_words().max(self.observe_answer_words()).max(self.query_answer_words()),
        };
        batches.max(16 * self.acting_words()).max(16 * mentor) as u64
    }

    /// Shared memory that the run will take, bytes, to within its fixed costs of some 100 kB a service.
    pub(super) fn shared_memory_bytes(&self) -> u64 {
        let batches = self.actors * (self.transitions_buffer() + 2) * self.batch_words * 4;
        let weights = 4 * self.acting_words() * 4;
        let mentor = if self.mentor_len == 0 {
            0
        } else {
            4 * 4 * (self.observe_request_words() + self.observe_answer_words() + self.query_answer_words())
        };
        const FIXED: usize = 8 << 20;
        (batches + weights + mentor + FIXED) as u64
    }
}
