//! Random maps by seed. A map is a function of generator, seed and size alone.
//!
//! * `walls`: straight walls in an open hall, the generator `random`;
//! * `corridors`: a labyrinth or a serpentine of corridors of one width;
//! * `rooms`: rooms with doors; `cave`: a cellular automaton; `blocks`: single cells of wall;
//! * `gap`: a hall whose short way only some action sets can pass.

mod blocks;
mod cave;
mod corridors;
mod gap;
mod plan;
mod rooms;
mod walls;

use super::map::Map;
use trestle_proto::rng::{Purpose, below, stream};

/// Smallest side of a map of the generator `random`, cells.
const MIN_OPEN: usize = 4;
/// Smallest side of a map of those without corridors.
const MIN_SIDE: usize = 8;

/// A generator of maps. Each names the action sets with which the goal of its maps can be reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Generator {
    /// Straight walls in an open hall: regular and irregular.
    Random,
    /// A labyrinth of corridors this many cells wide, 1 to 3: regular, and from a width of 2 on irregular.
    Corridors(usize),
    /// One winding corridor this many cells wide, 1 to 3: regular, and from a width of 2 on irregular.
    Serpentine(usize),
    /// Rooms with doors: regular and irregular.
    Rooms,
    /// A cave: regular and irregular.
    Cave,
    /// Single cells of wall in an open hall: regular and irregular.
    Blocks,
    /// A hall with walls that regular agents pass along the edge, and irregular ones only at the far end: regular and
    /// irregular.
    Gap,
}

