//! A map in the making: which cells are free, and where start and goal go in the end.

use super::super::actions::{Direction, REGULAR};
use super::super::map::{Cell, Map};

/// Drafts that a generator makes of a map, at most. The one with the longest way is taken.
const MAX_DRAFTS: usize = 32;

/// Free cells of a rectangle.
#[derive(Clone, Debug)]
pub(super) struct Plan {
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// By row and column.
    free: Vec<bool>,
}

impl Plan {
    /// A rectangle whose cells are all free or all walls.
    pub(super) fn new(columns: usize, rows: usize, free: bool) -> Self {
        Self { columns, rows, free: vec![free; columns * rows] }
    }

    pub(super) fn is_free(&self, [column, row]: Cell) -> bool {
        self.free[row * self.columns + column]
    }

    pub(super) fn set(&mut self, [column, row]: Cell, free: bool) {
        self.free[row * self.columns + column] = free;
    }

    /// All cells, row by row.
    pub(super) fn cells(&self) -> impl Iterator<Item = Cell> + use<> {
        let columns = self.columns;
        (0..columns * self.rows).map(move |i| [i % columns, i / columns])
    }

    /// The map with this start and goal, which become free.
    pub(super) fn map(&self, start: Cell, goal: Cell) -> Map {
        Map::with(self.columns, self.rows, start, goal, |cell| self.is_free(cell))
    }

    /// The map whose start is the cell nearest to the top left of the largest part that is connected by `moves`, and whose goal is
    /// the cell of that part that is the farthest from there for a regular agent; and how far it is for that one. None if no two
    /// free cells are connected.
    ///
    /// `moves` must lead back as well as forth: then they are moves of every other set, possibly in two steps.
    fn ends(&self, moves: &[Direction]) -> Option<(Map, u32)> {
        let mut cells: Vec<Cell> = self.cells().filter(|&cell| self.is_free(cell)).collect();
        cells.sort_by_key(|[column, row]| column + row);
        let first = *cells.first()?;
        let map = self.map(first, first);
        let mut known = vec![false; map.indices()];
        let mut largest: Vec<(Cell, u32)> = Vec::new();
        for &start in &cells {
            if !known[map.index(start)] {
                let part = spread(&map, start, moves, &mut known);
                if part.len() > largest.len() {
                    largest = part;
                }
            }
        }
        let &(start, _) = largest.first()?;
        let mut within = vec![false; map.indices()];
        largest.iter().for_each(|&(cell, _)| within[map.index(cell)] = true);
        let mut by_regular = spread(&map, start, REGULAR, &mut vec![false; map.indices()]);
        by_regular.retain(|&(cell, _)| within[map.index(cell)]);
        let &(goal, far) = by_regular.iter().max_by_key(|&&([column, row], far)| (far, row, column))?;
        (far > 0).then(|| (self.map(start, goal), far))
    }
}

/// The cells of `map` that `moves` connect with `start`, which become known, and how far they are, the nearest first.
fn spread(map: &Map, start: Cell, moves: &[Direction], known: &mut [bool]) -> Vec<(Cell, u32)> {
    let steps = map.moves(moves);
    known[map.index(start)] = true;
    let mut found = vec![(start, 0)];
    let mut at = 0;
    while let Some(&(cell, far)) = found.get(at) {
        at += 1;
        for &step in &steps {
            if let Some(next) = map.advance(map.index(cell), step)
                && !std::mem::replace(&mut known[next], true)
            {
                found.push((map.cell(next), far + 1));
            }
        }
    }
    found
}

/// The first map of `draft` whose goal is at least three quarters of the two sides away, or the longest of
/// [`MAX_DRAFTS`]; an open hall if none of them has a way at all.
pub(super) fn drafted(moves: &[Direction], mut draft: impl FnMut() -> Plan) -> Map {
    let mut best: Option<(Map, u32)> = None;
    let mut size = [1, 1];
    for _ in 0..MAX_DRAFTS {
        let plan = draft();
        size = [plan.columns, plan.rows];
        let found = plan.ends(moves);
        let far = |found: &Option<(Map, u32)>| found.as_ref().map_or(0, |(_, far)| *far);
        if far(&found) > far(&best) {
            best = found;
        }
        if 4 * far(&best) as usize >= 3 * (plan.columns + plan.rows) {
            break;
        }
    }
    best.map_or_else(|| Map::open(size[0], size[1]), |(map, _)| map)
}
