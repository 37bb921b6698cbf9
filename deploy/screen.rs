//! Status lines at the bottom of a terminal, which are drawn over and over in the same place.
//!
//! Between two drawings the cursor rests at the beginning of the first of them. All that was drawn is then at the cursor and
//! below it, whatever a change of the terminal's width has made of it: some terminals fold lines that have become too long,
//! others cut them off. So clearing from the cursor on leaves nothing behind.

use std::cell::RefCell;
use std::io::{IsTerminal, Write, stderr};
use std::rc::Rc;
use std::time::{Duration, Instant};
use terminal_size::{Height, Width, terminal_size_of};

/// Least time between two drawings that only show progress.
const PAUSE: Duration = Duration::from_millis(50);
/// Columns and rows where the terminal does not tell.
const USUAL: (u16, u16) = (80, 24);

/// Draws a line that is at most so many columns wide.
type Draw = Box<dyn Fn(usize) -> String>;

/// The status lines of this process.
#[derive(Clone)]
pub(crate) struct Screen(Rc<RefCell<Rows>>);

struct Rows {
    out: Box<dyn Write>,
    /// Columns and rows of the terminal.
    size: Box<dyn Fn() -> (u16, u16)>,
    /// The lines from the top down, each with a number that tells it apart.
    lines: Vec<(u64, Draw)>,
    next: u64,
    drawn: Option<Instant>,
}

/// One line; it vanishes when it is dropped.
pub(crate) struct Line {
    screen: Screen,
    number: u64,
}

impl Screen {
    /// That of standard error; none where that is no terminal.
    pub(crate) fn new() -> Option<Self> {
        let size =
            || terminal_size_of(stderr()).map_or(USUAL, |(Width(columns), Height(rows))| (columns, rows));
        stderr().is_terminal().then(|| Self::on(Box::new(stderr()), Box::new(size)))
    }

    fn on(out: Box<dyn Write>, size: Box<dyn Fn() -> (u16, u16)>) -> Self {
        Self(Rc::new(RefCell::new(Rows { out, size, lines: Vec::new(), next: 0, drawn: None })))
    }

    /// A new line below the others, or above the lowest one if `above_last`.
    pub(crate) fn line(&self, above_last: bool) -> Line {
        let mut rows = self.0.borrow_mut();
        let number = rows.next;
        rows.next += 1;
        let at = rows.lines.len() - usize::from(above_last && !rows.lines.is_empty());
        rows.lines.insert(at, (number, Box::new(|_| String::new())));
        Line { screen: self.clone(), number }
    }

    /// Prints `text`, which stays, above the lines.
    pub(crate) fn print(&self, text: &str) {
        self.0.borrow_mut().draw(Some(text));
    }
}

impl Line {
    /// Shows what `draw` makes of the width.
    pub(crate) fn show(&self, draw: impl Fn(usize) -> String + 'static) {
        let mut rows = self.screen.0.borrow_mut();
        if let Some(line) = rows.lines.iter_mut().find(|(number, _)| *number == self.number) {
            line.1 = Box::new(draw);
        }
        if rows.drawn.is_none_or(|at| at.elapsed() >= PAUSE) {
            rows.draw(None);
        }
    }

    /// Prints `text`, which stays, above all lines.
    pub(crate) fn print(&self, text: &str) {
        self.screen.print(text);
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        let mut rows = self.screen.0.borrow_mut();
        rows.lines.retain(|(number, _)| *number != self.number);
        rows.draw(None);
    }
}

impl Rows {
    fn draw(&mut self, above: Option<&str>) {
        let (columns, height) = (self.size)();
        // A line of the full width would make some terminals go on to the next row, and more lines than rows would scroll.
        let (width, most) = (usize::from(columns).saturating_sub(1), usize::from(height).saturating_sub(1));
        let mut text = String::from("\r\x1b[J");
        for line in above.iter().flat_map(|text| text.lines()) {
            text += line;
            text += "\r\n";
        }
        let hidden = self.lines.len().saturating_sub(most);
        let lines: Vec<String> =
            self.lines[hidden..].iter().map(|(_, draw)| cut(&draw(width), width)).collect();
        text += &lines.join("\r\n");
        if let Some(up) = lines.len().checked_sub(1).filter(|&up| up > 0) {
            text += &format!("\x1b[{up}A");
        }
        text.push('\r');
        // Where the terminal has gone nobody is looking.
        let _ = self.out.write_all(text.as_bytes()).and_then(|()| self.out.flush());
        self.drawn = Some(Instant::now());
    }
}

/// The beginning of `text` that fits into `width` columns, without control characters. Letters beyond the alphabets that take one
/// column may take two.
fn cut(text: &str, width: usize) -> String {
    let mut columns = 0;
    let fits = |c: &char| {
        columns += if *c < '\u{1100}' { 1 } else { 2 };
        columns <= width
    };
    text.chars().filter(|c| !c.is_control()).take_while(fits).collect()
}

