//! Which stored states may be similar to a state: a hash of cells as wide as the radius of similarity.
//!
//! Similar states differ by at most the radius in every whitened feature, so they lie in the same cell or in adjacent
//! ones. Cells are cut along at most three features, in which the mentor's states spread widest. Cells that share
//! a hash share a list, which costs a few needless tests and nothing else: every join is verified by its KL.
//!
//! Where states lie thinly, most of those in adjacent cells are not similar, and a search asks for the same states again and
//! again. So a state keeps a list of the similar ones, unless a cell around it is crowded. Where cells are crowded, lists would
//! grow without bound, and there nothing is kept and nothing has to be kept up to date.

use crate::similarity::metric::kl;
use crate::states::{MixedMap, mix};

/// Features that cells are cut along, at most: more of them mean more adjacent cells to look at.
const MAX_AXES: usize = 3;
/// A cell and those around it.
const MAX_KEYS: usize = 3usize.pow(MAX_AXES as u32);
/// A cell with more states than this is crowded.
const CROWDED: usize = 64;
/// The same where lists are worth much memory, at most.
pub const CROWDED_AT_MOST: usize = 1024;
/// Entries of all lists together, at most, where a cell with more than [`CROWDED`] states is not crowded.
const MAX_ENTRIES: usize = if cfg!(test) { 1 << 12 } else { 1 << 24 };

/// The states by cell. Memory: about 50 bytes a state, and 4 for each pair of similar states that is listed, which for one
/// state is at most 64 in each of 27 cells, or after [`Cells::widen`] as many again for all states together as `MAX_ENTRIES`.
#[derive(Clone, Debug)]
pub struct Cells {
    axes: Vec<usize>,
    e_th: f32,
    /// Side of a cell, a little above the radius so that rounding cannot separate similar states further.
    side: f64,
    cells: MixedMap<Vec<u32>>,
    /// A cell with more states than this is crowded: [`CROWDED`] to [`CROWDED_AT_MOST`].
    pub(super) crowded: usize,
    /// Position of each state in its cell's list.
    slots: Vec<u32>,
    /// What surrounds each state.
    surroundings: Vec<Option<Surroundings>>,
    /// Entries of all lists together.
    entries: usize,
    /// See [`Cells::dispersed`].
    dispersed: Vec<u32>,
}

