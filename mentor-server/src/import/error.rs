//! Why a source cannot be imported.

use std::fmt;
use std::path::{Path, PathBuf};

/// A source that cannot be imported.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// The operating system, or the library that reads the format, could not go on.
    #[error("{path}: {message}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The reason.
        message: String,
    },
    /// Contents that are no demonstration, or not what was asked for.
    #[error("{place}: {what} is {value}; accepted: {accepted}")]
    Content {
        /// Where.
        place: Place,
        /// What is wrong.
        what: Box<str>,
        /// What is there.
        value: Box<str>,
        /// What is accepted.
        accepted: Box<str>,
    },
}

/// A place in a source, as far as it is known.
#[derive(Clone, Debug)]
pub struct Place {
    path: PathBuf,
    episode: Option<u64>,
    row: Option<u64>,
}

impl Place {
    /// Somewhere in a file.
    pub(super) fn of(path: &Path) -> Self {
        Self { path: path.into(), episode: None, row: None }
    }

    /// In an episode, counted from 0.
    pub(super) fn episode(mut self, episode: u64) -> Self {
        self.episode = Some(episode);
        self
    }

    /// In a row: of the array, from 0; of a CSV file, where the header is row 1.
    pub(super) fn row(mut self, row: u64) -> Self {
        self.row = Some(row);
        self
    }

    pub(super) fn refuse(
        self,
        what: impl ToString,
        value: impl ToString,
        accepted: impl ToString,
    ) -> ImportError {
        ImportError::Content {
            place: self,
            what: what.to_string().into(),
            value: value.to_string().into(),
            accepted: accepted.to_string().into(),
        }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.path.display())?;
        self.episode.map_or(Ok(()), |episode| write!(f, ", episode {episode}"))?;
        self.row.map_or(Ok(()), |row| write!(f, ", row {row}"))
    }
}
