//! The map of a maze: its text, its cells, and which moves are possible.
//!
//! One line a row, the top row first: `#` a wall, `.` a free cell, `S` the start, `G` the goal. Lines end with LF or
//! CRLF; the last one may lack its end. A byte-order mark, blank lines before and after the map, and blanks at the ends of
//! lines are no part of it.

use super::actions::Direction;
use std::fmt;
use trestle_proto::limits::MAX_MAP_SIDE;

/// A cell as [column, row], from [0, 0] at the top left.
pub type Cell = [usize; 2];

/// A text that is no usable map: where, and why.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("map {origin}, line {line}, column {column}: {fault}")]
pub struct MapError {
    /// Name or file of the map.
    pub origin: String,
    /// Line, from 1.
    pub line: usize,
    /// Column, from 1.
    pub column: usize,
    /// What is wrong there.
    pub fault: MapFault,
}

/// What is wrong at one place of a map.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MapFault {
    /// There is nothing.
    #[error("the map is empty; accepted: 1 to {MAX_MAP_SIDE} lines of 1 to {MAX_MAP_SIDE} characters")]
    Empty,
    /// More lines or columns than are accepted.
    #[error("the map is too large; accepted: up to {MAX_MAP_SIDE} lines of up to {MAX_MAP_SIDE} characters")]
    Large,
    /// A line of another length than the first.
    #[error("this line has {found} characters; accepted: {expected}, as the first one")]
    Ragged {
        /// Its length, characters.
        found: usize,
        /// Length of the first line.
        expected: usize,
    },
    /// A character that means nothing.
    #[error("{found:?}; accepted: # . S G; `trestle map import` reads other forms")]
    Unknown {
        /// The character.
        found: char,
    },
    /// Bytes that are no text.
    #[error("bytes that are not UTF-8 text; accepted: # . S G")]
    NotText,
    /// A second start or goal.
    #[error("a second `{letter}`, after that of line {line}, column {column}; accepted: exactly one")]
    Second {
        /// `S` or `G`.
        letter: char,
        /// Line of the first, from 1.
        line: usize,
        /// Column of the first, from 1.
        column: usize,
    },
    /// The map ends here without a start or goal.
    #[error("the map ends without a `{letter}`; accepted: exactly one")]
    Missing {
        /// `S` or `G`.
        letter: char,
    },
    /// There is no way to the goal.
    #[error(
        "the goal `G` cannot be reached from the start `S` (line {line}, column {column}) with the actions {actions} \
         of the set `{set}`"
    )]
    Unreachable {
        /// Line of the start, from 1.
        line: usize,
        /// Column of the start, from 1.
        column: usize,
        /// The directions that were tried.
        actions: String,
        /// Name of their set.
        set: String,
    },
}

/// A rectangular maze. Its cells are stored with a border of walls, so that no move needs a bounds test.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Map {
    columns: usize,
    rows: usize,
    start: Cell,
    goal: Cell,
    /// `(columns + 2) * (rows + 2)`, row-major.
    walls: Vec<bool>,
}

/// A cell's place in the bordered map; see [`Map::index`].
pub(in crate::env) type Index = usize;

/// A direction on one map's bordered cells: where it leads, and which two cells it passes between.
#[derive(Clone, Copy, Debug)]
pub(in crate::env) struct Move {
    target: isize,
    sides: [isize; 2],
}

