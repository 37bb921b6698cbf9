//! What can be wrong with a checkpoint, each with the file that it is wrong with.

use std::io;
use std::path::{Path, PathBuf};
use trestle_algorithm::agent::AgentError;
use trestle_proto::regular_file::FileError;

/// A checkpoint that cannot be written or used.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The file system refused.
    #[error("cannot {action} {path}: {source}")]
    Io {
        /// What was to be done.
        action: &'static str,
        /// With which file or directory.
        path: PathBuf,
        /// The reason.
        source: io::Error,
    },
    /// A file that is not there, or not one that can be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// The checkpoint was never finished, or is being removed.
    #[error("{path} is missing: the checkpoint is not complete")]
    Incomplete {
        /// The missing COMPLETE.
        path: PathBuf,
    },
    /// A file is shorter or longer than it should be.
    #[error("{path} has {found} bytes; expected {expected}")]
    Size {
        /// The file.
        path: PathBuf,
        /// Its size.
        found: u64,
        /// Its size in the MANIFEST, or the largest that is read.
        expected: u64,
    },
    /// A file is damaged.
    #[error("{path} has CRC-32C {found:08x}; expected {expected:08x}")]
    Checksum {
        /// The file.
        path: PathBuf,
        /// What was computed.
        found: u32,
        /// What was written down.
        expected: u32,
    },
    /// A file is whole, but not what it should be.
    #[error("{path}: {message}")]
    Contents {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// The checkpoint is of a run with other settings.
    #[error(
        "{path} is of another configuration ({found}; this run's is {expected}): algorithm, seed, mode, environment, \
         actors, exploration, learner and mentor must be the same"
    )]
    Configuration {
        /// The MANIFEST.
        path: PathBuf,
        /// The fingerprint in it.
        found: String,
        /// The fingerprint of the experiment.
        expected: String,
    },
    /// The files are sound, but not of this run.
    #[error("{path}: {source}")]
    Agent {
        /// The checkpoint.
        path: PathBuf,
        /// What does not fit.
        source: Box<AgentError>,
    },
}

/// Makes an [`CheckpointError::Io`] of an I/O error.
pub(super) fn io(path: &Path, action: &'static str) -> impl Fn(io::Error) -> CheckpointError + use<> {
    let path = path.to_path_buf();
    move |source| CheckpointError::Io { action, path: path.clone(), source }
}

/// Makes a [`CheckpointError::Contents`] of whatever a reader of the file says.
pub(super) fn contents<E: ToString>(path: &Path) -> impl Fn(E) -> CheckpointError + use<E> {
    let path = path.to_path_buf();
    move |message| CheckpointError::Contents { path: path.clone(), message: message.to_string() }
}
