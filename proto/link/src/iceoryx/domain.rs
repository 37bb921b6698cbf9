//! Where a run's shared resources lie, who holds them, and how they are removed.
//!
//! Everything that a run shares is in `/dev/shm`: a root directory `trestle_<run>` (mode 0700; node and service files) and
//! files whose names begin with `trestle_<run>_` (mode 0600). Nothing is in `/tmp`.
//!
//! The run's supervisor holds a lock (`flock`) on the root directory from before anybody can see it until its own end,
//! however that comes. So a run is alive as long as its root is locked. This holds for every process that sees the same
//! `/dev/shm`, also in a container with other processes and another `/tmp`. Files without a root may still be needed, and
//! no process can tell. They are [`Liveness::Unknown`], and must be left alone.

use super::Ipc;
use crate::Liveness;
use iceoryx2::prelude::{
    Config, FileName, Node, NodeBuilder, Path as IoxPath, SemanticString, SignalHandlingMode,
};
use nix::libc::{O_DIRECTORY, O_NOFOLLOW};
use nix::unistd::getuid;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind};
use std::ops::Deref;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
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
    /// iceoryx2 could not start.
    #[error("cannot join the run's shared memory under {path}: {message}")]
    Node {
        /// The run's root.
        path: PathBuf,
        /// Its message.
        message: String,
    },
}

/// A run's place among the host's shared resources.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Domain {
    run: u64,
    root: PathBuf,
}

/// The domain of a run of this process, which counts as alive as long as this is there. Then everything is removed.
#[derive(Debug)]
pub struct HeldDomain {
    domain: Domain,
    /// The root, locked. Only the end of this value unlocks it, so that no process sees the run die before it is removed.
    _lock: File,
}

impl Deref for HeldDomain {
    type Target = Domain;

    fn deref(&self) -> &Domain {
        &self.domain
    }
}

impl Drop for HeldDomain {
    fn drop(&mut self) {
        if let Err(error) = self.domain.remove() {
            tracing::error!("cannot remove what the run shared: {error}; `trestle doctor --fix` can");
        }
    }
}

/// Removes a run that is over when it is dropped. A process that joins a run makes one first: the run may end, and be removed, while
/// the process joins.
#[derive(Debug)]
pub struct Departure {
    domain: Domain,
    joined: bool,
}

impl Departure {
    /// Of a process that is about to join the run of `domain`.
    pub fn of(domain: &Domain) -> Self {
        Self { joined: domain.is_alive(), domain: domain.clone() }
    }

    /// Whether the run was in progress then.
    pub fn joined(&self) -> bool {
        self.joined
    }
}

impl Drop for Departure {
    fn drop(&mut self) {
        // A run without a root is still being made; or, for a process that found it in progress, others have removed it.
        let removed = self.joined && matches!(self.domain.root.try_exists(), Ok(false));
        if !removed && !self.domain.is_dead() {
            return;
        }
        if let Err(error) = self.domain.remove() {
            tracing::error!("cannot remove what the run shared: {error}; `trestle doctor --fix` can");
        }
    }
}

fn io_error(path: &Path) -> impl FnOnce(io::Error) -> DomainError {
    move |source| DomainError::Io { path: path.into(), source }
}

impl Domain {
    /// The domain of `run`, whether it exists or not.
    pub fn of(run: u64) -> Self {
        Self { run, root: Path::new(SHM).join(format!("trestle_{run:08x}")) }
    }

