//! Single cells of wall in an open hall.

use super::super::actions::IRREGULAR;
use super::super::map::Map;
use super::below;
use super::plan::{Plan, drafted};
use trestle_proto::rng::Stream;

/// Of a hundred cells so many are walls.
const WALLS: usize = 22;

/// A hall in which about one cell in five is a wall.
pub(super) fn generate(columns: usize, rows: usize, rng: &mut Stream) -> Map {
    drafted(IRREGULAR, || {
        let mut plan = Plan::new(columns, rows, true);
        plan.cells().for_each(|cell| plan.set(cell, below(rng, 100) >= WALLS));
        plan
    })
}
