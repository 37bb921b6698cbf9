//! Random mazes by seed: walls in an open rectangle, the goal within reach of both built-in action sets.

use super::actions::{ActionSet, IRREGULAR, REGULAR};
use super::map::Map;
use super::search::connects;
use rand::RngCore;
use trestle_proto::rng::Stream;

/// Smallest side of a generated maze, cells.
pub const MIN_SIDE: usize = 4;
/// Most wall segments that are tried. Each one costs two searches of the map, so this bounds the time of the largest
/// maps; the benchmark's 30 x 30 maze has four segments.
const MAX_SEGMENTS: usize = 64;

/// A maze of `columns` x `rows` cells, each [`MIN_SIDE`] or more, with the start at the top left and the goal at the
/// bottom right. It is a function of the size and of the state of `rng` alone.
///
/// Straight wall segments are laid one by one, about one for every eight cells of the two sides together, half of
/// them vertical, a quarter to three quarters of the side long, half of them from an edge of the map. A segment that
/// would cut the goal off from the start, with the regular or the irregular action set, is taken back. Draws for each
/// segment: direction, length, column, row, edge.
pub fn generate(columns: usize, rows: usize, rng: &mut Stream) -> Map {
    let sets = [ActionSet::new("regular", REGULAR), ActionSet::new("irregular", IRREGULAR)];
    let mut map = Map::open(columns, rows);
    for _ in 0..((columns + rows) / 8).clamp(2, MAX_SEGMENTS) {
        let vertical = below(rng, 2) == 1;
        let side = if vertical { rows } else { columns };
        let length = side / 4 + below(rng, side / 2 + 1);
        let mut column = below(rng, columns + 1 - if vertical { 1 } else { length });
        let mut row = below(rng, rows + 1 - if vertical { length } else { 1 });
        let along = if vertical { &mut row } else { &mut column };
        match below(rng, 4) {
            0 => *along = 0,
            1 => *along = side - length,
            _ => {}
        }
        let before = map.clone();
        for i in 0..length {
            let cell = if vertical { [column, row + i] } else { [column + i, row] };
            if cell != map.start() && cell != map.goal() {
                map.set_wall(cell, true);
            }
        }
        if !sets.iter().all(|set| connects(&map, set)) {
            map = before;
        }
    }
    map
}

/// A number in `0..n` from one word of `rng`; `n` is a number of cells, so that the bias is below 2^-21.
fn below(rng: &mut Stream, n: usize) -> usize {
    ((u64::from(rng.next_u32()) * n as u64) >> 32) as usize
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::search::Search;
    use super::*;
    use proptest::prelude::*;
    use trestle_proto::limits::MAX_MAP_SIDE;
    use trestle_proto::rng::{Purpose, stream};

    fn by_seed(seed: u64, columns: usize, rows: usize) -> Map {
        generate(columns, rows, &mut stream(seed, Purpose::Map, 0))
    }

    fn solvable(map: &Map) -> bool {
        [REGULAR, IRREGULAR]
            .iter()
            .all(|set| Search::new(map, &ActionSet::new("", set)).distance(map.goal()).is_some())
    }

    proptest! {
        #[test]
        fn every_maze_is_solvable_and_repeatable(seed in any::<u64>(), columns in 4usize..40, rows in 4usize..40) {
            let map = by_seed(seed, columns, rows);
            prop_assert!(solvable(&map));
            prop_assert_eq!((map.columns(), map.rows()), (columns, rows));
            prop_assert_eq!((map.start(), map.goal()), ([0, 0], [columns - 1, rows - 1]));
            prop_assert_eq!(Map::parse("m", &map.to_string()).unwrap(), by_seed(seed, columns, rows));
        }
    }

    #[test]
    fn mazes_differ_by_seed_and_have_walls() {
        let maps: Vec<Map> = (0..20).map(|seed| by_seed(seed, 20, 20)).collect();
        assert!(maps.iter().all(|map| map.free_cells() < 400));
        assert!(maps.windows(2).all(|pair| pair[0] != pair[1]));
    }

    #[test]
    fn the_largest_size_works() {
        assert!(solvable(&by_seed(1, MAX_MAP_SIDE, MAX_MAP_SIDE)));
        assert!(solvable(&by_seed(1, MIN_SIDE, MAX_MAP_SIDE)));
    }
}