impl Map {
    /// The map in `text`; `origin` names it in errors. Whether the goal can be reached is a question of the action
    /// set and is not asked here.
    ///
    /// # Errors
    /// The first fault, with line and column.
    pub fn parse(origin: &str, text: &str) -> Result<Self, MapError> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let all: Vec<&str> = text.split('\n').map(str::trim_end).collect();
        let first = all.iter().position(|line| !line.is_empty()).unwrap_or(0);
        let last = all.iter().rposition(|line| !line.is_empty()).unwrap_or(0);
        let lines = &all[first..=last];
        // The line is that of the text.
        let fault = |row: usize, column: usize, fault| MapError {
            origin: origin.into(),
            line: first + row + 1,
            column: column + 1,
            fault,
        };
        let columns = lines.first().map_or(0, |line| line.chars().count());
        if columns == 0 {
            return Err(fault(0, 0, MapFault::Empty));
        }
        if columns > MAX_MAP_SIDE {
            return Err(fault(0, MAX_MAP_SIDE, MapFault::Large));
        }
        if lines.len() > MAX_MAP_SIDE {
            return Err(fault(MAX_MAP_SIDE, 0, MapFault::Large));
        }
        let mut map = Self::enclosed(columns, lines.len());
        let mut ends: [Option<Cell>; 2] = [None; 2];
        for (row, line) in lines.iter().enumerate() {
            let found = line.chars().count();
            if found != columns {
                return Err(fault(row, found.min(columns), MapFault::Ragged { found, expected: columns }));
            }
            for (column, letter) in line.chars().enumerate() {
                let end = match letter {
                    '#' => continue,
                    '.' => None,
                    'S' => Some(&mut ends[0]),
                    'G' => Some(&mut ends[1]),
                    found => return Err(fault(row, column, MapFault::Unknown { found })),
                };
                let index = map.index([column, row]);
                map.walls[index] = false;
                if let Some(Some([c, r])) = end {
                    return Err(fault(
                        row,
                        column,
                        MapFault::Second { letter, line: first + *r + 1, column: *c + 1 },
                    ));
                }
                if let Some(end) = end {
                    *end = Some([column, row]);
                }
            }
        }
        let missing = |letter| fault(lines.len() - 1, columns - 1, MapFault::Missing { letter });
        map.start = ends[0].ok_or_else(|| missing('S'))?;
        map.goal = ends[1].ok_or_else(|| missing('G'))?;
        Ok(map)
    }

    /// A map without walls but its border, the start at the top left and the goal at the bottom right.
    pub(in crate::env) fn open(columns: usize, rows: usize) -> Self {
        Self::with(columns, rows, [0, 0], [columns - 1, rows - 1], |_| true)
    }

    /// The map with these ends in which the cells are free that `free` says, and both ends.
    pub(in crate::env) fn with(
        columns: usize,
        rows: usize,
        start: Cell,
        goal: Cell,
        free: impl Fn(Cell) -> bool,
    ) -> Self {
        let mut map = Self { start, goal, ..Self::enclosed(columns, rows) };
        for row in 0..rows {
            for column in 0..columns {
                let cell = [column, row];
                map.set_wall(cell, !free(cell) && cell != start && cell != goal);
            }
        }
        map
    }

    /// A map of walls alone.
    fn enclosed(columns: usize, rows: usize) -> Self {
        let walls = vec![true; (columns + 2) * (rows + 2)];
        Self { columns, rows, start: [0, 0], goal: [0, 0], walls }
    }

    /// Number of columns, 1 to [`MAX_MAP_SIDE`].
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Number of rows, 1 to [`MAX_MAP_SIDE`].
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Where every episode begins.
    pub fn start(&self) -> Cell {
        self.start
    }

    /// Where an episode ends.
    pub fn goal(&self) -> Cell {
        self.goal
    }

    /// Whether `cell` is inside the map and no wall.
    pub fn is_free(&self, cell: Cell) -> bool {
        cell[0] < self.columns && cell[1] < self.rows && !self.walls[self.index(cell)]
    }

    /// Where a move in `direction` leads from `cell`, which must be free; none if it is blocked.
    pub fn neighbour(&self, cell: Cell, direction: Direction) -> Option<Cell> {
        let step = self.moves(&[direction]);
        self.advance(self.index(cell), step[0]).map(|index| self.cell(index))
    }

    /// Number of cells that are no walls.
    pub fn free_cells(&self) -> usize {
        self.walls.iter().filter(|&&wall| !wall).count()
    }

    /// Whether `cell`, inside the map and neither start nor goal, is a wall from now on.
    pub(in crate::env) fn set_wall(&mut self, cell: Cell, wall: bool) {
        let index = self.index(cell);
        self.walls[index] = wall;
    }

    /// Number of cells with the border: what an index is below.
    pub(in crate::env) fn indices(&self) -> usize {
        self.walls.len()
    }

    /// Place of `cell`, inside the map, in the bordered map.
    pub(in crate::env) fn index(&self, cell: Cell) -> Index {
        (cell[1] + 1) * (self.columns + 2) + cell[0] + 1
    }

    /// The cell at `index`, which must not be in the border.
    pub(in crate::env) fn cell(&self, index: Index) -> Cell {
        [index % (self.columns + 2) - 1, index / (self.columns + 2) - 1]
    }

    /// `directions` as moves on this map.
    pub(in crate::env) fn moves(&self, directions: &[Direction]) -> Vec<Move> {
        let width = self.columns as isize + 2;
        let of = |direction: &Direction| {
            let (column, row) = direction.delta();
            let (column, row) = (column as isize, row as isize * width);
            // A straight move passes between no cells: its target stands in, which blocks it exactly if it is a
            // wall, so that straight and diagonal moves need the same test.
            let sides = if column == 0 || row == 0 { [column + row; 2] } else { [column, row] };
            Move { target: column + row, sides }
        };
        directions.iter().map(of).collect()
    }

    /// Where `step` leads from `index`, a free cell; `None` if it is blocked: by a wall or the edge of the map, or,
    /// diagonally, because both cells that it passes between are blocked.
    #[inline]
    pub(in crate::env) fn advance(&self, index: Index, step: Move) -> Option<Index> {
        let target = index.wrapping_add_signed(step.target);
        let [a, b] = step.sides.map(|side| self.walls[index.wrapping_add_signed(side)]);
        if self.walls[target] | (a & b) { None } else { Some(target) }
    }
}

