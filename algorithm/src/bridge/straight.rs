//! Straight bridges: the newest transition as the last step of a path of predecessors.
//!
//! Such a path is a stretch of one actor's episode, so its beginning is one of the last k transitions. This finds every
//! bridge that needs no cross-referencing, at a cost of k - 1 look-ups at most.

use super::{Path, Place, improve};
use crate::demonstration::transitions;
use crate::history::History;
use crate::similarity::Hit;
use trestle_proto::annotation::{AnnotationTable, Bridge};

/// Working memory.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    stack: Vec<u32>,
    starts: Vec<Hit>,
    /// Numbers of the transitions of the path, last to first.
    steps: Vec<u64>,
}

/// Looks for bridges that end with transition `index`, the newest of `history`, and improves `table`. The mentor states of
/// `newest` are similar to the transition's beginning, those of `ends` to its end. `improved` is called with each mentor
/// transition whose bridge was replaced, perhaps more than once.
pub fn search(
    history: &History,
    index: u64,
    [newest, ends]: [&[Hit]; 2],
    path: &Path<'_>,
    table: &mut AnnotationTable,
    scratch: &mut Scratch,
    mut improved: impl FnMut(usize),
) {
    let Scratch { stack, starts, steps } = scratch;
    let states = &history.states;
    if ends.is_empty() {
        return;
    }
    let mut first = Some(index);
    steps.clear();
    for length in 1..=path.rule.k {
        let Some(at) = first else { return };
        let step = history.get(at);
        let near = if length == 1 {
            newest
        } else {
            path.similarity.states(states.whitened(step.from), stack, starts);
            starts.as_slice()
        };
        for (j, _) in transitions(near, path.order) {
            if table.errors()[j] < path.rule.e_infeas {
                continue;
            }
            let Some((end_kl, ahead)) = path.nearest_end(j, ends) else { continue };
            let found = Bridge {
                action: step.action,
                length: length as u32,
                reward: step.reward,
                end_kl,
                next_obs: states.raw(step.to),
                terminated: step.terminated(),
                ahead,
            };
            if improve(table, j, &found, Place { first: length == 1, last: true }) {
                improved(j);
                let further = steps.iter().rev().map(|&step| history.get(step));
                table.set_further(j, further.map(|step| (step.action, states.raw(step.from))));
            }
        }
        steps.push(at);
        first = history.predecessor(at);
    }
}
