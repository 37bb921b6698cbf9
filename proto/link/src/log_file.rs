//! Logs of bounded size: the end of a file that has grown to its limit is copied to `<name>.1`, in the place of an older copy,
//! and the file is emptied. So a process keeps at most twice the limit, and three times while it copies.
//!
//! A log is never renamed: an environment may write it as its standard output, or hand it on to programs that it starts, which
//! may outlive it. All of these would go on with the renamed file. Each of them writes at the end of the log, wherever that is.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Read, Seek, SeekFrom};
use std::os::fd::AsFd;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use trestle_proto::limits::MAX_LOG_BYTES;
use trestle_proto::own_file;
use trestle_proto::rundir::{Durable, write_atomically};

/// Where the lines are that had no room in the log at `path` any more.
pub fn former(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_os_string();
    name.push(".1");
    name.into()
}

/// Opens the log at `path` to add to it. One that has grown to its limit is emptied first, if there is room for the copy of its
/// end.
///
/// # Errors
/// What the system says, and anything at `path` but a regular file.
pub fn open(path: &Path) -> io::Result<File> {
    if fs::symlink_metadata(path).is_ok_and(|meta| meta.is_file() && meta.len() >= MAX_LOG_BYTES) {
        match empty(path) {
            // The log cannot grow either, and is no reason to end a run.
            Err(e) if matches!(e.kind(), ErrorKind::StorageFull | ErrorKind::QuotaExceeded) => {}
            emptied => emptied?,
        }
    }
    own_file::append(path)
}

/// The log that this process writes as its standard error.
#[derive(Debug)]
pub struct OwnLog(PathBuf);

impl OwnLog {
    /// The log at `path`, if it is where this process's standard error goes.
    pub fn at(path: PathBuf) -> Option<Self> {
        let log = Self(path);
        log.length().map(|_| log)
    }

    /// Bytes of the log; none if this process's standard error goes elsewhere.
    fn length(&self) -> Option<u64> {
        let own = File::from(io::stderr().as_fd().try_clone_to_owned().ok()?).metadata().ok()?;
        let there = fs::symlink_metadata(&self.0).ok()?;
        (there.is_file() && (own.dev(), own.ino()) == (there.dev(), there.ino())).then_some(own.len())
    }

    /// Empties the log if it has grown to its limit, whichever process wrote the lines; its end is in [`former`] from then on.
    /// To be called now and then.
    ///
    /// # Errors
    /// What the system says. The log grows on then.
    pub fn keep_bounded(&self) -> io::Result<()> {
        match self.length() {
            Some(MAX_LOG_BYTES..) => empty(&self.0),
            _ => Ok(()),
        }
    }
}

/// Room in the copy for lines that come while others are copied. Those of a process that writes faster than that are lost.
const LATE: u64 = MAX_LOG_BYTES / 4;

/// Copies the end of the log at `path` to where its former lines are, [`MAX_LOG_BYTES`] at most, and empties it. If the copy fails,
/// the log and its older copy stay as they are.
fn empty(path: &Path) -> io::Result<()> {
    let mut log = own_file::change(path)?;
    let length = log.metadata()?.len();
    log.seek(SeekFrom::Start(length.saturating_sub(MAX_LOG_BYTES - LATE)))?;
    write_atomically(&former(path), Durable::Later, |copy| {
        io::copy(&mut log.by_ref().take(MAX_LOG_BYTES), copy).map(drop)
    })?;
    log.set_len(0)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::io::Write;

    #[test]
    fn a_log_keeps_its_newest_lines_in_two_files() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("learner.log");
        let line = [b'x'; 1 << 16];
        for start in 0..200u32 {
            let mut log = open(&path).unwrap();
            log.write_all(&start.to_be_bytes()).unwrap();
            log.write_all(&line).unwrap();
        }
        let sizes = [&path, &former(&path)].map(|path| fs::metadata(path).unwrap().len());
        assert!(sizes.iter().all(|&size| size <= MAX_LOG_BYTES + (1 << 16) + 4), "{sizes:?}");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2);
        let newest = fs::read(&path).unwrap();
        assert_eq!(newest[newest.len() - line.len() - 4..][..4], 199u32.to_be_bytes());
        assert!(OwnLog::at(path).is_none(), "it is not this process's standard error");
    }

    /// A process that has the log open goes on writing the log, and not its copy.
    #[test]
    fn a_log_that_others_write_is_emptied() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("actor-0.log");
        let mut others = [open(&path).unwrap(), open(&path).unwrap()];
        let burst = vec![b'x'; 3 * MAX_LOG_BYTES as usize];
        for round in 0..3 {
            others[round % 2].write_all(&burst).unwrap();
            others[0].write_all(b"the end").unwrap();
            match round {
                1 => drop(open(&path).unwrap()),
                _ => empty(&path).unwrap(),
            }
            assert_eq!(fs::metadata(&path).unwrap().len(), 0);
            let kept = fs::read(former(&path)).unwrap();
            assert!(kept.len() as u64 == MAX_LOG_BYTES - LATE && kept.ends_with(b"xthe end"));
            others[1].write_all(b"more").unwrap();
            assert_eq!(fs::read(&path).unwrap(), b"more");
        }
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2);
    }

    #[test]
    fn an_older_copy_stays_until_the_new_one_is_complete() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("actor-0.log");
        fs::write(former(&path), "older").unwrap();
        let lines = vec![b'x'; MAX_LOG_BYTES as usize];
        fs::write(&path, &lines).unwrap();
        // In the way of the copy that is being made.
        let begun = dir.path().join(format!(".actor-0.log.1.{}.tmp", std::process::id()));
        fs::create_dir(&begun).unwrap();
        assert!(open(&path).is_err());
        assert_eq!(fs::read(former(&path)).unwrap(), b"older");
        assert!(fs::read(&path).unwrap() == lines);
        fs::remove_dir(begun).unwrap();
        open(&path).unwrap();
        assert!(fs::read(former(&path)).unwrap() == lines[LATE as usize..]);
        assert_eq!(fs::metadata(&path).unwrap().len(), 0);
    }
}
