//! What columns mean by their names: the same names in CSV, in structured arrays, in HDF5 and in NPZ. And how rows with such
//! columns become episodes, so that no transition leads from one into the next.

use super::Options;
use super::error::{ImportError, Place, list};
use super::sink::Sink;
use std::collections::BTreeSet;

/// What a column says of episodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// Which episode a row belongs to.
    Episode,
    /// The episode ends here, in a terminal state.
    Terminal,
    /// The episode ends here, in a state like any other.
    CutOff,
    /// The episode ends here, one way or the other.
    End,
    /// An episode begins here.
    First,
    /// How far into its episode a row is.
    Step,
    /// How many rows each episode has.
    Length,
}

const EPISODE: &[&str] = &[
    "trajectory",
    "trajectory_id",
    "trajectory_index",
    "traj",
    "traj_id",
    "episode",
    "episode_id",
    "episode_index",
    "episode_idx",
    "episode_number",
    "episode_num",
    "ep",
    "ep_id",
    "ep_idx",
    "rollout",
    "rollout_id",
    "demo",
    "demo_id",
    "demo_index",
    "trial",
    "trial_id",
    "trial_index",
    "traj_idx",
    "traj_index",
    "trajectory_idx",
    "sequence_id",
    "run_id",
];
const TERMINAL: &[&str] = &[
    "terminal",
    "terminals",
    "is_terminal",
    "terminated",
    "is_terminated",
    "termination",
    "terminations",
    "next_terminal",
    "next_terminated",
];
const CUT_OFF: &[&str] = &[
    "truncated",
    "is_truncated",
    "truncation",
    "truncations",
    "timeout",
    "timeouts",
    "is_timeout",
    "timed_out",
    "time_limit",
    "time_limit_truncated",
    "timelimit_truncated",
    "next_truncated",
];
const END: &[&str] = &[
    "done",
    "dones",
    "is_done",
    "next_done",
    "episode_end",
    "episode_ends",
    "episode_done",
    "ep_end",
    "end_of_episode",
    "is_end",
    "is_last",
    "is_final",
    "is_last_step",
    "last_step",
    "eoe",
    "end",
    "ended",
    "ep_done",
    "episode_over",
    "episode_ended",
    "game_over",
    "traj_end",
    "traj_done",
    "trajectory_end",
    "trajectory_done",
];
const FIRST: &[&str] = &[
    "is_first",
    "episode_start",
    "episode_starts",
    "episode_begin",
    "ep_start",
    "is_start",
    "start_of_episode",
    "is_first_step",
    "new_episode",
    "newepisode",
    "is_reset",
    "reset",
];
const STEP: &[&str] = &[
    "t",
    "step",
    "steps",
    "step_id",
    "step_index",
    "timestep",
    "timesteps",
    "time_step",
    "time",
    "frame",
    "frame_index",
    "timestamp",
];
const LENGTH: &[&str] = &[
    "episode_length",
    "episode_lengths",
    "ep_length",
    "ep_lengths",
    "ep_len",
    "ep_lens",
    "traj_length",
    "traj_lengths",
    "traj_len",
    "traj_lens",
    "trajectory_length",
    "trajectory_lengths",
];
/// What a name begins with if its column is no part of a state.
const NO_STATE: &[&str] = &["action", "reward"];

/// The role of what is called `name`, whatever its case and whatever joins its words.
pub(super) fn role(name: &str) -> Option<Role> {
    let name = plain(name);
    let of = [
        (EPISODE, Role::Episode),
        (TERMINAL, Role::Terminal),
        (CUT_OFF, Role::CutOff),
        (END, Role::End),
        (FIRST, Role::First),
        (STEP, Role::Step),
        (LENGTH, Role::Length),
    ];
    of.into_iter().find(|(names, _)| names.contains(&&*name)).map(|(_, role)| role)
}

