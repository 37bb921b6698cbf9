//! CSV with a header, read row by row. In the project's own form (`trajectory,terminal,...`, see
//! [`crate::demo_file`]) all further columns are the state. Elsewhere `--columns` says which ones are, so that nothing
//! else, actions and rewards above all, is taken for a part of it. Columns that say where episodes begin and how they
//! end are known by their names.

use super::Options;
use super::error::{ImportError, Place};
use super::sink::Sink;
use csv::{ReaderBuilder, StringRecord};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

const EPISODE: &[&str] = &["trajectory", "episode", "episode_id"];
const TERMINAL: &[&str] = &["terminal", "terminals", "terminated", "termination", "terminations"];
const CUT_OFF: &[&str] = &["truncated", "truncation", "truncations", "timeout", "timeouts"];
/// What a name begins with if its column is no part of a state.
const NO_STATE: &[&str] = &["action", "reward"];

/// Reads all episodes into `sink`.
pub(super) fn read(path: &Path, options: &Options, sink: &mut Sink<'_>) -> Result<(), ImportError> {
    let io =
        |error: &dyn std::fmt::Display| ImportError::Io { path: path.into(), message: error.to_string() };
    if options.key.is_some() {
        return Err(Place::of(path).refuse("--key", "of no use for CSV", "no --key"));
    }
    let file = File::open(path).map_err(|e| io(&e))?;
    let mut rows = ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .buffer_capacity(1 << 20)
        .from_reader(BufReader::new(file));
    let mut record = StringRecord::new();
    if !rows.read_record(&mut record).map_err(|e| io(&e))? {
        return Err(Place::of(path).refuse("the header", "missing", "names of the columns"));
    }
    let table = Table::of(path, &record, options, sink)?;
    let mut state = Vec::new();
    let mut current = Current::default();
    let mut row = 1;
    while rows.read_record(&mut record).map_err(|e| io(&e))? {
        row = record.position().map_or(row + 1, csv::Position::line);
        table.row(&record, row, &mut current, &mut state, sink)?;
        if sink.satisfied() {
            return Ok(());
        }
    }
    if current.open {
        sink.end(current.terminal)?;
    }
    Ok(())
}

/// Where which column is.
struct Table {
    names: Vec<String>,
    episode: Option<usize>,
    terminal: Option<usize>,
    cut_off: Option<usize>,
    /// The places of the state's columns.
    state: Vec<usize>,
}

/// The episode that is being read.
#[derive(Default)]
struct Current {
    open: bool,
    terminal: bool,
    id: String,
    /// Identities of the episodes before.
    seen: BTreeSet<String>,
}

impl Table {
    fn of(
        path: &Path,
        record: &StringRecord,
        options: &Options,
        sink: &mut Sink<'_>,
    ) -> Result<Self, ImportError> {
        let names: Vec<String> = record.iter().map(|name| name.trim().to_string()).collect();
        let find = |known: &[&str]| names.iter().position(|name| known.contains(&&*name.to_lowercase()));
        let place = || Place::of(path).row(1);
        let own = names.len() > 2 && names[..2] == ["trajectory", "terminal"];
        let state = match &options.columns {
            Some(columns) => {
                let refuse = |(value, accepted)| place().refuse("--columns", value, accepted);
                columns.resolve(names.len(), &names).map_err(refuse)?
            }
            None if own => (2..names.len()).collect(),
            None => {
                let accepted = format!("--columns with those that are the state, of {}", names.join(", "));
                return Err(place().refuse("--columns", "missing", accepted));
            }
        };
        let (episode, terminal, cut_off) = (find(EPISODE), find(TERMINAL), find(CUT_OFF));
        for &column in &state {
            let name = names[column].to_lowercase();
            let marker = [episode, terminal, cut_off].contains(&Some(column));
            if marker || NO_STATE.iter().any(|start| name.starts_with(start)) {
                let accepted = "columns of the state; actions and rewards are no part of a demonstration";
                return Err(place().refuse("--columns", format!("`{}`", names[column]), accepted));
            }
        }
        let chosen: Vec<String> = state.iter().map(|&column| names[column].clone()).collect();
        sink.chosen(&chosen)?;
        if terminal.is_none() && sink.ends_recorded() {
            let names = TERMINAL.join(", ");
            sink.note(format!("no column is named {names}: no last state is taken as terminal"));
        }
        if episode.is_none() && terminal.is_none() && cut_off.is_none() {
            sink.note(format!("no column is named {}: all rows are one episode", EPISODE.join(", ")));
        }
        Ok(Self { names, episode, terminal, cut_off, state })
    }

    fn row(
        &self,
        record: &StringRecord,
        row: u64,
        current: &mut Current,
        state: &mut Vec<f64>,
        sink: &mut Sink<'_>,
    ) -> Result<(), ImportError> {
        if record.len() != self.names.len() {
            let place = sink.place().row(row);
            return Err(place.refuse("the number of columns", record.len(), self.names.len()));
        }
        if let Some(column) = self.episode {
            let id = record[column].trim();
            if current.open && id != current.id {
                sink.end(current.terminal)?;
                current.open = false;
            }
            if !current.open {
                if sink.satisfied() {
                    return Ok(());
                }
                if !current.seen.insert(id.into()) {
                    let accepted = "all rows of an episode together";
                    return Err(sink.place().row(row).refuse(
                        &self.names[column],
                        format!("`{id}`"),
                        accepted,
                    ));
                }
                current.id = id.into();
            } else if current.terminal {
                let accepted = "0 before the last row of an episode";
                return Err(sink.place().row(row - 1).refuse("the terminal flag", 1, accepted));
            }
        }
        current.open = true;
        current.terminal = self.flag(self.terminal, record, row, sink)?;
        let cut_off = self.flag(self.cut_off, record, row, sink)?;
        if sink.wanted() {
            state.clear();
            for &column in &self.state {
                let text = record[column].trim();
                let x = text.parse::<f64>().ok().filter(|x| (*x as f32).is_finite()).ok_or_else(|| {
                    let accepted = "a finite 32-bit number";
                    sink.place().row(row).refuse(&self.names[column], format!("`{text}`"), accepted)
                })?;
                state.push(x);
            }
            sink.row(row, |i| state[i])?;
        }
        if self.episode.is_none() && (current.terminal || cut_off) {
            sink.end(current.terminal)?;
            current.open = false;
        }
        Ok(())
    }

    fn flag(
        &self,
        column: Option<usize>,
        record: &StringRecord,
        row: u64,
        sink: &Sink<'_>,
    ) -> Result<bool, ImportError> {
        let Some(column) = column else { return Ok(false) };
        match record[column].trim().to_lowercase().as_str() {
            "0" | "0.0" | "false" => Ok(false),
            "1" | "1.0" | "true" => Ok(true),
            other => {
                let place = sink.place().row(row);
                Err(place.refuse(&self.names[column], format!("`{other}`"), "0 or 1, false or true"))
            }
        }
    }
}
