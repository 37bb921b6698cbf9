//! Gives a new mentor-server the history that the replay holds, and the annotations that came of it.

use trestle_algorithm::agent::Agent;
use trestle_algorithm::replay::Replay;
use trestle_link::{LearnerLink, LinkError, pulse};
use trestle_proto::batch::{Batch, words};
use trestle_proto::limits::{HISTORY_WORDS, MAX_QUERY_ROWS, MAX_ROLLOUT};
use trestle_proto::observe::{ObserveRequest, PART_WORDS, Part, REBUILD, RESTORE};
use trestle_proto::plan::RunPlan;
use trestle_proto::round::Round;
use trestle_proto::row::RowKind;

/// A request to `mentor/observe` about `count` parts or records.
pub(crate) fn request(
    plan: &RunPlan,
    round: Round,
    first_index: u64,
    op: u32,
    count: usize,
) -> ObserveRequest {
    let (run, count, obs_dim) = (plan.life.run, count as u32, plan.experiment.spec.obs_dim() as u32);
    ObserveRequest { run, round, first_index, op, count, obs_dim, reserved: 0 }
}

/// Gives a mentor-server that knows nothing the state that came of what `agent` has been told until `round`. Where no bridges are looked
/// for, old transitions are of no use to it.
pub(crate) fn rebuild_mentor(
    link: &mut dyn LearnerLink,
    plan: &RunPlan,
    agent: &Agent,
    round: Round,
) -> Result<(), LinkError> {
    let (replay, config, spec) = (agent.replay(), &plan.experiment.config, &plan.experiment.spec);
    if config.mentor.seeks_bridges(config.run.algo) {
        let mut index = replay.first_index();
        let mut piece = Piece::default();
        while index < replay.next_index() {
            let next = piece.fill(replay, index, spec.row());
            link.teach(&request(plan, round, index, REBUILD, piece.parts), &piece.words)?;
            pulse::step();
            index = next;
        }
    }
    let records = agent.annotation_records();
    let record = plan.experiment.record_words();
    for chunk in records.chunks(record * MAX_QUERY_ROWS as usize) {
        let request = request(plan, round, replay.next_index(), RESTORE, chunk.len() / record);
        link.teach(&request, chunk)?;
    }
    Ok(())
}

/// A piece of the history, as it travels.
#[derive(Default)]
struct Piece {
    /// Parts: transitions that one actor made in a row.
    parts: usize,
    words: Vec<u32>,
    batch: Batch,
}

impl Piece {
    /// Makes this the piece that begins with transition `first`, which is stored: as many transitions as [`HISTORY_WORDS`] have room for,
    /// and one at least. Returns the number of the first one behind it.
    fn fill(&mut self, replay: &Replay, first: u64, row: RowKind) -> u64 {
        self.words.clear();
        self.parts = 0;
        let mut next = first;
        let mut most = self.room(row).max(1);
        while most > 0 && next < replay.next_index() {
            next += replay.fill_batch(next, most, &mut self.batch) as u64;
            let part = Part::of(&self.batch);
            self.words.extend_from_slice(&part.header());
            self.words.extend_from_slice(part.payload);
            self.parts += 1;
            most = self.room(row);
        }
        next
    }

    /// How many transitions between states of kind `row` one more part may have.
    fn room(&self, row: RowKind) -> usize {
        let left = HISTORY_WORDS.saturating_sub(self.words.len() + PART_WORDS);
        (left / words(1, row)).min(MAX_ROLLOUT as usize)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use trestle_proto::NONE;
    use trestle_proto::batch::Transition;

    /// What is sent of a replay of `count` transitions with `dim` features, of which actor 0 makes the first `alone` and two actors the
    /// others by turns: actors and rewards, which are the transitions' numbers. And how many words each request had.
    fn sent(count: usize, dim: usize, alone: usize) -> (Vec<(u32, f32)>, Vec<usize>) {
        let mut replay = Replay::new(count, dim).unwrap();
        let state = vec![0.5; dim];
        for i in 0..count {
            let t = Transition { obs: &state, next_obs: &state, action: 0, reward: i as f32, flags: 0 };
            replay.push(&t, if i < alone { 0 } else { i as u32 % 2 }, NONE);
        }
        let (row, mut piece, mut index) = (RowKind::from(dim), Piece::default(), 0);
        let (mut found, mut sizes) = (Vec::new(), Vec::new());
        while index < count as u64 {
            index = piece.fill(&replay, index, row);
            let mut words = &piece.words[..];
            for _ in 0..piece.parts {
                let part = Part::take(&mut words, row).unwrap();
                let n = part.count as usize;
                let rewards = part.payload[2 * n * dim + n..][..n].iter();
                found.extend(rewards.map(|&word| (part.actor, f32::from_bits(word))));
            }
            assert!(words.is_empty());
            sizes.push(piece.words.len());
        }
        assert_eq!(index, count as u64);
        (found, sizes)
    }

    #[test]
    fn the_history_travels_whole_in_pieces_of_bounded_size() {
        for (count, dim, alone) in [(20_000, 2, 15_000), (3, 2, 3), (12, 4096, 5), (9, 4096, 0)] {
            let (found, sizes) = sent(count, dim, alone);
            let expected = |i: usize| (if i < alone { 0 } else { i as u32 % 2 }, i as f32);
            assert!(found.iter().copied().eq((0..count).map(expected)), "{count} of {dim}");
            assert!(sizes.iter().all(|&size| size <= HISTORY_WORDS), "{sizes:?}");
            // All but the last are full, to within one transition.
            let full = HISTORY_WORDS - PART_WORDS - words(1, dim);
            assert!(sizes[..sizes.len() - 1].iter().all(|&size| size >= full - PART_WORDS), "{sizes:?}");
        }
    }
}