/// Whether what is called `name` is an action or a reward.
pub(super) fn is_no_state(name: &str) -> bool {
    let name = plain(name);
    NO_STATE.iter().any(|start| name.starts_with(start))
}

/// Lower case, words joined by `_`: `isDone`, `is-done` and `IS DONE` are `is_done`.
fn plain(name: &str) -> String {
    let mut out = String::new();
    let mut small = false;
    for c in name.trim().chars() {
        if small && c.is_uppercase() {
            out.push('_');
        }
        small = c.is_lowercase();
        out.push(if c.is_alphanumeric() { c.to_ascii_lowercase() } else { '_' });
    }
    out.trim_matches('_').into()
}

/// Names of flags that say how an episode ended, for messages.
pub(super) fn known_flags() -> String {
    "terminals, terminated, timeouts, truncated, dones or the like".into()
}

/// One row of a source with named columns.
pub(super) trait Row {
    /// The number in a column, finite or not; none if there is none.
    fn number(&mut self, column: usize) -> Option<f64>;
    /// What is in a column, for messages and as an identity.
    fn text(&self, column: usize) -> String;
}

/// Where which column is.
pub(super) struct Labels {
    names: Vec<String>,
    width: usize,
    episode: Option<usize>,
    terminal: Option<usize>,
    cut_off: Vec<usize>,
    end: Vec<usize>,
    first: Vec<usize>,
    step: Option<usize>,
    /// The places of the state's columns.
    state: Vec<usize>,
}

impl Labels {
    /// `names` of `width` columns, none if they have none; `place` is where the names are. Says to `sink` which columns are
    /// the state, and what could not be known.
    pub(super) fn of(
        names: &[String],
        width: usize,
        place: &Place,
        options: &Options,
        sink: &mut Sink<'_>,
    ) -> Result<Self, ImportError> {
        let mut seen = BTreeSet::new();
        if let Some(twice) = names.iter().find(|name| !name.is_empty() && !seen.insert(name.as_str())) {
            let places: Vec<String> =
                (0..names.len()).filter(|&i| names[i] == *twice).map(|i| i.to_string()).collect();
            let value = format!("the name of columns {}", list(&places));
            return Err(place.clone().refuse(
                format!("`{twice}`"),
                value,
                "each name once; rename or remove the others",
            ));
        }
        let all = |wanted: Role| -> Vec<usize> {
            (0..names.len()).filter(|&i| role(&names[i]) == Some(wanted)).collect()
        };
        let only = |wanted: Role| match all(wanted)[..] {
            [] => Ok(None),
            [one] => Ok(Some(one)),
            [one, other, ..] => {
                let what = format!("columns `{}` and `{}`", names[one], names[other]);
                Err(place.clone().refuse(what, "two that say the same", "one of them; rename the other"))
            }
        };
        let (episode, terminal) = (only(Role::Episode)?, only(Role::Terminal)?);
        let step = all(Role::Step).first().copied();
        let (cut_off, end, first) = (all(Role::CutOff), all(Role::End), all(Role::First));
        let own = names.len() > 2 && names[..2] == ["trajectory", "terminal"];
        let state = match &options.columns {
            Some(columns) => {
                let refuse = |(value, accepted)| place.clone().refuse("--columns", value, accepted);
                columns.resolve(width, names).map_err(refuse)?
            }
            None if own => (2..names.len()).collect(),
            None => {
                let accepted = if names.is_empty() {
                    format!(
                        "--columns with those that are the state, of 0 to {}; there are no names",
                        width.saturating_sub(1)
                    )
                } else {
                    format!("--columns with those that are the state, of {}", list(names))
                };
                return Err(place.clone().refuse("--columns", "missing", accepted));
            }
        };
        for &column in &state {
            let Some(name) = names.get(column) else { continue };
            let marker = role(name).is_some_and(|role| !matches!(role, Role::Step | Role::Length));
            if marker || is_no_state(name) {
                let accepted = "columns of the state; actions and rewards are no part of a demonstration";
                return Err(place.clone().refuse("--columns", format!("`{name}`"), accepted));
            }
        }
        let chosen = state.iter().enumerate();
        let name = |(i, &column): (usize, &usize)| names.get(column).cloned().unwrap_or(format!("s{i}"));
        sink.chosen(&chosen.map(name).collect::<Vec<_>>())?;
        let labels =
            Self { names: names.to_vec(), width, episode, terminal, cut_off, end, first, step, state };
        labels.say_what_is_not_known(sink);
        Ok(labels)
    }

