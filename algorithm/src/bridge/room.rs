//! Which mentor transitions leave a path room on both sides of the newest transition.
//!
//! Where no bridge is known, a path through t may have k - 2 steps before t and still go on after it. Where a bridge of l
//! steps is known, it may have l - 2, if a bridge of the same length is of use. Once most bridges are short, hardly any
//! room is left, and this index says so without a look at each mentor transition.

use super::wanted::Reach;
use crate::similarity::Similarity;
use crate::similarity::tree::WIDTH;

/// The most room that any mentor state leaves, node by node of the index over them.
#[derive(Clone, Debug, Default)]
pub(super) struct Room {
    /// Never less than the true room: bridges only become shorter, and a visit brings a node up to date.
    most: Vec<u32>,
}

impl Room {
    /// Forgets everything: annotations have been replaced, and room may have grown.
    pub(super) fn forget(&mut self) {
        self.most.clear();
    }

    /// Calls `visit` with each mentor state whose room is enough for a path from it to `from`, at least one step, and with
    /// its KL from `from`. `room` gives the steps that a mentor state leaves room for, `most` at most.
    pub(super) fn around(
        &mut self,
        from: &[f32],
        (similarity, reach, most): (&Similarity, &Reach, u32),
        room: impl Fn(usize) -> u32,
        stack: &mut Vec<u32>,
        mut visit: impl FnMut(usize, f32),
    ) {
        let tree = similarity.fine();
        self.most.resize(tree.n_nodes(), most);
        let is_room = |steps: u32, kl: f32| steps > 0 && kl <= reach.limit(steps, reach.radius);
        stack.clear();
        stack.push(0);
        while let Some(at) = stack.pop() {
            let at = at as usize;
            let children = tree.children(at);
            if !children.is_empty() {
                for (child, bound) in children.zip(tree.lower_bounds(at, from)) {
                    if is_room(self.most[child], bound) {
                        stack.push(child as u32);
                    }
                }
                continue;
            }
            let mut largest = 0;
            for (group, numbers) in tree.numbers(at).chunks(WIDTH).enumerate() {
                for (&m, kl) in numbers.iter().zip(tree.kl(at, group, 0, from)) {
                    let steps = room(m as usize);
                    largest = largest.max(steps);
                    if is_room(steps, kl) {
                        visit(m as usize, kl);
                    }
                }
            }
            tree.lower(&mut self.most, at, largest);
        }
    }
}
