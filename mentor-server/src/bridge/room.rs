//! Which mentor transitions leave a path room on both sides of the newest transition.
//!
//! Where no bridge is known, a path through t may have k - 2 steps before t and still go on after it; where one of l
//! steps is known, l - 2, if as long a one is of use. Once most bridges are short, hardly any room is left, and this says
//! so without a look at each mentor transition.

use super::wanted::Reach;
use trestle_proto::similarity::Similarity;
use trestle_proto::similarity::metric::kl;

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
        let tree = similarity.tree();
        self.most.resize(tree.nodes().len(), most);
        stack.clear();
        stack.push(0);
        while let Some(at) = stack.pop() {
            let at = at as usize;
            let (node, steps) = (&tree.nodes()[at], self.most[at]);
            if steps == 0 || tree.lower_bound(at, from, &[]) > reach.limit(steps, reach.radius) {
                continue;
            }
            if node.left != 0 {
                stack.extend([node.left + 1, node.left]);
                continue;
            }
            let mut largest = 0;
            for (m, state) in tree.points(at) {
                let steps = room(m);
                largest = largest.max(steps);
                let kl = kl(from, state);
                if steps > 0 && kl <= reach.limit(steps, reach.radius) {
                    visit(m, kl);
                }
            }
            tree.lower(&mut self.most, at, largest);
        }
    }
}
