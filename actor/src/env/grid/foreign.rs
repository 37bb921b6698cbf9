//! Maps in the forms that other people have, as ours.
//!
//! | form | how it is known |
//! |---|---|
//! | rows of characters or of 0 and 1, ours included | nothing else fits |
//! | D4RL's strings, `"#####\\#GOO#\\#####"` | backslashes or quotes, no brackets |
//! | nested lists, as Gymnasium-Robotics has them: 1, 0, `"r"`, `"g"`, `"c"` | brackets |
//! | drawings of walls between cells, as of micromouse mazes: `+---+` or `o---o` | corners and lines in the first row |
//! | numbers 0 and 1, or gym-maze's bits of open sides | [`of_numbers`] |
//!
//! Where walls lie between cells, a cell [column, row] becomes the cell [2 column + 1, 2 row + 1], and walls become cells.

use super::map::{Cell, Map, MapError};
use std::collections::BTreeSet;
use trestle_proto::limits::MAX_MAP_SIDE;

/// A map of others as ours.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Imported {
    /// The map.
    pub map: Map,
    /// What the source is.
    pub form: &'static str,
    /// What was decided that the source does not say, in sentences.
    pub notes: Vec<String>,
}

/// What the source may leave open.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Choices {
    /// The start: column and row of the source's cells, from 0 at the top left.
    pub start: Option<Cell>,
    /// The goal, likewise.
    pub goal: Option<Cell>,
    /// Whether 0 is a wall and 1 is free, instead of the other way round.
    pub zero_is_wall: bool,
}

/// A source that is no map, or not a whole one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ForeignError {
    /// Something at one place of the source.
    #[error("{origin}, line {line}: {what} is {value}; accepted: {accepted}")]
    Content {
        /// Name of the source.
        origin: String,
        /// Line, or row of an array, from 1.
        line: usize,
        /// What is wrong.
        what: &'static str,
        /// What is there.
        value: String,
        /// What is accepted.
        accepted: &'static str,
    },
    /// No map that is read.
    #[error(
        "{origin}: {what}; accepted: rows of # . S G or of 0 and 1, D4RL's strings, nested lists, drawings of +---+, and NPY arrays \
         of 0 and 1 or of gym-maze's walls"
    )]
    Unknown {
        /// Name of the source.
        origin: String,
        /// What it is instead.
        what: String,
    },
    /// No start or goal, or several.
    #[error("{origin}: {what} is {value}; accepted: --{what} COLUMN,ROW, from 0,0 at the top left to {last}")]
    End {
        /// Name of the source.
        origin: String,
        /// `start` or `goal`.
        what: &'static str,
        /// What is there.
        value: String,
        /// The cell at the bottom right.
        last: String,
    },
    /// Ours, but not a sound one.
    #[error(transparent)]
    Map(#[from] MapError),
}

/// The map in `text`, in any of the forms above; `origin` names it in errors.
///
/// # Errors
/// What is not understood, with its line, and a start or goal that is missing or there several times.
pub fn of_text(origin: &str, text: &str, choices: &Choices) -> Result<Imported, ForeignError> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let lines: Vec<(usize, &str)> = lines(text);
    let Some((_, first)) = lines.first() else { return Err(unknown(origin, "it is empty".into())) };
    if is_drawing(first) {
        return drawing(origin, &lines)?.finish(origin, "a drawing of walls", choices);
    }
    if text.contains('[') {
        return lists(origin, text)?.sketch(origin, choices)?.finish(origin, "nested lists", choices);
    }
    if text.contains(['\\', '"', '\'']) {
        return strings(origin, text)?.sketch(origin, choices)?.finish(
            origin,
            "strings, as D4RL has them",
            choices,
        );
    }
    table(&lines).sketch(origin, choices)?.finish(origin, "rows of characters", choices)
}

