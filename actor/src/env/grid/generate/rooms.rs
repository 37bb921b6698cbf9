//! Rooms with doors: a hall that walls divide again and again.

use super::super::actions::IRREGULAR;
use super::super::map::Map;
use super::below;
use super::plan::{Plan, drafted};
use trestle_proto::rng::Stream;

/// Smallest side of a room, cells.
const MIN_ROOM: usize = 3;
/// A room whose sides are no longer than this is divided only half of the time.
const SMALL: usize = 8;

/// A part of the map: its corner and size, [along the columns, along the rows].
#[derive(Clone, Copy)]
struct Room {
    corner: [usize; 2],
    size: [usize; 2],
}

/// A hall divided by walls one cell thick, across the longer side, until rooms are small. A wall has one or two doors, each one
/// or two cells wide. No wall ends at a door of another.
pub(super) fn generate(columns: usize, rows: usize, rng: &mut Stream) -> Map {
    drafted(IRREGULAR, || {
        let mut plan = Plan::new(columns, rows, true);
        let mut waiting = vec![Room { corner: [0, 0], size: [columns, rows] }];
        while let Some(room) = waiting.pop() {
            waiting.extend(divide(&mut plan, room, rng).into_iter().flatten());
        }
        plan
    })
}

/// Builds a wall through `room`, if there is a place for it; the two rooms at its sides.
fn divide(plan: &mut Plan, room: Room, rng: &mut Stream) -> Option<[Room; 2]> {
    let Room { corner, size } = room;
    // The wall runs across this axis and along the other.
    let axis = usize::from(size[1] > size[0] || size[1] == size[0] && below(rng, 2) == 1);
    let other = 1 - axis;
    let small = size[axis] <= SMALL;
    if size[axis] < 2 * MIN_ROOM + 1 || small && below(rng, 2) == 0 {
        return None;
    }
    let cell = |across: usize, along: usize| {
        let mut cell = [0, 0];
        (cell[axis], cell[other]) = (across, along);
        cell
    };
    let [low, high] = [corner[other], corner[other] + size[other]];
    let limit = [plan.columns, plan.rows][other];
    // Beyond either end there is the edge of the map or a wall.
    let closed = |across: usize| {
        (low == 0 || !plan.is_free(cell(across, low - 1)))
            && (high == limit || !plan.is_free(cell(across, high)))
    };
    let places: Vec<usize> =
        (corner[axis] + MIN_ROOM..corner[axis] + size[axis] - MIN_ROOM).filter(|&at| closed(at)).collect();
    if places.is_empty() {
        return None;
    }
    let across = places[below(rng, places.len())];
    (low..high).for_each(|along| plan.set(cell(across, along), false));
    for _ in 0..1 + below(rng, 2) {
        let wide = 1 + below(rng, 2);
        let at = low + below(rng, size[other] + 1 - wide);
        (at..at + wide).for_each(|along| plan.set(cell(across, along), true));
    }
    let part = |from: usize, to: usize| {
        let mut part = room;
        (part.corner[axis], part.size[axis]) = (from, to - from);
        part
    };
    Some([part(corner[axis], across), part(across + 1, corner[axis] + size[axis])])
}
