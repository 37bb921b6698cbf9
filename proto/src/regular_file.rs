//! Reading files that a user, a configuration or a run directory names.
//!
//! A path can lead to anything: a FIFO that nobody writes to, a device without an end, a directory, a sparse file of
//! many terabytes. Every reader of such a path opens it here, and says how many bytes it accepts at the most. Then
//! nothing hangs, and memory stays bounded, whatever is there.

use libc::{O_NOCTTY, O_NONBLOCK};
use std::fmt;
use std::fs::{self, File, FileType, Metadata, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

/// A file that is not read. The message names the path, what is there, and what is accepted.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The operating system refuses.
    #[error("{path}: {error}")]
    Io {
        /// The path as it was given.
        path: PathBuf,
        /// The reason.
        error: io::Error,
    },
    /// Something other than a regular file, or a link to one.
    #[error("{path} is {kind}; accepted: a regular file")]
    Kind {
        /// The path as it was given.
        path: PathBuf,
        /// What is there.
        kind: FileKind,
    },
    /// More bytes than the reader accepts.
    #[error("{path} has {bytes} bytes; accepted: up to {limit}")]
    Large {
        /// The path as it was given.
        path: PathBuf,
        /// Its length, or as much as has been read where the file is longer than it says.
        bytes: u64,
        /// The most that the reader accepts.
        limit: u64,
    },
    /// Bytes that are no text.
    #[error("{path}, {error}")]
    NotText {
        /// The path as it was given.
        path: PathBuf,
        /// Where.
        error: NotText,
    },
}

/// Bytes that are no text: neither UTF-8 nor, with a byte-order mark, UTF-16.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}, column {column}: bytes that are not UTF-8 text")]
pub struct NotText {
    /// The line of the first such byte, from 1.
    pub line: usize,
    /// Its column, from 1.
    pub column: usize,
}

impl FileError {
    /// Whether there is nothing at the path.
    pub fn is_not_found(&self) -> bool {
        matches!(self, Self::Io { error, .. } if error.kind() == io::ErrorKind::NotFound)
    }
}

/// What a path leads to, where that is not a regular file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A directory.
    Directory,
    /// A named pipe.
    Fifo,
    /// A Unix socket.
    Socket,
    /// A character or block device.
    Device,
    /// Something else that the operating system knows.
    Other,
}

impl FileKind {
    fn of(kind: FileType) -> Self {
        match kind {
            kind if kind.is_dir() => Self::Directory,
            kind if kind.is_fifo() => Self::Fifo,
            kind if kind.is_socket() => Self::Socket,
            kind if kind.is_char_device() || kind.is_block_device() => Self::Device,
            _ => Self::Other,
        }
    }
}

impl fmt::Display for FileKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Directory => "a directory",
            Self::Fifo => "a pipe (FIFO)",
            Self::Socket => "a socket",
            Self::Device => "a device",
            Self::Other => "a special file",
        })
    }
}

/// Opens the regular file at `path`, or the one that a link there leads to, for reading. It has up to `limit` bytes.
///
/// The open never waits, and the file descriptor is not inherited by child processes. A file may still grow, and those
/// of `/proc` are longer than they say: a reader that keeps what it reads must count, as [`read`] does.
///
/// # Errors
/// Nothing there, no permission, another kind of file, or one that is too long.
pub fn open(path: &Path, limit: u64) -> Result<File, FileError> {
    let io = |error| FileError::Io { path: path.into(), error };
    let accept = |found: &Metadata| {
        if !found.is_file() {
            return Err(FileError::Kind { path: path.into(), kind: FileKind::of(found.file_type()) });
        }
        if found.len() > limit {
            return Err(FileError::Large { path: path.into(), bytes: found.len(), limit });
        }
        Ok(())
    };
    // Looked at before it is opened, because to open a device can have effects, and to open a socket fails.
    accept(&fs::metadata(path).map_err(io)?)?;
    // The standard library adds O_CLOEXEC.
    let flags = O_NONBLOCK | O_NOCTTY;
    let file = OpenOptions::new().read(true).custom_flags(flags).open(path).map_err(io)?;
    // The path may lead elsewhere by now.
    accept(&file.metadata().map_err(io)?)?;
    Ok(file)
}

/// All bytes of the regular file at `path`, up to `limit` of them.
///
/// # Errors
/// As [`open`], and what the operating system says of reading.
pub fn read(path: &Path, limit: u64) -> Result<Vec<u8>, FileError> {
    let mut bytes = Vec::new();
    let read = open(path, limit)?.take(limit.saturating_add(1)).read_to_end(&mut bytes);
    read.map_err(|error| FileError::Io { path: path.into(), error })?;
    match bytes.len() as u64 {
        bytes if bytes > limit => Err(FileError::Large { path: path.into(), bytes, limit }),
        _ => Ok(bytes),
    }
}

