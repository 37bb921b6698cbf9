//! Breadth-first search on a map with any action set: shortest paths, the mentor's path, the best return.

use super::actions::ActionSet;
use super::map::{Cell, Map, MapError, MapFault};
use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};

/// Marks a cell that cannot be reached.
const FAR: u32 = u32::MAX;

/// Shortest paths from the start to every cell.
pub struct Search<'a> {
    map: &'a Map,
    /// Moves from the start, or [`FAR`]; by bordered index.
    moves: Vec<u32>,
    /// The cell before on the path, by bordered index.
    before: Vec<u32>,
}

impl<'a> Search<'a> {
    /// Searches `map` from its start with the moves of `set`.
    ///
    /// Cells are expanded in the order in which they were found, their moves in the order of the action set. So of
    /// all shortest paths to a cell the one that is first by the order of its actions is kept. As the goal ends an
    /// episode, no path leads through it.
    pub fn new(map: &'a Map, set: &ActionSet) -> Self {
        let steps = map.moves(&set.directions);
        let (start, goal) = (map.index(map.start()), map.index(map.goal()));
        let mut moves = vec![FAR; map.indices()];
        let mut before = vec![FAR; map.indices()];
        let mut queue = VecDeque::from([start]);
        moves[start] = 0;
        while let Some(at) = queue.pop_front() {
            if at == goal {
                continue;
            }
            for &step in &steps {
                if let Some(next) = map.advance(at, step)
                    && moves[next] == FAR
                {
                    moves[next] = moves[at] + 1;
                    before[next] = at as u32;
                    queue.push_back(next);
                }
            }
        }
        Self { map, moves, before }
    }

    /// Moves on a shortest path from the start to `cell`; `None` if it is no free cell or cannot be reached.
    pub fn distance(&self, cell: Cell) -> Option<u32> {
        self.map.is_free(cell).then(|| self.moves[self.map.index(cell)]).filter(|&moves| moves != FAR)
    }

    /// The shortest path to `cell`, from the start, both included: see [`Search::new`] for which one. `None` if there
    /// is none.
    pub fn path(&self, cell: Cell) -> Option<Vec<Cell>> {
        let length = self.distance(cell)?;
        let mut at = self.map.index(cell);
        let mut path = vec![cell];
        for _ in 0..length {
            at = self.before[at] as usize;
            path.push(self.map.cell(at));
        }
        path.reverse();
        Some(path)
    }
}

/// Whether a path leads from the start of `map` to its goal with the moves of `set`: what [`Search::distance`] says, without the
/// distance. It looks at the cells that are nearest to the goal first, so that on an open map it meets few of them.
pub(super) fn connects(map: &Map, set: &ActionSet) -> bool {
    let steps = map.moves(&set.directions);
    let far = |index| {
        let ([column, row], goal) = (map.cell(index), map.goal());
        Reverse(column.abs_diff(goal[0]) + row.abs_diff(goal[1]))
    };
    let (start, goal) = (map.index(map.start()), map.index(map.goal()));
    let mut seen = vec![false; map.indices()];
    seen[start] = true;
    let mut open = BinaryHeap::from([(far(start), start)]);
    while let Some((_, at)) = open.pop() {
        if at == goal {
            return true;
        }
        for next in steps.iter().filter_map(|&step| map.advance(at, step)) {
            if !std::mem::replace(&mut seen[next], true) {
                open.push((far(next), next));
            }
        }
    }
    false
}