impl Generator {
    /// All of them, with their names in configurations and the index of their random streams, which never changes.
    pub const ALL: [(Self, &'static str, u64); 11] = [
        (Self::Random, "random", 0),
        (Self::Corridors(1), "corridors-1", 1),
        (Self::Corridors(2), "corridors-2", 2),
        (Self::Corridors(3), "corridors-3", 3),
        (Self::Serpentine(1), "serpentine-1", 4),
        (Self::Serpentine(2), "serpentine-2", 5),
        (Self::Serpentine(3), "serpentine-3", 6),
        (Self::Rooms, "rooms", 7),
        (Self::Cave, "cave", 8),
        (Self::Blocks, "blocks", 9),
        (Self::Gap, "gap", 10),
    ];

    /// The generator called `name`.
    pub fn of_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|(_, known, _)| *known == name).map(|(generator, ..)| generator)
    }

    /// Fewest columns and rows of its maps.
    pub fn min_side(self) -> usize {
        match self {
            Self::Random => MIN_OPEN,
            // Three corridors side by side.
            Self::Corridors(width) | Self::Serpentine(width) => 3 * width + 2,
            Self::Rooms | Self::Cave | Self::Blocks | Self::Gap => MIN_SIDE,
        }
    }

    /// Its map of `columns` x `rows` cells, each [`Self::min_side`] or more, by `seed`.
    pub fn generate(self, seed: u64, columns: usize, rows: usize) -> Map {
        let index = Self::ALL.into_iter().find(|(generator, ..)| *generator == self).map_or(0, |(.., i)| i);
        let rng = &mut stream(seed, Purpose::Map, index);
        match self {
            Self::Random => walls::generate(columns, rows, rng),
            Self::Corridors(width) => corridors::labyrinth(width, columns, rows, rng),
            Self::Serpentine(width) => corridors::serpentine(width, columns, rows, rng),
            Self::Rooms => rooms::generate(columns, rows, rng),
            Self::Cave => cave::generate(columns, rows, rng),
            Self::Blocks => blocks::generate(columns, rows, rng),
            Self::Gap => gap::generate(columns, rows, rng),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::actions::{ActionSet, Direction, IRREGULAR, REGULAR};
    use super::super::map::Cell;
    use super::super::search::Search;
    use super::*;
    use proptest::prelude::*;
    use trestle_proto::limits::MAX_MAP_SIDE;

    fn distance(map: &Map, set: &[Direction]) -> Option<u32> {
        Search::new(map, &ActionSet::new("", set)).distance(map.goal())
    }

    /// The sets that must reach the goal of a map of `generator`.
    fn sets(generator: Generator) -> Vec<&'static [Direction]> {
        match generator {
            Generator::Corridors(1) | Generator::Serpentine(1) => vec![REGULAR, &Direction::ALL],
            _ => vec![REGULAR, IRREGULAR, &Direction::ALL],
        }
    }

    proptest! {
        #[test]
        fn every_map_can_be_solved_and_is_its_seeds(
            which in 0..Generator::ALL.len(), seed in any::<u64>(), columns in 12usize..=40, rows in 12usize..=40,
        ) {
            let (generator, name, _) = Generator::ALL[which];
            let map = generator.generate(seed, columns, rows);
            prop_assert_eq!((map.columns(), map.rows()), (columns, rows));
            for set in sets(generator) {
                let moves = distance(&map, set);
                let least = match generator {
                    Generator::Random => 1,
                    Generator::Gap => columns - 1,
                    _ => (columns + rows) / 4,
                };
                prop_assert!(moves.is_some_and(|moves| moves as usize >= least), "{name} {moves:?}\n{map}");
            }
            prop_assert_eq!(Map::parse("m", &map.to_string()).unwrap(), generator.generate(seed, columns, rows));
        }

        #[test]
        fn a_corridor_is_as_wide_as_it_is_called(
            width in 1usize..=3, winding in any::<bool>(), seed in any::<u64>(), columns in 12usize..=40, rows in 12usize..=40,
        ) {
            let generator = if winding { Generator::Serpentine(width) } else { Generator::Corridors(width) };
            let map = generator.generate(seed, columns, rows);
            let free = |[c, r]: Cell, w: usize| (0..w * w).all(|i| map.is_free([c + i % w, r + i / w]));
            let cells = (0..columns * rows).map(|i| [i % columns, i / columns]);
            // Every free cell is part of a free square as wide as the corridors, and there is none that is wider.
            for cell in cells.clone().filter(|&cell| map.is_free(cell)) {
                let around = (0..width * width).filter_map(|i| Some([cell[0].checked_sub(i % width)?, cell[1].checked_sub(i / width)?]));
                prop_assert!(around.into_iter().any(|corner| free(corner, width)), "{cell:?}\n{map}");
            }
            prop_assert!(!cells.into_iter().any(|cell| free(cell, width + 1)), "{map}");
        }
    }

    #[test]
    fn names_are_found_and_streams_differ() {
        for (at, (generator, name, index)) in Generator::ALL.into_iter().enumerate() {
            assert_eq!((Generator::of_name(name), index), (Some(generator), at as u64));
            let maps: Vec<Map> = (0..20).map(|seed| generator.generate(seed, 20, 20)).collect();
            assert!(maps.iter().all(|map| map.free_cells() < 400), "{name}");
            assert!((1..20).any(|seed| maps[seed] != maps[0]), "{name}");
        }
        assert_eq!(Generator::of_name("labyrinth"), None);
    }

    #[test]
    fn the_smallest_and_the_largest_sizes_work() {
        for (generator, name, _) in Generator::ALL {
            let small = generator.min_side();
            for (columns, rows) in [(small, small), (small, MAX_MAP_SIDE), (MAX_MAP_SIDE, MAX_MAP_SIDE)] {
                let map = generator.generate(1, columns, rows);
                for set in sets(generator) {
                    assert!(distance(&map, set).is_some(), "{name} {columns}x{rows}");
                }
            }
        }
    }

    /// A regular agent goes straight through every gap, and an irregular one has to go round.
    #[test]
    fn only_the_mentor_passes_the_gap() {
        for seed in 0..50 {
            let map = Generator::Gap.generate(seed, 16, 14);
            assert_eq!(distance(&map, REGULAR), Some(15), "{map}");
            assert!(distance(&map, IRREGULAR).unwrap() >= 15 + 2 * 7, "{map}");
        }
    }
}
