//! `mentor/observe`: the learner hands each batch on, in its replay's order, and gets back, for every transition, a
//! similar mentor transition or none, and the annotations that changed.
//!
//! Request payload: a batch ([`crate::batch`]) for [`OBSERVE`] and [`REBUILD`], annotation records
//! ([`crate::annotation`]) for [`RESTORE`]. Answer payload: `count` words (an index of a mentor transition, or
//! [`NONE`]), then `changed` annotation records.

use crate::NONE;
use crate::annotation::record_words;
use crate::message::Message;
use bytemuck::{Pod, Zeroable};

/// Take the transitions in, infer actions, look for bridges, and answer with mentor indices.
pub const OBSERVE: u32 = 1;
/// Take the transitions in as history alone: what an earlier process had already inferred from them is restored
/// separately. Used when a run is resumed.
pub const REBUILD: u32 = 2;
/// Replace annotations by those of a checkpoint.
pub const RESTORE: u32 = 3;

/// What is sent beside a request.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct ObserveRequest {
    /// Identity of the run.
    pub run: u64,
    /// The tick that the batch belongs to, for logs.
    pub tick: u64,
    /// Position of the first transition in the run's one history, counted from 0; must be where the last ended.
    pub first_index: u64,
    /// One of the constants of this module.
    pub op: u32,
    /// The actor whose transitions these are: consecutive ones of one actor follow upon each other in time.
    pub actor: u32,
    /// Transitions, or records.
    pub count: u32,
    /// Features of an observation.
    pub obs_dim: u32,
}

impl Message for ObserveRequest {
    const TYPE_NAME: &'static str = "trestle.ObserveRequest.v1";
}

/// What is sent beside an answer.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct ObserveAnswer {
    /// The request's `first_index`.
    pub first_index: u64,
    /// 0, or a fault: one of [`crate::query::STATUS`]' positions.
    pub status: u32,
    /// Mentor indices in the payload.
    pub count: u32,
    /// Annotation records in the payload, after the indices.
    pub changed: u32,
    /// Searches for bridges that met their limit.
    pub cut_short: u32,
}

impl Message for ObserveAnswer {
    const TYPE_NAME: &'static str = "trestle.ObserveAnswer.v1";
}

/// An answer that cannot be right.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ObserveError {
    /// The payload's size does not follow from the header.
    #[error("answer of the mentor-server has {found} words; its header asks for {expected}")]
    Size {
        /// Words received.
        found: usize,
        /// Words announced.
        expected: usize,
    },
    /// An index outside the demonstration.
    #[error("the mentor-server names mentor transition {index}; accepted: below {len}, or none")]
    Index {
        /// The index.
        index: u32,
        /// Number of mentor transitions.
        len: usize,
    },
}

/// An answer in private memory.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Observed {
    /// For each transition the index of a similar mentor transition, or [`NONE`].
    pub mentor: Vec<u32>,
    /// Encoded annotation records that changed ([`crate::annotation`]).
    pub changed: Vec<u32>,
    /// Searches for bridges that met their limit, and so may have missed one.
    pub cut_short: u32,
}

impl Observed {
    /// Forgets the last answer and keeps its memory.
    pub fn clear(&mut self) {
        self.mentor.clear();
        self.changed.clear();
        self.cut_short = 0;
    }

    /// Copies what a peer sent and checks sizes and indices (records are checked where they are applied).
    pub fn receive(
        &mut self,
        answer: &ObserveAnswer,
        payload: &[u32],
        obs_dim: usize,
        mentor_len: usize,
    ) -> Result<(), ObserveError> {
        let (count, changed) = (answer.count as usize, answer.changed as usize);
        let expected = count.saturating_add(changed.saturating_mul(record_words(obs_dim)));
        if payload.len() != expected {
            return Err(ObserveError::Size { found: payload.len(), expected });
        }
        self.clear();
        self.mentor.extend_from_slice(&payload[..count]);
        self.changed.extend_from_slice(&payload[count..]);
        self.cut_short = answer.cut_short;
        match self.mentor.iter().find(|&&j| j != NONE && j as usize >= mentor_len) {
            Some(&index) => Err(ObserveError::Index { index, len: mentor_len }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_indices_are_checked() {
        let answer = ObserveAnswer { count: 2, ..ObserveAnswer::default() };
        let mut got = Observed::default();
        assert_eq!(got.receive(&answer, &[3, NONE], 2, 4), Ok(()));
        assert_eq!(got.mentor, [3, NONE]);
        assert!(matches!(got.receive(&answer, &[4, NONE], 2, 4), Err(ObserveError::Index { index: 4, .. })));
        assert!(matches!(got.receive(&answer, &[4], 2, 4), Err(ObserveError::Size { .. })));
        let many = ObserveAnswer { changed: u32::MAX, count: u32::MAX, ..answer };
        assert!(matches!(got.receive(&many, &[4], 2, 4), Err(ObserveError::Size { .. })));
    }
}
