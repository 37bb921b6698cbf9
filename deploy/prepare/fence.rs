//! The lock that keeps every process but those of one run from writing into the run's directory.
//!
//! It is a lock on the directory itself (`flock`), which belongs to an open file and not to a process. The supervisor takes
//! it and lets its learner, the only other process that writes there, inherit the open file. So it ends with the last of
//! the two: a learner that outlives its supervisor, for however short a time, keeps the directory locked.

use super::aside::replaced;
use crate::TRANSPORT;
use anyhow::{Context, Result, bail};
use nix::unistd::dup;
use std::fs::{self, File, TryLockError};
use std::io::ErrorKind;
use std::os::fd::OwnedFd;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::thread::sleep;
use std::time::{Duration, Instant};
use trestle_link::{Liveness, Transport};
use trestle_proto::limits::FENCE_WAIT;
use trestle_proto::rundir::RunDir;

/// Time between two looks at a lock that somebody else has.
///
/// The system has no wait that would do instead. `flock` waits without a deadline: a thread that waited in it could only be
/// abandoned, and would later take a lock that its start has given up. The locks that do take a deadline need a file that is open
/// for writing, which a directory never is. Nothing announces the end of a lock. And a start waits for more than the lock: for
/// another directory in the place, for a run that turns out to live. So it looks, for [`FENCE_WAIT`] at most, once in a start.
const LOOK: Duration = Duration::from_millis(20);
/// Time after which the user is told what is waited for.
const SILENCE: Duration = Duration::from_secs(1);

/// The lock of a run's directory, until this is dropped and the learners that have inherited it are gone.
#[derive(Debug)]
pub(crate) struct Fence(Option<File>);

impl Fence {
    /// Takes the lock of the directory `root`. Where the processes of a dead run still have it, they get up to [`FENCE_WAIT`] to
    /// end. Nobody is kept out where the file system knows no locks; then a warning says so. None where the directory has gone.
    ///
    /// # Errors
    /// A run is in progress in the directory, or a process of a former one has not ended in time.
    pub(super) fn take(root: &Path) -> Result<Option<Self>> {
        let (start, mut said) = (Instant::now(), false);
        loop {
            // Opened anew each time: another start, which had the lock, may have put a directory of its own in the place of this
            // one, or be about to.
            let dir = match File::open(root) {
                Err(e) if e.kind() == ErrorKind::NotFound => {
                    // Without a run beside it that is being replaced, nobody is about to put a directory here.
                    if start.elapsed() >= FENCE_WAIT || replaced(root).is_empty() {
                        return Ok(None);
                    }
                    sleep(LOOK);
                    continue;
                }
                opened => opened.with_context(|| format!("cannot open {}", root.display()))?,
            };
            match dir.try_lock() {
                Ok(()) if is_at(&dir, root) => return Ok(Some(Self(Some(dir)))),
                Ok(()) => {
                    drop(dir);
                    sleep(LOOK);
                    continue;
                }
                Err(TryLockError::WouldBlock) => {}
                Err(TryLockError::Error(error)) => {
                    tracing::warn!(
                        "{} cannot be locked ({error}): see to it that no other run uses it",
                        root.display()
                    );
                    return Ok(Some(Self(None)));
                }
            }
            let alive = RunDir::new(root)
                .read_plan()
                .is_ok_and(|plan| TRANSPORT.liveness(plan.life.run) == Liveness::Alive);
            if alive || start.elapsed() >= FENCE_WAIT {
                bail!(
                    "{}: a run is in progress there, held by {}; accepted: another --out, or to wait for its end",
                    root.display(),
                    holders(&dir)
                );
            }
            if start.elapsed() >= SILENCE && !said {
                said = true;
                crate::output::say(&format!("waiting for the end of {}", holders(&dir)));
            }
            sleep(LOOK);
        }
    }

    /// Whether the lock is held: not where the file system knows none.
    pub(super) fn holds(&self) -> bool {
        self.0.is_some()
    }

    /// The lock for a process that is started while this descriptor is open: unlike others, it is inherited.
    pub(crate) fn inheritable(&self) -> Result<Option<OwnedFd>> {
        // A duplicate is not closed when another program begins.
        self.0.as_ref().map(dup).transpose().context("cannot hand on the lock of the run's directory")
    }
}

/// Takes the lock of the directory `root` if nobody has it; none where the file system knows no locks.
///
/// # Errors
/// Somebody has it, or there is no such directory.
pub(crate) fn try_lock(root: &Path) -> Result<Option<File>> {
    let dir = File::open(root).with_context(|| format!("cannot open {}", root.display()))?;
    match dir.try_lock() {
        Ok(()) if is_at(&dir, root) => Ok(Some(dir)),
        Ok(()) | Err(TryLockError::WouldBlock) => bail!("{} is in use", root.display()),
        Err(TryLockError::Error(_)) => Ok(None),
    }
}

