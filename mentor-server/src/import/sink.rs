//! Where the rows of every format end up: picks columns and episodes, looks at each number, keeps to the limits.

use super::error::{ImportError, Place};
use super::{Ends, Options};
use std::path::{Path, PathBuf};
use trestle_algorithm::demonstration::Demonstration;
use trestle_proto::limits::{MAX_MENTOR_TRANSITIONS, MAX_OBS_DIM};

/// Takes rows, episode after episode.
pub(super) struct Sink<'a> {
    path: PathBuf,
    options: &'a Options,
    width: usize,
    columns: Vec<usize>,
    demonstration: Option<Demonstration>,
    /// States of the episode that is being read, the chosen columns alone.
    pending: Vec<f32>,
    /// Episodes that have ended.
    episodes: u64,
    /// Episodes of one state.
    single: u64,
    notes: Vec<String>,
}

impl<'a> Sink<'a> {
    pub(super) fn new(path: &Path, options: &'a Options) -> Self {
        Self {
            path: path.into(),
            options,
            width: 0,
            columns: Vec::new(),
            demonstration: None,
            pending: Vec::new(),
            episodes: 0,
            single: 0,
            notes: Vec::new(),
        }
    }

    /// Where we are, for messages.
    pub(super) fn place(&self) -> Place {
        Place::of(&self.path).episode(self.episodes)
    }

    /// The episode that is being read, from 0.
    pub(super) fn episode(&self) -> u64 {
        self.episodes
    }

    /// States have `width` columns from here on, with `names` where the source has them. The first call decides;
    /// later ones must agree.
    pub(super) fn columns(&mut self, width: usize, names: &[String]) -> Result<(), ImportError> {
        if self.demonstration.is_some() {
            if width != self.width {
                return Err(self.place().refuse("the number of features", width, self.width));
            }
            return Ok(());
        }
        let place = Place::of(&self.path);
        if width == 0 {
            return Err(place.refuse("the number of features", 0, format!("1 to {MAX_OBS_DIM}")));
        }
        self.columns = match &self.options.columns {
            Some(columns) => columns
                .resolve(width, names)
                .map_err(|(value, accepted)| place.clone().refuse("--columns", value, accepted))?,
            None => (0..width.min(MAX_OBS_DIM + 1)).collect(),
        };
        let name = |(i, &column): (usize, &usize)| names.get(column).cloned().unwrap_or(format!("s{i}"));
        let names = self.columns.iter().enumerate().map(name).collect();
        self.demonstration = Some(Demonstration::new(names).map_err(|_| {
            let accepted = format!("1 to {MAX_OBS_DIM}; --columns chooses some");
            place.refuse("the number of features", width, accepted)
        })?);
        self.width = width;
        Ok(())
    }

    /// As [`Sink::columns`] where the choice has been made already: rows hold these columns alone.
    pub(super) fn chosen(&mut self, names: &[String]) -> Result<(), ImportError> {
        let demonstration = Demonstration::new(names.to_vec());
        let refuse = |error| Place::of(&self.path).refuse("the state", "out of range", error);
        self.demonstration = Some(demonstration.map_err(refuse)?);
        self.width = names.len();
        self.columns = (0..names.len()).collect();
        Ok(())
    }

    /// Whether the episode that comes next is wanted.
    pub(super) fn wanted(&self) -> bool {
        self.options.episodes.as_ref().is_none_or(|episodes| episodes.contains(self.episodes))
    }

    /// Whether no episode from here on is wanted.
    pub(super) fn satisfied(&self) -> bool {
        self.options.episodes.as_ref().is_some_and(|episodes| self.episodes >= episodes.end())
    }

    /// Number of states of the episode so far.
    pub(super) fn len(&self) -> usize {
        self.pending.len().checked_div(self.columns.len()).unwrap_or(0)
    }

    /// The state in row `row`; `value` gives its columns.
    pub(super) fn row(&mut self, row: u64, value: impl Fn(usize) -> f64) -> Result<(), ImportError> {
        for &column in &self.columns {
            let x = value(column) as f32;
            if !x.is_finite() {
                let what = format!("column {column}");
                let accepted = "a finite 32-bit number";
                return Err(self.place().row(row).refuse(what, value(column), accepted));
            }
            self.pending.push(x);
        }
        let transitions =
            self.demonstration.as_ref().map_or(0, Demonstration::n_transitions) + self.len() - 1;
        if transitions > MAX_MENTOR_TRANSITIONS {
            let accepted = format!("up to {MAX_MENTOR_TRANSITIONS}; --episodes chooses some");
            return Err(self.place().row(row).refuse("the number of transitions", transitions, accepted));
        }
        Ok(())
    }

    /// The episode is over; `terminal` if its last state is known to be terminal. One that is not wanted has no
    /// states here.
    pub(super) fn end(&mut self, terminal: bool) -> Result<(), ImportError> {
        let terminal = match self.options.ends {
            Ends::Recorded => terminal,
            Ends::Terminal => true,
            Ends::CutOff => false,
        };
        if self.len() == 1 {
            self.single += 1;
        } else if let (2.., Some(demonstration)) = (self.len(), &mut self.demonstration) {
            let pushed = demonstration.push_trajectory(&self.pending, terminal);
            pushed.map_err(|error| self.place().refuse("the episode", "unusable", error))?;
        }
        self.pending.clear();
        self.episodes += 1;
        Ok(())
    }

    /// Something to tell the user.
    pub(super) fn note(&mut self, note: String) {
        self.notes.push(note);
    }

    /// Whether ends are taken as the source has them.
    pub(super) fn ends_recorded(&self) -> bool {
        self.options.ends == Ends::Recorded
    }

    /// The whole demonstration, and the notes.
    pub(super) fn done(mut self) -> Result<(Demonstration, Vec<String>), ImportError> {
        let place = Place::of(&self.path);
        if let Some(episodes) = &self.options.episodes
            && self.episodes < episodes.end()
        {
            let accepted = format!("up to 0..{}", self.episodes);
            return Err(place.refuse("--episodes", episodes, accepted));
        }
        if self.single > 0 {
            let single = self.single;
            self.notes.push(format!("{single} episodes of a single state left out: they hold no transition"));
        }
        match self.demonstration {
            Some(demonstration) if demonstration.n_trajectories() > 0 => Ok((demonstration, self.notes)),
            _ => Err(place.refuse("every episode", "shorter than two states", "one of two states or more")),
        }
    }
}
