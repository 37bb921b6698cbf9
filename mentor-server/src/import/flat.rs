//! Flat arrays over all episodes, as D4RL has them: the observation *before* each action. An episode ends where a flag is set
//! that says so.
//!
//! The state that an action led to is the next row, but for the last row of an episode: that state is only among the next
//! observations, where a file has them. Without them a terminal state is not in the file, and the last state that is has a
//! value like any other. It is not marked as terminal then, unless the user says so.
//!
//! Instead of a flag a state, an array may hold the rows at which episodes begin or end, or how long they are. And where there
//! is one state more than flags, that is the state after the last step of a single episode.

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

/// Where episodes end, by an array that is shorter than the states.
#[derive(Default)]
struct Short {
    /// Numbers of the first rows that are no part of an episode any more, ascending; none where no array says.
    rows: Vec<u64>,
    /// The arrays that say so.
    names: Vec<String>,
    /// What the flags of a single episode say of the state after its last step.
    last: Option<Marks>,
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
        let roles = self.marks.iter().map(|(_, role, _)| *role).filter(|role| *role != Role::Length);
        let roles: Vec<Role> = roles.collect();
        let short = self.short(place)?;
        self.check(place, short.last.is_some() || !short.names.is_empty())?;
        sink.columns(width, &[])?;
        let has = |wanted: Role| roles.contains(&wanted);
        let (terminals, cut_offs) = (has(Role::Terminal), has(Role::CutOff));
        let ends = has(Role::End) || !short.names.is_empty();
        let (mut first, mut open, mut unseen, mut unclear) = (0, false, 0_u64, 0_u64);
        let mut episode = None;
        while first < rows && !sink.satisfied() {
            let count = self.states.window().min(rows - first);
            let values = self.states.read(first, count)?;
            let mut marks = self.marks(first, count, place, &mut episode)?;
            if let (Some(last), Some(of_last)) = (short.last, marks.last_mut())
                && first + count == rows
            {
                *of_last = last;
            }
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
                let last = self.length.is_some_and(|length| (row + 1).is_multiple_of(length))
                    || short.rows.binary_search(&(row + 1)).is_ok();
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
                let there = successor.is_some() || short.last.is_some();
                unseen += u64::from(wanted && terminal && !there);
                sink.end(terminal && there)?;
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
        if !short.names.is_empty() && !terminals && !cut_offs && sink.ends_recorded() {
            sink.note(format!(
                "{} says where episodes end, but not how: no last state is taken as terminal",
                short.names.join(", ")
            ));
        } else if roles.is_empty() && self.length.is_none() {
            sink.note("no flags in the file: all rows are one episode".into());
        } else if terminals && !cut_offs && !ends {
            sink.note("no timeouts in the file: an episode ends at a terminal state alone".into());
        }
        Ok(())
    }

    /// Takes those marks away that have no flag a state, and says what they mean.
    fn short(&mut self, place: &Place) -> Result<Short, ImportError> {
        let rows = self.states.rows();
        let mut found = Short::default();
        for (name, role, mut marks) in std::mem::take(&mut self.marks) {
            let count = marks.rows();
            // A length in each row repeats what something else says.
            if role == Role::Length && count == rows {
                continue;
            }
            let flags_of_steps = count + 1 == rows && self.length.is_none_or(|length| length == rows);
            let positions = matches!(role, Role::Length | Role::End | Role::First) && count < rows;
            if marks.width() != 1 || !(positions || flags_of_steps) {
                self.marks.push((name, role, marks));
                continue;
            }
            let values = marks.read(0, count)?;
            if let Some(ends) = positions.then(|| ends(role, &values, rows)).flatten() {
                found.rows.extend(ends);
                found.names.push(format!("`{name}`"));
                continue;
            }
            let set = values.iter().position(|&value| value != 0.0);
            let only_last = set.is_none_or(|at| at + 1 == values.len() && values[at] == 1.0);
            if flags_of_steps && only_last && self.successors.is_none() {
                let last = found.last.get_or_insert_default();
                match role {
                    Role::Terminal => last.terminal |= set.is_some(),
                    Role::CutOff => last.cut_off |= set.is_some(),
                    Role::End => last.end |= set.is_some(),
                    Role::First | Role::Episode | Role::Step | Role::Length => {}
                }
                continue;
            }
            let value = format!("{count} numbers, for {rows} states");
            let accepted = "one a state, or the rows at which episodes end, or their lengths; or, of one episode, one a step, of \
                            which only the last is set";
            return Err(place.clone().refuse(name, value, accepted));
        }
        found.rows.sort_unstable();
        found.rows.dedup();
        Ok(found)
    }

    /// Whether the arrays fit together; `marked`: something else says where episodes end.
    fn check(&self, place: &Place, marked: bool) -> Result<(), ImportError> {
        let rows = self.states.rows();
        if self.marks.is_empty() && !self.one_episode && !marked {
            let accepted = format!(
                "an array with one a step, such as {}; --key takes all rows as one episode",
                known_flags()
            );
            return Err(place.clone().refuse("what ends an episode", "missing", accepted));
        }
        for (name, _, marks) in &self.marks {
            if (marks.rows(), marks.width()) != (rows, 1) {
                let value = format!("{} rows of {}", marks.rows(), marks.width());
                let cut_off = if marks.rows() < rows { "; it may be cut off" } else { "" };
                let accepted = format!("{rows} of 1, as there are states{cut_off}");
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

/// The first rows behind each of the episodes of `rows` states, by the `values` of an array of positions or lengths; none if
/// that is not what they are.
fn ends(role: Role, values: &[f64], rows: u64) -> Option<Vec<u64>> {
    let whole = values.iter().map(|&value| (value >= 0.0 && value.fract() == 0.0).then_some(value as u64));
    let whole: Vec<u64> = whole.collect::<Option<_>>()?;
    let (&first, &last) = (whole.first()?, whole.last()?);
    let ascending = whole.is_sorted_by(|a, b| a < b);
    match role {
        Role::Length => {
            let sums = whole.iter().scan(0_u64, |sum, length| {
                *sum = sum.checked_add(*length)?;
                Some(*sum)
            });
            let sums: Vec<u64> = sums.collect();
            (sums.len() == whole.len() && sums.last() == Some(&rows)).then_some(sums)
        }
        Role::First => (ascending && first == 0 && last < rows).then(|| [&whole[1..], &[rows]].concat()),
        Role::End if ascending && last == rows => Some(whole),
        // The last row of each episode.
        Role::End if ascending && last + 1 == rows => Some(whole.iter().map(|row| row + 1).collect()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_and_lengths_are_told_from_flags() {
        assert_eq!(ends(Role::End, &[4.0, 12.0], 12), Some(vec![4, 12]));
        assert_eq!(ends(Role::End, &[3.0, 11.0], 12), Some(vec![4, 12]));
        assert_eq!(ends(Role::First, &[0.0, 4.0], 12), Some(vec![4, 12]));
        assert_eq!(ends(Role::Length, &[4.0, 8.0], 12), Some(vec![4, 12]));
        for (role, values) in [
            (Role::End, &[4.0, 4.0, 12.0][..]),
            (Role::End, &[4.0, 13.0]),
            (Role::End, &[0.5, 12.0]),
            (Role::End, &[]),
            (Role::First, &[1.0, 4.0]),
            (Role::Length, &[4.0, 9.0]),
            (Role::Terminal, &[4.0, 12.0]),
            (Role::Length, &[f64::NAN, 12.0]),
        ] {
            assert_eq!(ends(role, values, 12), None, "{role:?} {values:?}");
        }
    }
}
