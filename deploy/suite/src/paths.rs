//! Paths through a map of cells.

use std::collections::VecDeque;
use trestle_actor::env::grid::{ActionSet, Cell, Map, Search};
use trestle_proto::rng::{Stream, below};

/// Distance from walls beyond which a cell is no freer, cells.
const CLEAR: u32 = 3;

/// Which of all shortest paths is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ties {
    /// The one that is nearest to walls: the least sum of its cells' distances from them.
    Hugging,
    /// The one that is farthest from walls.
    Free,
    /// At each cell one of the next cells by chance.
    Mixed,
}

/// A map with the moves of one action set.
pub struct Paths<'a> {
    map: &'a Map,
    /// Moves that are left to the goal, by row and column; none where there is no way.
    left: Vec<Option<u32>>,
    /// Moves that lead to each cell: the cells before it.
    before: Vec<Vec<Cell>>,
    set: &'a ActionSet,
}

impl<'a> Paths<'a> {
    /// The ways of an agent that acts with `set` on `map`. None leads through the goal.
    pub fn new(map: &'a Map, set: &'a ActionSet) -> Self {
        let mut paths = Self { map, left: vec![None; size(map)], before: vec![Vec::new(); size(map)], set };
        for cell in cells(map).filter(|&cell| map.is_free(cell)) {
            for next in paths.after(cell) {
                paths.before[place(map, next)].push(cell);
            }
        }
        paths.left = paths.distances(map.goal());
        paths
    }

    /// The cells that one move leads to, in the order of the action set; none from the goal.
    fn after(&self, cell: Cell) -> Vec<Cell> {
        let moves = self.set.directions.iter().filter(|_| cell != self.map.goal());
        moves.filter_map(|&direction| self.map.neighbour(cell, direction)).collect()
    }

    /// Fewest moves from each cell to `target`.
    fn distances(&self, target: Cell) -> Vec<Option<u32>> {
        let mut far = vec![None; size(self.map)];
        far[place(self.map, target)] = Some(0);
        let mut open = VecDeque::from([(target, 0)]);
        while let Some((cell, moves)) = open.pop_front() {
            for &before in &self.before[place(self.map, cell)] {
                let known = &mut far[place(self.map, before)];
                if known.is_none() {
                    *known = Some(moves + 1);
                    open.push_back((before, moves + 1));
                }
            }
        }
        far
    }

    /// Fewest moves from the start to the goal; none if there is no way.
    pub fn moves(&self) -> Option<u32> {
        self.left[place(self.map, self.map.start())]
    }

    /// A shortest path from the start to the goal, both included. `rng` decides between paths that `ties` does not tell apart,
    /// or between all. None if there is no way.
    pub fn shortest(&self, ties: Ties, rng: &mut Stream) -> Option<Vec<Cell>> {
        self.moves()?;
        Some(self.down(self.map.start(), &self.left, ties, rng))
    }

    /// A shortest path from `from` to where `left` is 0.
    fn down(&self, from: Cell, left: &[Option<u32>], ties: Ties, rng: &mut Stream) -> Vec<Cell> {
        let freedom = self.freedom(left, ties);
        let mut path = vec![from];
        let mut at = from;
        while let Some(moves) = left[place(self.map, at)].filter(|&moves| moves > 0) {
            let next: Vec<Cell> = self
                .after(at)
                .into_iter()
                .filter(|&next| left[place(self.map, next)] == Some(moves - 1))
                .collect();
            let best = next.iter().map(|&next| freedom[place(self.map, next)]).min();
            let best: Vec<Cell> =
                next.into_iter().filter(|&next| Some(freedom[place(self.map, next)]) == best).collect();
            at = best[below(rng, best.len())];
            path.push(at);
        }
        path
    }