impl fmt::Display for Map {
    /// The map's text, every line ended by LF.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for row in 0..self.rows {
            for column in 0..self.columns {
                let cell = [column, row];
                let letter = match self.is_free(cell) {
                    _ if cell == self.start => "S",
                    _ if cell == self.goal => "G",
                    true => ".",
                    false => "#",
                };
                f.write_str(letter)?;
            }
            f.write_str("\n")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    fn refused(text: &str) -> String {
        Map::parse("m", text).unwrap_err().to_string()
    }

    #[test]
    fn a_map_is_what_its_text_says() {
        let map = Map::parse("m", "S.#\n..G\n").unwrap();
        assert_eq!((map.columns(), map.rows(), map.start(), map.goal()), (3, 2, [0, 0], [2, 1]));
        assert_eq!(map.free_cells(), 5);
        assert!(map.is_free([1, 0]) && !map.is_free([2, 0]));
        assert!(!map.is_free([3, 0]) && !map.is_free([0, 2]));
        assert_eq!(map.to_string(), "S.#\n..G\n");
        for same in [
            "S.#\r\n..G\r\n",
            "S.#\n..G",
            "S.#\r\n..G",
            "\u{feff}S.#\n..G\n",
            "\nS.#\n..G\n",
            "\u{feff}\r\n \r\nS.#\r\n..G\r\n\r\n",
            "S.#  \n..G\t\n\n \n",
        ] {
            assert_eq!(Map::parse("m", same).unwrap(), map, "{same:?}");
        }
        assert!(Map::parse("m", "GS").is_ok());
    }

