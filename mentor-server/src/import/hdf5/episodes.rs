//! A group an episode: observations, T + 1 of them for T steps or T, and flags that say how the episode ended.
//!
//! With T + 1 observations the last one is the state in which the episode ended. With T that state is known only where a dataset
//! of next observations has it; otherwise the last state that is there is one step earlier and has a value like any other.

use super::Source;
use super::layout::{Episodes, join};
use super::table::Table;
use crate::import::error::{ImportError, Place};
use crate::import::labels::{Role, role};
use crate::import::metadata::last_alone;
use crate::import::rows::Rows;
use crate::import::sink::Sink;

/// Observations, and the ones after each step.
const SUCCESSORS: [(&str, &str); 2] = [("observations", "next_observations"), ("obs", "next_obs")];
/// Minari's flags.
const TERMINATIONS: &str = "terminations";
const TRUNCATIONS: &str = "truncations";

/// How many episodes are such and such, for notes.
#[derive(Default)]
struct Counts {
    /// As many observations as steps.
    short: u64,
    /// A flag before the last step.
    early: u64,
    /// Ended by a flag that does not say how.
    unclear: u64,
    /// Without flags.
    silent: u64,
}

/// Reads the episodes that are wanted into `sink`.
pub(super) fn read(source: &Source, episodes: &Episodes, sink: &mut Sink<'_>) -> Result<(), ImportError> {
    let mut counts = Counts::default();
    for group in &episodes.groups {
        if sink.satisfied() {
            break;
        }
        let terminal =
            if sink.wanted() { episode(source, group, episodes, &mut counts, sink)? } else { false };
        sink.end(terminal)?;
    }
    counts.say(sink);
    Ok(())
}

/// How an episode ended, as far as its flags say so.
#[derive(Default)]
struct Flags {
    /// Number of steps; none where there are no flags.
    steps: Option<u64>,
    terminal: bool,
    early: bool,
    unclear: bool,
}

/// Reads an episode's states; says whether its last one is terminal.
fn episode(
    source: &Source,
    group: &str,
    episodes: &Episodes,
    counts: &mut Counts,
    sink: &mut Sink<'_>,
) -> Result<bool, ImportError> {
    let place = sink.place();
    let path = join(group, &episodes.dataset);
    let mut table = Table::new(source, &path, &place, "observations")?;
    let flags = if episodes.minari {
        minari_flags(source, group, &place)?
    } else if episodes.dataset.is_empty() {
        Flags::default()
    } else {
        any_flags(source, group, &place)?
    };
    let rows = table.rows();
    let whole = match flags.steps {
        None => false,
        Some(steps) if rows == steps + 1 => true,
        Some(steps) if rows == steps => false,
        Some(steps) => {
            let accepted = format!("{}, one more than steps, or {steps}; it may be cut off", steps + 1);
            return Err(place.refuse("the number of observations", rows, accepted));
        }
    };
    let mut next = match successors(&episodes.dataset) {
        Some(name) if !whole => match source.dataset_if_any(&join(group, &name))? {
            Some(_) => Some(Table::new(source, &join(group, &name), &place, "next observations")?),
            None => None,
        },
        _ => None,
    };
    sink.columns(table.width(), &[])?;
    let mut first = 0;
    while first < rows {
        let count = table.window().min(rows - first);
        let values = table.read(first, count)?;
        for (i, state) in values.chunks_exact(table.width()).enumerate() {
            sink.row(first + i as u64, |column| state[column])?;
        }
        first += count;
    }
    let mut known = whole;
    if let Some(next) = &mut next
        && rows > 0
    {
        if (next.rows(), next.width()) != (rows, table.width()) {
            let value = format!("{} rows of {}", next.rows(), next.width());
            return Err(place.refuse("next observations", value, format!("{rows} of {}", table.width())));
        }
        let last = next.read(rows - 1, 1)?;
        sink.row(rows, |column| last[column])?;
        known = true;
    }
    counts.short += u64::from(flags.steps == Some(rows) && !known);
    counts.early += u64::from(flags.early);
    counts.unclear += u64::from(flags.unclear);
    counts.silent += u64::from(flags.steps.is_none());
    Ok(flags.terminal && known)
}

