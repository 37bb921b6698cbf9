//! Opening and syncing the files that a run writes.
//!
//! A run's directory may lie where other users can write. So no file is created or opened for writing through a link, and
//! none that is no regular file. What a file system cannot do, and a run can do without, is told from failures.

use libc::{EINVAL, ELOOP, ENOSYS, ENXIO, EOPNOTSUPP, EPERM, EROFS, O_NOCTTY, O_NOFOLLOW, O_NONBLOCK};
use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// Creates an empty file at `path` in the place of one that may be there.
///
/// # Errors
/// What the system says, also of a directory at `path`.
pub fn create(path: &Path) -> io::Result<File> {
    match fs::remove_file(path) {
        Err(e) if e.kind() != ErrorKind::NotFound => return Err(e),
        _ => {}
    }
    OpenOptions::new().write(true).create_new(true).open(path)
}

/// Opens `path` to write at its end; creates it if there is nothing.
///
/// # Errors
/// What the system says, and anything at `path` but a regular file.
pub fn append(path: &Path) -> io::Result<File> {
    open(OpenOptions::new().append(true).create(true), path)
}

/// Opens the file at `path` to read and to change it.
///
/// # Errors
/// What the system says, and anything at `path` but a regular file.
pub fn change(path: &Path) -> io::Result<File> {
    open(OpenOptions::new().read(true).write(true), path)
}

fn open(options: &mut OpenOptions, path: &Path) -> io::Result<File> {
    const REFUSED: &str = "a link, a pipe or another special file; accepted: a regular file";
    let refused = |_| io::Error::new(ErrorKind::InvalidInput, REFUSED);
    // To open a pipe that nobody reads would wait for ever.
    let flags = O_NOFOLLOW | O_NONBLOCK | O_NOCTTY;
    let file = options.custom_flags(flags).open(path).map_err(|error| match error.raw_os_error() {
        Some(ELOOP | ENXIO) => refused(()),
        _ => error,
    })?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(refused(())) }
}

/// Makes sure that the entries of `dir` survive a power cut, as far as its file system can.
///
/// # Errors
/// What the system says.
pub fn sync_dir(dir: &Path) -> io::Result<()> {
    synced(File::open(dir)?.sync_all())
}

/// The outcome of a sync, where not being able to is no failure: network shares and the like do not know how, which is no
/// reason to end a run. Its start says so.
///
/// # Errors
/// All other failures.
pub fn synced(outcome: io::Result<()>) -> io::Result<()> {
    outcome.or_else(|error| if cannot_sync(&error) { Ok(()) } else { Err(error) })
}

/// Whether a file system says with `error` that it cannot sync such a thing at all.
pub fn cannot_sync(error: &io::Error) -> bool {
    matches!(error.raw_os_error(), Some(EINVAL | EOPNOTSUPP | ENOSYS | EROFS))
}

/// Whether a file system says with `error` that it has no links of the kind that was to be made.
pub fn cannot_link(error: &io::Error) -> bool {
    matches!(error.raw_os_error(), Some(EPERM | EINVAL | EOPNOTSUPP | ENOSYS))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use nix::sys::stat::Mode;
    use nix::unistd::mkfifo;
    use std::io::Write;
    use std::os::unix::fs::symlink;

    /// Whatever lies at the path, what a link leads to stays as it is, and nothing waits.
    #[test]
    fn nothing_is_written_through_a_link_or_into_a_pipe() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        fs::write(at("victim"), "precious").unwrap();
        symlink(at("victim"), at("link")).unwrap();
        symlink(at("nowhere"), at("dangling")).unwrap();
        mkfifo(&at("fifo"), Mode::S_IRWXU).unwrap();
        for name in ["link", "dangling", "fifo"] {
            for opened in [append(&at(name)), change(&at(name))] {
                assert!(opened.unwrap_err().to_string().contains("accepted: a regular file"), "{name}");
            }
        }
        for name in ["link", "dangling", "fifo"] {
            create(&at(name)).unwrap().write_all(b"new").unwrap();
            append(&at(name)).unwrap().write_all(b"er").unwrap();
            assert_eq!(fs::read(at(name)).unwrap(), b"newer");
        }
        assert_eq!(fs::read(at("victim")).unwrap(), b"precious");
        assert!(!at("nowhere").exists());
        fs::create_dir(at("directory")).unwrap();
        assert!(create(&at("directory")).is_err() && append(&at("directory")).is_err());
    }

    #[test]
    fn only_inability_to_sync_is_passed_over() {
        let sync = |errno| synced(Err(io::Error::from_raw_os_error(errno)));
        assert!(sync(libc::EINVAL).is_ok() && sync(libc::ENOSYS).is_ok());
        assert!(sync(libc::EIO).is_err() && sync(libc::ENOSPC).is_err());
        assert!(synced(Ok(())).is_ok());
    }
}
