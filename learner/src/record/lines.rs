//! A text file that grows by whole lines and that a resumed run cuts back to what its checkpoint counts.

use super::error::{RecordError, io};
use crate::checkpoint::Unsynced;
use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

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
        let mut file = BufWriter::new(File::create(path).map_err(io("create", path))?);
        file.write_all(header.as_bytes()).map_err(io("write", path))?;
        file.flush().map_err(io("write", path))?;
        Ok(Self { path: path.to_path_buf(), file, rows: 0 })
    }

    /// The file cut back to its header and the first `rows` lines; a torn line after them goes as well.
    pub(super) fn resume(path: &Path, header: &'static str, rows: u64) -> Result<Self, RecordError> {
        let file = OpenOptions::new().read(true).write(true).open(path).map_err(io("open", path))?;
        let mut reader = BufReader::new(file);
        if !starts_with(&mut reader, header.as_bytes()).map_err(io("read", path))? {
            return Err(RecordError::Header { path: path.to_path_buf(), header: header.trim_end() });
        }
        let (found, bytes) = end_of_rows(&mut reader, rows).map_err(io("read", path))?;
        if found < rows {
            return Err(RecordError::MissingRows { path: path.to_path_buf(), rows, found });
        }
        let mut file = reader.into_inner();
        let end = header.len() as u64 + bytes;
        file.set_len(end).map_err(io("shorten", path))?;
        file.seek(SeekFrom::Start(end)).map_err(io("shorten", path))?;
        Ok(Self { path: path.to_path_buf(), file: BufWriter::new(file), rows })
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

    /// Hands all lines to the operating system; returns the file for whoever sees to it that they reach the disk.
    pub(super) fn unsynced(&mut self) -> Result<Unsynced, RecordError> {
        self.flush()?;
        let file = self.file.get_ref().try_clone().map_err(io("write", &self.path))?;
        Ok(Unsynced { path: self.path.clone(), file })
    }
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
/// damaged file without line feeds does not fill the memory.
fn end_of_rows(reader: &mut impl BufRead, rows: u64) -> std::io::Result<(u64, u64)> {
    let (mut found, mut end, mut offset) = (0, 0, 0);
    while found < rows {
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
        assert!(matches!(Lines::resume(&path, HEADER, 0), Err(RecordError::Io { .. })));

        std::fs::write(&path, "a,c\n1,2\n").unwrap();
        assert!(matches!(Lines::resume(&path, HEADER, 1), Err(RecordError::Header { header: "a,b", .. })));

        std::fs::write(&path, "a,").unwrap();
        assert!(matches!(Lines::resume(&path, HEADER, 0), Err(RecordError::Header { .. })));

        std::fs::write(&path, "a,b\n1,2\n3,").unwrap();
        let error = Lines::resume(&path, HEADER, 2).unwrap_err();
        assert!(matches!(error, RecordError::MissingRows { rows: 2, found: 1, .. }));
        assert!(error.to_string().contains("x.csv"));
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

            let mut file = Lines::resume(&path, HEADER, kept as u64).unwrap();
            for line in &lines[kept..] {
                file.push(line).unwrap();
            }
            file.unsynced().unwrap();
            prop_assert_eq!(file.rows(), lines.len() as u64);
            prop_assert_eq!(std::fs::read(&path).unwrap(), undisturbed);
        }
    }
}