/// What surrounds a state, as long as no cell there is crowded.
#[derive(Clone, Debug)]
struct Surroundings {
    /// The similar states, this one included.
    similar: Vec<u32>,
    /// States in its cell and those around it.
    crowd: u32,
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
            e_th,
            side: (2.0 * f64::from(e_th)).sqrt() * 1.001 + 1e-18,
            cells: MixedMap::default(),
            crowded: CROWDED,
            slots: Vec::new(),
            surroundings: Vec::new(),
            entries: 0,
            dispersed: Vec::new(),
        }
    }

    fn coordinate(&self, x: f32) -> i64 {
        // Far away, adjacent cells merge into the outermost one, which keeps adjacency.
        (f64::from(x) / self.side).floor().clamp(-1e9, 1e9) as i64
    }

    /// Adds state `id`. `whitened` gives its features and those of every state that was added before and not removed.
    pub fn insert<'a>(&mut self, id: u32, whitened: impl Fn(u32) -> &'a [f32]) {
        let state = whitened(id);
        let key = self.key(state);
        let cell = self.cells.entry(key).or_default();
        let at = id as usize;
        if self.slots.len() <= at {
            self.slots.resize(at + 1, 0);
            self.surroundings.resize(at + 1, None);
        }
        self.slots[at] = cell.len() as u32;
        cell.push(id);
        match cell.len() {
            size if size == self.crowded + 1 => self.forget_around(state, key),
            // Nothing is kept around a crowded cell.
            size if size > self.crowded => {}
            _ => self.meet(id, whitened),
        }
    }

    /// Enters new state `id` with those around it, and them with it.
    fn meet<'a>(&mut self, id: u32, whitened: impl Fn(u32) -> &'a [f32]) {
        let state = whitened(id);
        let mut own = Surroundings { similar: Vec::new(), crowd: 0 };
        let mut crowded = false;
        for key in self.keys(state) {
            let Some(cell) = self.cells.get(&key) else { continue };
            own.crowd += cell.len() as u32;
            if cell.len() > self.crowded {
                crowded = true;
                continue;
            }
            for &other in cell {
                let similar = kl(state, whitened(other)) <= self.e_th;
                if similar {
                    own.similar.push(other);
                }
                if let Some(theirs) = &mut self.surroundings[other as usize] {
                    theirs.crowd += 1;
                    if similar {
                        theirs.similar.push(id);
                        self.entries += 1;
                    }
                }
            }
        }
        if !crowded {
            self.entries += own.similar.len();
            self.surroundings[id as usize] = Some(own);
        }
    }

    /// The cell `own` of `state` has become crowded.
    fn forget_around(&mut self, state: &[f32], own: u64) {
        for key in self.keys(state) {
            let Some(cell) = self.cells.get(&key) else { continue };
            // Around other crowded cells nothing was kept.
            if key == own || cell.len() <= self.crowded {
                for &id in cell {
                    let lost = self.surroundings[id as usize].take();
                    self.entries -= lost.map_or(0, |lost| lost.similar.len());
                }
                self.dispersed.extend(cell);
            }
        }
    }

    /// Has lists of similar states kept where cells are not `crowded`, [`CROWDED_AT_MOST`] at most, or less so if that were
    /// too many entries. `ids` are all states, `whitened` as for [`Cells::insert`].
    pub fn widen<'a>(&mut self, crowded: usize, ids: &[u32], whitened: impl Fn(u32) -> &'a [f32]) {
        self.crowded = crowded.clamp(CROWDED, CROWDED_AT_MOST);
        while !self.list(ids, &whitened) {
            self.crowded = (self.crowded / 2).max(CROWDED);
        }
    }

    /// Makes the lists of `ids`, all states, anew. False if they have too many entries: then some are missing.
    fn list<'a>(&mut self, ids: &[u32], whitened: impl Fn(u32) -> &'a [f32]) -> bool {
        self.surroundings.fill(None);
        self.entries = 0;
        for &id in ids {
            let own = self.survey(id, &whitened);
            self.entries += own.as_ref().map_or(0, |own| own.similar.len());
            self.surroundings[id as usize] = own;
            if self.is_full() {
                return false;
            }
        }
        true
    }

    /// Where a cell is crowded: from more states than this on.
    pub fn crowded(&self) -> usize {
        self.crowded
    }

    /// Whether lists are kept in crowds that are beyond `CROWDED`.
    pub fn is_wide(&self) -> bool {
        self.crowded > CROWDED
    }

    /// Whether the lists have so many entries that they are to be kept in smaller crowds alone.
    pub fn is_full(&self) -> bool {
        self.is_wide() && self.entries > MAX_ENTRIES
    }

    /// What surrounds state `id`, which has been entered in its cell; nothing where a cell is crowded.
    fn survey<'a>(&self, id: u32, whitened: impl Fn(u32) -> &'a [f32]) -> Option<Surroundings> {
        let state = whitened(id);
        let mut own = Surroundings { similar: Vec::new(), crowd: 0 };
        for key in self.keys(state) {
            let Some(cell) = self.cells.get(&key) else { continue };
            if cell.len() > self.crowded {
                return None;
            }
            own.crowd += cell.len() as u32;
            own.similar.extend(cell.iter().filter(|&&other| kl(state, whitened(other)) <= self.e_th));
        }
        Some(own)
    }

    /// A transition is about to be stored.
    pub fn begin(&mut self) {
        self.dispersed.clear();
    }

    /// The states that the newest transition has made states in a crowd, among others.
    pub fn dispersed(&self) -> &[u32] {
        &self.dispersed
    }

    /// Whether the states of a `cell` that [`Cells::nearby`] has shown are in a crowd.
    pub fn is_crowd(&self, cell: &[u32]) -> bool {
        cell.len() > self.crowded
    }

    /// Removes state `id`; `whitened` as for [`Cells::insert`].
    pub fn remove<'a>(&mut self, id: u32, whitened: impl Fn(u32) -> &'a [f32]) {
        let state = whitened(id);
        let own = self.key(state);
        let lost = self.surroundings[id as usize].take();
        self.entries -= lost.map_or(0, |lost| lost.similar.len());
        if self.cells.get(&own).is_some_and(|cell| cell.len() <= self.crowded) {
            for key in self.keys(state) {
                for &other in
                    self.cells.get(&key).filter(|cell| cell.len() <= self.crowded).into_iter().flatten()
                {
                    let Some(theirs) = &mut self.surroundings[other as usize] else { continue };
                    theirs.crowd -= 1;
                    if let Some(at) = theirs.similar.iter().position(|&similar| similar == id) {
                        theirs.similar.swap_remove(at);
                        self.entries -= 1;
                    }
                }
            }
        }
        let Some(cell) = self.cells.get_mut(&own) else { return };
        let slot = self.slots[id as usize];
        cell.swap_remove(slot as usize);
        if let Some(&moved) = cell.get(slot as usize) {
            self.slots[moved as usize] = slot;
        } else if cell.is_empty() {
            self.cells.remove(&own);
        }
    }

    fn key(&self, whitened: &[f32]) -> u64 {
        self.axes.iter().fold(0, |seed, &axis| mix(seed, self.coordinate(whitened[axis]) as u64))
    }

    /// The keys of the cell of `whitened` and of those around it.
    fn keys(&self, whitened: &[f32]) -> impl Iterator<Item = u64> + use<> {
        let mut centre = [0; MAX_AXES];
        for (c, &axis) in centre.iter_mut().zip(&self.axes) {
            *c = self.coordinate(whitened[axis]);
        }
        let n = self.axes.len();
        let mut keys = [0; MAX_KEYS];
        let count = 3usize.pow(n as u32);
        for (code, key) in keys[..count].iter_mut().enumerate() {
            let mut rest = code;
            *key = centre[..n].iter().fold(0, |seed, &c| {
                let offset = (rest % 3) as i64 - 1;
                rest /= 3;
                mix(seed, (c + offset) as u64)
            });
        }
        keys.into_iter().take(count)
    }

    /// Calls `visit` with lists that together hold every state similar to `whitened`, and others. A state may come up
    /// more than once. Which states come up depends on the states alone, their order on how they were stored.
    pub fn nearby(&self, whitened: &[f32], mut visit: impl FnMut(&[u32])) {
        for key in self.keys(whitened) {
            if let Some(cell) = self.cells.get(&key) {
                visit(cell);
            }
        }
    }

    /// The states similar to state `id`, itself included, and how many [`Cells::nearby`] would go through to find them;
    /// none where that is not known.
    pub fn listed(&self, id: u32) -> Option<(&[u32], usize)> {
        let known = self.surroundings[id as usize].as_ref()?;
        Some((&known.similar, known.crowd as usize))
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
                4..120,
            ),
            removed in proptest::collection::vec(any::<bool>(), 120),
            e_th in prop_oneof![0.01f32..2.0, Just(0.0f32), Just(0.5f32)],
            widened in any::<bool>(),
        ) {
            let points: Vec<&[f32]> = numbers.chunks_exact(dim).collect();
            let mut cells = Cells::new(e_th, &numbers[..points.len() * dim], dim);
            for id in 0..points.len() as u32 {
                cells.insert(id, |id| points[id as usize]);
            }
            for id in (0..points.len()).filter(|&id| removed[id]) {
                cells.remove(id as u32, |id| points[id as usize]);
            }
            if widened {
                let stored = (0..points.len()).filter(|&id| !removed[id]).map(|id| id as u32);
                let stored: Vec<u32> = stored.collect();
                cells.widen(CROWDED_AT_MOST, &stored, |id| points[id as usize]);
                prop_assert!(!cells.is_full());
            }
            let listed = (0..points.len()).filter(|&id| !removed[id]).filter_map(|id| cells.listed(id as u32));
            prop_assert_eq!(cells.entries, listed.map(|(list, _)| list.len()).sum::<usize>());
            for (asking, query) in points.iter().enumerate() {
                let mut found: BTreeSet<u32> = BTreeSet::new();
                let mut crowd = 0;
                cells.nearby(query, |list| {
                    found.extend(list);
                    crowd += list.len();
                });
                if let Some((listed, looks)) = cells.listed(asking as u32) {
                    let similar = |id: &u32| !removed[*id as usize] && kl(query, points[*id as usize]) <= e_th;
                    let expected: Vec<u32> = (0..points.len() as u32).filter(similar).collect();
                    let mut listed = listed.to_vec();
                    listed.sort_unstable();
                    prop_assert_eq!((listed, looks), (expected, crowd));
                } else {
                    prop_assert!(removed[asking] || points.len() > CROWDED);
                }
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
