//! Flat arrays over all episodes, as D4RL has them: the observation *before* each action. An episode ends where a flag is set
//! that says so.
//!
//! The state that an action led to is the next row, but for the last row of an episode: that state is only among the next
//! observations, where a file has them. Without them a terminal state is not in the file, and the last state that is has a
//! value like any other. It is not marked as terminal then, unless the user says so.

use super::error::{ImportError, Place};
use super::labels::{Role, known_flags};
use super::rows::{Rows, flags};
use super::sink::Sink;

/// The arrays of a source.
pub(super) struct Flat {
    pub(super) states: Box<dyn Rows>,
    /// The states after each step, if there are such; what they are called.
    pub(super) successors: Option<(String, Box<dyn Rows>)>,
    /// What says where episodes begin and end, by name.
    pub(super) marks: Vec<(String, Role, Box<dyn Rows>)>,
    /// Whether rows without any mark are accepted as one episode.
    pub(super) one_episode: bool,
    /// The rows of an episode, where the array has an axis for them.
    pub(super) length: Option<u64>,
}

/// What the marks of one row say.
#[derive(Clone, Copy, Default)]
struct Marks {
    first: bool,
    terminal: bool,
    cut_off: bool,
    end: bool,
}

impl Flat {
    /// Reads the episodes that are wanted into `sink`; `place` is the source.
    pub(super) fn read(mut self, place: &Place, sink: &mut Sink<'_>) -> Result<(), ImportError> {
        let (rows, width) = (self.states.rows(), self.states.width());
        self.check(place)?;
        sink.columns(width, &[])?;
        let has = |wanted: Role, marks: &[(String, Role, Box<dyn Rows>)]| {
            marks.iter().any(|(_, role, _)| *role == wanted)
        };
        let (terminals, cut_offs, ends) =
            (has(Role::Terminal, &self.marks), has(Role::CutOff, &self.marks), has(Role::End, &self.marks));
        let (mut first, mut open, mut unseen, mut unclear) = (0, false, 0_u64, 0_u64);
        let mut episode = None;
        while first < rows && !sink.satisfied() {
            let count = self.states.window().min(rows - first);
            let values = self.states.read(first, count)?;
            let marks = self.marks(first, count, place, &mut episode)?;
            for (i, state) in values.chunks_exact(width).enumerate() {
                let row = first + i as u64;
                if open && marks[i].first {
                    sink.end(false)?;
                }
                if sink.satisfied() {
                    open = false;
                    break;
                }
                let wanted = sink.wanted();
                if wanted {
                    sink.row(row, |column| state[column])?;
                }
                let Marks { terminal, cut_off, end, .. } = marks[i];
                let last = self.length.is_some_and(|length| (row + 1).is_multiple_of(length));
                open = !(terminal || cut_off || end || last);
                if open {
                    continue;
                }
                // `done` alone says nothing of how an episode ended; beside a flag for the other way it does.
                let terminal = terminal || (end && !terminals && cut_offs && !cut_off);
                unclear += u64::from(wanted && end && !terminals && !cut_offs);
                let successor = match &mut self.successors {
                    Some((_, next)) if wanted => Some(next.read(row, 1)?),
                    _ => None,
                };
                if let Some(state) = &successor {
                    sink.row(row, |column| state[column])?;
                }
                unseen += u64::from(wanted && terminal && successor.is_none());
                sink.end(terminal && successor.is_some())?;
            }
            first += count;
        }
        if open {
            sink.end(false)?;
        }
        if sink.ends_recorded() && unseen > 0 {
            sink.note(format!(
                "{unseen} episodes were terminated, but the terminal state is not in the file (no next_observations): their \
                 last recorded state is not taken as terminal; --ends terminal takes it as that"
            ));
        }
        if sink.ends_recorded() && unclear > 0 {
            sink.note(format!(
                "{unclear} episodes end with a flag that does not say whether their last state is terminal: it is not taken as \
                 that; --ends terminal takes it as that"
            ));
        }
        if self.marks.is_empty() && self.length.is_none() {
            sink.note("no flags in the file: all rows are one episode".into());
        } else if terminals && !cut_offs && !ends {
            sink.note("no timeouts in the file: an episode ends at a terminal state alone".into());
        }
        Ok(())
    }

    /// Whether the arrays fit together.
    fn check(&self, place: &Place) -> Result<(), ImportError> {
        let rows = self.states.rows();
        if self.marks.is_empty() && !self.one_episode {
            let accepted = format!(
                "an array with one a step, such as {}; --key takes all rows as one episode",
                known_flags()
            );
            return Err(place.clone().refuse("what ends an episode", "missing", accepted));
        }
        for (name, _, marks) in &self.marks {
            if (marks.rows(), marks.width()) != (rows, 1) {
                let value = format!("{} rows of {}", marks.rows(), marks.width());
                let accepted = format!("{rows} of 1, as there are states; it may be cut off");
                return Err(place.clone().refuse(name, value, accepted));
            }
        }
        if let Some((name, next)) = &self.successors
            && (next.rows(), next.width()) != (rows, self.states.width())
        {
            let value = format!("{} rows of {}", next.rows(), next.width());
            return Err(place.clone().refuse(name, value, format!("{rows} of {}", self.states.width())));
        }
        Ok(())
    }

    /// What the marks of some rows say; `episode` is the number of the row before, where there are such.
    fn marks(
        &mut self,
        first: u64,
        count: u64,
        place: &Place,
        episode: &mut Option<f64>,
    ) -> Result<Vec<Marks>, ImportError> {
        let mut out = vec![Marks::default(); count as usize];
        for (name, role, marks) in &mut self.marks {
            if *role == Role::Episode {
                for (i, number) in marks.read(first, count)?.into_iter().enumerate() {
                    out[i].first |= episode.is_some_and(|before| before != number);
                    *episode = Some(number);
                }
                continue;
            }
            for (i, flag) in flags(marks.as_mut(), first, count, place, name)?.into_iter().enumerate() {
                let field = match role {
                    Role::Terminal => &mut out[i].terminal,
                    Role::CutOff => &mut out[i].cut_off,
                    Role::First => &mut out[i].first,
                    _ => &mut out[i].end,
                };
                *field |= flag;
            }
        }
        Ok(out)
    }
}
