//! Where a run's shared resources lie, and how they are removed.
//!
//! A run has a root directory `/tmp/trestle-<uid>/<run>` (mode 0700; node and service files) and files in
//! `/dev/shm` that begin with `trestle_<run>_` (mode 0600). The root holds a file `owner` with the supervisor's process id and
//! start time, so that what a dead run left can be told from what a living one needs.

use super::Ipc;
use iceoryx2::prelude::{
    Config, FileName, Node, NodeBuilder, Path as IoxPath, SemanticString, SignalHandlingMode,
};
use nix::unistd::{Uid, getuid};
use std::fs;
use std::io::{self, ErrorKind};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use trestle_proto::limits::MAX_ACTORS;

/// How often removing a run's root is tried anew when others remove it, too: more than it has processes.
const REMOVALS: u32 = 2 * MAX_ACTORS;
const SHM: &str = "/dev/shm";

/// A run's place among shared resources that cannot be had.
#[derive(Debug, thiserror::Error)]
pub enum DomainError {
    /// A directory or file.
    #[error("{path}: {source}")]
    Io {
        /// Which.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// Somebody else's directory under our name.
    #[error(
        "{path} belongs to user {owner}, with mode {mode:o}; accepted: a directory of user {user}, mode 700"
    )]
    Foreign {
        /// The directory.
        path: PathBuf,
        /// Its owner.
        owner: u32,
        /// Its mode.
        mode: u32,
        /// This user.
        user: u32,
    },
    /// iceoryx2 could not start.
    #[error("cannot join the run's shared memory under {path}: {message}")]
    Node {
        /// The run's root.
        path: PathBuf,
        /// What it says.
        message: String,
    },
}

/// A run's place among the host's shared resources.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Domain {
    run: u64,
    root: PathBuf,
}

/// The directory that holds the roots of all runs of this user.
fn base() -> PathBuf {
    PathBuf::from(format!("/tmp/trestle-{}", getuid()))
}

fn io_error(path: &Path) -> impl FnOnce(io::Error) -> DomainError {
    move |source| DomainError::Io { path: path.into(), source }
}

impl Domain {
    /// The domain of `run`, whether it exists or not.
    pub fn of(run: u64) -> Self {
        Self { run, root: base().join(format!("{run:08x}")) }
    }

    /// Makes the root of a new run with this process as owner. `run` must not exist yet.
    ///
    /// # Errors
    /// The directory exists, cannot be made, or is another user's.
    pub fn create(run: u64) -> Result<Self, DomainError> {
        let base = base();
        let mut private = fs::DirBuilder::new();
        private.mode(0o700);
        match private.create(&base) {
            Err(e) if e.kind() != ErrorKind::AlreadyExists => return Err(io_error(&base)(e)),
            _ => own(&base)?,
        }
        let domain = Self::of(run);
        // Renamed into place with its owner inside, so that no one ever sees a living run without one; a run of the
        // same identity is in the way of the renaming because its directory is not empty.
        let pid = std::process::id();
        let new = base.join(format!("new-{pid}-{run:08x}"));
        private.create(&new).map_err(io_error(&new))?;
        let stamp = format!("{pid} {}\n", start_time(pid).unwrap_or_default());
        let made = fs::write(new.join("owner"), stamp).and_then(|()| fs::rename(&new, &domain.root));
        if let Err(source) = made {
            fs::remove_dir_all(&new).map_err(io_error(&new))?;
            return Err(DomainError::Io { path: domain.root, source });
        }
        Ok(domain)
    }

    /// The run's identity.
    pub fn run(&self) -> u64 {
        self.run
    }

    /// The run's root directory.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// What the names of its files in `/dev/shm` begin with.
    pub fn prefix(&self) -> String {
        format!("trestle_{:08x}_", self.run)
    }