/// The path of the next observations of those at `path`, if such are usual.
fn successors(path: &str) -> Option<String> {
    let (first, rest) = path.split_once('/').unwrap_or((path, ""));
    let (_, next) = SUCCESSORS.iter().find(|(own, _)| *own == first)?;
    Some(join(next, rest))
}

/// Both flags must be there, and only the last step's may be set.
fn minari_flags(source: &Source, group: &str, place: &Place) -> Result<Flags, ImportError> {
    let flags = |name: &str| {
        let at = join(group, name);
        if source.dataset_if_any(&at)?.is_none() {
            return Err(place.clone().refuse(format!("dataset {name}"), "missing", "one flag a step"));
        }
        Table::new(source, &at, place, name)?.all_flags(place, name)
    };
    let (terminations, truncations) = (flags(TERMINATIONS)?, flags(TRUNCATIONS)?);
    if truncations.len() != terminations.len() {
        return Err(place.clone().refuse("the number of truncations", truncations.len(), terminations.len()));
    }
    last_alone(&truncations, place, TRUNCATIONS)?;
    let terminal = last_alone(&terminations, place, TERMINATIONS)?;
    Ok(Flags { steps: Some(terminations.len() as u64), terminal, ..Flags::default() })
}

/// Whatever flags there are, by their names. The group is the episode: a flag before its last step ends nothing.
fn any_flags(source: &Source, group: &str, place: &Place) -> Result<Flags, ImportError> {
    let mut out = Flags::default();
    let (mut terminal, mut cut_off, mut end) = (None, None, None);
    source.refuse_unread(group, |name| role(name).is_some())?;
    for name in source.children(group)?.0 {
        let Some(kind @ (Role::Terminal | Role::CutOff | Role::End)) = role(&name) else { continue };
        let flags = Table::new(source, &join(group, &name), place, &name)?.all_flags(place, &name)?;
        let steps = flags.len() as u64;
        if out.steps.is_some_and(|others| others != steps) {
            let accepted = out.steps.unwrap_or_default();
            return Err(place.clone().refuse(format!("the number of flags in {name}"), steps, accepted));
        }
        out.steps = Some(steps);
        out.early |= flags.split_last().is_some_and(|(_, before)| before.contains(&true));
        let last = flags.last() == Some(&true);
        let known = match kind {
            Role::Terminal => &mut terminal,
            Role::CutOff => &mut cut_off,
            _ => &mut end,
        };
        *known = Some(known.unwrap_or(false) || last);
    }
    // `done` alone says nothing of how an episode ended; beside a flag for the other way it does.
    out.terminal = terminal.unwrap_or(end == Some(true) && cut_off == Some(false));
    out.unclear = terminal.is_none() && cut_off.is_none() && end == Some(true);
    Ok(out)
}

impl Counts {
    fn say(&self, sink: &mut Sink<'_>) {
        if self.short > 0 {
            sink.note(format!(
                "{} episodes have as many observations as steps: the state that their last step led to is not in the file, so \
                 their last state is not taken as terminal",
                self.short
            ));
        }
        if self.early > 0 {
            sink.note(format!(
                "{} episodes have a flag before their last step: a group is one episode here",
                self.early
            ));
        }
        if self.unclear > 0 && sink.ends_recorded() {
            sink.note(format!(
                "{} episodes end with a flag that does not say whether their last state is terminal: it is not taken as that; \
                 --ends terminal takes all",
                self.unclear
            ));
        }
        if self.silent > 0 && sink.ends_recorded() {
            sink.note(format!(
                "{} episodes do not say how they ended: their last state is not taken as terminal",
                self.silent
            ));
        }
    }
}
