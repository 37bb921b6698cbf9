//! A run's directory: the place of every file in it, and writing files so that a reader never sees half of one.

use crate::codec::MAX_BODY;
use crate::own_file;
use crate::plan::RunPlan;
use crate::regular_file::{self, FileError};
use crate::run_files::{
    ACTORS_FILE, BEST_FILE, BUILD_FILE, CHECKPOINTS_DIR, COMMAND_FILE, CONFIG_FILE, DEMONSTRATION_FILE,
    DEMONSTRATIONS_DIR, EVALS_FILE, HOSTS_FILE, LAST_LINK, LOGS_DIR, MAP_FILE, MENTOR_FILE, METRICS_FILE,
    PLAN_FILE, RESULT_FILE, TIMELINE_FILE,
};
use std::cmp::Ordering;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// A file or directory of a run that cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum RunDirError {
    /// The file cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// The directory holds no run.
    #[error("{path} is not a run's directory: it has no {missing}")]
    NotARun {
        /// The directory.
        path: PathBuf,
        /// The file that is missing.
        missing: &'static str,
    },
    /// There is nothing.
    #[error("{path} is not a run's directory: there is nothing")]
    Nothing {
        /// The directory.
        path: PathBuf,
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

impl RunDirError {
    /// How the version of the plan compares with this program's, if it is a plan of another version.
    pub fn other_version(&self) -> Option<Ordering> {
        match self {
            Self::Plan { source, .. } => source.other_version(),
            _ => None,
        }
    }
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
        self.root.join(CONFIG_FILE)
    }

    /// The command that was typed.
    pub fn command(&self) -> PathBuf {
        self.root.join(COMMAND_FILE)
    }

    /// Version, commit, processor features and back ends.
    pub fn build(&self) -> PathBuf {
        self.root.join(BUILD_FILE)
    }

    /// The plan that the run's processes read.
    pub fn plan(&self) -> PathBuf {
        self.root.join(PLAN_FILE)
    }

    /// The demonstration that the mentor-server reads.
    pub fn demonstration(&self) -> PathBuf {
        self.root.join(DEMONSTRATION_FILE)
    }

    /// The run's own copy of the demonstration called `name`, where there are several.
    pub fn demonstration_of(&self, name: &str) -> PathBuf {
        self.root.join(DEMONSTRATIONS_DIR).join(format!("{name}.csv"))
    }

    /// What was found out about each mentor transition.
    pub fn mentor(&self) -> PathBuf {
        self.root.join(MENTOR_FILE)
    }

    /// What was counted of each incarnation of an actor, in free mode.
    pub fn actors(&self) -> PathBuf {
        self.root.join(ACTORS_FILE)
    }

    /// What went over the network to other hosts.
    pub fn hosts(&self) -> PathBuf {
        self.root.join(HOSTS_FILE)
    }

    /// Greedy evaluations.
    pub fn evals(&self) -> PathBuf {
        self.root.join(EVALS_FILE)
    }

    /// Episodes and intervals.
    pub fn metrics(&self) -> PathBuf {
        self.root.join(METRICS_FILE)
    }

    /// Moments of the run, for its page.
    pub fn timeline(&self) -> PathBuf {
        self.root.join(TIMELINE_FILE)
    }

    /// Where the environment's states lie on a map, for pictures.
    pub fn map(&self) -> PathBuf {
        self.root.join(MAP_FILE)
    }

    /// Logs, one file a process.
    pub fn logs(&self) -> PathBuf {
        self.root.join(LOGS_DIR)
    }

    /// The log of one process, such as `learner` or `actor-0`.
    pub fn log(&self, process: &str) -> PathBuf {
        self.logs().join(format!("{process}.log"))
    }

    /// Checkpoints, one directory a tick.
    pub fn checkpoints(&self) -> PathBuf {
        self.root.join(CHECKPOINTS_DIR)
    }

    /// Link to the newest complete checkpoint.
    pub fn last(&self) -> PathBuf {
        self.root.join(LAST_LINK)
    }

    /// The weights of the best greedy evaluation.
    pub fn best(&self) -> PathBuf {
        self.root.join(BEST_FILE)
    }

    /// The outcome.
    pub fn result(&self) -> PathBuf {
        self.root.join(RESULT_FILE)
    }

    /// Reads the plan.
    ///
    /// # Errors
    /// The directory holds no run, or the plan is damaged.
    pub fn read_plan(&self) -> Result<RunPlan, RunDirError> {
        let path = self.plan();
        let bytes =
            regular_file::read(&path, MAX_BODY as u64).map_err(|error| match error.is_not_found() {
                true if !self.root.exists() => RunDirError::Nothing { path: self.root.clone() },
                true => RunDirError::NotARun { path: self.root.clone(), missing: PLAN_FILE },
                false => RunDirError::File(error),
            })?;
        RunPlan::decode(&bytes).map_err(|source| RunDirError::Plan { path, source })
    }
}

