//! Which mentor transitions leave a path room on both sides of the newest transition.
//!
//! Where no bridge is known, a path through t may have k - 2 steps before t and still go on after it; where one of l
//! steps is known, l - 2, if as long a one is of use. Once most bridges are short, hardly any room is left, and this says
//! so without a look at each mentor transition.

use super::wanted::Reach;
use crate::similarity::Similarity;
use crate::similarity::tree::WIDTH;

/// The most room that any mentor state leaves, node by node of the index over them.
#[derive(Clone, Debug, Default)]
pub(super) struct Room {
    /// Never less than what is true: bridges only become shorter, and a node is brought up to date when it is looked at.
    most: Vec<u32>,
}

impl Room {
    /// Forgets everything: annotations have been replaced, and room may have grown.
    pub(super) fn forget(&mut self) {
        self.most.clear();
    }

    /// Calls `visit` with each mentor state, and its KL from `from`, that so many steps may lead from to `from` as it leaves
    /// room for, at least one. `room` says how many that are, `most` of them at most.
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