/// The map in an array of numbers: 0 and 1 by row and column, or the bit fields that gym-maze saves by column and row, where 1, 2,
/// 4 and 8 say that the north, east, south and west sides of a cell are open.
///
/// # Errors
/// As [`of_text`].
pub fn of_numbers(origin: &str, rows: &[Vec<f64>], choices: &Choices) -> Result<Imported, ForeignError> {
    let binary = |x: &f64| *x == 0.0 || *x == 1.0;
    if rows.iter().flatten().all(binary) {
        let token = |x: &f64| if *x == 0.0 { "0".to_string() } else { "1".to_string() };
        let rows = rows.iter().enumerate().map(|(i, row)| (i + 1, row.iter().map(token).collect())).collect();
        return Tokens { rows }.sketch(origin, choices)?.finish(origin, "an array of 0 and 1", choices);
    }
    walls(origin, rows)?.finish(origin, "gym-maze's walls", choices)
}

fn unknown(origin: &str, what: String) -> ForeignError {
    ForeignError::Unknown { origin: origin.into(), what }
}

/// Lines that hold something, with their numbers from 1.
fn lines(text: &str) -> Vec<(usize, &str)> {
    let all = text.split('\n').map(str::trim_end).enumerate().map(|(i, line)| (i + 1, line));
    all.filter(|(_, line)| !line.is_empty()).collect()
}

/// What the two ends are called.
const START: &str = "start";
const GOAL: &str = "goal";

/// A map that may lack its start and goal.
struct Sketch {
    /// Walls by row and column of our map.
    walls: Vec<Vec<bool>>,
    /// Cells of the source.
    starts: Vec<Cell>,
    goals: Vec<Cell>,
    /// Where start and goal are if the source does not say so, by the custom of its form.
    usual: Option<[Cell; 2]>,
    /// Whether walls lie between the source's cells.
    between: bool,
    notes: Vec<String>,
}

impl Sketch {
    fn of_cells(columns: usize, rows: usize) -> Self {
        let walls = vec![vec![false; columns]; rows];
        Self { walls, starts: Vec::new(), goals: Vec::new(), usual: None, between: false, notes: Vec::new() }
    }

    /// `columns` x `rows` cells, all sides closed.
    fn of_rooms(origin: &str, columns: usize, rows: usize) -> Result<Self, ForeignError> {
        let most = (MAX_MAP_SIDE - 1) / 2;
        if columns.min(rows) == 0 || columns.max(rows) > most {
            let what = format!(
                "{columns} x {rows} cells with walls between them; up to {most} x {most} become a map"
            );
            return Err(unknown(origin, what));
        }
        let mut sketch = Self { between: true, ..Self::of_cells(2 * columns + 1, 2 * rows + 1) };
        for (row, line) in sketch.walls.iter_mut().enumerate() {
            line.iter_mut().enumerate().for_each(|(column, wall)| *wall = row % 2 == 0 || column % 2 == 0);
        }
        Ok(sketch)
    }

    /// Whether a way leads from each free cell to each other.
    fn is_connected(&self) -> bool {
        let free = |[x, y]: Cell| self.walls.get(y).and_then(|row| row.get(x)) == Some(&false);
        let all = self.walls.iter().flatten().filter(|&&wall| !wall).count();
        let mut open = vec![self.place([0, 0])];
        let mut seen: BTreeSet<Cell> = open.iter().copied().collect();
        while let Some([x, y]) = open.pop() {
            for next in [[x + 1, y], [x, y + 1], [x.wrapping_sub(1), y], [x, y.wrapping_sub(1)]] {
                if free(next) && seen.insert(next) {
                    open.push(next);
                }
            }
        }
        seen.len() == all
    }

    /// Columns and rows of the source.
    fn size(&self) -> [usize; 2] {
        let size = [self.walls.first().map_or(0, Vec::len), self.walls.len()];
        if self.between { size.map(|side| side / 2) } else { size }
    }

    /// Our cell for one of the source.
    fn place(&self, cell: Cell) -> Cell {
        if self.between { cell.map(|x| 2 * x + 1) } else { cell }
    }

