//! The folder that is shown, and the way into it. Nothing outside is ever opened.
//!
//! A path below the folder is a list of names. Each is opened in the directory before it and never as a link, so no name leads
//! out, whatever another process does to the folder meanwhile.

use rustix::fs::{AtFlags, FileType, Mode, OFlags, RawDir, openat, statat};
use std::fmt;
use std::fs::File;
use std::io::{self, Read};
use std::mem::MaybeUninit;
use std::os::fd::OwnedFd;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Most names in a path below the folder.
const MAX_DEPTH: usize = 8;
/// Longest name, bytes.
const MAX_NAME: usize = 255;
/// Entries of one directory that are looked at, at most.
const MAX_ENTRIES: usize = 250_000;

/// A path below the folder: names that are no way out.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Below(Vec<String>);

impl Below {
    /// `text` as names with slashes between them; none if one of them is hidden, a way up, or too long.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        let names: Vec<String> = text.split('/').filter(|name| !name.is_empty()).map(Into::into).collect();
        (names.len() <= MAX_DEPTH && names.iter().all(|name| is_plain(name))).then_some(Self(names))
    }

    /// The entry `name` of this directory; none where it is no plain name or too deep.
    pub(crate) fn join(&self, name: &str) -> Option<Self> {
        let fits = self.0.len() < MAX_DEPTH && is_plain(name) && !name.contains('/');
        fits.then(|| Self(self.0.iter().cloned().chain([name.into()]).collect()))
    }

    /// The names.
    pub(crate) fn names(&self) -> &[String] {
        &self.0
    }

    /// The names after those of `above`, which are the first ones.
    pub(crate) fn after(&self, above: &Self) -> Vec<&str> {
        self.0.iter().skip(above.0.len()).map(String::as_str).collect()
    }
}

/// Names of hidden files are those of programs' scratch space.
fn is_plain(name: &str) -> bool {
    !name.starts_with('.') && name.len() <= MAX_NAME && !name.contains('\0')
}

impl fmt::Display for Below {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.join("/"))
    }
}

/// The folder that is shown. It need not be there yet, and may go and come again.
#[derive(Clone, Debug)]
pub(crate) struct Root(PathBuf);

impl Root {
    /// The folder at `path`, or where a link there leads.
    ///
    /// # Errors
    /// A path that is no directory's, or relative to a directory that is gone.
    pub(crate) fn new(path: &Path) -> io::Result<Self> {
        match path.canonicalize() {
            Ok(path) if path.is_dir() => Ok(Self(path)),
            Ok(_) => Err(io::Error::from(io::ErrorKind::NotADirectory)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Self(std::path::absolute(path)?)),
            Err(error) => Err(error),
        }
    }

    /// The path of `below`, for people.
    pub(crate) fn path_of(&self, below: &Below) -> String {
        // Joining nothing would end it with a slash.
        let path = below.names().iter().fold(self.0.clone(), |path, name| path.join(name));
        path.display().to_string()
    }

    /// The directory `below` it.
    ///
    /// # Errors
    /// There is none, or a link.
    pub(crate) fn dir(&self, below: &Below) -> io::Result<Dir> {
        let mut dir = Dir { fd: File::open(&self.0)?.into() };
        for name in below.names() {
            dir = dir.dir(name)?;
        }
        Ok(dir)
    }
}

/// An open directory.
#[derive(Debug)]
pub(crate) struct Dir {
    fd: OwnedFd,
}

/// What identifies a file or directory on this host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Identity {
    /// Its device.
    pub(crate) dev: u64,
    /// Its inode.
    pub(crate) ino: u64,
}

/// What there is to know of a file without reading it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stamp {
    /// Which file it is.
    pub(crate) identity: Identity,
    /// Bytes.
    pub(crate) len: u64,
    /// Last change, seconds since 1970 and nanoseconds.
    pub(crate) changed: (i64, i64),
}

impl Stamp {
    fn of(file: &File) -> io::Result<Self> {
        let meta = file.metadata()?;
        Ok(Self {
            identity: Identity { dev: meta.dev(), ino: meta.ino() },
            len: meta.len(),
            changed: (meta.mtime(), meta.mtime_nsec()),
        })
    }
}

impl Dir {
    /// The directory `name` in this one.
    pub(crate) fn dir(&self, name: &str) -> io::Result<Self> {
        let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
        Ok(Self { fd: openat(&self.fd, name, flags, Mode::empty())? })
    }

    /// Which directory it is.
    pub(crate) fn identity(&self) -> io::Result<Identity> {
        let stat = rustix::fs::fstat(&self.fd)?;
        Ok(Identity { dev: stat.st_dev as u64, ino: stat.st_ino as u64 })
    }

    /// Whether `name` is there, and is what it is asked for: a directory, or else a regular file.
    pub(crate) fn has(&self, name: &str, directory: bool) -> bool {
        let kind = statat(&self.fd, name, AtFlags::SYMLINK_NOFOLLOW)
            .map(|stat| FileType::from_raw_mode(stat.st_mode));
        kind == Ok(if directory { FileType::Directory } else { FileType::RegularFile })
    }

    /// Opens the regular file `name`. The open never waits.
    ///
    /// # Errors
    /// Nothing there, or anything else than a regular file.
    pub(crate) fn open(&self, name: &str) -> io::Result<(File, Stamp)> {
        // To open a device can have effects: it is looked at first.
        if !self.has(name, false) {
            return Err(io::ErrorKind::NotFound.into());
        }
        let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
        let file = File::from(openat(&self.fd, name, flags, Mode::empty())?);
        if !file.metadata()?.is_file() {
            return Err(io::ErrorKind::NotFound.into());
        }
        let stamp = Stamp::of(&file)?;
        Ok((file, stamp))
    }

    /// The contents of `name`, up to `limit` bytes.
    ///
    /// # Errors
    /// As [`Dir::open`], or more than `limit` bytes.
    pub(crate) fn read(&self, name: &str, limit: u64) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.open(name)?.0.take(limit + 1).read_to_end(&mut bytes)?;
        if bytes.len() as u64 > limit {
            return Err(io::ErrorKind::FileTooLarge.into());
        }
        Ok(bytes)
    }

    /// Names of the files and directories in it, each with whether it is a directory; ordered, hidden ones left out. The second part
    /// of the answer says that there are more than can be looked at.
    ///
    /// # Errors
    /// What the system says.
    pub(crate) fn entries(&self) -> io::Result<(Vec<(String, bool)>, bool)> {
        let mut found = Vec::new();
        let mut buffer = [MaybeUninit::uninit(); 1 << 13];
        let own = self.dir(".")?;
        let mut entries = RawDir::new(&own.fd, &mut buffer);
        let mut more = false;
        while let Some(entry) = entries.next() {
            let entry = entry?;
            if found.len() == MAX_ENTRIES {
                more = true;
                break;
            }
            let Ok(name) = entry.file_name().to_str() else { continue };
            if !is_plain(name) {
                continue;
            }
            let directory = match entry.file_type() {
                FileType::Directory => true,
                FileType::RegularFile => false,
                FileType::Unknown if self.has(name, true) => true,
                FileType::Unknown if self.has(name, false) => false,
                _ => continue,
            };
            found.push((name.to_owned(), directory));
        }
        found.sort_unstable();
        Ok((found, more))
    }
}