    /// What `ties` makes of the best shortest path from each cell, the least first: the sum over its cells of their distance from
    /// walls, or of what they lack in it, or nothing.
    fn freedom(&self, left: &[Option<u32>], ties: Ties) -> Vec<u32> {
        let own = |cell: Cell| match ties {
            Ties::Hugging => self.clearance(cell),
            Ties::Free => CLEAR - self.clearance(cell),
            Ties::Mixed => 0,
        };
        let mut order: Vec<(u32, Cell)> =
            cells(self.map).filter_map(|cell| Some((left[place(self.map, cell)]?, cell))).collect();
        order.sort_unstable();
        let mut freedom = vec![0; size(self.map)];
        for (moves, cell) in order {
            let nearer = self
                .after(cell)
                .into_iter()
                .filter(|&next| moves > 0 && left[place(self.map, next)] == Some(moves - 1));
            let rest = nearer.map(|next| freedom[place(self.map, next)]).min().unwrap_or(0);
            freedom[place(self.map, cell)] = own(cell) + rest;
        }
        freedom
    }

    /// Cells between `cell` and the nearest wall or edge, diagonals counted as one: 0 beside a wall, [`CLEAR`] at most.
    fn clearance(&self, [column, row]: Cell) -> u32 {
        let free = |radius: isize| {
            (-radius..=radius).all(|dx| {
                (-radius..=radius).all(|dy| {
                    let there = [column.wrapping_add_signed(dx), row.wrapping_add_signed(dy)];
                    self.map.is_free(there)
                })
            })
        };
        (1..=CLEAR as isize).take_while(|&radius| free(radius)).count() as u32
    }

    /// A path from the start to the goal by way of a cell that `rng` draws, on which the path is half as long again as the
    /// shortest one, or up to three times as long. If there is no such cell, that with the longest path is taken. None if there
    /// is no way at all.
    pub fn detour(&self, rng: &mut Stream) -> Option<Vec<Cell>> {
        let shortest = self.moves()?;
        let map = self.map;
        let from_start = Search::new(map, self.set);
        let by_way = cells(map)
            .filter(|&cell| cell != map.goal())
            .filter_map(|cell| Some((from_start.distance(cell)? + self.left[place(map, cell)]?, cell)));
        let ways: Vec<(u32, Cell)> = by_way.collect();
        let good: Vec<Cell> = ways
            .iter()
            .filter(|(moves, _)| (3 * shortest..=6 * shortest).contains(&(2 * moves)))
            .map(|&(_, cell)| cell)
            .collect();
        let way = match good.is_empty() {
            true => ways.into_iter().max()?.1,
            false => good[below(rng, good.len())],
        };
        let mut path = self.down(map.start(), &self.distances(way), Ties::Mixed, rng);
        path.extend(self.down(way, &self.left, Ties::Mixed, rng).into_iter().skip(1));
        Some(path)
    }

    /// A walk of `moves` moves from the start, each drawn from those that are possible and do not end at the goal. It ends early
    /// where there is none.
    pub fn walk(&self, moves: u32, rng: &mut Stream) -> Vec<Cell> {
        let mut path = vec![self.map.start()];
        for at in 0..moves as usize {
            let next: Vec<Cell> =
                self.after(path[at]).into_iter().filter(|&next| next != self.map.goal()).collect();
            if next.is_empty() {
                break;
            }
            path.push(next[below(rng, next.len())]);
        }
        path
    }

    /// `jumps` jumps from the start to the goal over free cells that `rng` draws. Each jump leads over three cells or more where
    /// the map is large enough, so no agent that moves from cell to cell can follow.
    pub fn leaps(&self, jumps: u32, rng: &mut Stream) -> Vec<Cell> {
        /// Draws of a cell before the last one is taken.
        const DRAWS: usize = 64;
        let (start, goal) = (self.map.start(), self.map.goal());
        let free: Vec<Cell> =
            cells(self.map).filter(|&cell| self.map.is_free(cell) && cell != start && cell != goal).collect();
        let far = |a: Cell, b: Cell| a[0].abs_diff(b[0]).max(a[1].abs_diff(b[1])) >= 3;
        let mut path = vec![start];
        for jump in 1..jumps {
            if free.is_empty() {
                break;
            }
            let last = path[path.len() - 1];
            let fits = |&cell: &Cell| far(last, cell) && (jump + 1 < jumps || far(cell, goal));
            let mut cell = free[below(rng, free.len())];
            for _ in 0..DRAWS {
                if fits(&cell) {
                    break;
                }
                cell = free[below(rng, free.len())];
            }
            path.push(cell);
        }
        path.push(goal);
        path
    }
}

