//! A static tree of bounding boxes over points in Euclidean space, the index behind [`super::Similarity`] and
//! action inference.
//!
//! The points are sorted by repeated halving along the widest side of their box and never move. Halving is by
//! position, not by value, so any number of equal points is as good as any other set. Boxes only rule out what cannot
//! be in reach; every point that remains is for the caller to test, so what is found is exact.

/// Points in a leaf, at most.
const LEAF: usize = 8;
/// Boxes promise slightly less than they could, so that rounding never rules out a point in reach: sums of the largest
/// number of squares (two states of 4096 features) in different orders differ by a thousandth at most.
const MARGIN: f32 = 0.998;

/// A part of the points ([`Tree::points`]), with its bounding box. The two halves of an inner node are `left` and `left + 1`.
#[derive(Clone, Debug)]
pub struct Node {
    start: u32,
    end: u32,
    /// Number of the first half's node; 0 for a leaf.
    pub left: u32,
    /// Number of the parent; the root's is 0.
    pub parent: u32,
}

/// The tree. Memory: 16 bytes and two points for each node, about a node for every three points; 4 bytes and the point for
/// each point.
#[derive(Clone, Debug)]
pub struct Tree {
    dim: usize,
    order: Vec<u32>,
    /// The points in that order, so that those of a leaf lie side by side.
    points: Vec<f32>,
    nodes: Vec<Node>,
    /// Lower corner, then upper corner of each node's box.
    boxes: Vec<f32>,
}

impl Tree {
    /// A tree over `points` (row-major, `dim` numbers each, all finite, fewer than 2^31 points).
    pub fn new(points: &[f32], dim: usize) -> Self {
        let count = points.len() / dim;
        let mut tree = Self {
            dim,
            order: (0..count as u32).collect(),
            points: Vec::new(),
            nodes: Vec::new(),
            boxes: Vec::new(),
        };
        tree.push(points, 0, count, 0);
        let mut at = 0;
        while at < tree.nodes.len() {
            let (start, end) = (tree.nodes[at].start as usize, tree.nodes[at].end as usize);
            if end - start > LEAF {
                let axis = tree.widest(at);
                let middle = start + (end - start) / 2;
                let key = |&i: &u32| points[i as usize * dim + axis];
                tree.order[start..end]
                    .select_nth_unstable_by(middle - start, |a, b| key(a).total_cmp(&key(b)).then(a.cmp(b)));
                tree.nodes[at].left = tree.nodes.len() as u32;
                tree.push(points, start, middle, at);
                tree.push(points, middle, end, at);
            }
            at += 1;
        }
        let point = |&i: &u32| &points[i as usize * dim..][..dim];
        tree.points = tree.order.iter().flat_map(point).copied().collect();
        tree
    }

    /// Appends a node and its box.
    fn push(&mut self, points: &[f32], start: usize, end: usize, parent: usize) {
        let at = self.boxes.len();
        self.boxes.resize(at + self.dim, f32::INFINITY);
        self.boxes.resize(at + 2 * self.dim, f32::NEG_INFINITY);
        let (low, high) = self.boxes[at..].split_at_mut(self.dim);
        for &i in &self.order[start..end] {
            let point = &points[i as usize * self.dim..][..self.dim];
            low.iter_mut().zip(point).for_each(|(l, &x)| *l = l.min(x));
            high.iter_mut().zip(point).for_each(|(h, &x)| *h = h.max(x));
        }
        self.nodes.push(Node { start: start as u32, end: end as u32, left: 0, parent: parent as u32 });
    }

    /// The axis along which node `at` is widest; the first of equals.
    fn widest(&self, at: usize) -> usize {
        let (low, high) = self.bounds(at);
        let side = |axis: usize| high[axis] - low[axis];
        (1..self.dim).fold(0, |best, axis| if side(axis) > side(best) { axis } else { best })
    }

    fn bounds(&self, at: usize) -> (&[f32], &[f32]) {
        self.boxes[2 * at * self.dim..][..2 * self.dim].split_at(self.dim)
    }

    /// The points of node `at`, each with its number.
    pub fn points(&self, at: usize) -> impl Iterator<Item = (usize, &[f32])> {
        let (start, end) = (self.nodes[at].start as usize, self.nodes[at].end as usize);
        let points = self.points[start * self.dim..end * self.dim].chunks_exact(self.dim);
        self.order[start..end].iter().map(|&i| i as usize).zip(points)
    }

    /// All nodes; number 0 is the root, and a parent comes before its halves.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// A lower bound of the KL divergence (half the squared distance) of the point `query`, followed by `more`, to every
    /// point of node `at`, as [`super::metric::kl`] would compute it in whatever order of summation.
    pub fn lower_bound(&self, at: usize, query: &[f32], more: &[f32]) -> f32 {
        let (low, high) = self.bounds(at);
        let square = |((&x, &l), &h): ((&f32, &f32), &f32)| {
            let gap = (l - x).max(x - h).max(0.0);
            gap * gap
        };
        0.5 * MARGIN * query.iter().chain(more).zip(low).zip(high).map(square).sum::<f32>()
    }

    /// Brings `maxima`, the largest of some number that each point has for each node, up to date where that of leaf `leaf`
    /// has fallen to `largest`.
    pub fn lower<T: Copy + PartialOrd>(&self, maxima: &mut [T], leaf: usize, mut largest: T) {
        let mut at = leaf;
        while largest < maxima[at] {
            maxima[at] = largest;
            if at == 0 {
                return;
            }
            at = self.nodes[at].parent as usize;
            let left = self.nodes[at].left as usize;
            let halves = (maxima[left], maxima[left + 1]);
            largest = if halves.0 < halves.1 { halves.1 } else { halves.0 };
        }
    }

    /// Calls `visit` with number and place of every point whose KL divergence from `query` may be `reach` or less (and some
    /// others), in no particular order. `stack` is working memory.
    pub fn candidates(
        &self,
        query: &[f32],
        reach: f32,
        stack: &mut Vec<u32>,
        mut visit: impl FnMut(usize, &[f32]),
    ) {
        stack.clear();
        stack.push(0);
        while let Some(at) = stack.pop() {
            if self.lower_bound(at as usize, query, &[]) > reach {
                continue;
            }
            let node = &self.nodes[at as usize];
            if node.left == 0 {
                self.points(at as usize).for_each(|(i, point)| visit(i, point));
            } else {
                stack.extend([node.left + 1, node.left]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::similarity::metric::kl;
    use crate::similarity::testing::{cases, points};
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(cases(256))]
        #[test]
        fn nothing_in_reach_is_missed((dim, points) in points(2..90), reach in 0.0f32..9.0) {
            let (points, query) = points.split_at(points.len() - dim);
            let tree = Tree::new(points, dim);
            let in_reach = |i: usize| kl(query, &points[i * dim..][..dim]) <= reach;
            let mut found = Vec::new();
            tree.candidates(query, reach, &mut Vec::new(), |i, point| {
                assert_eq!(point, &points[i * dim..][..dim]);
                if in_reach(i) {
                    found.push(i);
                }
            });
            found.sort_unstable();
            prop_assert_eq!(found, (0..points.len() / dim).filter(|&i| in_reach(i)).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_thousand_equal_points_are_no_special_case() {
        let tree = Tree::new(&[2.5; 1000], 1);
        let mut count = 0;
        tree.candidates(&[2.5], 0.0, &mut Vec::new(), |_, _| count += 1);
        assert_eq!(count, 1000);
        assert!(tree.nodes().iter().all(|n| n.end > n.start));
    }
}
