//! Why a source cannot be imported.

use std::fmt;
use std::path::{Path, PathBuf};
use trestle_proto::regular_file::{FileError, FileKind};

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
    /// A format, or a way of storing, that is known and not read.
    #[error("{place}: this is {what}, which is not read; {next}")]
    Foreign {
        /// Where.
        place: Place,
        /// What it is, with an article.
        what: Box<str>,
        /// What to do instead.
        next: Box<str>,
    },
    /// No regular file of a size that is read.
    #[error("{0}{next}", next = next_step(.0))]
    File(#[from] FileError),
}

/// What to do about a file that is not opened.
fn next_step(error: &FileError) -> &'static str {
    match error {
        FileError::Kind { kind: FileKind::Fifo, .. } => {
            "; write what comes out of the pipe into a file first"
        }
        FileError::Large { .. } => "; split it, and import the parts that are needed",
        _ => "",
    }
}

/// Most names that a message lists, and most characters of a value that it quotes.
const MAX_NAMES: usize = 20;
const MAX_VALUE: usize = 200;

/// Names for a message, the first ones of many.
pub(crate) fn list(names: &[impl AsRef<str>]) -> String {
    let shown: Vec<String> = names.iter().take(MAX_NAMES).map(|name| short(name.as_ref())).collect();
    let more = names.len() - shown.len();
    let end = if more > 0 { format!(" and {more} more") } else { String::new() };
    shown.join(", ") + &end
}

/// A value for a message, cut where it is long.
pub(crate) fn short(value: &str) -> String {
    match value.char_indices().nth(MAX_VALUE) {
        Some((end, _)) => format!("{}...", &value[..end]),
        None => value.into(),
    }
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

    /// The file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Something that is known and not read; `next` is what to do instead.
    pub(super) fn foreign(self, what: impl ToString, next: impl ToString) -> ImportError {
        ImportError::Foreign { place: self, what: what.to_string().into(), next: next.to_string().into() }
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
            value: short(&value.to_string()).into(),
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
