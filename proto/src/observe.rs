//! `mentor/observe`: the learner hands each round's batches on, in its replay's order, and gets back, for every
//! transition, a similar mentor transition or none, and the annotations that changed.
//!
//! Request payload for [`OBSERVE`] and [`REBUILD`], one part after the other: the actor, the number of transitions, and
//! a batch's payload ([`crate::batch`]). For [`RESTORE`]: annotation records ([`crate::annotation`]).
//!
//! Answer payload to [`OBSERVE`], one part after the other: for each transition an index of a mentor transition, or
//! [`NONE`]; the number of records; and the annotation records that this part changed. So the learner can take the parts
//! over one by one, as if it had asked about each of them alone.

use crate::NONE;
use crate::batch::{self, Batch, BatchError, Checked, Spaces, Transitions};
use crate::limits::MAX_ROLLOUT;
use crate::message::Message;
use crate::round::Round;
use crate::row::RowKind;
use bytemuck::{Pod, Zeroable};

/// Take the transitions in, infer actions, look for bridges, and answer with mentor indices.
pub const OBSERVE: u32 = 1;
/// Take the transitions in as history alone: what an earlier process had already inferred from them is restored
/// separately. Used when a run is resumed.
pub const REBUILD: u32 = 2;
/// Replace annotations by those of a checkpoint.
pub const RESTORE: u32 = 3;

/// Words in front of a part's batch.
pub const PART_WORDS: usize = 2;

/// What is sent beside a request.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct ObserveRequest {
    /// Identity of the run.
    pub run: u64,
    /// The round that the batches belong to, for logs.
    pub round: Round,
    /// Position of the first transition in the run's one history, counted from 0; must be where the last ended.
    pub first_index: u64,
    /// One of the constants of this module.
    pub op: u32,
    /// Parts of the payload, or records.
    pub count: u32,
    /// Features of an observation.
    pub obs_dim: u32,
    /// 0.
    pub reserved: u32,
}

impl Message for ObserveRequest {
    const TYPE_NAME: &'static str = "trestle.ObserveRequest.v2";
}

/// What is sent beside an answer.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct ObserveAnswer {
    /// The request's `first_index`.
    pub first_index: u64,
    /// 0, or a fault: one of [`crate::query::STATUS`]' positions.
    pub status: u32,
    /// Searches for bridges that met their limit.
    pub cut_short: u32,
}

impl Message for ObserveAnswer {
    const TYPE_NAME: &'static str = "trestle.ObserveAnswer.v2";
}

/// One part of a request: consecutive transitions of one actor, which follow upon each other in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part<'a> {
    /// The actor.
    pub actor: u32,
    /// Its transitions.
    pub count: u32,
    /// They themselves, as a batch's payload.
    pub payload: &'a [u32],
}

impl<'a> Part<'a> {
    /// The part that `batch` makes.
    pub fn of(batch: &'a Batch) -> Self {
        Self { actor: batch.header.actor, count: batch.header.count, payload: batch.payload() }
    }

    /// What stands in front of the part's payload.
    pub fn header(&self) -> [u32; PART_WORDS] {
        [self.actor, self.count]
    }

    /// Words of the part as it travels.
    pub fn words(&self) -> usize {
        PART_WORDS + self.payload.len()
    }

    /// Takes the first part off `words`; none where they do not hold a whole one of 1 to [`MAX_ROLLOUT`] transitions
    /// between states of kind `row`.
    pub fn take(words: &mut &'a [u32], row: impl Into<RowKind>) -> Option<Self> {
        let (&[actor, count], rest) = words.split_first_chunk()?;
        if !(1..=MAX_ROLLOUT).contains(&count) {
            return None;
        }
        let (payload, rest) = rest.split_at_checked(batch::words(count as usize, row))?;
        *words = rest;
        Some(Self { actor, count, payload })
    }

    /// Its transitions, where they lie, checked. States of one byte are copied to `wide` as `f32`.
    ///
    /// # Errors
    /// The first number that is not of a run with these `spaces`.
    pub fn check<'w>(
        &self,
        spaces: &Spaces,
        wide: &'w mut Vec<f32>,
    ) -> Result<Checked<Transitions<'w>>, BatchError>
    where
        'a: 'w,
    {
        Transitions::check(self.actor, self.count, self.payload, spaces, wide)
    }
}

/// An answer that cannot be right.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ObserveError {
    /// The payload is not what the parts of the request ask for.
    #[error("answer of the mentor-server has {found} words; its parts ask for {expected}")]
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

