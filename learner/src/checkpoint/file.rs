//! Files with a checksum that is computed when they are written or read, and the sync calls.

use super::error::{CheckpointError, io};
use super::manifest::FileEntry;
use std::fs::{self, File, OpenOptions};
use std::io::{Read, Write};
use std::path::Path;
use trestle_link::pulse;
use trestle_proto::{own_file, regular_file};

/// Bytes between two signs of progress of a writer.
const PIECE: usize = 1 << 20;

/// Counts and checksums what passes through.
#[derive(Debug)]
pub(super) struct Checked<F> {
    inner: F,
    crc: u32,
}

impl<F: Read> Read for Checked<F> {
    fn read(&mut self, into: &mut [u8]) -> std::io::Result<usize> {
        let read = self.inner.read(into)?;
        self.crc = crc32c::crc32c_append(self.crc, &into[..read]);
        pulse::step();
        Ok(read)
    }
}

/// Writes the new file `name` in `dir`, syncs it, and says what the MANIFEST needs to know of it.
pub(super) fn write(dir: &Path, name: &str, bytes: &[u8]) -> Result<FileEntry, CheckpointError> {
    let path = dir.join(name);
    let fault = io(&path, "write");
    let mut file = OpenOptions::new().write(true).create_new(true).open(&path).map_err(&fault)?;
    for piece in bytes.chunks(PIECE) {
        file.write_all(piece).map_err(&fault)?;
        pulse::step();
    }
    own_file::synced(file.sync_all()).map_err(&fault)?;
    Ok(FileEntry { name: name.into(), bytes: bytes.len() as u64, crc32c: crc32c::crc32c(bytes) })
}

/// Gives the file `entry` of the checkpoint in `from` to that in `to` as well: as a second link to the same file or,
/// where the file system has none, as a copy.
pub(super) fn link(from: &Path, to: &Path, entry: &FileEntry) -> Result<(), CheckpointError> {
    let (from, path) = (from.join(&entry.name), to.join(&entry.name));
    if fs::hard_link(&from, &path).is_ok() {
        return Ok(());
    }
    let bytes = regular_file::read(&from, entry.bytes)?;
    let copy = write(to, &entry.name, &bytes)?;
    if copy.crc32c == entry.crc32c {
        return Ok(());
    }
    Err(CheckpointError::Checksum { path: from, found: copy.crc32c, expected: entry.crc32c })
}

/// Makes sure that the entries of `dir` survive a power cut, as far as its file system can.
pub(super) fn sync_dir(dir: &Path) -> Result<(), CheckpointError> {
    own_file::sync_dir(dir).map_err(io(dir, "sync"))
}

/// Opens `entry` of `dir`, lets `contents` read it, and checks size and checksum of the whole file. Where both the
/// checksum and what `contents` says are faults, the checksum is reported: it is the cause.
pub(super) fn read<R>(
    dir: &Path,
    entry: &FileEntry,
    contents: impl FnOnce(&mut Checked<File>) -> Result<R, CheckpointError>,
) -> Result<R, CheckpointError> {
    let path = dir.join(&entry.name);
    let fault = io(&path, "read");
    let file = regular_file::open(&path, u64::MAX)?;
    let found = file.metadata().map_err(&fault)?.len();
    if found != entry.bytes {
        return Err(CheckpointError::Size { path, found, expected: entry.bytes });
    }
    let mut file = Checked { inner: file, crc: 0 };
    let result = contents(&mut file);
    let mut rest = [0; 1 << 16];
    while file.read(&mut rest).map_err(&fault)? > 0 {}
    if file.crc != entry.crc32c {
        return Err(CheckpointError::Checksum { path, found: file.crc, expected: entry.crc32c });
    }
    result
}

/// All bytes of `entry` of `dir`, checked.
pub(super) fn read_all(dir: &Path, entry: &FileEntry) -> Result<Vec<u8>, CheckpointError> {
    read(dir, entry, |file| {
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(io(&dir.join(&entry.name), "read"))?;
        Ok(bytes)
    })
}

/// Checks size and checksum of `entry` of `dir`.
pub(super) fn verify(dir: &Path, entry: &FileEntry) -> Result<(), CheckpointError> {
    read(dir, entry, |_| Ok(()))
}
