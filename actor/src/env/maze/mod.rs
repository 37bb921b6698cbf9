//! The two-dimensional maze: an agent on a map of cells, one cell a step, a goal that ends the episode.
//!
//! * [`Map`]: the text of a map, its cells, which moves are possible;
//! * [`ActionSet`]: the mentor's and the observer's compass directions;
//! * [`Maze`]: dynamics and rewards;
//! * [`Search`], [`mentor_path`]: shortest paths, hence the best return and the mentor's demonstration;
//! * [`generate`]: random mazes; [`draw`]: paths on a map, as text.

mod actions;
mod draw;
mod environment;
mod generate;
mod map;
mod search;
mod source;

pub use actions::{ActionSet, Direction, IRREGULAR, REGULAR, action_set};
pub use draw::{cells, draw};
pub use environment::{BLOCKED_REWARD, GOAL_REWARD, MOVE_REWARD, Maze, REVISIT_REWARD, map_of, plan_states};
pub use generate::{MIN_SIDE, generate};
pub use map::{Cell, Map, MapError, MapFault};
pub use search::{Search, mentor_path};
pub use source::resolve;

pub(in crate::env) use source::builtin_names;

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::map::Map;
    use proptest::prelude::*;

    /// Maps of 2 to 8 columns and rows with a third of their cells walls; the goal may be out of reach.
    pub(super) fn any_map() -> impl Strategy<Value = Map> {
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