    /// A node of this process in the run. Signals stay the process's own affair.
    pub fn node(&self) -> Result<Node<Ipc>, DomainError> {
        let fault = |message: String| DomainError::Node { path: self.root.clone(), message };
        let mut config = Config::default();
        let root = self.root.as_os_str().as_encoded_bytes();
        config.global.set_root_path(&IoxPath::new(root).map_err(|e| fault(e.to_string()))?);
        config.global.prefix = FileName::new(self.prefix().as_bytes()).map_err(|e| fault(e.to_string()))?;
        // The supervisor alone reaps: a child that cleans up could take part of a node that is just starting.
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.service.cleanup_dead_nodes_on_open = false;
        let node = NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Ipc>()
            .map_err(|e| fault(e.to_string()))?;
        self.close_to_others()?;
        Ok(node)
    }

    /// Takes every right to the run's shared memory from other users: iceoryx2 gives them all to one file, the count of
    /// nodes that keeps the nodes' names apart.
    fn close_to_others(&self) -> Result<(), DomainError> {
        for file in self.shared_memory()? {
            let closed = fs::symlink_metadata(&file).and_then(|meta| match meta.mode() & 0o077 {
                0 => Ok(()),
                _ => fs::set_permissions(&file, fs::Permissions::from_mode(0o600)),
            });
            match closed {
                // What has gone meanwhile belongs to a process that is leaving.
                Err(e) if e.kind() != ErrorKind::NotFound => return Err(io_error(&file)(e)),
                _ => {}
            }
        }
        Ok(())
    }

    /// Whether the process that made the run still lives.
    pub fn is_alive(&self) -> bool {
        let Ok(text) = fs::read_to_string(self.root.join("owner")) else { return false };
        let mut fields = text.split_whitespace();
        let (pid, started) = (fields.next().and_then(|p| p.parse().ok()), fields.next());
        pid.is_some_and(|pid| start_time(pid).as_deref() == started)
    }

    /// Whether there is something left of a run whose maker does not live. A run that is only just being made has no root, or
    /// one with a living owner in it; so what this finds stays dead.
    pub fn is_dead(&self) -> bool {
        self.root.exists() && !self.is_alive()
    }

    /// Removes the root and all files in `/dev/shm`; none of the run's processes may need them any more. What is
    /// already gone is no error: several processes may be removing the same run.
    pub fn remove(&self) -> Result<(), DomainError> {
        let mut attempts = 0;
        loop {
            match self.try_remove() {
                // Another process is in the middle of the same directory.
                Err(DomainError::Io { source, .. })
                    if attempts < REMOVALS
                        && matches!(source.kind(), ErrorKind::NotFound | ErrorKind::DirectoryNotEmpty) =>
                {
                    attempts += 1;
                }
                result => return result,
            }
        }
    }

    fn try_remove(&self) -> Result<(), DomainError> {
        for file in self.shared_memory()? {
            match fs::remove_file(&file) {
                Err(e) if e.kind() != ErrorKind::NotFound => return Err(io_error(&file)(e)),
                _ => {}
            }
        }
        match fs::remove_dir_all(&self.root) {
            Err(e) if e.kind() != ErrorKind::NotFound => Err(io_error(&self.root)(e)),
            _ => Ok(()),
        }
    }

    /// The run's files in `/dev/shm`, sorted. Files of other users are none of this user's run, whatever their names:
    /// root, who may remove them, could otherwise take the living run of another for what is left of a dead one of its own.
    pub fn shared_memory(&self) -> Result<Vec<PathBuf>, DomainError> {
        let mut files = own_shared_memory(&self.prefix())?;
        files.sort();
        Ok(files.iter().map(|name| Path::new(SHM).join(name)).collect())
    }