    fn say_what_is_not_known(&self, sink: &mut Sink<'_>) {
        let name = |columns: &[usize]| {
            columns.iter().map(|&i| format!("`{}`", self.names[i])).collect::<Vec<_>>().join(", ")
        };
        if self.terminal.is_none() && sink.ends_recorded() {
            sink.note(match (&self.end[..], &self.cut_off[..]) {
                ([], _) => "no column says which last states are terminal (such as `terminated`): none is taken as that".into(),
                (end, []) => format!(
                    "{} ends episodes, but does not say which last states are terminal: none is taken as that; --ends terminal \
                     takes all",
                    name(end)
                ),
                (end, cut_off) => format!("a last state counts as terminal where {} is set and {} is not", name(end), name(cut_off)),
            });
        }
        if self.episode.is_some() || !self.flags().is_empty() || !self.first.is_empty() {
            return;
        }
        sink.note(match self.step {
            Some(step) => format!(
                "no column says where episodes begin: a new one begins where `{}` falls",
                self.names[step]
            ),
            None => {
                let unused = (0..self.names.len()).filter(|column| !self.state.contains(column));
                let unused: Vec<&str> =
                    unused.map(|column| self.names[column].as_str()).filter(|name| !name.is_empty()).collect();
                let rest = match unused[..] {
                    [] => String::new(),
                    _ => format!("; not read: {}", list(&unused)),
                };
                format!(
                    "no column says where episodes begin or end (such as `episode` or `done`): all rows are one{rest}"
                )
            }
        });
    }

    fn flags(&self) -> Vec<usize> {
        [self.terminal.as_slice(), &self.cut_off, &self.end].concat()
    }
}

/// The episode that is being read.
#[derive(Default)]
pub(super) struct Current {
    open: bool,
    terminal: bool,
    /// The row before, and the flag that was set there.
    row: u64,
    flag: Option<usize>,
    step: Option<f64>,
    id: String,
    /// Identities of the episodes before.
    seen: BTreeSet<String>,
    state: Vec<f64>,
}

impl Current {
    /// Takes the next row, number `at` of the source, which has `width` columns.
    pub(super) fn take(
        &mut self,
        labels: &Labels,
        row: &mut impl Row,
        width: usize,
        at: u64,
        sink: &mut Sink<'_>,
    ) -> Result<(), ImportError> {
        if width != labels.width {
            return Err(sink.place().row(at).refuse("the number of columns", width, labels.width));
        }
        let begins = labels.any(&labels.first, row, at, sink)?.is_some();
        match labels.episode {
            Some(column) => self.meet_episode(labels, column, row.text(column), begins, at, sink)?,
            None => {
                let step = labels.step.filter(|_| labels.flags().is_empty() && labels.first.is_empty());
                let step = step.and_then(|column| row.number(column));
                let fell = step.zip(self.step).is_some_and(|(now, before)| now < before);
                self.step = step;
                if begins || fell {
                    self.end(sink)?;
                }
            }
        }
        if !self.open && sink.satisfied() {
            return Ok(());
        }
        let terminal = labels.any(labels.terminal.as_slice(), row, at, sink)?;
        let cut_off = labels.any(&labels.cut_off, row, at, sink)?;
        let end = labels.any(&labels.end, row, at, sink)?;
        // `done` alone says nothing of how an episode ended; beside a flag for the other way it does.
        let done =
            end.is_some() && cut_off.is_none() && !labels.cut_off.is_empty() && labels.terminal.is_none();
        if sink.wanted() {
            self.state.clear();
            for &column in &labels.state {
                let x = row.number(column).filter(|x| (*x as f32).is_finite()).ok_or_else(|| {
                    let name = labels.names.get(column).cloned().unwrap_or(format!("column {column}"));
                    let value = format!("`{}`", row.text(column));
                    sink.place().row(at).refuse(name, value, "a finite 32-bit number")
                })?;
                self.state.push(x);
            }
            sink.row(at, |i| self.state[i])?;
        }
        self.open = true;
        self.row = at;
        self.terminal = terminal.is_some() || done;
        self.flag = terminal.or(cut_off).or(end);
        if labels.episode.is_none() && self.flag.is_some() {
            self.end(sink)?;
        }
        Ok(())
    }

