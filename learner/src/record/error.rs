//! What can go wrong while a run is written down.

use std::path::{Path, PathBuf};

/// A file of the run directory could not be written or gone on with.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The operating system refused.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// The file or directory.
        path: PathBuf,
        /// Why it failed.
        source: std::io::Error,
    },
    /// A resumed run's file is shorter than its checkpoint says.
    #[error(
        "{} has {found} of the {rows} lines that the checkpoint counts: restore the file, or start the run anew",
        path.display()
    )]
    MissingRows {
        /// The file.
        path: PathBuf,
        /// Lines that the checkpoint counts, the header aside.
        rows: u64,
        /// Complete lines that are there.
        found: u64,
    },
    /// A resumed run's file does not begin as this version writes it.
    #[error("{} does not begin with the line {header:?}: it was not written by this version", path.display())]
    Header {
        /// The file.
        path: PathBuf,
        /// The line accepted.
        header: &'static str,
    },
    /// An evaluation without episodes has no mean.
    #[error("the evaluation at {env_steps} environment steps has 0 episodes; 1 or more are accepted")]
    NoEpisodes {
        /// When it took place.
        env_steps: u64,
    },
}

/// For `map_err`: what was tried with which path.
pub(super) fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> RecordError {
    move |source| RecordError::Io { action, path: path.to_path_buf(), source }
}
