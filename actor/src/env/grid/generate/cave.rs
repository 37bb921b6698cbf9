//! A cave by a cellular automaton.

use super::super::actions::IRREGULAR;
use super::super::map::Map;
use super::below;
use super::plan::{Plan, drafted};
use trestle_proto::rng::Stream;

/// Of a hundred cells so many begin as walls.
const WALLS: usize = 43;
/// How often the automaton runs.
const ROUNDS: usize = 4;
/// From so many walls among the eight neighbours on a cell becomes one. What lies outside counts as wall.
const MANY: usize = 5;

/// A cave: walls at random, then rounds in which each cell becomes what most of its neighbours are. Pockets without a way to
/// the rest stay.
pub(super) fn generate(columns: usize, rows: usize, rng: &mut Stream) -> Map {
    drafted(IRREGULAR, || {
        let mut plan = Plan::new(columns, rows, true);
        plan.cells().for_each(|cell| plan.set(cell, below(rng, 100) >= WALLS));
        for _ in 0..ROUNDS {
            let before = plan.clone();
            for cell in before.cells() {
                let walls = walls_around(&before, cell);
                if walls != MANY - 1 {
                    plan.set(cell, walls < MANY);
                }
            }
        }
        plan
    })
}

/// Walls among the eight neighbours of a cell.
fn walls_around(plan: &Plan, [column, row]: [usize; 2]) -> usize {
    let around =
        (0..9).filter(|&i| i != 4).map(|i| [(column + i % 3).wrapping_sub(1), (row + i / 3).wrapping_sub(1)]);
    around.filter(|&[c, r]| c >= plan.columns || r >= plan.rows || !plan.is_free([c, r])).count()
}
