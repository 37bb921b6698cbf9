//! Corridors of one width between walls of one cell: a labyrinth with few loops, or one that winds through the whole map.

use super::super::actions::{Direction, IRREGULAR, REGULAR};
use super::super::map::{Cell, Map};
use super::below;
use super::plan::{Plan, drafted};
use trestle_proto::rng::Stream;

/// Of the walls that the labyrinth leaves between two of its squares, one in this many is opened.
const LOOPS: usize = 12;

/// The moves that must connect the ends of a map with corridors `width` cells wide. An irregular agent needs two rows to move
/// along one.
fn moves(width: usize) -> &'static [Direction] {
    if width == 1 { REGULAR } else { IRREGULAR }
}

/// A labyrinth of corridors `width` cells wide: a random walk that turns back where it is stuck (depth-first search) connects
/// all squares of a grid, then every twelfth of the walls that are left is opened. What is too narrow for a corridor at the right
/// and at the bottom is wall.
pub(super) fn labyrinth(width: usize, columns: usize, rows: usize, rng: &mut Stream) -> Map {
    drafted(moves(width), || {
        let grid = Grid { width, size: [(columns + 1) / (width + 1), (rows + 1) / (width + 1)] };
        let mut plan = Plan::new(columns, rows, false);
        let mut known = vec![false; grid.size[0] * grid.size[1]];
        let place = |[column, row]: Cell| row * grid.size[0] + column;
        let first = [below(rng, grid.size[0]), below(rng, grid.size[1])];
        known[place(first)] = true;
        grid.clear(&mut plan, first);
        let mut way = vec![first];
        while let Some(&square) = way.last() {
            let beside: Vec<Cell> = grid.beside(square).filter(|&next| !known[place(next)]).collect();
            if beside.is_empty() {
                way.pop();
                continue;
            }
            let next = beside[below(rng, beside.len())];
            known[place(next)] = true;
            grid.clear(&mut plan, next);
            grid.open(&mut plan, square, next);
            way.push(next);
        }
        for row in 0..grid.size[1] {
            for column in 0..grid.size[0] {
                for next in [[column + 1, row], [column, row + 1]] {
                    if next[0] < grid.size[0] && next[1] < grid.size[1] && below(rng, LOOPS) == 0 {
                        grid.open(&mut plan, [column, row], next);
                    }
                }
            }
        }
        plan
    })
}

/// Corridors `width` cells wide from side to side, each joined with the next one at alternate ends. Drawn: whether they run
/// across or down, at which side the first joint is, and how far each joint is from the side, up to an eighth of it.
pub(super) fn serpentine(width: usize, columns: usize, rows: usize, rng: &mut Stream) -> Map {
    drafted(moves(width), || {
        let (down, mirrored) = (below(rng, 2) == 1, below(rng, 2) == 1);
        let [long, short] = if down { [rows, columns] } else { [columns, rows] };
        let mut plan = Plan::new(columns, rows, false);
        let mut free = |along: usize, across: usize| {
            plan.set(if down { [across, along] } else { [along, across] }, true);
        };
        let count = (short + 1) / (width + 1);
        for corridor in 0..count {
            let top = corridor * (width + 1);
            for at in 0..width * long {
                free(at % long, top + at / long);
            }
            if corridor + 1 < count {
                let inset = below(rng, long / 8 + 1);
                let begin = if (corridor % 2 == 0) == mirrored { inset } else { long - width - inset };
                (0..width).for_each(|at| free(begin + at, top + width));
            }
        }
        plan
    })
}

/// Squares with a side of `width` cells and one cell of wall between them.
struct Grid {
    width: usize,
    size: [usize; 2],
}

impl Grid {
    fn corner(&self, square: Cell) -> Cell {
        square.map(|at| at * (self.width + 1))
    }

    /// Frees a square.
    fn clear(&self, plan: &mut Plan, square: Cell) {
        let [column, row] = self.corner(square);
        (0..self.width * self.width)
            .for_each(|i| plan.set([column + i % self.width, row + i / self.width], true));
    }

    /// Frees the wall between two squares side by side.
    fn open(&self, plan: &mut Plan, a: Cell, b: Cell) {
        let first = self.corner([a[0].min(b[0]), a[1].min(b[1])]);
        for i in 0..self.width {
            let [column, row] = first;
            plan.set(
                if a[0] == b[0] { [column + i, row + self.width] } else { [column + self.width, row + i] },
                true,
            );
        }
    }

    /// The squares beside one.
    fn beside(&self, [column, row]: Cell) -> impl Iterator<Item = Cell> {
        let all = [
            [column, row.wrapping_sub(1)],
            [column + 1, row],
            [column, row + 1],
            [column.wrapping_sub(1), row],
        ];
        let size = self.size;
        all.into_iter().filter(move |next| next[0] < size[0] && next[1] < size[1])
    }
}