/// The text of the regular file at `path`, up to `limit` bytes; see [`decode`].
///
/// # Errors
/// As [`read`], and bytes that are no text.
pub fn read_to_string(path: &Path, limit: u64) -> Result<String, FileError> {
    decode(read(path, limit)?).map_err(|error| FileError::NotText { path: path.into(), error })
}

/// The text in `bytes`: UTF-8, or UTF-16 with a byte-order mark. The mark is no part of the text.
///
/// # Errors
/// Where the first bytes are that are no text.
pub fn decode(bytes: Vec<u8>) -> Result<String, NotText> {
    let not_text = |sound: &str| NotText {
        line: sound.split('\n').count(),
        column: sound.rsplit('\n').next().map_or(0, |last| last.chars().count()) + 1,
    };
    let unit = match bytes.as_slice() {
        [0xff, 0xfe, ..] => Some(u16::from_le_bytes as fn([u8; 2]) -> u16),
        [0xfe, 0xff, ..] => Some(u16::from_be_bytes as fn([u8; 2]) -> u16),
        _ => None,
    };
    let Some(unit) = unit else {
        let text = String::from_utf8(bytes).map_err(|error| {
            let sound = &error.as_bytes()[..error.utf8_error().valid_up_to()];
            not_text(&String::from_utf8_lossy(sound))
        })?;
        return Ok(text.strip_prefix('\u{feff}').map(String::from).unwrap_or(text));
    };
    let (units, rest) = bytes[2..].as_chunks::<2>();
    let mut text = String::with_capacity(units.len());
    for letter in char::decode_utf16(units.iter().map(|&pair| unit(pair))) {
        match letter {
            Ok(letter) => text.push(letter),
            Err(_) => return Err(not_text(&text)),
        }
    }
    if rest.is_empty() { Ok(text) } else { Err(not_text(&text)) }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use nix::sys::stat::Mode;
    use nix::unistd::mkfifo;
    use std::os::unix::fs::symlink;
    use std::os::unix::net::UnixListener;

    fn refused(path: &Path, limit: u64) -> String {
        let error = read_to_string(path, limit).unwrap_err();
        assert_eq!(open(path, limit).err().map(|e| e.to_string()), Some(error.to_string()));
        error.to_string()
    }

    #[test]
    fn only_regular_files_are_opened() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        mkfifo(&at("fifo"), Mode::S_IRWXU).unwrap();
        symlink(at("fifo"), at("link")).unwrap();
        let _socket = UnixListener::bind(at("socket")).unwrap();
        let accepted = "; accepted: a regular file";
        for (name, kind) in [
            ("fifo", "a pipe (FIFO)"),
            ("link", "a pipe (FIFO)"),
            ("socket", "a socket"),
            ("", "a directory"),
        ] {
            assert_eq!(refused(&at(name), 10), format!("{} is {kind}{accepted}", at(name).display()));
        }
        for device in ["/dev/zero", "/dev/full", "/dev/null"] {
            assert_eq!(refused(Path::new(device), 10), format!("{device} is a device{accepted}"));
        }
        assert!(open(&at("none"), 10).unwrap_err().is_not_found());
        fs::write(at("file"), "text").unwrap();
        symlink(at("file"), at("way")).unwrap();
        for name in ["file", "way"] {
            assert_eq!(read_to_string(&at(name), 4).unwrap(), "text");
            assert!(refused(&at(name), 3).ends_with(" has 4 bytes; accepted: up to 3"));
        }
    }

    #[test]
    fn length_and_encoding_are_checked() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("file");
        // Sparse, so that it takes no room.
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        assert!(refused(&path, 1 << 20).contains(" has 1099511627776 bytes; accepted: up to 1048576"));
        // One that is longer than it says.
        let proc = Path::new("/proc/self/status");
        assert!(open(proc, 8).is_ok());
        assert!(read(proc, 8).unwrap_err().to_string().ends_with(" has 9 bytes; accepted: up to 8"));
        fs::write(&path, b"a\nb\nc\xff").unwrap();
        let message = read_to_string(&path, 9).unwrap_err().to_string();
        assert!(message.ends_with(", line 3, column 2: bytes that are not UTF-8 text"), "{message}");
    }

    #[test]
    fn marks_are_no_part_of_a_text() {
        let text = "x = 1\n\u{1f600}\n";
        let wide = |order: fn(u16) -> [u8; 2]| {
            "\u{feff}".encode_utf16().chain(text.encode_utf16()).flat_map(order).collect()
        };
        let marked = [b"\xef\xbb\xbf", text.as_bytes()].concat();
        for bytes in [text.into(), marked, wide(u16::to_le_bytes), wide(u16::to_be_bytes)] {
            assert_eq!(decode(bytes).unwrap(), text);
        }
        assert_eq!(decode(vec![]).unwrap(), "");
        // Half a character, and half of a pair.
        assert_eq!(decode(vec![0xff, 0xfe, b'a', 0, b'b']), Err(NotText { line: 1, column: 2 }));
        assert_eq!(decode(vec![0xff, 0xfe, 0x00, 0xd8]), Err(NotText { line: 1, column: 1 }));
    }
}
