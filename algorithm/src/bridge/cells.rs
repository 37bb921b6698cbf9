//! Which stored states may be similar to a state: a hash of cells as wide as the radius of similarity.
//!
//! Similar states differ by at most the radius in every whitened feature, so they lie in the same cell or in adjacent
//! ones. Cells are cut along at most three features, in which the mentor's states spread widest. Cells that share
//! a hash share a list, which costs a few needless tests and nothing else: every join is verified by its KL.

use crate::states::{MixedMap, mix};

/// Features that cells are cut along, at most: more of them mean more adjacent cells to look at.
const MAX_AXES: usize = 3;

/// The states by cell.
#[derive(Clone, Debug)]
pub struct Cells {
    axes: Vec<usize>,
    /// Side of a cell, a little above the radius so that rounding cannot separate similar states further.
    side: f64,
    cells: MixedMap<Vec<u32>>,
    /// Position of each state in its cell's list.
    slots: Vec<u32>,
}

impl Cells {
    /// Cells for states similar up to KL = `e_th`, cut along the features in which `whitened` (row-major, `dim`
    /// features) spreads widest.
    pub fn new(e_th: f32, whitened: &[f32], dim: usize) -> Self {
        let spread = |axis: usize| {
            let column = whitened.iter().skip(axis).step_by(dim);
            let (low, high) =
                column.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), &x| (l.min(x), h.max(x)));
            high - low
        };
        let mut axes: Vec<(f32, usize)> = (0..dim).map(|axis| (spread(axis), axis)).collect();
        axes.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        Self {
            axes: axes.into_iter().take(MAX_AXES).map(|(_, axis)| axis).collect(),
            side: (2.0 * f64::from(e_th)).sqrt() * 1.001 + 1e-18,
            cells: MixedMap::default(),
            slots: Vec::new(),
        }
    }

    fn coordinate(&self, x: f32) -> i64 {
        // Far away, adjacent cells merge into the outermost one, which keeps adjacency.
        (f64::from(x) / self.side).floor().clamp(-1e9, 1e9) as i64
    }

    /// Adds state `id` at `whitened`.
    pub fn insert(&mut self, id: u32, whitened: &[f32]) {
        let key = self.key(whitened);
        let cell = self.cells.entry(key).or_default();
        if self.slots.len() <= id as usize {
            self.slots.resize(id as usize + 1, 0);
        }
        self.slots[id as usize] = cell.len() as u32;
        cell.push(id);
    }

    /// Removes state `id`, which was inserted at `whitened`.
    pub fn remove(&mut self, id: u32, whitened: &[f32]) {
        let key = self.key(whitened);
        let Some(cell) = self.cells.get_mut(&key) else { return };
        let slot = self.slots[id as usize];
        cell.swap_remove(slot as usize);
        if let Some(&moved) = cell.get(slot as usize) {
            self.slots[moved as usize] = slot;
        } else if cell.is_empty() {
            self.cells.remove(&key);
        }
    }

    fn key(&self, whitened: &[f32]) -> u64 {
        self.axes.iter().fold(0, |seed, &axis| mix(seed, self.coordinate(whitened[axis]) as u64))
    }

    /// Calls `visit` with lists that together hold every state similar to `whitened`, and others. A state may come up
    /// more than once. Which states come up depends on the states alone, their order on how they were stored.
    pub fn nearby(&self, whitened: &[f32], mut visit: impl FnMut(&[u32])) {
        let mut centre = [0; MAX_AXES];
        for (c, &axis) in centre.iter_mut().zip(&self.axes) {
            *c = self.coordinate(whitened[axis]);
        }
        let n = self.axes.len();
        for code in 0..3usize.pow(n as u32) {
            let mut rest = code;
            let key = centre[..n].iter().fold(0, |seed, &c| {
                let offset = (rest % 3) as i64 - 1;
                rest /= 3;
                mix(seed, (c + offset) as u64)
            });
            if let Some(cell) = self.cells.get(&key) {
                visit(cell);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::similarity::metric::kl;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    proptest! {
        #[test]
        fn nothing_similar_is_missed(
            dim in 1usize..5,
            numbers in proptest::collection::vec(
                prop_oneof![4 => -3.0f32..3.0, 2 => (-3i8..4).prop_map(f32::from), 1 => -1e18f32..1e18],
                4..80,
            ),
            removed in proptest::collection::vec(any::<bool>(), 80),
            e_th in prop_oneof![0.01f32..2.0, Just(0.0f32), Just(0.5f32)],
        ) {
            let points: Vec<&[f32]> = numbers.chunks_exact(dim).collect();
            let mut cells = Cells::new(e_th, &numbers[..points.len() * dim], dim);
            for (id, point) in points.iter().enumerate() {
                cells.insert(id as u32, point);
            }
            for (id, point) in points.iter().enumerate().filter(|&(id, _)| removed[id]) {
                cells.remove(id as u32, point);
            }
            for query in &points {
                let mut found: BTreeSet<u32> = BTreeSet::new();
                cells.nearby(query, |list| found.extend(list));
                for (id, point) in points.iter().enumerate() {
                    if removed[id] {
                        prop_assert!(!found.contains(&(id as u32)));
                    } else if kl(query, point) <= e_th {
                        prop_assert!(found.contains(&(id as u32)), "{query:?} {point:?}");
                    }
                }
            }
        }
    }
}
