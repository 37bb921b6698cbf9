//! Which mentor transitions leave a path room on both sides of the newest transition.
//!
//! Where no bridge is known, a path through t may have k - 2 steps before t and still go on after it. Where a bridge of l
//! steps is known, it may have l - 2, if a bridge of the same length is of use. Once most bridges are short, hardly any
//! room is left. And where no stored transition begins or ends yet as a bridge must, there is none at all. This index says
//! so without a look at each mentor transition.

use crate::similarity::tree::{Tree, WIDTH};

/// The most room that any mentor state leaves, node by node of the index over them.
#[derive(Clone, Debug, Default)]
pub(super) struct Room {
    /// Never less than the true room: a visit brings a node up to date, and [`Room::grow`] says where room has grown since.
    most: Vec<u32>,
    /// The leaf that each mentor state is in.
    leaf_of: Vec<u32>,
}

impl Room {
    /// Forgets everything: annotations have been replaced, and room may have grown anywhere.
    pub(super) fn forget(&mut self) {
        self.most.clear();
    }

    /// Room has grown at mentor state `m` of `tree`, to `steps` at most.
    pub(super) fn grow(&mut self, tree: &Tree, m: usize, steps: u32) {
        // Nothing is known before the first visit.
        if self.most.is_empty() {
            return;
        }
        if self.leaf_of.len() <= m {
            for at in 0..tree.n_nodes() {
                for &m in tree.numbers(at) {
                    self.leaf_of.resize(self.leaf_of.len().max(m as usize + 1), 0);
                    self.leaf_of[m as usize] = at as u32;
                }
            }
        }
        tree.raise(&mut self.most, self.leaf_of[m] as usize, steps);
    }

    /// Calls `visit` with the mentor states of `tree` that may have room for a path from them to `from`, at least one step, and
    /// with their KL from `from`. It answers with the steps that a mentor state leaves room for, or with nothing to end the
    /// walk, which is then false. `limits` has the largest KL for each number of steps that may come up.
    pub(super) fn around(
        &mut self,
        from: &[f32],
        tree: &Tree,
        limits: &[f32],
        stack: &mut Vec<u32>,
        mut visit: impl FnMut(usize, f32) -> Option<u32>,
    ) -> bool {
        let most = limits.len().saturating_sub(1);
        if most == 0 {
            return true;
        }
        self.most.resize(tree.n_nodes(), most as u32);
        let is_room = |steps: u32, kl: f32| steps > 0 && kl <= limits[steps as usize];
        stack.clear();
        if self.most[0] > 0 {
            stack.push(0);
        }
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
                    let Some(steps) = visit(m as usize, kl) else { return false };
                    largest = largest.max(steps);
                }
            }
            tree.lower(&mut self.most, at, largest);
        }
        true
    }
}
