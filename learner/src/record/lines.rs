//! A text file that grows by whole lines and that a resumed run cuts back to what its checkpoint counts.

use super::error::{RecordError, io};
use crate::checkpoint::Unsynced;
use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, ErrorKind, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use trestle_proto::own_file;

/// Longest line that is looked for, bytes: where none ends for longer, the file is damaged.
const MAX_LINE: u64 = 1 << 16;

/// What to do about lines that a checkpoint counts and that are not there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Lost {
    /// The run does not go on without them.
    Refused,
    /// It goes on behind those that there are.
    Accepted,
}

/// A text file that grows by whole lines. Buffered until [`Lines::flush`].
#[derive(Debug)]
pub(super) struct Lines {
    path: PathBuf,
    file: BufWriter<File>,
    rows: u64,
}

impl Lines {
    /// An empty file but for its header, which is empty or ends with a line feed. Replaces what is there.
    pub(super) fn create(path: &Path, header: &str) -> Result<Self, RecordError> {
        let mut file = BufWriter::new(own_file::create(path).map_err(io("create", path))?);
        file.write_all(header.as_bytes()).map_err(io("write", path))?;
        file.flush().map_err(io("write", path))?;
        Ok(Self { path: path.to_path_buf(), file, rows: 0 })
    }

    /// Whether the file at `path` has its header and `rows` lines, all of which [`Lines::resume`] wants. Changes nothing.
    pub(super) fn check(path: &Path, header: &'static str, rows: u64) -> Result<(), RecordError> {
        let mut reader = BufReader::new(own_file::change(path).map_err(io("open", path))?);
        match read_to_rows(&mut reader, path, header, rows)? {
            (found, _) if found < rows => {
                Err(RecordError::MissingRows { path: path.to_path_buf(), rows, found })
            }
            _ => Ok(()),
        }
    }

    /// The file cut back to its header and the first `rows` lines; a torn line after them goes as well. `lost` says what is
    /// done about lines that are missing.
    pub(super) fn resume(
        path: &Path,
        header: &'static str,
        rows: u64,
        lost: Lost,
    ) -> Result<Self, RecordError> {
        let file = match own_file::change(path) {
            Err(e) if e.kind() == ErrorKind::NotFound && lost == Lost::Accepted => {
                tracing::warn!("{} is missing: a new one is begun", path.display());
                return Self::create(path, header);
            }
            file => file.map_err(io("open", path))?,
        };
        let mut reader = BufReader::new(file);
        let (found, bytes) = read_to_rows(&mut reader, path, header, rows)?;
        if found < rows {
            let missing = RecordError::MissingRows { path: path.to_path_buf(), rows, found };
            match lost {
                Lost::Refused => return Err(missing),
                Lost::Accepted => tracing::warn!("{missing}; going on behind those that there are"),
            }
        }
        let mut file = reader.into_inner();
        let end = header.len() as u64 + bytes;
        file.set_len(end).map_err(io("shorten", path))?;
        file.seek(SeekFrom::Start(end)).map_err(io("shorten", path))?;
        Ok(Self { path: path.to_path_buf(), file: BufWriter::new(file), rows: found })
    }

    /// Lines so far, the header aside.
    pub(super) fn rows(&self) -> u64 {
        self.rows
    }

    /// Adds `line`, which contains no line feed.
    pub(super) fn push(&mut self, line: &str) -> Result<(), RecordError> {
        self.file.write_all(line.as_bytes()).map_err(io("write", &self.path))?;
        self.file.write_all(b"\n").map_err(io("write", &self.path))?;
        self.rows += 1;
        Ok(())
    }

    /// Hands all lines to the operating system.
    pub(super) fn flush(&mut self) -> Result<(), RecordError> {
        self.file.flush().map_err(io("write", &self.path))
    }

    /// Hands all lines to the operating system; returns the file, whose lines the caller brings to the disk.
    pub(super) fn unsynced(&mut self) -> Result<Unsynced, RecordError> {
        self.flush()?;
        let file = self.file.get_ref().try_clone().map_err(io("write", &self.path))?;
        Ok(Unsynced { path: self.path.clone(), file })
    }
}

/// Reads the file at `path` as far as its first `rows` lines behind `header`: those that are there, and the bytes that they take.
fn read_to_rows(
    reader: &mut impl BufRead,
    path: &Path,
    header: &'static str,
    rows: u64,
) -> Result<(u64, u64), RecordError> {
    if !starts_with(reader, header.as_bytes()).map_err(io("read", path))? {
        return Err(RecordError::Header { path: path.to_path_buf(), header: header.trim_end() });
    }
    end_of_rows(reader, rows).map_err(io("read", path))
}

