//! An HDF5 file for the library: opened already, looked at, its soft links of the old style made hard.

use super::links::{Finder, hardened};
use super::{Source, unreadable};
use crate::import::error::{ImportError, Place};
use hdf5_pure::FormatError;
use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;

/// As much of a superblock as is looked at, bytes.
const SUPERBLOCK_BYTES: usize = 64;
const SIGNATURE: &[u8] = b"\x89HDF\r\n\x1a\n";
/// The first place after 0 where a superblock can be, behind a user block; the others are its doubles.
const FIRST_USER_BLOCK: u64 = 512;

/// The file's bytes, some of them replaced.
struct Patched {
    file: File,
    length: u64,
    patches: BTreeMap<u64, Vec<u8>>,
}

impl hdf5_pure::Source for Patched {
    fn len(&self) -> u64 {
        self.length
    }

    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<(), FormatError> {
        let end = offset.saturating_add(buffer.len() as u64);
        if end > self.length {
            let size = |bytes: u64| usize::try_from(bytes).unwrap_or(usize::MAX);
            return Err(FormatError::UnexpectedEof { expected: size(end), available: size(self.length) });
        }
        let failed = |error: io::Error| FormatError::Source(error.to_string());
        self.file.read_exact_at(buffer, offset).map_err(failed)?;
        for (&at, bytes) in self.patches.range(..end) {
            let (from, to) = (at.max(offset), (at + bytes.len() as u64).min(end));
            if from < to {
                let own = &bytes[(from - at) as usize..(to - at) as usize];
                buffer[(from - offset) as usize..(to - offset) as usize].copy_from_slice(own);
            }
        }
        Ok(())
    }
}

/// Where the signature of HDF5 is in a file, looked for where its library looks: at 0, or behind a user block.
pub(crate) fn signature(file: &File) -> io::Result<Option<u64>> {
    let length = file.metadata()?.len();
    let behind = std::iter::successors(Some(FIRST_USER_BLOCK), |at| at.checked_mul(2));
    for at in std::iter::once(0).chain(behind).take_while(|at| at.saturating_add(8) <= length) {
        let mut bytes = [0; 8];
        file.read_exact_at(&mut bytes, at)?;
        if bytes == *SIGNATURE {
            return Ok(Some(at));
        }
    }
    Ok(None)
}

/// Opens `file`, which has the signature of HDF5 somewhere; `path` is for messages.
pub(super) fn open(path: &Path, file: File) -> Result<Source, ImportError> {
    let io = |error: io::Error| ImportError::Io { path: path.into(), message: error.to_string() };
    let length = file.metadata().map_err(io)?.len();
    let base = signature(&file).map_err(io)?.unwrap_or(0);
    let mut start = vec![0; SUPERBLOCK_BYTES.min(length.saturating_sub(base) as usize)];
    file.read_exact_at(&mut start, base).map_err(io)?;
    if let Some(end) = end_of_file(&start)
        && end > length
    {
        let accepted = format!("{end}, as it says itself; it is cut off");
        return Err(Place::of(path).refuse("the file's length", format!("{length} bytes"), accepted));
    }
    let finder = Finder::new(file.try_clone().map_err(io)?, base);
    let patches = hardened(&file, &finder);
    let patched = Patched { file, length, patches };
    let file = hdf5_pure::File::from_source(patched).map_err(unreadable(path))?;
    Ok(Source { path: path.into(), file, finder })
}

/// Where the file should end according to its superblock (HDF5 file format, II.A). The library does not look: a file
/// that is cut off behind what we need would pass.
fn end_of_file(start: &[u8]) -> Option<u64> {
    let (size_of_offsets, at) = match *start.get(8)? {
        0 => (13, 40),
        1 => (13, 44),
        2 | 3 => (9, 28),
        _ => return None,
    };
    if *start.get(size_of_offsets)? != 8 {
        return None;
    }
    Some(u64::from_le_bytes(start.get(at..at + 8)?.try_into().ok()?))
}
