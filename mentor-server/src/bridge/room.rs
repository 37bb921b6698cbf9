//! Which mentor transitions leave a path room on both sides of the newest transition.
//!
//! Where no bridge is known, a path through t may have k - 2 steps before t and still go on after it; where one of l
//! steps is known, l - 3, since only a shorter one would do. Once most bridges are short, hardly any room is left, and
//! this says so without a look at each mentor transition.

use super::wanted::Reach;
use trestle_proto::similarity::Similarity;
use trestle_proto::similarity::metric::kl;

/// The most room that any mentor state leaves, node by node of the index over them.
#[derive(Clone, Debug, Default)]
pub(super) struct Room {
    /// Never less than what is true: room only shrinks, and a node is brought up to date when it is looked at.
    most: Vec<u32>,
}

impl Room {
    /// Forgets everything: room may have grown.
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
            for &m in &tree.order()[node.start as usize..node.end as usize] {
                let (m, steps) = (m as usize, room(m as usize));
                largest = largest.max(steps);
                let kl = kl(from, similarity.state(m));
                if steps > 0 && kl <= reach.limit(steps, reach.radius) {
                    visit(m, kl);
                }
            }
            self.lower(similarity, at, largest);
        }
    }

    /// Sets what leaf `leaf` leaves, and what the nodes above it do.
    fn lower(&mut self, similarity: &Similarity, leaf: usize, largest: u32) {
        let nodes = similarity.tree().nodes();
        let (mut at, mut largest) = (leaf, largest);
        while largest < self.most[at] {
            self.most[at] = largest;
            if at == 0 {
                return;
            }
            at = nodes[at].parent as usize;
            let left = nodes[at].left as usize;
            largest = self.most[left].max(self.most[left + 1]);
        }
    }
}