    #[test]
    fn each_fault_names_line_and_column() {
        assert!(refused("").starts_with("map m, line 1, column 1: the map is empty"));
        assert!(refused("\n \n").starts_with("map m, line 1, column 1: the map is empty"));
        assert!(
            refused("S.\n.G.\n")
                .starts_with("map m, line 2, column 3: this line has 3 characters; accepted: 2")
        );
        assert!(refused("S.\n\nG.\n").starts_with("map m, line 2, column 1: this line has 0 characters"));
        let other = "accepted: # . S G; `trestle map import` reads other forms";
        assert_eq!(refused("S.\n.x\n"), format!("map m, line 2, column 2: 'x'; {other}"));
        assert!(refused("\n\nS.\n.x\n").starts_with("map m, line 4, column 2: 'x'"));
        assert!(
            refused("\nS.\nGS").contains("line 3, column 2: a second `S`, after that of line 2, column 1")
        );
        assert!(refused("S.\n.\tG").starts_with("map m, line 2, column 3: this line has 3"));
        assert!(refused("S\u{e9}G").starts_with("map m, line 1, column 2: '\u{e9}'"));
        assert!(refused("S.\nGS").contains("line 2, column 2: a second `S`, after that of line 1, column 1"));
        assert!(refused("SG\n.G").contains("line 2, column 2: a second `G`, after that of line 1, column 2"));
        assert!(refused("..\n.G").contains("line 2, column 2: the map ends without a `S`"));
        assert!(refused("S.\n..\n").contains("line 2, column 2: the map ends without a `G`"));
        let side = MAX_MAP_SIDE;
        assert!(
            refused(&".".repeat(side + 1)).starts_with("map m, line 1, column 1001: the map is too large")
        );
        assert!(
            refused(&".\n".repeat(side + 1)).starts_with("map m, line 1001, column 1: the map is too large")
        );
        assert!(Map::parse("m", &format!("S{}G", ".".repeat(side - 2))).is_ok());
    }

    /// Where one move in `direction` leads from the middle of a 3 x 3 map whose walls are at `walls`.
    fn from_the_middle(walls: &[Cell], direction: Direction) -> Option<Cell> {
        let mut map = Map::open(3, 3);
        for &cell in walls {
            map.set_wall(cell, true);
        }
        let step = map.moves(&[direction])[0];
        map.advance(map.index([1, 1]), step).map(|index| map.cell(index))
    }

    #[test]
    fn a_diagonal_move_needs_one_free_side() {
        assert_eq!(from_the_middle(&[], Direction::NE), Some([2, 0]));
        assert_eq!(from_the_middle(&[[1, 0]], Direction::NE), Some([2, 0]));
        assert_eq!(from_the_middle(&[[2, 1]], Direction::NE), Some([2, 0]));
        assert_eq!(from_the_middle(&[[1, 0], [2, 1]], Direction::NE), None);
        assert_eq!(from_the_middle(&[[2, 0]], Direction::NE), None);
        assert_eq!(from_the_middle(&[[1, 0]], Direction::N), None);
        assert_eq!(from_the_middle(&[[0, 0], [2, 0], [0, 1]], Direction::N), Some([1, 0]));
    }

    proptest! {
        #[test]
        fn any_text_is_a_map_or_a_fault_in_it(text in "[#.SGx\r\n]{0,40}") {
            match Map::parse("m", &text) {
                Ok(map) => prop_assert_eq!(Map::parse("m", &map.to_string()).unwrap(), map),
                Err(e) => prop_assert!(e.line >= 1 && e.column >= 1 && e.line <= text.lines().count().max(1)),
            }
        }

        /// Moves on bordered cells against the rule written out with bounds tests.
        #[test]
        fn moves_follow_the_rule(walls in prop::collection::vec(any::<bool>(), 20), column in 0usize..5, row in 0usize..4) {
            let mut map = Map::open(5, 4);
            for (i, &wall) in walls.iter().enumerate() {
                map.set_wall([i % 5, i / 5], wall);
            }
            map.set_wall([column, row], false);
            for direction in Direction::ALL {
                let (dx, dy) = direction.delta();
                let at = |dx: i32, dy: i32| {
                    let cell = [column.wrapping_add_signed(dx as isize), row.wrapping_add_signed(dy as isize)];
                    map.is_free(cell).then_some(cell)
                };
                let corner = dx != 0 && dy != 0 && at(dx, 0).is_none() && at(0, dy).is_none();
                let expected = if corner { None } else { at(dx, dy) };
                let step = map.moves(&[direction])[0];
                let found = map.advance(map.index([column, row]), step).map(|index| map.cell(index));
                prop_assert_eq!(found, expected);
            }
        }
    }
}
