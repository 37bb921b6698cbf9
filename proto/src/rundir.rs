//! A run's directory: what lies where, and writing files so that a reader never sees half of one.

use crate::plan::RunPlan;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// A file or directory of a run that cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum RunDirError {
    /// The system refuses.
    #[error("{path}: {source}")]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The directory holds no run.
    #[error("{path} is not a run's directory: it has no {missing}")]
    NotARun {
        /// The directory.
        path: PathBuf,
        /// The file that is missing.
        missing: &'static str,
    },
    /// The plan is damaged or of another version.
    #[error("{path}: {source}")]
    Plan {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: crate::codec::CodecError,
    },
}

/// The directory of one run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunDir {
    root: PathBuf,
}

impl RunDir {
    /// The run's directory at `root`, whether it exists or not.
    pub fn new(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into() }
    }

    /// The directory itself.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The resolved configuration.
    pub fn config(&self) -> PathBuf {
        self.root.join("config.toml")
    }

    /// The command that was typed.
    pub fn command(&self) -> PathBuf {
        self.root.join("command.txt")
    }

    /// Version, commit, processor features and back ends.
    pub fn build(&self) -> PathBuf {
        self.root.join("build.json")
    }

    /// The plan that the run's processes read.
    pub fn plan(&self) -> PathBuf {
        self.root.join("plan.bin")
    }

    /// The demonstration that the mentor-server reads.
    pub fn demonstration(&self) -> PathBuf {
        self.root.join("demonstration.csv")
    }

    /// The run's own copy of the demonstration called `name`, where there are several.
    pub fn demonstration_of(&self, name: &str) -> PathBuf {
        self.root.join("demonstrations").join(format!("{name}.csv"))
    }

    /// What was found out about each mentor transition.
    pub fn mentor(&self) -> PathBuf {
        self.root.join("mentor.csv")
    }

    /// What was counted of each incarnation of an actor, in free mode.
    pub fn actors(&self) -> PathBuf {
        self.root.join("actors.csv")
    }

    /// Greedy evaluations.
    pub fn evals(&self) -> PathBuf {
        self.root.join("evals.csv")
    }

    /// Episodes and intervals.
    pub fn metrics(&self) -> PathBuf {
        self.root.join("metrics.jsonl")
    }

    /// Logs, one file a process.
    pub fn logs(&self) -> PathBuf {
        self.root.join("logs")
    }

    /// The log of one process, such as `learner` or `actor-0`.
    pub fn log(&self, process: &str) -> PathBuf {
        self.logs().join(format!("{process}.log"))
    }

    /// Checkpoints, one directory a tick.
    pub fn checkpoints(&self) -> PathBuf {
        self.root.join("checkpoints")
    }

    /// Link to the newest complete checkpoint.
    pub fn last(&self) -> PathBuf {
        self.root.join("last")
    }

    /// The outcome.
    pub fn result(&self) -> PathBuf {
        self.root.join("result.json")
    }

    /// Reads the plan.
    ///
    /// # Errors
    /// The directory holds no run, or the plan is damaged.
    pub fn read_plan(&self) -> Result<RunPlan, RunDirError> {
        let path = self.plan();
        let bytes = fs::read(&path).map_err(|source| match source.kind() {
            io::ErrorKind::NotFound => RunDirError::NotARun { path: self.root.clone(), missing: "plan.bin" },
            _ => RunDirError::Io { path: path.clone(), source },
        })?;
        RunPlan::decode(&bytes).map_err(|source| RunDirError::Plan { path, source })
    }
}

/// Writes `bytes` to `path` by way of a temporary file beside it, so that `path` always holds either what it held or
/// all of `bytes`, also after a crash.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), RunDirError> {
    let fault = |source| RunDirError::Io { path: path.into(), source };
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(".tmp");
    let temporary = path.with_file_name(name);
    let mut file = File::create(&temporary).map_err(fault)?;
    file.write_all(bytes).and_then(|()| file.sync_all()).map_err(fault)?;
    fs::rename(&temporary, path).map_err(fault)?;
    sync_parent(path).map_err(fault)
}

/// Makes a renamed or new entry of `path`'s directory survive a crash.
pub fn sync_parent(path: &Path) -> io::Result<()> {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => File::open(parent)?.sync_all(),
        _ => File::open(".")?.sync_all(),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn files_are_replaced_whole() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("result.json");
        write_atomically(&path, b"one").unwrap();
        write_atomically(&path, b"two").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
        assert!(write_atomically(&dir.path().join("none/x"), b"").is_err());
    }

    #[test]
    fn a_directory_without_a_plan_is_no_run() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunDir::new(dir.path());
        assert!(matches!(run.read_plan(), Err(RunDirError::NotARun { .. })));
        fs::write(run.plan(), b"rubbish").unwrap();
        assert!(matches!(run.read_plan(), Err(RunDirError::Plan { .. })));
    }
}
