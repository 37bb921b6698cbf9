//! Maps of cells, which several environments share: the text of a map and where it comes from, compass directions and action
//! sets made of them, shortest paths, random maps.
//!
//! * [`Map`]: the text of a map, its cells, which moves are possible; [`resolve`]: where it comes from; [`foreign`]: those of others;
//! * [`ActionSet`]: compass directions under a name; [`ActionSets`]: those that a configuration can name;
//! * [`Search`], [`mentor_path`]: shortest paths; [`Generator`]: random maps.

mod actions;
mod error;
pub mod foreign;
mod generate;
mod map;
mod search;
mod source;

pub use actions::{ActionSet, ActionSets, Direction, IRREGULAR, REGULAR};
pub use error::GridError;
pub use generate::Generator;
pub use map::{Cell, Map, MapError, MapFault};
pub(in crate::env) use map::{Index, Move};
pub use search::{Search, mentor_path};
pub use source::{ACCEPTED, map_of, resolve};

#[cfg(test)]
pub(in crate::env) mod tests {
    #![allow(clippy::unwrap_used)]
    use super::map::Map;
    use proptest::prelude::*;

    /// Maps of 2 to 8 columns and rows with a third of their cells walls; the goal may be out of reach.
    pub(in crate::env) fn any_map() -> impl Strategy<Value = Map> {
        (2usize..=8, 2usize..=8)
            .prop_flat_map(|(columns, rows)| {
                let walls = prop::collection::vec(prop::bool::weighted(0.3), columns * rows);
                let ends = prop::sample::subsequence((0..columns * rows).collect::<Vec<_>>(), 2);
                (Just(columns), walls, ends, any::<bool>())
            })
            .prop_map(|(columns, walls, ends, swapped)| {
                let mut letters: Vec<char> = walls.iter().map(|&wall| if wall { '#' } else { '.' }).collect();
                letters[ends[usize::from(swapped)]] = 'S';
                letters[ends[usize::from(!swapped)]] = 'G';
                let lines = letters.chunks(columns).map(|line| line.iter().collect::<String>() + "\n");
                Map::parse("any", &lines.collect::<String>()).unwrap()
            })
    }
}
