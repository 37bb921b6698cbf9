//! A static tree of bounding boxes over points in Euclidean space, the index behind [`super::Similarity`] and
//! action inference.
//!
//! The points are sorted by repeated halving along the widest side of their box and never move. Halving is by
//! position, not by value, so any number of equal points is as good as any other set. Boxes only rule out points that
//! cannot be in reach. Every point that remains is tested, so the result is exact.
//!
//! A node has up to [`WIDTH`] children, whose corners lie together, feature by feature, so that a query compares itself with
//! all of them at once. The points of a leaf form groups of [`WIDTH`] that are compared in the same way and lie one after the
//! other.

use super::metric::square;
use std::ops::Range;

/// Children of a node, at most, and points of a group.
pub const WIDTH: usize = 8;
/// Halvings that make the children of a node.
const HALVINGS: u32 = WIDTH.ilog2();
/// Boxes promise slightly less than they could, so that rounding never rules out a point in reach: sums of the largest
/// number of squares (two states of 4096 features) in different orders differ by a thousandth at most.
const MARGIN: f32 = 0.998;

/// One number for each child or point of a node; the numbers of absent ones mean nothing.
pub type Lanes = [f32; WIDTH];

#[derive(Clone, Debug)]
struct Node {
    /// Number of the first child, or place of the first point; the others follow.
    first: u32,
    count: u32,
    leaf: bool,
    /// Number of the parent; the root's is 0.
    parent: u32,
}

/// The tree. Nodes are numbered from the root, 0, and a parent comes before its children. Memory: with `dim` features
/// about 6 to 13 `dim` bytes and some a point.
#[derive(Clone, Debug)]
pub struct Tree {
    dim: usize,
    /// Rows of a node. All have as many, so that they are found, and fetched, without a look at the node itself.
    stride: usize,
    /// The points' numbers, a leaf's side by side.
    order: Vec<u32>,
    nodes: Vec<Node>,
    /// For a node: the lower corners of its children's boxes, feature by feature, and then the upper ones. For a leaf: the
    /// points, `dim` rows a group. The remaining rows mean nothing.
    rows: Vec<Lanes>,
}

impl Tree {
    /// A tree over `points` (row-major, `dim` numbers each, all finite, fewer than 2^31 points) with up to `leaf` points in a
    /// leaf, at least 1. With larger leaves a query reads more points one after the other, and fewer boxes, which lie far
    /// apart in memory.
    pub fn new(points: &[f32], dim: usize, leaf: usize) -> Self {
        let count = points.len() / dim;
        let order = (0..count as u32).collect();
        let stride = dim * leaf.div_ceil(WIDTH).max(2);
        let mut tree = Self { dim, stride, order, nodes: Vec::new(), rows: Vec::new() };
        tree.push(0..count, 0);
        let mut at = 0;
        while at < tree.nodes.len() {
            let (range, base) = (tree.points(at), at * stride);
            if range.len() > leaf {
                let parts = tree.split(points, range, leaf);
                (tree.nodes[at].first, tree.nodes[at].count) = (tree.nodes.len() as u32, parts.len() as u32);
                for (lane, part) in parts.into_iter().enumerate() {
                    let (low, high) = tree.bounds(points, part.clone());
                    let rows = tree.rows[base..].iter_mut();
                    rows.zip(low.into_iter().chain(high)).for_each(|(row, x)| row[lane] = x);
                    tree.push(part, at);
                }
            } else {
                tree.nodes[at].leaf = true;
                for (i, place) in range.enumerate() {
                    let point = &points[tree.order[place] as usize * dim..][..dim];
                    let rows = tree.rows[base + i / WIDTH * dim..].iter_mut();
                    rows.zip(point).for_each(|(row, &x)| row[i % WIDTH] = x);
                }
            }
            at += 1;
        }
        tree
    }

    /// Appends a node that has the points of `range` for the present, and whose rows are empty.
    fn push(&mut self, range: Range<usize>, parent: usize) {
        let (first, count) = (range.start as u32, range.len() as u32);
        self.nodes.push(Node { first, count, leaf: false, parent: parent as u32 });
        self.rows.resize(self.rows.len() + self.stride, [0.0; WIDTH]);
    }

    /// The places of the points of a node that has no children.
    fn points(&self, at: usize) -> Range<usize> {
        let node = &self.nodes[at];
        node.first as usize..(node.first + node.count) as usize
    }