/// A part of a line, which is left out where there is no room: the higher its rank, the sooner.
pub(crate) struct Part {
    /// 0 is never left out.
    pub(crate) rank: u8,
    pub(crate) text: String,
}

/// The parts side by side, without those for which `width` columns have no room.
pub(crate) fn fit(parts: &[Part], width: usize) -> String {
    let mut most = u8::MAX;
    loop {
        let kept: Vec<&str> = parts
            .iter()
            .filter(|part| part.rank <= most && !part.text.is_empty())
            .map(|part| part.text.as_str())
            .collect();
        let text = kept.join("  ");
        let next = parts.iter().map(|part| part.rank).filter(|&rank| rank > 0 && rank <= most).max();
        match next {
            Some(rank) if text.chars().count() > width => most = rank - 1,
            _ => return text,
        }
    }
}

/// A bar that is filled by `share`, 0 to 1.
pub(crate) fn bar(share: f64) -> String {
    const LENGTH: usize = 16;
    let full = ((share * LENGTH as f64) as usize).min(LENGTH);
    format!("[{}{}]", "#".repeat(full), "-".repeat(LENGTH - full))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::cell::Cell;

    /// What a terminal shows: its lines, and where the cursor is. A line that was written stays one, however often the
    /// terminal folds it.
    #[derive(Default)]
    struct Terminal {
        lines: Vec<Vec<char>>,
        row: usize,
        column: usize,
    }

    impl Terminal {
        fn feed(&mut self, text: &str) {
            let mut chars = text.chars();
            while let Some(c) = chars.next() {
                if self.lines.len() <= self.row {
                    self.lines.resize(self.row + 1, Vec::new());
                }
                match c {
                    '\r' => self.column = 0,
                    '\n' => self.row += 1,
                    '\x1b' => {
                        assert_eq!(chars.next(), Some('['));
                        let rest: String = chars.as_str().into();
                        let end = rest.find(char::is_alphabetic).unwrap();
                        match &rest[end..=end] {
                            "J" => {
                                self.lines.truncate(self.row + 1);
                                self.lines[self.row].truncate(self.column);
                            }
                            "A" => self.row -= rest[..end].parse::<usize>().unwrap(),
                            other => panic!("{other}"),
                        }
                        chars.nth(end);
                    }
                    c => {
                        self.lines[self.row].resize(self.column, ' ');
                        self.lines[self.row].push(c);
                        self.column += 1;
                    }
                }
            }
        }

        fn shows(&self) -> Vec<String> {
            self.lines
                .iter()
                .map(|line| line.iter().collect())
                .filter(|line: &String| !line.is_empty())
                .collect()
        }
    }

    #[derive(Clone, Default)]
    struct Sink(Rc<RefCell<Vec<u8>>>);

    impl Write for Sink {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.borrow_mut().extend(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn nothing_is_left_behind_when_the_width_changes() {
        let (sink, size) = (Sink::default(), Rc::new(Cell::new((40, 5))));
        let given = size.clone();
        let screen = Screen::on(Box::new(sink.clone()), Box::new(move || given.get()));
        let mut terminal = Terminal::default();
        let mut look = || {
            terminal.feed(&String::from_utf8(std::mem::take(&mut sink.0.borrow_mut())).unwrap());
            assert_eq!(terminal.column, 0);
            terminal.shows()
        };
        let total = screen.line(false);
        total.show(|width| "t".repeat(width));
        let run = screen.line(true);
        run.show(|_| "run\n\x1b".into());
        screen.print("first\nsecond");
        assert_eq!(look(), ["first", "second", "run", &"t".repeat(39)]);
        for columns in [20, 9, 60] {
            size.set((columns, 5));
            screen.print(&columns.to_string());
            assert_eq!(look().last().unwrap().len(), usize::from(columns) - 1);
        }
        run.print("last");
        drop(run);
        let kept = ["first", "second", "20", "9", "60", "last"];
        assert_eq!(look(), [&kept[..], &[&"t".repeat(59)]].concat());
        // No more lines than the terminal has rows.
        let many: Vec<Line> = (0..9).map(|_| screen.line(false)).collect();
        many.iter().for_each(|line| line.show(|_| "x".into()));
        screen.print("");
        assert_eq!(look(), [&kept[..], &["x"; 4]].concat());
        drop(many);
        drop(total);
        assert_eq!(look(), kept);
    }

    #[test]
    fn parts_are_left_out_by_rank() {
        let part = |rank, text: &str| Part { rank, text: text.into() };
        let parts = [part(0, "name"), part(2, "bar"), part(1, "more"), part(2, "also"), part(1, "")];
        assert_eq!(fit(&parts, 22), "name  bar  more  also");
        assert_eq!(fit(&parts, 20), "name  more");
        assert_eq!((fit(&parts, 9), fit(&parts, 0)), ("name".into(), "name".into()));
        assert_eq!((bar(0.0), bar(0.5)), ("[----------------]".into(), "[########--------]".into()));
        assert_eq!(bar(7.0), "[################]");
        assert_eq!(cut("a漢b", 3), "a漢");
    }
}
