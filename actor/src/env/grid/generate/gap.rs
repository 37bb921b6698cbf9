//! A hall whose short way leads through gaps that an irregular agent cannot pass.

use super::super::map::{Cell, Map};
use super::below;
use trestle_proto::rng::Stream;

/// A wall for about every so many columns.
const APART: usize = 12;
/// Fewest rows that are open at the far end of a wall.
const OPENING: usize = 3;

/// Walls from the top to the bottom, one cell thick and about twelve apart. Each leaves one cell free at the edge where start and
/// goal are, and the last quarter of the rows at the other edge. Drawn: at which edge start and goal are, and the place of each
/// wall within two columns.
///
/// A regular agent walks straight along the edge. An irregular one moves along a row by NE and S, or by SW and N, so it cannot
/// pass where there is one row alone.
pub(super) fn generate(columns: usize, rows: usize, rng: &mut Stream) -> Map {
    let bottom = below(rng, 2) == 1;
    let turned = |[column, row]: Cell| [column, if bottom { rows - 1 - row } else { row }];
    let count = (columns / APART).max(1);
    let walls: Vec<usize> =
        (0..count).map(|i| (2 * i + 1) * columns / (2 * count) - 1 + below(rng, 3)).collect();
    let depth = rows - (rows / 4).max(OPENING);
    let wall = |[column, row]: Cell| walls.contains(&column) && (1..depth).contains(&row);
    Map::with(columns, rows, turned([0, 0]), turned([columns - 1, 0]), |cell| !wall(turned(cell)))
}