/// When a file that has been written is on the disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Durable {
    /// Before the writer goes on. The file survives a power cut.
    Now,
    /// When the system finds time. After a power cut the file may be the old one, or empty.
    Later,
}

/// Writes the file `path` by way of a temporary file beside it, so that `path` always holds either what it held or all that
/// `contents` writes. With [`Durable::Now`] this holds after a power cut, too, as far as the file system can sync. Where it
/// fails, nothing is left behind; a kill leaves a file that [`is_temporary`].
///
/// # Errors
/// What `contents` or the system says.
pub fn write_atomically(
    path: &Path,
    durable: Durable,
    contents: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    let Some(name) = path.file_name() else { return Err(io::Error::other("not the name of a file")) };
    let temporary = path.with_file_name(format!(".{}.{}.tmp", name.to_string_lossy(), std::process::id()));
    let written = write_new(&temporary, durable, contents).and_then(|()| fs::rename(&temporary, path));
    if written.is_err() {
        // The first error is the one worth reporting.
        let _ = fs::remove_file(&temporary);
    }
    match durable {
        Durable::Now => written.and_then(|()| sync_parent(path)),
        Durable::Later => written,
    }
}

fn write_new(
    path: &Path,
    durable: Durable,
    contents: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    // Also in the place of what a process with the same id left that was killed here.
    let mut file = BufWriter::new(own_file::create(path)?);
    contents(&mut file)?;
    file.flush()?;
    match durable {
        Durable::Now => own_file::synced(file.get_ref().sync_all()),
        Durable::Later => Ok(()),
    }
}

/// Whether a file with this name is what [`write_atomically`] leaves when it is killed.
pub fn is_temporary(name: &str) -> bool {
    let middle = name.strip_prefix('.').and_then(|name| name.strip_suffix(".tmp"));
    let process = middle.and_then(|middle| middle.rsplit_once('.')).map(|(_, process)| process);
    process.is_some_and(|id| !id.is_empty() && id.bytes().all(|byte| byte.is_ascii_digit()))
}

/// Makes a renamed or new entry of `path`'s directory survive a crash, as far as the file system can.
///
/// # Errors
/// What the system says.
pub fn sync_parent(path: &Path) -> io::Result<()> {
    own_file::sync_dir(match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn files_are_replaced_whole() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("result.json");
        write_atomically(&path, Durable::Now, |file| file.write_all(b"one")).unwrap();
        write_atomically(&path, Durable::Later, |file| file.write_all(b"two")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        let half = |file: &mut BufWriter<File>| {
            file.write_all(b"thr")?;
            file.flush()?;
            Err(io::Error::other("no more"))
        };
        assert_eq!(write_atomically(&path, Durable::Now, half).unwrap_err().to_string(), "no more");
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "no temporary file is left");
        assert!(write_atomically(&dir.path().join("none/x"), Durable::Now, |_| Ok(())).is_err());
        let temporary = |name: &str| format!(".{name}.{}.tmp", std::process::id());
        assert!(is_temporary(&temporary("plan.bin")));
        for name in ["plan.bin", ".tmp", ".plan.bin.tmp", ".plan.bin.x.tmp", "plan.bin.4.tmp", ".plan.bin.4"]
        {
            assert!(!is_temporary(name), "{name}");
        }
        // What lies in its way is not followed.
        let victim = dir.path().join("victim");
        fs::write(&victim, "precious").unwrap();
        std::os::unix::fs::symlink(&victim, dir.path().join(temporary("new"))).unwrap();
        write_atomically(&dir.path().join("new"), Durable::Now, |file| file.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&victim).unwrap(), b"precious");
        assert!(write_atomically(Path::new("/"), Durable::Now, |_| Ok(())).is_err());
    }

    #[test]
    fn a_directory_without_a_plan_is_no_run() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunDir::new(dir.path());
        assert!(matches!(run.read_plan(), Err(RunDirError::NotARun { .. })));
        fs::write(run.plan(), b"rubbish").unwrap();
        assert!(matches!(run.read_plan(), Err(RunDirError::Plan { .. })));
        assert!(matches!(RunDir::new(dir.path().join("none")).read_plan(), Err(RunDirError::Nothing { .. })));
    }
}