    /// The row belongs to episode `id`, by its column.
    fn meet_episode(
        &mut self,
        labels: &Labels,
        column: usize,
        id: String,
        begins: bool,
        at: u64,
        sink: &mut Sink<'_>,
    ) -> Result<(), ImportError> {
        if self.open && id != self.id {
            self.end(sink)?;
        }
        if !self.open {
            if !sink.satisfied() && !self.seen.insert(id.clone()) {
                let accepted = "all rows of an episode together";
                return Err(sink.place().row(at).refuse(&labels.names[column], format!("`{id}`"), accepted));
            }
            self.id = id;
            return Ok(());
        }
        if let Some(flag) = self.flag {
            let what = if labels.terminal == Some(flag) { "the terminal flag" } else { &labels.names[flag] };
            let accepted = "0 before the last row of an episode";
            return Err(sink.place().row(self.row).refuse(what, 1, accepted));
        }
        if begins {
            let accepted = "0 after the first row of an episode";
            return Err(sink.place().row(at).refuse(&labels.names[labels.first[0]], 1, accepted));
        }
        Ok(())
    }

    /// The episode is over, if there is one.
    pub(super) fn end(&mut self, sink: &mut Sink<'_>) -> Result<(), ImportError> {
        if std::mem::take(&mut self.open) {
            sink.end(self.terminal)?;
        }
        self.flag = None;
        Ok(())
    }
}

impl Labels {
    /// The first of these flags that is set.
    fn any(
        &self,
        columns: &[usize],
        row: &mut impl Row,
        at: u64,
        sink: &Sink<'_>,
    ) -> Result<Option<usize>, ImportError> {
        let mut set = None;
        for &column in columns {
            let flag = match row.number(column) {
                Some(0.0) => false,
                Some(1.0) => true,
                _ => match row.text(column).to_lowercase().as_str() {
                    // Many logs have a mark in the last row alone.
                    "" | "false" | "f" | "no" | "n" => false,
                    "true" | "t" | "yes" | "y" => true,
                    other => {
                        let place = sink.place().row(at);
                        return Err(place.refuse(
                            &self.names[column],
                            format!("`{other}`"),
                            "0 or 1, false or true",
                        ));
                    }
                },
            };
            set = set.or(flag.then_some(column));
        }
        Ok(set)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_have_roles() {
        for (name, expected) in [
            ("Done", Some(Role::End)),
            ("next.done", Some(Role::End)),
            ("TimeLimit.truncated", Some(Role::CutOff)),
            ("is-terminal", Some(Role::Terminal)),
            ("Episode ID", Some(Role::Episode)),
            ("is_first", Some(Role::First)),
            ("frame_index", Some(Role::Step)),
            ("episode_lengths", Some(Role::Length)),
            ("EpisodeID", Some(Role::Episode)),
            ("isDone", Some(Role::End)),
            ("game over", Some(Role::End)),
            ("x", None),
            ("endurance", None),
        ] {
            assert_eq!(role(name), expected, "{name}");
        }
        assert!(is_no_state("Action_0") && is_no_state("rewards") && !is_no_state("reactor"));
    }
}
