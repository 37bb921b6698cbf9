//! Demonstrations as CSV files.
//!
//! The first row is the header `trajectory,terminal,` and then a name for each feature of a state (`s0`, `s1`, ...
//! where there are no better ones). Each further row is one state, in the order of the recording:
//!
//! | column | content |
//! |---|---|
//! | `trajectory` | a whole number; where it changes, another trajectory begins, and it must not come back later |
//! | `terminal` | `1` on the last row of a trajectory that ended in a terminal state, `0` on all others |
//! | features | finite numbers |
//!
//! Example: two steps that end in the goal, then one step of a recording that was broken off.
//!
//! ```csv
//! trajectory,terminal,column,row
//! 0,0,1,1
//! 0,0,2,1
//! 0,1,2,2
//! 1,0,5,5
//! 1,0,5,6
//! ```

use crate::import::short;
use crate::import::sniff::{Kind, kind};
use crate::import::table::{Fault, Header, Record, Rows};
use std::collections::BTreeSet;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use trestle_algorithm::demonstration::{Demonstration, DemonstrationError};
use trestle_proto::limits::MAX_MENTOR_TRANSITIONS;
use trestle_proto::regular_file::{self, FileError};
use trestle_proto::rundir::{Durable, write_atomically};

const FIXED_COLUMNS: [&str; 2] = ["trajectory", "terminal"];

/// Largest file that is read, bytes: more than the longest demonstration of the widest states needs.
pub const MAX_BYTES: u64 = 1 << 40;

/// A demonstration's file that cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum DemoFileError {
    /// No regular file of a size that is read.
    #[error(transparent)]
    File(#[from] FileError),
    /// The operating system.
    #[error("{path}: {message}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The reason.
        message: String,
    },
    /// Another format.
    #[error("{path}: this is {what}; accepted: a demonstration in CSV. {next}")]
    Format {
        /// The file.
        path: PathBuf,
        /// What it is, with an article.
        what: &'static str,
        /// What to do.
        next: String,
    },
    /// Rows that are no demonstration.
    #[error("{path}, row {row}: {what} is {value}; accepted: {accepted}")]
    Content {
        /// The file.
        path: PathBuf,
        /// Row of the file; the header is row 1.
        row: u64,
        /// The column, or what else is wrong.
        what: String,
        /// What is there.
        value: String,
        /// What is accepted.
        accepted: String,
    },
}

/// Reads a demonstration row by row; memory grows with its states alone.
///
/// # Errors
/// A file that cannot be read, or whose contents are not as described at the top of this module; the message names the
/// row, the column, the value and what is accepted.
pub fn read(path: &Path) -> Result<Demonstration, DemoFileError> {
    let (mut rows, mut demo) = open(path)?;
    let mut source = Source { path, row: rows.header().map_or(1, |(row, _)| row) };
    let mut record = Record::default();
    let mut pending = Pending::default();
    let mut seen = BTreeSet::new();
    while rows.next(&mut record).map_err(|fault| refusal(path, fault))? {
        let row = record.line;
        let id = Source { path, row }.whole_number(&record)?;
        if pending.id != Some(id) {
            source.finish(&mut pending, &mut demo)?;
            source.row = row;
            if !seen.insert(id) {
                return Err(source.refuse("trajectory", id, "all rows of a trajectory together"));
            }
            pending.id = Some(id);
        } else if pending.terminal {
            return Err(source.refuse("terminal", 1, "0 before the last row of a trajectory"));
        }
        source.row = row;
        source.features(&record, &mut rows, &demo, &mut pending)?;
    }
    if pending.id.is_none() {
        source.row += 1;
        return Err(source.refuse("the first state", "missing", "2 rows or more"));
    }
    source.finish(&mut pending, &mut demo)?;
    Ok(demo)
}

/// The row of the file at `path` that holds state `state` of its demonstration; none where it holds no such state any more.
pub fn row_of(path: &Path, state: usize) -> Option<u64> {
    let (mut rows, _) = open(path).ok()?;
    let mut record = Record::default();
    for _ in 0..=state {
        if !rows.next(&mut record).ok()? {
            return None;
        }
    }
    Some(record.line)
}

/// The rows of a demonstration's file, and a demonstration without any.
fn open(path: &Path) -> Result<(Rows, Demonstration), DemoFileError> {
    let file = regular_file::open(path, MAX_BYTES)?;
    let io = |error: io::Error| DemoFileError::Io { path: path.into(), message: error.to_string() };
    let format = |what, next| DemoFileError::Format { path: path.into(), what, next };
    let import = || "`trestle demo import` makes one of it".into();
    match kind(&file, path).map_err(io)? {
        Kind::Text | Kind::Empty => {}
        Kind::Hdf5 => return Err(format("HDF5", import())),
        Kind::Arrow => return Err(format("Arrow", import())),
        Kind::Npy => return Err(format("NPY", import())),
        Kind::Npz => return Err(format("NPZ", import())),
        Kind::Foreign(foreign) => return Err(format(foreign.what, foreign.next)),
    }
    let rows = Rows::open(file, Header::Yes).map_err(|fault| refusal(path, fault))?;
    let Some((row, names)) = rows.header() else {
        return Err(Source { path, row: 1 }.refuse(
            "the header",
            "missing",
            "trajectory,terminal,<features>",
        ));
    };
    let demo = Source { path, row }.demonstration(names)?;
    Ok((rows, demo))
}