    /// All runs of this user that have a root or a file in `/dev/shm`, living or dead, in ascending order.
    ///
    /// # Errors
    /// A directory that cannot be listed, or somebody else's in the place of this user's.
    pub fn all() -> Result<Vec<Self>, DomainError> {
        let mut runs = Vec::new();
        let base = base();
        // What a link leads to, or another user has made, is not to be removed as if it were a run's.
        match own(&base) {
            Err(DomainError::Io { source, .. }) if source.kind() == ErrorKind::NotFound => {}
            Err(error) => return Err(error),
            Ok(()) => {
                for entry in fs::read_dir(&base).map_err(io_error(&base))? {
                    let name = entry.map_err(io_error(&base))?.file_name();
                    runs.extend(u64::from_str_radix(&name.to_string_lossy(), 16));
                }
            }
        }
        for name in own_shared_memory("trestle_")? {
            let run = name.strip_prefix("trestle_").and_then(|rest| rest.split('_').next());
            runs.extend(run.and_then(|run| u64::from_str_radix(run, 16).ok()));
        }
        runs.sort_unstable();
        runs.dedup();
        Ok(runs.into_iter().map(Self::of).collect())
    }
}

/// The names of this user's files in `/dev/shm` that begin with `prefix`.
fn own_shared_memory(prefix: &str) -> Result<Vec<String>, DomainError> {
    let shm = Path::new(SHM);
    let mut names = Vec::new();
    for entry in fs::read_dir(shm).map_err(io_error(shm))? {
        let entry = entry.map_err(io_error(shm))?;
        let name = entry.file_name().to_string_lossy().into_owned();
        // A file that vanished meanwhile belongs to a run that is ending.
        if name.starts_with(prefix) && entry.metadata().is_ok_and(|m| m.uid() == getuid().as_raw()) {
            names.push(name);
        }
    }
    Ok(names)
}

/// Refuses a directory that another user could have prepared or could look into.
fn own(path: &Path) -> Result<(), DomainError> {
    let meta = fs::symlink_metadata(path).map_err(io_error(path))?;
    let (owner, mode, user) = (meta.uid(), meta.mode() & 0o777, getuid());
    if meta.is_dir() && Uid::from_raw(owner) == user && mode == 0o700 {
        return Ok(());
    }
    Err(DomainError::Foreign { path: path.into(), owner, mode, user: user.as_raw() })
}

/// When process `pid` started, in the kernel's clock ticks since boot (proc(5), `stat`, field 22); none if there is
/// no such process, or if it has ended and its parent has not asked for its status yet (field 3). Tells a process from a
/// later one with the same id.
fn start_time(pid: u32) -> Option<String> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The second field is the command in parentheses and may itself contain blanks and parentheses.
    let (_, fields) = stat.rsplit_once(')')?;
    let mut fields = fields.split_whitespace();
    fields.next().filter(|state| !["Z", "X"].contains(state))?;
    fields.nth(18).map(String::from)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_domain_is_private_owned_and_leaves_nothing() {
        // Process ids are at most 2^22, so no run of a user, which draws 32 bits, is likely to meet this one.
        let run = u64::from(std::process::id()) << 32 | 1;
        assert!(!Domain::of(run).is_dead(), "it may be about to be made");
        let domain = Domain::create(run).unwrap();
        assert!(!domain.is_dead());
        assert_eq!(fs::metadata(domain.root()).unwrap().mode() & 0o777, 0o700);
        assert!(domain.is_alive());
        assert!(Domain::all().unwrap().contains(&domain));
        assert!(matches!(Domain::create(domain.run()), Err(DomainError::Io { .. })));
        fs::write(domain.root().join("owner"), format!("{} 1\n", std::process::id())).unwrap();
        assert!(domain.is_dead() && !domain.is_alive(), "another process with the same id");
        let node = domain.node().unwrap();
        let files = domain.shared_memory().unwrap();
        assert!(!files.is_empty());
        assert!(files.iter().all(|file| fs::metadata(file).unwrap().mode() & 0o777 == 0o600), "{files:?}");
        drop(node);
        domain.remove().unwrap();
        assert!(!domain.root().exists());
        assert!(domain.shared_memory().unwrap().is_empty());
        domain.remove().unwrap();
    }
}