    /// The start or goal, whichever `what` names, as a cell of the source: the one that is given, else the one that was found,
    /// else the usual one.
    fn end(
        &self,
        origin: &str,
        what: &'static str,
        given: Option<Cell>,
        found: &[Cell],
        notes: &mut Vec<String>,
    ) -> Result<Cell, ForeignError> {
        let [columns, rows] = self.size();
        let text = |[column, row]: &Cell| format!("{column},{row}");
        let refuse = |value: String| ForeignError::End {
            origin: origin.into(),
            what,
            value,
            last: text(&[columns.saturating_sub(1), rows.saturating_sub(1)]),
        };
        let usual = self.usual.map(|[start, goal]| if what == START { start } else { goal });
        let cell = match (given, found, usual) {
            (Some(cell), _, _) => cell,
            (None, [only], _) => *only,
            (None, [], Some(usual)) => {
                notes.push(format!(
                    "the {what} is {}, as is usual for this form; --{what} gives another",
                    text(&usual)
                ));
                usual
            }
            (None, [], None) => return Err(refuse("missing".into())),
            (None, several, _) => {
                let shown: Vec<String> = several.iter().take(8).map(text).collect();
                let more = if several.len() > shown.len() { " and others" } else { "" };
                return Err(refuse(format!("at {}{more}", shown.join(", then "))));
            }
        };
        if cell[0] >= columns || cell[1] >= rows {
            return Err(refuse(format!("{}, outside of the map", text(&cell))));
        }
        let [column, row] = self.place(cell);
        if self.walls[row][column] {
            return Err(refuse(format!("{}, a wall", text(&cell))));
        }
        Ok(cell)
    }

    fn finish(
        mut self,
        origin: &str,
        form: &'static str,
        choices: &Choices,
    ) -> Result<Imported, ForeignError> {
        let [columns, rows] = self.size();
        let mut notes = std::mem::take(&mut self.notes);
        let start = self.end(origin, START, choices.start, &self.starts, &mut notes)?;
        // A cell for either is the goal only if it is not the start.
        let goals: Vec<Cell> = self.goals.iter().copied().filter(|&cell| cell != start).collect();
        let goal = self.end(origin, GOAL, choices.goal, &goals, &mut notes)?;
        if self.between {
            notes.push(format!(
                "walls lie between the source's {columns} x {rows} cells: its cell c,r is the map's 2c+1,2r+1"
            ));
        }
        let (start, goal) = (self.place(start), self.place(goal));
        let mut text = String::new();
        for (row, line) in self.walls.iter().enumerate() {
            for (column, &wall) in line.iter().enumerate() {
                text.push(match [column, row] {
                    cell if cell == start => 'S',
                    cell if cell == goal => 'G',
                    _ if wall => '#',
                    _ => '.',
                });
            }
            text.push('\n');
        }
        Ok(Imported { map: Map::parse(origin, &text)?, form, notes })
    }
}

/// Rows of tokens, a cell each, with the lines that they are in.
struct Tokens {
    rows: Vec<(usize, Vec<String>)>,
}

