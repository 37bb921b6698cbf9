//! D4RL's HDF5: flat arrays over all episodes, the observation *before* each action. An episode ends where `terminals`
//! or `timeouts` (which may be missing) is set.
//!
//! The state that an action led to is the next row, but for the last row of an episode: that state is only in
//! `next_observations`, where a file has them. Without them a terminal state is not in the file, and the last state
//! that is has a value like any other. It is not marked as terminal then, unless the user says so.

use super::Options;
use super::error::{ImportError, Place};
use super::hdf5::{Table, damaged, flags, open};
use super::sink::Sink;
use std::path::Path;

const OBSERVATIONS: &str = "observations";
const SUCCESSORS: &str = "next_observations";

/// Reads the episodes that are wanted into `sink`.
pub(super) fn read(path: &Path, options: &Options, sink: &mut Sink<'_>) -> Result<(), ImportError> {
    let file = open(path)?;
    let place = || Place::of(path);
    let present = file.root().datasets().map_err(damaged(path))?;
    let has = |name: &str| present.iter().any(|own| own == name);
    let table = |name: &str| -> Result<Table, ImportError> {
        let dataset = file.dataset(name).map_err(|error| {
            place().refuse(format!("dataset {name}"), "missing", format!("a dataset of it ({error})"))
        })?;
        Table::new(path, dataset, place(), name)
    };
    let key = options.key.as_deref().unwrap_or(OBSERVATIONS);
    if key != OBSERVATIONS && !key.starts_with("infos/") {
        return Err(place().refuse("--key", format!("`{key}`"), "observations, or what is in infos/"));
    }
    let states = table(key)?;
    let terminals = table("terminals")?;
    let timeouts = if has("timeouts") { Some(table("timeouts")?) } else { None };
    let successors = if key == OBSERVATIONS && has(SUCCESSORS) { Some(table(SUCCESSORS)?) } else { None };
    let rows = states.rows();
    let lists = [("terminals", Some(&terminals)), ("timeouts", timeouts.as_ref())];
    for (name, list) in lists {
        if let Some(list) = list
            && (list.rows(), list.width()) != (rows, 1)
        {
            let value = format!("{} rows of {}", list.rows(), list.width());
            let accepted = format!("{rows} of 1, as there are states; it may be cut off");
            return Err(place().refuse(name, value, accepted));
        }
    }
    if let Some(next) = &successors
        && (next.rows(), next.width()) != (rows, states.width())
    {
        let value = format!("{} rows of {}", next.rows(), next.width());
        return Err(place().refuse(SUCCESSORS, value, format!("{rows} of {}", states.width())));
    }
    sink.columns(states.width(), &[])?;
    let (mut first, mut open, mut unseen) = (0, false, 0_u64);
    while first < rows && !sink.satisfied() {
        let count = states.window().min(rows - first);
        let values = states.read(first, count)?;
        let terminal = flags(&terminals, first, count, &place(), "terminals")?;
        let timeout = match &timeouts {
            Some(timeouts) => flags(timeouts, first, count, &place(), "timeouts")?,
            None => vec![false; terminal.len()],
        };
        for (i, state) in values.chunks_exact(states.width()).enumerate() {
            if sink.satisfied() {
                break;
            }
            let (row, wanted) = (first + i as u64, sink.wanted());
            if wanted {
                sink.row(row, |column| state[column])?;
            }
            open = !(terminal[i] || timeout[i]);
            if open {
                continue;
            }
            let successor = match &successors {
                Some(next) if wanted => Some(next.read(row, 1)?),
                _ => None,
            };
            if let Some(state) = &successor {
                sink.row(row, |column| state[column])?;
            }
            unseen += u64::from(wanted && terminal[i] && successor.is_none());
            sink.end(terminal[i] && successor.is_some())?;
        }
        first += count;
    }
    if open {
        sink.end(false)?;
    }
    if unseen > 0 && sink.ends_recorded() {
        sink.note(format!(
            "{unseen} episodes were terminated, but the terminal state is not in the file (no {SUCCESSORS}): their last \
             recorded state is not taken as terminal; --ends terminal takes it as that"
        ));
    }
    if timeouts.is_none() {
        sink.note("no timeouts in the file: an episode ends at a terminal state alone".into());
    }
    Ok(())
}