fn refusal(path: &Path, fault: Fault) -> DemoFileError {
    match fault {
        Fault::Io(message) => DemoFileError::Io { path: path.into(), message },
        Fault::Content { row, what, value, accepted } => {
            DemoFileError::Content { path: path.into(), row, what, value, accepted }
        }
    }
}

/// The trajectory that is being read.
#[derive(Default)]
struct Pending {
    id: Option<u64>,
    states: Vec<f32>,
    terminal: bool,
}

/// Where in which file we are, for messages.
struct Source<'a> {
    path: &'a Path,
    row: u64,
}

impl Source<'_> {
    fn refuse(&self, what: impl ToString, value: impl ToString, accepted: impl ToString) -> DemoFileError {
        DemoFileError::Content {
            path: self.path.into(),
            row: self.row,
            what: what.to_string(),
            value: value.to_string(),
            accepted: accepted.to_string(),
        }
    }

    /// A demonstration with the features that the header names.
    fn demonstration(&self, names: &[String]) -> Result<Demonstration, DemoFileError> {
        for (i, expected) in FIXED_COLUMNS.iter().enumerate() {
            let found = names.get(i).map_or("missing", String::as_str);
            if found != *expected {
                let value = format!("`{}`", short(found));
                let accepted = format!("`{expected}`; `trestle demo import` reads other tables");
                return Err(self.refuse(format!("column {}", i + 1), value, accepted));
            }
        }
        let names = names[FIXED_COLUMNS.len()..].to_vec();
        Demonstration::new(names).map_err(|e| self.refuse("the header", "out of range", e))
    }

    /// The trajectory's number.
    fn whole_number(&self, record: &Record) -> Result<u64, DemoFileError> {
        let text = record.get(0);
        text.parse().map_err(|_| self.refuse("trajectory", format!("`{}`", short(text)), "a whole number"))
    }

    /// Appends a row's state to the trajectory.
    fn features(
        &self,
        record: &Record,
        rows: &mut Rows,
        demo: &Demonstration,
        pending: &mut Pending,
    ) -> Result<(), DemoFileError> {
        let columns = FIXED_COLUMNS.len() + demo.dim();
        if record.len() != columns {
            return Err(self.refuse("the number of columns", record.len(), columns));
        }
        pending.terminal = match record.get(1) {
            "0" => false,
            "1" => true,
            other => return Err(self.refuse("terminal", format!("`{}`", short(other)), "0 or 1")),
        };
        for (text, name) in record.iter().skip(FIXED_COLUMNS.len()).zip(demo.names()) {
            // Read as 32 bits at once, so that what was written comes back to the bit.
            match rows.numbers.plain(text).and_then(|text| text.parse::<f32>().ok()) {
                Some(x) if x.is_finite() => pending.states.push(x),
                _ => return Err(self.refuse(name, format!("`{}`", short(text)), "a finite 32-bit number")),
            }
        }
        let transitions = demo.n_transitions() + pending.states.len() / demo.dim() - 1;
        if transitions > MAX_MENTOR_TRANSITIONS {
            let accepted = format!("up to {MAX_MENTOR_TRANSITIONS}");
            return Err(self.refuse("the number of transitions", transitions, accepted));
        }
        Ok(())
    }

    /// Moves a whole trajectory into the demonstration.
    fn finish(&self, pending: &mut Pending, demo: &mut Demonstration) -> Result<(), DemoFileError> {
        if let Some(id) = pending.id {
            demo.push_trajectory(&pending.states, pending.terminal).map_err(|e| match e {
                DemonstrationError::Length { .. } => {
                    self.refuse(format!("the length of trajectory {id}"), 1, "2 rows or more")
                }
                other => self.refuse(format!("trajectory {id}"), "unusable", other),
            })?;
        }
        *pending = Pending { states: std::mem::take(&mut pending.states), ..Pending::default() };
        pending.states.clear();
        Ok(())
    }
}

/// Writes a demonstration so that [`read`] gives back the same numbers, to the bit. The file appears whole or not at
/// all: it is written under another name beside `path` and then renamed.
///
/// # Errors
/// What the operating system refuses; nothing is left behind.
pub fn write(path: &Path, demo: &Demonstration) -> Result<(), DemoFileError> {
    write_atomically(path, Durable::Now, |file| write_rows(file, demo))
        .map_err(|e| DemoFileError::Io { path: path.into(), message: e.to_string() })
}