impl Tokens {
    fn sketch(self, origin: &str, choices: &Choices) -> Result<Sketch, ForeignError> {
        let columns = self.rows.first().map_or(0, |(_, row)| row.len());
        if columns == 0 || columns > MAX_MAP_SIDE || self.rows.len() > MAX_MAP_SIDE {
            let what =
                format!("{} rows of {columns} cells; up to {MAX_MAP_SIDE} x {MAX_MAP_SIDE}", self.rows.len());
            return Err(unknown(origin, what));
        }
        let mut sketch = Sketch::of_cells(columns, self.rows.len());
        let mut counted = false;
        for (row, (line, tokens)) in self.rows.iter().enumerate() {
            let refuse = |what, value: String, accepted| {
                Err(ForeignError::Content { origin: origin.into(), line: *line, what, value, accepted })
            };
            if tokens.len() != columns {
                return refuse(
                    "the number of cells",
                    tokens.len().to_string(),
                    "as many as in the first row",
                );
            }
            for (column, token) in tokens.iter().enumerate() {
                let cell = [column, row];
                let number: Option<f64> = token.parse().ok();
                counted |= number.is_some();
                let wall = match (number, token.as_str()) {
                    (Some(0.0), _) | (_, "false" | "False") => choices.zero_is_wall,
                    (Some(1.0), _) | (_, "true" | "True") => !choices.zero_is_wall,
                    (_, "#" | "X" | "x" | "@" | "W" | "w" | "█") => true,
                    (_, "." | " " | "O" | "o" | "_") => false,
                    (_, "S" | "s" | "R" | "r" | "START" | "RESET" | "reset") => {
                        sketch.starts.push(cell);
                        false
                    }
                    (_, "G" | "g" | "E" | "e" | "GOAL" | "goal") => {
                        sketch.goals.push(cell);
                        false
                    }
                    (_, "C" | "c" | "COMBINED" | "combined") => {
                        sketch.starts.push(cell);
                        sketch.goals.push(cell);
                        false
                    }
                    _ => {
                        let value = format!("`{}`", token.chars().take(40).collect::<String>());
                        let accepted = "0 or . or O (free), 1 or # (a wall), S or r (the start), G or g (the goal), c (either)";
                        return refuse("a cell", value, accepted);
                    }
                };
                sketch.walls[row][column] = wall;
            }
        }
        if counted {
            let (wall, free) = if choices.zero_is_wall { (0, 1) } else { (1, 0) };
            sketch.notes.push(format!(
                "{wall} is a wall and {free} is free; --walls {free} takes them the other way round"
            ));
        }
        Ok(sketch)
    }

    /// Rows whose tokens are their characters.
    fn of_characters<'a>(rows: impl IntoIterator<Item = (usize, &'a str)>) -> Self {
        let characters = |(line, row): (usize, &str)| (line, row.chars().map(String::from).collect());
        Self { rows: rows.into_iter().map(characters).collect() }
    }
}

/// Rows of characters, or of single characters and numbers with something between them.
fn table(lines: &[(usize, &str)]) -> Tokens {
    let split = |line: &str| -> Vec<String> {
        let parts = line.split(|c: char| c.is_whitespace() || c == ',' || c == ';');
        parts.filter(|part| !part.is_empty()).map(String::from).collect()
    };
    let rows: Vec<(usize, Vec<String>)> = lines.iter().map(|(line, text)| (*line, split(text))).collect();
    let one_cell = |token: &String| token.chars().count() == 1 || token.parse::<f64>().is_ok();
    let columns = rows.first().map_or(0, |(_, row)| row.len());
    if columns > 1 && rows.iter().all(|(_, row)| row.len() == columns && row.iter().all(one_cell)) {
        return Tokens { rows };
    }
    let mut tokens = Tokens::of_characters(lines.iter().copied());
    // Where blanks are free cells, those at the ends of lines are mostly cut off.
    if lines.iter().any(|(_, line)| line.contains(' ')) {
        let columns = tokens.rows.iter().map(|(_, row)| row.len()).max().unwrap_or(0).min(MAX_MAP_SIDE + 1);
        tokens.rows.iter_mut().for_each(|(_, row)| row.resize(columns.max(row.len()), " ".into()));
    }
    tokens
}