    /// Sorts the points of `range` into up to [`WIDTH`] parts that lie apart; one of up to `leaf` points is not parted.
    fn split(&mut self, points: &[f32], range: Range<usize>, leaf: usize) -> Vec<Range<usize>> {
        let mut parts = vec![range];
        for _ in 0..HALVINGS {
            for part in std::mem::take(&mut parts) {
                if part.len() <= leaf {
                    parts.push(part);
                    continue;
                }
                let (low, high) = self.bounds(points, part.clone());
                let side = |axis: usize| high[axis] - low[axis];
                // The first of equals.
                let widest =
                    (1..self.dim).fold(0, |best, axis| if side(axis) > side(best) { axis } else { best });
                let key = |&i: &u32| points[i as usize * self.dim + widest];
                let half = part.len() / 2;
                self.order[part.clone()]
                    .select_nth_unstable_by(half, |a, b| key(a).total_cmp(&key(b)).then(a.cmp(b)));
                parts.extend([part.start..part.start + half, part.start + half..part.end]);
            }
        }
        parts
    }

    /// The corners of the box around the points of `range`.
    fn bounds(&self, points: &[f32], range: Range<usize>) -> (Vec<f32>, Vec<f32>) {
        let (mut low, mut high) = (vec![f32::INFINITY; self.dim], vec![f32::NEG_INFINITY; self.dim]);
        for &i in &self.order[range] {
            let point = &points[i as usize * self.dim..][..self.dim];
            low.iter_mut().zip(point).for_each(|(l, &x)| *l = l.min(x));
            high.iter_mut().zip(point).for_each(|(h, &x)| *h = h.max(x));
        }
        (low, high)
    }

    /// The numbers of all points, those of each node side by side.
    pub fn in_order(&self) -> &[u32] {
        &self.order
    }

    /// How many nodes there are.
    pub fn n_nodes(&self) -> usize {
        self.nodes.len()
    }

    /// The children of node `at`; none for a leaf.
    pub fn children(&self, at: usize) -> Range<usize> {
        if self.nodes[at].leaf { 0..0 } else { self.points(at) }
    }

    /// The numbers of the points of leaf `at`; none for another node.
    pub fn numbers(&self, at: usize) -> &[u32] {
        if self.nodes[at].leaf { &self.order[self.points(at)] } else { &[] }
    }

    /// For each child of node `at` a lower bound of the KL divergence (half the squared distance) of the point `query` to
    /// every point below the child, as [`super::metric::kl`] would compute it in any order of summation.
    pub fn lower_bounds(&self, at: usize, query: &[f32]) -> Lanes {
        let (low, high) = self.rows[at * self.stride..][..2 * self.dim].split_at(self.dim);
        let mut sum = [0.0; WIDTH];
        for ((&x, low), high) in query.iter().zip(low).zip(high) {
            for lane in 0..WIDTH {
                let (below, above) = (low[lane] - x, x - high[lane]);
                // Unlike `f32::max` these are single instructions.
                let gap = if below > above { below } else { above };
                let gap = if gap > 0.0 { gap } else { 0.0 };
                sum[lane] += square(gap);
            }
        }
        sum.map(|sum| 0.5 * MARGIN * sum)
    }

    /// The KL divergence of each point of group `group` of leaf `at`, which has the points from `group * WIDTH` on, from `query`
    /// in the features from `first` on, as many as `query` has. It equals [`super::metric::kl`] bit for bit.
    pub fn kl(&self, at: usize, group: usize, first: usize, query: &[f32]) -> Lanes {
        let mut sum = [0.0; WIDTH];
        let rows = &self.rows[at * self.stride + group * self.dim + first..];
        for (&x, row) in query.iter().zip(rows) {
            for lane in 0..WIDTH {
                sum[lane] += square(x - row[lane]);
            }
        }
        sum.map(|sum| 0.5 * sum)
    }

    /// Updates `maxima` after the maximum of leaf `leaf` has fallen to `largest`. `maxima` has, for each node, the largest
    /// of some number that each point has.
    pub fn lower<T: Copy + PartialOrd>(&self, maxima: &mut [T], leaf: usize, largest: T) {
        let (mut at, mut largest) = (leaf, largest);
        while largest < maxima[at] {
            maxima[at] = largest;
            if at == 0 {
                return;
            }
            at = self.nodes[at].parent as usize;
            for &child in &maxima[self.children(at)] {
                if largest < child {
                    largest = child;
                }
            }
        }
    }