    /// Makes the root of a new run, which this process holds. `run` must not exist yet.
    ///
    /// # Errors
    /// The directory exists or cannot be made.
    pub fn create(run: u64) -> Result<HeldDomain, DomainError> {
        let domain = Self::of(run);
        // Renamed into place when it is locked, so that no one ever sees a living run without a lock. A run of the same
        // identity is in the way of the renaming because its directory is not empty.
        let new = Path::new(SHM).join(format!("{}new", domain.prefix()));
        fs::DirBuilder::new().mode(0o700).create(&new).map_err(io_error(&new))?;
        let made = fs::write(new.join("owner"), format!("{}\n", std::process::id()))
            .and_then(|()| open_directory(&new))
            .and_then(|lock| lock.try_lock().map(|()| lock).map_err(io::Error::from))
            .and_then(|lock| fs::rename(&new, &domain.root).map(|()| lock));
        match made {
            Ok(lock) => Ok(HeldDomain { domain, _lock: lock }),
            Err(source) => {
                fs::remove_dir_all(&new).map_err(io_error(&new))?;
                Err(DomainError::Io { path: domain.root, source })
            }
        }
    }

    /// The run's identity.
    pub fn run(&self) -> u64 {
        self.run
    }

    /// The run's root directory.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The beginning of the names of its files in `/dev/shm`.
    pub fn prefix(&self) -> String {
        format!("trestle_{:08x}_", self.run)
    }

    /// A pattern of a shell's that names its files in `/dev/shm` and nothing else.
    pub(super) fn names(&self) -> String {
        format!("{SHM}/{}*", self.prefix())
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
                // A file that has gone meanwhile belongs to a process that is leaving.
                Err(e) if e.kind() != ErrorKind::NotFound => return Err(io_error(&file)(e)),
                _ => {}
            }
        }
        Ok(())
    }

    /// The state of the run.
    pub fn liveness(&self) -> Liveness {
        let root = match open_directory(&self.root) {
            Ok(root) => root,
            Err(e) if e.kind() == ErrorKind::NotFound => {
                return match own_shared_memory(&self.prefix()) {
                    Ok(names) if names.is_empty() => Liveness::Absent,
                    _ => Liveness::Unknown,
                };
            }
            Err(_) => return Liveness::Unknown,
        };
        // Another user's file under the run's name says nothing about the run.
        if !root.metadata().is_ok_and(|meta| is_own(&meta)) {
            return Liveness::Unknown;
        }
        match root.try_lock_shared() {
            Ok(()) => Liveness::Dead,
            Err(TryLockError::WouldBlock) => Liveness::Alive,
            Err(TryLockError::Error(_)) => Liveness::Unknown,
        }
    }

    /// Whether the run's supervisor lives.
    pub(super) fn is_alive(&self) -> bool {
        self.liveness() == Liveness::Alive
    }

    /// Whether there is something left of a run whose supervisor is gone. A run that is only just being made has no root, or a
    /// locked one; so a dead run stays dead.
    pub fn is_dead(&self) -> bool {
        self.liveness() == Liveness::Dead
    }

    /// Removes the root and all files in `/dev/shm`; none of the run's processes may need them any more. A file that is
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
            let is_dir = fs::symlink_metadata(&file).is_ok_and(|meta| meta.is_dir());
            match if is_dir { fs::remove_dir_all(&file) } else { fs::remove_file(&file) } {
                Err(e) if e.kind() != ErrorKind::NotFound => return Err(io_error(&file)(e)),
                _ => {}
            }
        }
        // Anything else under the run's name is no part of this user's run.
        if !fs::symlink_metadata(&self.root).is_ok_and(|meta| meta.is_dir() && is_own(&meta)) {
            return Ok(());
        }
        match fs::remove_dir_all(&self.root) {
            Err(e) if e.kind() != ErrorKind::NotFound => Err(io_error(&self.root)(e)),
            _ => Ok(()),
        }
    }

    /// The run's files in `/dev/shm`, sorted. Another user's file is never part of this user's run, even if its name fits.
    /// Root may remove any file, and could otherwise take another user's living run for the remains of a dead run of root's.
    pub fn shared_memory(&self) -> Result<Vec<PathBuf>, DomainError> {
        let mut files = own_shared_memory(&self.prefix())?;
        files.sort();
        Ok(files.iter().map(|name| Path::new(SHM).join(name)).collect())
    }

    /// All runs of this user that have a root or a file in `/dev/shm`, living or dead, in ascending order.
    ///
    /// # Errors
    /// `/dev/shm` cannot be listed.
    pub fn all() -> Result<Vec<Self>, DomainError> {
        let names = own_shared_memory("trestle_")?;
        let run = |name: &String| {
            let run = name.strip_prefix("trestle_").and_then(|rest| rest.split('_').next());
            run.and_then(|run| u64::from_str_radix(run, 16).ok())
        };
        let mut runs: Vec<u64> = names.iter().filter_map(run).collect();
        runs.sort_unstable();
        runs.dedup();
        Ok(runs.into_iter().map(Self::of).collect())
    }
}