/// The answer to one part.
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

    /// Appends the answer, whose annotation records have `record` words each, to `out` as it travels.
    pub fn encode(&self, record: usize, out: &mut Vec<u32>) {
        out.extend_from_slice(&self.mentor);
        out.push((self.changed.len() / record) as u32);
        out.extend_from_slice(&self.changed);
    }

    /// Copies what a peer answered to a part of `count` transitions, takes it off `words`, and checks sizes and indices
    /// (records, of `record` words each, are checked where they are applied).
    fn receive(
        &mut self,
        words: &mut &[u32],
        count: usize,
        record: usize,
        mentor_len: usize,
    ) -> Result<(), ObserveError> {
        let found = words.len();
        let size = |expected| ObserveError::Size { found, expected };
        let (mentor, rest) = words.split_at_checked(count).ok_or(size(count + 1))?;
        let (&changed, rest) = rest.split_first().ok_or(size(count + 1))?;
        let changed = (changed as usize).saturating_mul(record);
        let (changed, rest) =
            rest.split_at_checked(changed).ok_or(size(changed.saturating_add(count + 1)))?;
        *words = rest;
        self.clear();
        self.mentor.extend_from_slice(mentor);
        self.changed.extend_from_slice(changed);
        match self.mentor.iter().find(|&&j| j != NONE && j as usize >= mentor_len) {
            Some(&index) => Err(ObserveError::Index { index, len: mentor_len }),
            None => Ok(()),
        }
    }
}

/// The answers to the parts of one request, in their order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Answers {
    parts: Vec<Observed>,
    len: usize,
}

impl Answers {
    /// The answers; none before the first request.
    pub fn parts(&self) -> &[Observed] {
        &self.parts[..self.len]
    }

    /// Copies the answer to a request with `counts` transitions a part, and checks it as [`Observed`] says. Annotation records have
    /// `record` words each. Keeps its memory from one answer to the next.
    ///
    /// # Errors
    /// Sizes that are not those of the request, or indices outside the demonstration. No part counts then.
    pub fn receive(
        &mut self,
        answer: &ObserveAnswer,
        mut payload: &[u32],
        counts: impl Iterator<Item = usize>,
        record: usize,
        mentor_len: usize,
    ) -> Result<(), ObserveError> {
        self.len = 0;
        let mut len = 0;
        for count in counts {
            if self.parts.len() == len {
                self.parts.push(Observed::default());
            }
            self.parts[len].receive(&mut payload, count, record, mentor_len)?;
            len += 1;
        }
        if !payload.is_empty() {
            return Err(ObserveError::Size { found: payload.len(), expected: 0 });
        }
        if let Some(last) = self.parts[..len].last_mut() {
            last.cut_short = answer.cut_short;
        }
        self.len = len;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Words of an annotation record.
    const RECORD: usize = 12;

    fn received(words: &[u32], counts: &[usize]) -> Result<Vec<Vec<u32>>, ObserveError> {
        let mut answers = Answers::default();
        let counts = counts.iter().copied();
        answers.receive(&ObserveAnswer::default(), words, counts, RECORD, 4)?;
        Ok(answers.parts().iter().map(|part| part.mentor.clone()).collect())
    }

    #[test]
    fn sizes_and_indices_are_checked() {
        assert_eq!(received(&[3, NONE, 0, 1, 0], &[2, 1]), Ok(vec![vec![3, NONE], vec![1]]));
        assert_eq!(received(&[], &[]), Ok(Vec::new()));
        assert!(matches!(received(&[4, NONE, 0], &[2]), Err(ObserveError::Index { index: 4, .. })));
        assert!(matches!(received(&[3], &[2]), Err(ObserveError::Size { .. })));
        assert!(matches!(received(&[3, 2], &[2]), Err(ObserveError::Size { .. })));
        assert!(matches!(received(&[3, 2, u32::MAX], &[2]), Err(ObserveError::Size { .. })));
        assert!(matches!(received(&[3, 0, 7], &[1]), Err(ObserveError::Size { .. })));
    }

    #[test]
    fn an_answer_survives_the_journey() {
        let record = vec![9; RECORD];
        let parts = [
            Observed { mentor: vec![1, 2], changed: record.clone(), cut_short: 0 },
            Observed { mentor: vec![NONE], changed: Vec::new(), cut_short: 5 },
        ];
        let mut words = Vec::new();
        parts.iter().for_each(|part| part.encode(RECORD, &mut words));
        let mut answers = Answers::default();
        let header = ObserveAnswer { cut_short: 5, ..ObserveAnswer::default() };
        assert_eq!(answers.receive(&header, &words, [2, 1].into_iter(), RECORD, 4), Ok(()));
        assert_eq!(answers.parts(), parts);
    }

    #[test]
    fn parts_are_taken_off_one_by_one() {
        let payload = vec![7; batch::words(3, 2)];
        let part = Part { actor: 5, count: 3, payload: &payload };
        let words = [&part.header(), part.payload].concat();
        let both = [&words[..], &words[..]].concat();
        let mut rest = &both[..];
        assert_eq!(Part::take(&mut rest, 2), Some(part));
        assert_eq!(Part::take(&mut rest, 2), Some(part));
        assert_eq!(Part::take(&mut rest, 2), None);
        for faulty in [&words[..4], &[1, 0], &[1, MAX_ROLLOUT + 1], &[1]] {
            let mut rest = faulty;
            assert_eq!(Part::take(&mut rest, 2), None, "{faulty:?}");
        }
    }
}