/// The path of an optimal agent that acts with `set`, from the start to the goal, both included: the shortest one,
/// ties broken in the order of the action set. `origin` names the map in the error.
///
/// # Errors
/// The goal cannot be reached with `set`.
pub fn mentor_path(origin: &str, map: &Map, set: &ActionSet) -> Result<Vec<Cell>, MapError> {
    Search::new(map, set).path(map.goal()).ok_or_else(|| MapError {
        origin: origin.into(),
        line: map.goal()[1] + 1,
        column: map.goal()[0] + 1,
        fault: MapFault::Unreachable {
            line: map.start()[1] + 1,
            column: map.start()[0] + 1,
            actions: set.describe(),
            set: set.name.clone(),
        },
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::actions::{Direction, IRREGULAR, REGULAR};
    use super::super::tests::any_map;
    use super::*;
    use proptest::prelude::*;

    fn maze30() -> Map {
        Map::parse("maze30", include_str!("../../../maps/maze30.txt")).unwrap()
    }

    #[test]
    fn maze30_has_the_known_shortest_paths() {
        let map = maze30();
        assert_eq!(map.free_cells(), 827);
        for (name, directions, moves) in [("regular", REGULAR, 96), ("irregular", IRREGULAR, 111)] {
            let search = Search::new(&map, &ActionSet::new(name, directions));
            assert_eq!(search.distance(map.goal()), Some(moves));
            assert_eq!(search.moves.iter().filter(|&&moves| moves != FAR).count(), 827, "all can be reached");
            assert_eq!(search.path(map.goal()).unwrap().len(), moves as usize + 1);
        }
    }

    #[test]
    fn maze_small_has_the_documented_shortest_paths() {
        let map = Map::parse("maze-small", include_str!("../../../maps/maze-small.txt")).unwrap();
        let moves = |directions| Search::new(&map, &ActionSet::new("", directions)).distance(map.goal());
        assert_eq!((moves(REGULAR), moves(IRREGULAR)), (Some(34), Some(35)));
    }

    #[test]
    fn ties_go_to_the_first_action() {
        let map = Map::open(3, 3);
        let path =
            |directions: &[Direction]| mentor_path("m", &map, &ActionSet::new("", directions)).unwrap();
        assert_eq!(path(REGULAR), [[0, 0], [1, 0], [2, 0], [2, 1], [2, 2]]);
        assert_eq!(path(&[Direction::S, Direction::E]), [[0, 0], [0, 1], [0, 2], [1, 2], [2, 2]]);
    }

    #[test]
    fn an_unreachable_goal_is_named() {
        let map = Map::parse("m", "S#\n#G\n").unwrap();
        let message = mentor_path("m", &map, &ActionSet::new("regular", REGULAR)).unwrap_err().to_string();
        assert!(message.starts_with("map m, line 2, column 2: the goal `G` cannot be reached"), "{message}");
        assert!(
            message.contains("(line 1, column 1) with the actions N, E, S, W of the set `regular`"),
            "{message}"
        );
    }

    /// Distances by relaxing every move of every cell until nothing changes.
    fn naive(map: &Map, directions: &[Direction]) -> Vec<Option<u32>> {
        let cells: Vec<Cell> =
            (0..map.rows()).flat_map(|row| (0..map.columns()).map(move |column| [column, row])).collect();
        let mut far = vec![None; cells.len()];
        let place = |cell: Cell| cell[1] * map.columns() + cell[0];
        far[place(map.start())] = Some(0);
        loop {
            let old = far.clone();
            for &cell in cells.iter().filter(|&&cell| cell != map.goal()) {
                let Some(here) = far[place(cell)] else { continue };
                for step in map.moves(directions) {
                    if let Some(next) = map.advance(map.index(cell), step) {
                        let there = &mut far[place(map.cell(next))];
                        *there = Some(there.map_or(here + 1, |known: u32| known.min(here + 1)));
                    }
                }
            }
            if far == old {
                return far;
            }
        }
    }

    proptest! {
        #[test]
        fn distances_are_those_of_relaxation(map in any_map(), regular in any::<bool>()) {
            let directions = if regular { REGULAR } else { IRREGULAR };
            let search = Search::new(&map, &ActionSet::new("", directions));
            let found: Vec<_> = (0..map.rows() * map.columns())
                .map(|i| search.distance([i % map.columns(), i / map.columns()]))
                .collect();
            prop_assert_eq!(found, naive(&map, directions));
            let set = ActionSet::new("", directions);
            prop_assert_eq!(connects(&map, &set), search.distance(map.goal()).is_some());
        }

        /// No shortest path is earlier by the order of its actions: at each cell of the path, no earlier action
        /// leads to a cell from which the goal is as near.
        #[test]
        fn the_path_is_the_first_by_the_order_of_actions(map in any_map(), regular in any::<bool>()) {
            let set = ActionSet::new("", if regular { REGULAR } else { IRREGULAR });
            let Ok(path) = mentor_path("m", &map, &set) else { return Ok(()) };
            for (i, pair) in path.windows(2).enumerate() {
                let left = path.len() - 1 - i;
                let best = map.moves(&set.directions).into_iter().find_map(|step| {
                    let next = map.cell(map.advance(map.index(pair[0]), step)?);
                    let rest = if next == map.goal() {
                        0
                    } else {
                        let moved = Map::parse("m", &restarted(&map, next)).unwrap();
                        Search::new(&moved, &set).distance(map.goal())?
                    };
                    (rest as usize == left - 1).then_some(next)
                });
                prop_assert_eq!(best, Some(pair[1]));
            }
        }
    }

    /// The text of `map` with its start at `cell`.
    fn restarted(map: &Map, cell: Cell) -> String {
        let mut rows: Vec<Vec<char>> = map.to_string().lines().map(|line| line.chars().collect()).collect();
        rows[map.start()[1]][map.start()[0]] = '.';
        rows[cell[1]][cell[0]] = 'S';
        rows.iter().map(|row| row.iter().collect::<String>() + "\n").collect()
    }
}