/// Whether the next bytes are `header`; reads no further than that.
fn starts_with(reader: &mut impl BufRead, header: &[u8]) -> std::io::Result<bool> {
    let mut start = vec![0; header.len()];
    match reader.read_exact(&mut start) {
        Ok(()) => Ok(start == header),
        Err(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => Ok(false),
        Err(e) => Err(e),
    }
}

/// Complete lines that are there, at most `rows`, and the bytes that they take. Reads in blocks, so that a
/// damaged file without line feeds does not fill the memory, and only as far as a line can be long.
fn end_of_rows(reader: &mut impl BufRead, rows: u64) -> std::io::Result<(u64, u64)> {
    let (mut found, mut end, mut offset) = (0, 0, 0);
    while found < rows && offset - end <= MAX_LINE {
        let block = reader.fill_buf()?;
        if block.is_empty() {
            break;
        }
        for (i, _) in
            block.iter().enumerate().filter(|(_, byte)| **byte == b'\n').take((rows - found) as usize)
        {
            found += 1;
            end = offset + i as u64 + 1;
        }
        let length = block.len();
        offset += length as u64;
        reader.consume(length);
    }
    Ok((found, end))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    const HEADER: &str = "a,b\n";

    #[test]
    fn damage_is_refused_by_name() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.csv");
        let refused = |rows| {
            let before = std::fs::metadata(&path).ok().map(|meta| meta.len());
            let said = Lines::check(&path, HEADER, rows).unwrap_err();
            assert_eq!(std::fs::metadata(&path).ok().map(|meta| meta.len()), before);
            let error = Lines::resume(&path, HEADER, rows, Lost::Refused).unwrap_err();
            assert_eq!(said.to_string(), error.to_string());
            error
        };
        assert!(matches!(refused(0), RecordError::Io { .. }));

        std::fs::write(&path, "a,c\n1,2\n").unwrap();
        assert!(matches!(refused(1), RecordError::Header { header: "a,b", .. }));

        std::fs::write(&path, "a,").unwrap();
        assert!(matches!(refused(0), RecordError::Header { .. }));

        std::fs::write(&path, "a,b\n1,2\n3,").unwrap();
        let error = refused(2);
        assert!(matches!(error, RecordError::MissingRows { rows: 2, found: 1, .. }));
        assert!(error.to_string().contains("x.csv"));

        // Without an end, of which no more is read than a line can take.
        let file = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
        file.set_len(1 << 40).unwrap();
        assert!(matches!(refused(2), RecordError::MissingRows { rows: 2, found: 1, .. }));
        std::fs::remove_file(&path).unwrap();
        nix::unistd::mkfifo(&path, nix::sys::stat::Mode::S_IRWXU).unwrap();
        assert!(refused(0).to_string().contains("x.csv: a link, a pipe"));
    }

    #[test]
    fn lost_lines_can_be_done_without() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.csv");
        let resumed = || {
            let mut lines = Lines::resume(&path, HEADER, 3, Lost::Accepted).unwrap();
            lines.push("8,9").unwrap();
            lines.flush().unwrap();
            (lines.rows(), std::fs::read_to_string(&path).unwrap())
        };
        assert_eq!(resumed(), (1, "a,b\n8,9\n".into()));
        std::fs::write(&path, "a,b\n1,2\n3,").unwrap();
        assert_eq!(resumed(), (2, "a,b\n1,2\n8,9\n".into()));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        /// Cutting back and writing on gives what writing without a break gives.
        #[test]
        fn resuming_leaves_no_trace(
            lines in proptest::collection::vec("[ -~]{0,400}", 0..60),
            kept in any::<proptest::sample::Index>(),
            torn in "[a-z]{0,5}",
        ) {
            let kept = kept.index(lines.len() + 1);
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("lines");
            let mut file = Lines::create(&path, HEADER).unwrap();
            for line in &lines {
                file.push(line).unwrap();
            }
            file.flush().unwrap();
            let undisturbed = std::fs::read(&path).unwrap();
            std::fs::write(&path, [undisturbed.as_slice(), torn.as_bytes()].concat()).unwrap();

            let mut file = Lines::resume(&path, HEADER, kept as u64, Lost::Refused).unwrap();
            for line in &lines[kept..] {
                file.push(line).unwrap();
            }
            file.unsynced().unwrap();
            prop_assert_eq!(file.rows(), lines.len() as u64);
            prop_assert_eq!(std::fs::read(&path).unwrap(), undisturbed);
        }
    }
}
