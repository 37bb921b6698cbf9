//! Tables of text, read row by row. In the project's own form (`trajectory,terminal,...`, see [`crate::demo_file`]) all further
//! columns are the state. Elsewhere `--columns` says which ones are, so that nothing else, actions and rewards above all, is
//! taken for a part of it. Columns that say where episodes begin and how they end are known by their names.

use super::Options;
use super::error::{ImportError, Place};
use super::labels::{Current, Labels, Row};
use super::sink::Sink;
use super::table::{Fault, Numbers, Record, Rows};
use std::fs::File;
use std::path::Path;

/// Reads all episodes into `sink`.
pub(super) fn read(
    path: &Path,
    file: File,
    options: &Options,
    sink: &mut Sink<'_>,
) -> Result<(), ImportError> {
    if options.key.is_some() {
        return Err(Place::of(path).refuse(
            "--key",
            "of no use for CSV",
            "no --key; --columns chooses columns",
        ));
    }
    let mut rows = Rows::open(file, options.header).map_err(|fault| refusal(fault, Place::of(path)))?;
    let place = Place::of(path).row(rows.header().map_or(1, |(row, _)| row));
    let labels = match (rows.header(), rows.width()) {
        (Some((_, names)), _) => Labels::of(names, names.len(), &place, options, sink)?,
        (None, Some(width)) => {
            sink.note(
                "the first row is numbers, so the table has no header: columns have places alone".into(),
            );
            Labels::of(&[], width, &place, options, sink)?
        }
        (None, None) => return Err(Place::of(path).refuse("the table", "empty", "rows of states")),
    };
    rows.notes.drain(..).for_each(|note| sink.note(note));
    let (mut record, mut current) = (Record::default(), Current::default());
    while rows.next(&mut record).map_err(|fault| refusal(fault, sink.place()))? {
        let (width, at) = (record.len(), record.line);
        let mut row = Fields { record: &record, numbers: &mut rows.numbers };
        current.take(&labels, &mut row, width, at, sink)?;
        if sink.satisfied() {
            return Ok(());
        }
    }
    if rows.numbers.commas() {
        sink.note("commas are read as decimal signs".into());
    }
    current.end(sink)
}

fn refusal(fault: Fault, place: Place) -> ImportError {
    match fault {
        Fault::Io(message) => ImportError::Io { path: place.path().into(), message },
        Fault::Content { row, what, value, accepted } => place.row(row).refuse(what, value, accepted),
    }
}

struct Fields<'a> {
    record: &'a Record,
    numbers: &'a mut Numbers,
}

impl Row for Fields<'_> {
    fn number(&mut self, column: usize) -> Option<f64> {
        self.numbers.number(self.record.get(column))
    }

    fn text(&self, column: usize) -> String {
        self.record.get(column).into()
    }
}