fn write_rows(file: impl Write, demo: &Demonstration) -> io::Result<()> {
    let mut rows = csv::Writer::from_writer(file);
    rows.write_record(FIXED_COLUMNS.into_iter().chain(demo.names().iter().map(String::as_str)))?;
    for i in 0..demo.n_trajectories() {
        let states = demo.trajectory(i);
        for m in states.clone() {
            let terminal = demo.terminal(i) && m + 1 == states.end;
            rows.write_field(i.to_string())?;
            rows.write_field(if terminal { "1" } else { "0" })?;
            for x in demo.state(m) {
                rows.write_field(x.to_string())?;
            }
            rows.write_record(None::<&[u8]>)?;
        }
    }
    rows.flush()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;
    use std::fs;

    fn read_text(text: &str) -> Result<Demonstration, DemoFileError> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("demo.csv");
        fs::write(&path, text).unwrap();
        read(&path)
    }

    fn refused(rows: &str) -> String {
        let message = read_text(&format!("trajectory,terminal,x,y\n{rows}")).unwrap_err().to_string();
        message.split_once("demo.csv, ").unwrap().1.to_string()
    }

    #[test]
    fn the_example_is_understood() {
        let text = include_str!("demo_file.rs");
        let example: String = text
            .lines()
            .skip_while(|l| *l != "//! ```csv")
            .skip(1)
            .take(6)
            .map(|l| format!("{}\n", &l[4..]))
            .collect();
        let demo = read_text(&example).unwrap();
        assert_eq!(demo.names(), ["column", "row"]);
        assert_eq!((demo.n_trajectories(), demo.n_states(), demo.n_transitions()), (2, 5, 3));
        assert_eq!(demo.state(2), [2.0, 2.0]);
        assert!(demo.terminal(0) && !demo.terminal(1));
    }

    #[test]
    fn refusals_name_row_column_value_and_what_is_accepted() {
        assert_eq!(refused("0,0,1\n"), "row 2: the number of columns is 3; accepted: 4");
        assert_eq!(refused("0,0,1,2\n0,0,1,2,3\n"), "row 3: the number of columns is 5; accepted: 4");
        assert_eq!(refused("0,0,1,NaN\n"), "row 2: y is `NaN`; accepted: a finite 32-bit number");
        assert_eq!(refused("0,0,inf,1\n"), "row 2: x is `inf`; accepted: a finite 32-bit number");
        assert_eq!(refused("0,0,1e39,1\n"), "row 2: x is `1e39`; accepted: a finite 32-bit number");
        assert_eq!(refused("0,0,east,1\n"), "row 2: x is `east`; accepted: a finite 32-bit number");
        assert_eq!(refused("a,0,1,1\n"), "row 2: trajectory is `a`; accepted: a whole number");
        assert_eq!(refused("0,yes,1,1\n"), "row 2: terminal is `yes`; accepted: 0 or 1");
        assert_eq!(
            refused("0,0,1,1\n0,1,1,2\n0,0,1,3\n"),
            "row 3: terminal is 1; accepted: 0 before the last row of a trajectory"
        );
        assert_eq!(
            refused("0,0,1,1\n0,0,1,2\n1,0,1,3\n1,0,1,4\n0,0,1,5\n"),
            "row 6: trajectory is 0; accepted: all rows of a trajectory together"
        );
        assert_eq!(
            refused("0,0,1,1\n0,0,1,2\n7,0,1,3\n8,0,1,4\n"),
            "row 4: the length of trajectory 7 is 1; accepted: 2 rows or more"
        );
        assert_eq!(refused(""), "row 2: the first state is missing; accepted: 2 rows or more");
    }

    #[test]
    fn headers_are_checked() {
        let message = |text| read_text(text).unwrap_err().to_string();
        assert!(message("").contains("the header is missing"));
        assert!(message("x,y\n").contains("column 1 is `x`; accepted: `trajectory`"));
        assert!(message("trajectory\n").contains("column 2 is `missing`"));
        assert!(message("trajectory,terminal\n").contains("0 features; accepted: 1 to 4096"));
        assert!(
            read(Path::new("/nonexistent/demo.csv")).unwrap_err().to_string().starts_with("/nonexistent")
        );
    }

    #[test]
    fn a_failed_write_leaves_nothing_behind() {
        let dir = tempfile::tempdir().unwrap();
        let mut demo = Demonstration::new(vec!["x".into()]).unwrap();
        demo.push_trajectory(&[0.0, 1.0], false).unwrap();
        let taken = dir.path().join("taken");
        fs::create_dir_all(taken.join("inside")).unwrap();
        assert!(write(&taken, &demo).is_err());
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn what_is_written_is_read(
            trajectories in proptest::collection::vec(
                (proptest::collection::vec(any::<f32>().prop_filter("finite", |x| x.is_finite()), 4..12), any::<bool>()),
                1..4,
            ),
            name in "[a-z ,\"]{0,6}x",
        ) {
            let mut demo = Demonstration::new(vec![name.trim().to_string(), "y".into()]).unwrap();
            for (numbers, terminal) in &trajectories {
                demo.push_trajectory(&numbers[..numbers.len() / 2 * 2], *terminal).unwrap();
            }
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("demo.csv");
            write(&path, &demo).unwrap();
            let back = read(&path).unwrap();
            let bits = |d: &Demonstration| d.states().iter().map(|x| x.to_bits()).collect::<Vec<_>>();
            prop_assert_eq!(bits(&back), bits(&demo));
            prop_assert_eq!(back, demo);
        }
    }
}