fn size(map: &Map) -> usize {
    map.columns() * map.rows()
}

fn place(map: &Map, [column, row]: Cell) -> usize {
    row * map.columns() + column
}

fn cells(map: &Map) -> impl Iterator<Item = Cell> + use<> {
    let columns = map.columns();
    (0..size(map)).map(move |i| [i % columns, i / columns])
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;
    use trestle_actor::env::grid::{Generator, IRREGULAR, REGULAR};
    use trestle_proto::rng::{Purpose, stream};

    fn rng(seed: u64) -> Stream {
        stream(seed, Purpose::Demonstration, 0)
    }

    /// Whether each step of `path` is a move of `set`, none of them from the goal.
    fn is_walk(map: &Map, set: &ActionSet, path: &[Cell]) -> bool {
        path.windows(2).all(|pair| {
            let mut moves = set.directions.iter().map(|&direction| map.neighbour(pair[0], direction));
            pair[0] != map.goal() && moves.any(|next| next == Some(pair[1]))
        })
    }

    #[test]
    fn ties_decide_how_near_a_path_is_to_walls() {
        let text = "S......\n.......\n.......\n...#...\n.......\n.......\n......G\n";
        let map = Map::parse("m", text).unwrap();
        let set = ActionSet::new("regular", REGULAR);
        let paths = Paths::new(&map, &set);
        let hugging = paths.shortest(Ties::Hugging, &mut rng(0)).unwrap();
        assert!(hugging.iter().all(|&cell| paths.clearance(cell) == 0), "{hugging:?}");
        let sum = |path: &[Cell]| path.iter().map(|&cell| paths.clearance(cell)).sum::<u32>();
        let free = paths.shortest(Ties::Free, &mut rng(0)).unwrap();
        assert!(sum(&free) >= 9, "{free:?}");
        let mixed: Vec<_> = (0..9).map(|seed| paths.shortest(Ties::Mixed, &mut rng(seed)).unwrap()).collect();
        assert!(mixed.windows(2).any(|pair| pair[0] != pair[1]));
    }

    proptest! {
        #[test]
        fn paths_are_what_they_are_called(
            which in 0..Generator::ALL.len(), seed in any::<u64>(), columns in 12usize..30, rows in 12usize..30, regular in any::<bool>(),
        ) {
            let map = Generator::ALL[which].0.generate(seed, columns, rows);
            let set = ActionSet::new("", if regular { REGULAR } else { IRREGULAR });
            let paths = Paths::new(&map, &set);
            let moves = Search::new(&map, &set).distance(map.goal());
            prop_assert_eq!(paths.moves(), moves);
            let Some(moves) = moves.map(|moves| moves as usize) else { return Ok(()) };
            for ties in [Ties::Hugging, Ties::Free, Ties::Mixed] {
                let path = paths.shortest(ties, &mut rng(seed)).unwrap();
                prop_assert_eq!((path.len(), path[0], path[moves]), (moves + 1, map.start(), map.goal()));
                prop_assert!(is_walk(&map, &set, &path));
            }
            let detour = paths.detour(&mut rng(seed)).unwrap();
            prop_assert!(is_walk(&map, &set, &detour) && detour.last() == Some(&map.goal()));
            prop_assert!(detour[0] == map.start() && detour.len() > moves && detour.len() <= 3 * moves + 1);
            let walk = paths.walk(99, &mut rng(seed));
            prop_assert!(is_walk(&map, &set, &walk) && walk.len() == 100 && !walk.contains(&map.goal()));
            let leaps = paths.leaps(6, &mut rng(seed));
            prop_assert_eq!((leaps.len(), leaps[0], leaps[6]), (7, map.start(), map.goal()));
            prop_assert!(leaps.iter().all(|&cell| map.is_free(cell)));
            let short = |pair: &[Cell]| pair[0][0].abs_diff(pair[1][0]).max(pair[0][1].abs_diff(pair[1][1])) < 3;
            prop_assert!(leaps.windows(2).filter(|pair| short(pair)).count() == 0, "{leaps:?}");
        }
    }
}
