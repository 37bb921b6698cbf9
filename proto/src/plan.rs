//! The plan of a run: all that a child process needs to know, written by the supervisor into the run's directory before
//! a child starts.

use crate::codec::{self, CodecError, Kind};
use crate::experiment::Experiment;
use crate::round::Round;
use serde::{Deserialize, Serialize};

/// What the frame of an encoded plan says that it is.
pub const PLAN_KIND: Kind = Kind { magic: *b"TRPLAN\0\0", version: 14 };

/// All that a child process needs to know.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunPlan {
    /// Which start of the run's processes it is for.
    pub life: Life,
    /// What they compute.
    pub experiment: Experiment,
}

/// One start of a run's processes, and its place among the others. Nothing that the run computes depends on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Life {
    /// Identity of the run, drawn anew each time it is started or resumed; in the name of its shared memory.
    pub run: u64,
    /// Identity of the run's history, drawn when the run begins anew and kept when it is resumed. With `generation` it tells whose
    /// a checkpoint is.
    pub history: u64,
    /// How many times the learner has been started before in this history: the upper half of the incarnations in free mode.
    pub generation: u16,
    /// Checkpoint to go on from, as the number of its tick.
    pub resume_tick: Option<Round>,
    /// How many times the run, or in free mode one of its processes, has been started again after the death of a process.
    pub restarts: u64,
}

impl RunPlan {
    /// The plan as bytes of a file.
    pub fn encode(&self) -> Result<Vec<u8>, CodecError> {
        codec::encode(PLAN_KIND, self)
    }

    /// The plan in the bytes of a file.
    pub fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        codec::decode(PLAN_KIND, bytes)
    }
}