/// Whether the open directory `dir` is the one that `root` leads to. A lock on a directory that has been moved or removed
/// keeps nobody out.
fn is_at(dir: &File, root: &Path) -> bool {
    let of = |meta: &fs::Metadata| (meta.dev(), meta.ino());
    matches!((dir.metadata(), fs::metadata(root)), (Ok(own), Ok(there)) if of(&own) == of(&there))
}

/// Who has the lock of `dir`, as far as can be seen from here.
fn holders(dir: &File) -> String {
    let Ok(wanted) = dir.metadata() else { return "an unknown process".into() };
    let mut found: Vec<String> = Vec::new();
    for process in fs::read_dir("/proc").into_iter().flatten().flatten() {
        let name = process.file_name().to_string_lossy().into_owned();
        let path = process.path();
        if name.parse::<u32>().is_ok() && holds(&path, &wanted) {
            found.push(format!("{} (process {name})", role(&path)));
        }
    }
    if found.is_empty() {
        return "a process of another container, user or host".into();
    }
    found.join(" and ")
}

/// Whether the process that `/proc` shows at `process` has an open file of the directory `wanted` with a lock on it.
fn holds(process: &Path, wanted: &fs::Metadata) -> bool {
    fs::read_dir(process.join("fd")).into_iter().flatten().flatten().any(|descriptor| {
        let same = fs::metadata(descriptor.path())
            .is_ok_and(|found| (found.dev(), found.ino()) == (wanted.dev(), wanted.ino()));
        let info = || fs::read_to_string(process.join("fdinfo").join(descriptor.file_name()));
        same && info().is_ok_and(|info| info.contains("FLOCK"))
    })
}

/// What the process does, by its subcommand.
fn role(process: &Path) -> String {
    let line = fs::read(process.join("cmdline")).unwrap_or_default();
    match line.split(|byte| *byte == 0).nth(1) {
        Some(b"train" | b"resume" | b"sweep") => "the supervisor".into(),
        Some(b"learner" | b"orphaned") => "the learner".into(),
        _ => "a program".into(),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::process::{Command, Stdio};

    /// A start waits for the lock of a directory. Meanwhile the start that has it puts another directory in its place. The waiting
    /// start gets the lock of the new directory, and not that of the old one beside it.
    #[test]
    fn the_lock_is_that_of_the_directory_in_the_place() {
        let dir = tempfile::tempdir().unwrap();
        let (root, aside) = (dir.path().join("run"), dir.path().join("run.replaced-7"));
        fs::create_dir(&root).unwrap();
        let first = Fence::take(&root).unwrap().unwrap();
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| Fence::take(&root).unwrap().unwrap());
            // Moved at any moment of the other one's wait, the outcome is the same.
            fs::rename(&root, &aside).unwrap();
            drop(first);
            std::thread::yield_now();
            fs::create_dir(&root).unwrap();
            let fence = waiting.join().unwrap();
            assert!(is_at(fence.0.as_ref().unwrap(), &root));
            assert!(try_lock(&root).is_err() && try_lock(&aside).unwrap().is_some());
        });
        // A directory that was opened and then removed is not the one at its path.
        let opened = File::open(&root).unwrap();
        fs::remove_dir(&root).unwrap();
        assert!(!is_at(&opened, &root));
        fs::create_dir(&root).unwrap();
        assert!(!is_at(&opened, &root) && is_at(&File::open(&root).unwrap(), &root));
    }

    #[test]
    fn the_lock_is_inherited_and_ends_with_the_last_who_has_it() {
        let dir = tempfile::tempdir().unwrap();
        let fence = Fence::take(dir.path()).unwrap().unwrap();
        let other = File::open(dir.path()).unwrap();
        assert!(matches!(other.try_lock(), Err(TryLockError::WouldBlock)));
        let handed_on = fence.inheritable().unwrap();
        let mut heir = Command::new("cat").stdin(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
        drop(handed_on);
        let mut stranger = Command::new("cat").stdin(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
        let own = holders(&other);
        assert!(own.contains(&format!("process {}", std::process::id())), "{own}");
        drop(fence);
        assert!(matches!(other.try_lock(), Err(TryLockError::WouldBlock)));
        assert_eq!(holders(&other), format!("a program (process {})", heir.id()));
        drop(heir.stdin.take());
        heir.wait().unwrap();
        other.try_lock().unwrap();
        stranger.kill().unwrap();
        stranger.wait().unwrap();
    }
}