/// Text in quotes, or after an equals sign, whose rows a backslash or a new line ends.
fn strings(origin: &str, text: &str) -> Result<Tokens, ForeignError> {
    if text.matches('=').count() > 1 {
        return Err(unknown(
            origin,
            "several maps in one file; put the one that is wanted into a file of its own".into(),
        ));
    }
    // A new line that is written as one in a string.
    let text = &text.replace("\\n", "\n");
    let value = text.split_once('=').map_or(text.as_str(), |(_, value)| value);
    let before = text.len() - value.len();
    let mut rows = Vec::new();
    let mut start = 0;
    let row = |from: usize, to: usize, rows: &mut Vec<(usize, String)>| {
        let kept: String =
            value[from..to].chars().filter(|c| !c.is_whitespace() && !"\"'(),+;".contains(*c)).collect();
        if !kept.is_empty() {
            rows.push((1 + text[..before + from].matches('\n').count(), kept));
        }
    };
    for (at, _) in value.match_indices(['\\', '\n']) {
        row(start, at, &mut rows);
        start = at + 1;
    }
    row(start, value.len(), &mut rows);
    Ok(Tokens::of_characters(rows.iter().map(|(line, row)| (*line, row.as_str()))))
}

/// Lists of lists of tokens, or lists of strings, as Python and JSON write them.
fn lists(origin: &str, text: &str) -> Result<Tokens, ForeignError> {
    let mut rows: Vec<(usize, Vec<String>)> = Vec::new();
    let (mut depth, mut line, mut maps) = (0_usize, 1, 0);
    let mut letters = text.chars().peekable();
    let token = |depth: usize, line: usize, token: String, rows: &mut Vec<(usize, Vec<String>)>| match depth {
        1 => rows.push((line, token.chars().map(String::from).collect())),
        2 => rows.last_mut().into_iter().for_each(|(_, row)| row.push(token.clone())),
        _ => {}
    };
    while let Some(letter) = letters.next() {
        match letter {
            '\n' => line += 1,
            '#' => {
                while letters.peek().is_some_and(|&c| c != '\n') {
                    letters.next();
                }
            }
            '[' | '(' => {
                depth += 1;
                maps += usize::from(depth == 1 && letter == '[');
                if depth == 2 {
                    rows.push((line, Vec::new()));
                }
                if depth > 2 {
                    let value = "in more than two brackets".into();
                    let accepted = "a list of rows, each a list of cells";
                    return Err(ForeignError::Content {
                        origin: origin.into(),
                        line,
                        what: "a cell",
                        value,
                        accepted,
                    });
                }
            }
            ']' | ')' => depth = depth.saturating_sub(1),
            '"' | '\'' => {
                let word: String = letters.by_ref().take_while(|&c| c != letter).collect();
                token(depth, line, word, &mut rows);
            }
            letter if letter.is_alphanumeric() || ".-".contains(letter) => {
                let mut word = String::from(letter);
                while let Some(&next) = letters.peek().filter(|&&c| c.is_alphanumeric() || "._-".contains(c))
                {
                    word.push(next);
                    letters.next();
                }
                token(depth, line, word, &mut rows);
            }
            _ => {}
        }
    }
    if maps > 1 {
        return Err(unknown(
            origin,
            "several maps in one file; put the one that is wanted into a file of its own".into(),
        ));
    }
    Ok(Tokens { rows })
}

const CORNERS: [char; 2] = ['+', 'o'];

/// Whether this is the first row of a drawing: corners with lines between them.
fn is_drawing(line: &str) -> bool {
    let line = line.trim();
    let ends = [line.chars().next(), line.chars().last()];
    ends.iter().all(|end| end.is_some_and(|c| CORNERS.contains(&c)))
        && line.contains(['-', '_', '='])
        && line.chars().all(|c| CORNERS.contains(&c) || " -_=".contains(c))
}