    /// Updates `maxima` after the number of a point in leaf `leaf` has risen to `value`.
    pub fn raise<T: Copy + PartialOrd>(&self, maxima: &mut [T], leaf: usize, value: T) {
        let mut at = leaf;
        while maxima[at] < value {
            maxima[at] = value;
            at = self.nodes[at].parent as usize;
        }
    }

    /// Calls `visit` with the number of every point whose KL divergence from `query` is `reach` or less, and that divergence, in
    /// no particular order. `stack` is working memory.
    pub fn within(&self, query: &[f32], reach: f32, stack: &mut Vec<u32>, mut visit: impl FnMut(usize, f32)) {
        stack.clear();
        stack.push(0);
        while let Some(at) = stack.pop() {
            let (at, node) = (at as usize, &self.nodes[at as usize]);
            if !node.leaf {
                for lane in in_reach(&self.lower_bounds(at, query), reach, node.count as usize) {
                    stack.push(node.first + lane as u32);
                }
                continue;
            }
            for (group, numbers) in self.numbers(at).chunks(WIDTH).enumerate() {
                let kl = self.kl(at, group, 0, query);
                in_reach(&kl, reach, numbers.len()).for_each(|lane| visit(numbers[lane] as usize, kl[lane]));
            }
        }
    }
}

/// The lanes among the first `count` in which `kl` is `reach` or less. It goes by way of bits: the processor predicts their
/// number better than their places.
fn in_reach(kl: &Lanes, reach: f32, count: usize) -> impl Iterator<Item = usize> {
    let all = kl.iter().zip(0..).fold(0u32, |bits, (&kl, lane)| bits | u32::from(kl <= reach) << lane);
    let mut bits = all & ((1 << count) - 1);
    std::iter::from_fn(move || {
        let lane = bits.trailing_zeros() as usize;
        let found = bits != 0;
        bits &= bits.wrapping_sub(1);
        found.then_some(lane)
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::similarity::metric::kl;
    use crate::similarity::testing::{cases, points};
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(cases(256))]
        #[test]
        fn what_is_in_reach_is_found((dim, points) in points(2..200), reach in 0.0f32..9.0, leaf in 1usize..40) {
            let (points, query) = points.split_at(points.len() - dim);
            let tree = Tree::new(points, dim, leaf);
            let mut found = Vec::new();
            tree.within(query, reach, &mut Vec::new(), |i, kl| found.push((i, kl)));
            found.sort_unstable_by_key(|(i, _)| *i);
            let all = points.chunks_exact(dim).map(|point| kl(query, point)).enumerate();
            prop_assert_eq!(found, all.filter(|(_, kl)| *kl <= reach).collect::<Vec<_>>());
        }

        #[test]
        fn maxima_are_kept(count in 1usize..400, changes in prop::collection::vec((0usize..400, 0u32..9), 0..60)) {
            let points: Vec<f32> = (0..count).map(|i| (i * 7 % 11) as f32).collect();
            let tree = Tree::new(&points, 1, 5);
            let mut values = vec![9; count];
            let mut maxima = vec![9; tree.n_nodes()];
            let largest = |values: &[u32], at: usize| tree.numbers(at).iter().map(|&i| values[i as usize]).max();
            for (i, value) in changes.into_iter().map(|(i, value)| (i % count, value)) {
                let leaf = (0..tree.n_nodes()).find(|&at| tree.numbers(at).contains(&(i as u32))).unwrap();
                if std::mem::replace(&mut values[i], value) < value {
                    tree.raise(&mut maxima, leaf, value);
                }
                tree.lower(&mut maxima, leaf, largest(&values, leaf).unwrap());
            }
            for at in (0..tree.n_nodes()).rev() {
                let below = tree.children(at).map(|child| maxima[child]).max();
                prop_assert_eq!(Some(maxima[at]), below.or(largest(&values, at)));
            }
        }
    }

    #[test]
    fn a_thousand_equal_points_are_no_special_case() {
        let tree = Tree::new(&[2.5; 1000], 1, 32);
        let mut count = 0;
        tree.within(&[2.5], 0.0, &mut Vec::new(), |_, _| count += 1);
        assert_eq!(count, 1000);
        assert!((0..tree.n_nodes()).all(|at| tree.children(at).is_empty() != tree.numbers(at).is_empty()));
    }
}
