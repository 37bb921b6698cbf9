//! Straight walls in an open rectangle, the goal within reach of both built-in action sets.

use super::super::actions::{ActionSet, IRREGULAR, REGULAR};
use super::super::map::Map;
use super::super::search::connects;
use super::below;
use trestle_proto::rng::Stream;

/// Most wall segments that are tried. Each one costs two searches of the map, so this bounds the time of the largest
/// maps; the benchmark's 30 x 30 maze has four segments.
const MAX_SEGMENTS: usize = 64;

/// A maze of `columns` x `rows` cells, each 4 or more, with the start at the top left and the goal at the
/// bottom right. It is a function of the size and of the state of `rng` alone.
///
/// Straight wall segments are laid one by one, about one for every eight cells of the two sides together, half of
/// them vertical, a quarter to three quarters of the side long, half of them from an edge of the map. A segment that
/// would cut the goal off from the start, with the regular or the irregular action set, is taken back. Draws for each
/// segment: direction, length, column, row, edge.
pub(super) fn generate(columns: usize, rows: usize, rng: &mut Stream) -> Map {
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

#[cfg(test)]
mod tests {
    use super::*;
    use trestle_proto::rng::{Purpose, stream};

    #[test]
    fn an_open_hall_goes_from_corner_to_corner() {
        let maps: Vec<Map> =
            (0..20).map(|seed| generate(20, 18, &mut stream(seed, Purpose::Map, 0))).collect();
        assert!(maps.iter().all(|map| map.free_cells() < 360));
        assert!(maps.windows(2).all(|pair| pair[0] != pair[1]));
        assert!(maps.iter().all(|map| (map.start(), map.goal()) == ([0, 0], [19, 17])));
    }
}