/// Cells between lines: a corner at every crossing, something other than a blank where there is a wall.
fn drawing(origin: &str, lines: &[(usize, &str)]) -> Result<Sketch, ForeignError> {
    let indent = lines.iter().map(|(_, line)| line.len() - line.trim_start().len()).min().unwrap_or(0);
    let picture: Vec<(usize, Vec<char>)> =
        lines.iter().map(|(line, text)| (*line, text.chars().skip(indent).collect())).collect();
    let at = |row: usize, column: usize| picture[row].1.get(column).copied().unwrap_or(' ');
    let posts: Vec<usize> =
        (0..picture[0].1.len()).filter(|&column| CORNERS.contains(&at(0, column))).collect();
    let beams: Vec<usize> = (0..picture.len()).filter(|&row| CORNERS.contains(&at(row, 0))).collect();
    let refuse = |row: usize, what, value: String, accepted| {
        Err(ForeignError::Content { origin: origin.into(), line: picture[row].0, what, value, accepted })
    };
    if beams.last() != Some(&(picture.len() - 1)) || beams.windows(2).any(|pair| pair[1] == pair[0] + 1) {
        return refuse(
            picture.len() - 1,
            "the drawing",
            "without its last row of corners".into(),
            "rows of corners and of cells in turn",
        );
    }
    if posts.windows(2).any(|pair| pair[1] == pair[0] + 1) {
        return refuse(0, "a cell", "without a width".into(), "corners with something between them");
    }
    let (columns, rows) = (posts.len() - 1, beams.len() - 1);
    let mut sketch = Sketch::of_rooms(origin, columns, rows)?;
    // The last post and beam have no cell behind them, but walls.
    for (r, &top) in beams.iter().enumerate() {
        for (c, &left) in posts.iter().enumerate() {
            if let Some(&right) = posts.get(c + 1) {
                sketch.walls[2 * r][2 * c + 1] = (left + 1..right).any(|column| at(top, column) != ' ');
            }
            let Some(&bottom) = beams.get(r + 1) else { continue };
            sketch.walls[2 * r + 1][2 * c] = (top + 1..bottom).any(|row| at(row, left) != ' ');
            let Some(&right) = posts.get(c + 1) else { continue };
            for row in top + 1..bottom {
                for column in left + 1..right {
                    match at(row, column) {
                        ' ' => {}
                        'S' | 's' | 'R' => sketch.starts.push([c, r]),
                        'G' | 'g' | 'E' => sketch.goals.push([c, r]),
                        other => return refuse(row, "a cell", format!("`{other}`"), "blanks, S or G"),
                    }
                }
            }
        }
    }
    Ok(sketch)
}

/// gym-maze's cells: bits of open sides, by column and row. A side is open if either cell says so.
fn walls(origin: &str, cells: &[Vec<f64>]) -> Result<Sketch, ForeignError> {
    let (columns, rows) = (cells.len(), cells.first().map_or(0, Vec::len));
    let mut sketch = Sketch::of_rooms(origin, columns, rows)?;
    for (column, line) in cells.iter().enumerate() {
        for (row, &value) in line.iter().enumerate() {
            if value.fract() != 0.0 || !(0.0..16.0).contains(&value) {
                let accepted =
                    "0 and 1 alone (free and walls), or whole numbers from 0 to 15 (gym-maze's open sides)";
                let value = value.to_string();
                return Err(ForeignError::Content {
                    origin: origin.into(),
                    line: column + 1,
                    what: "a number",
                    value,
                    accepted,
                });
            }
            let [x, y] = [2 * column + 1, 2 * row + 1];
            let sides = [
                (1, row > 0, [x, y - 1]),
                (2, column + 1 < columns, [x + 1, y]),
                (4, row + 1 < rows, [x, y + 1]),
                (8, column > 0, [x - 1, y]),
            ];
            for (bit, inside, [x, y]) in sides {
                if value as u8 & bit != 0 && inside {
                    sketch.walls[y][x] = false;
                }
            }
        }
    }
    if !sketch.is_connected() {
        let what =
            "numbers that are neither 0 and 1 alone nor gym-maze's, in which every cell can be reached";
        return Err(unknown(origin, what.into()));
    }
    sketch.usual = Some([[0, 0], [columns - 1, rows - 1]]);
    Ok(sketch)
}

#[cfg(test)]
#[path = "foreign_tests.rs"]
mod tests;