/// Whether a file is this user's.
fn is_own(meta: &fs::Metadata) -> bool {
    meta.uid() == getuid().as_raw()
}

/// Opens a directory, and nothing that a link leads to.
fn open_directory(path: &Path) -> io::Result<File> {
    OpenOptions::new().read(true).custom_flags(O_DIRECTORY | O_NOFOLLOW).open(path)
}

/// The names of this user's files in `/dev/shm` that begin with `prefix`.
fn own_shared_memory(prefix: &str) -> Result<Vec<String>, DomainError> {
    let shm = Path::new(SHM);
    let mut names = Vec::new();
    for entry in fs::read_dir(shm).map_err(io_error(shm))? {
        let entry = entry.map_err(io_error(shm))?;
        let name = entry.file_name().to_string_lossy().into_owned();
        // A file that vanished meanwhile belongs to a run that is ending.
        if name.starts_with(prefix) && entry.metadata().is_ok_and(|meta| is_own(&meta)) {
            names.push(name);
        }
    }
    Ok(names)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    // Process ids are at most 2^22, so no run of a user, which draws 32 bits, is likely to meet these.
    fn identity(nth: u64) -> u64 {
        u64::from(std::process::id()) << 32 | nth
    }

    #[test]
    fn a_domain_is_private_held_and_leaves_nothing() {
        let run = identity(1);
        assert_eq!(Domain::of(run).liveness(), Liveness::Absent, "it may be about to be made");
        let domain = Domain::create(run).unwrap();
        assert_eq!(fs::metadata(domain.root()).unwrap().mode() & 0o777, 0o700);
        assert_eq!(Domain::of(run).liveness(), Liveness::Alive);
        assert!(Domain::all().unwrap().contains(&domain));
        assert!(matches!(Domain::create(run), Err(DomainError::Io { .. })));
        let node = domain.node().unwrap();
        let files = domain.shared_memory().unwrap();
        assert!(!files.is_empty());
        assert!(files.iter().all(|file| fs::metadata(file).unwrap().mode() & 0o777 == 0o600), "{files:?}");
        drop(node);
        drop(domain);
        let domain = Domain::of(run);
        assert_eq!(domain.liveness(), Liveness::Absent);
        assert!(!domain.root().exists() && domain.shared_memory().unwrap().is_empty());
        domain.remove().unwrap();
    }

    #[test]
    fn a_lock_tells_the_living_from_the_dead_and_nothing_else_does() {
        let domain = Domain::of(identity(2));
        let file = Path::new(SHM).join(format!("{}file", domain.prefix()));
        fs::write(&file, "").unwrap();
        assert_eq!(
            domain.liveness(),
            Liveness::Unknown,
            "it may be of a run that this version knows nothing of"
        );
        fs::create_dir(domain.root()).unwrap();
        assert_eq!(domain.liveness(), Liveness::Dead);
        let lock = open_directory(domain.root()).unwrap();
        lock.try_lock().unwrap();
        assert_eq!(domain.liveness(), Liveness::Alive);
        drop(lock);
        assert_eq!(domain.liveness(), Liveness::Dead);
        domain.remove().unwrap();
        assert!(!file.exists());
        // Something lies there that is no directory of this user.
        std::os::unix::fs::symlink("/", domain.root()).unwrap();
        assert_eq!(domain.liveness(), Liveness::Unknown);
        domain.remove().unwrap();
        fs::remove_file(domain.root()).unwrap();
    }
}
