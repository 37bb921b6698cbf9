//! Reading a file of lines that grows, a piece at a time.
//!
//! Only whole lines are handed on: the last one may still be torn. Lines that are longer than the sink takes are passed over. A
//! file that is another one, is shorter, or has other bytes where this reader stopped, as after `trestle resume`, is read anew.

use crate::root::{Dir, Identity, Stamp};
use std::io::{self, Read, Seek, SeekFrom};

/// Longest line that a sink takes unless it says otherwise, bytes.
pub(crate) const MAX_LINE: usize = 1 << 16;
/// Bytes before the place where reading stopped that must still be the same.
const MARK: usize = 64;
/// Bytes that are read at once.
const CHUNK: usize = 1 << 16;

/// Where the reader of one file is.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tail {
    identity: Option<Identity>,
    /// Everything before has been handed on or passed over.
    offset: u64,
    /// The bytes before `offset`, up to [`MARK`].
    mark: Vec<u8>,
    /// Whether `offset` is inside a line that is passed over.
    skipping: bool,
    /// Length of the file when it was looked at last.
    len: u64,
}

/// What a look at a file came to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Looked {
    /// Lines were handed on.
    pub(crate) lines: u64,
    /// The file was read anew: forget everything from before, which `restart` was called for.
    pub(crate) anew: bool,
}

/// The receiver of the lines.
pub(crate) trait Sink {
    /// Longest line that it takes, bytes.
    const LONGEST: usize = MAX_LINE;
    /// The file is read anew.
    fn restart(&mut self);
    /// One line, without its end.
    fn line(&mut self, line: &[u8]);
}

impl Tail {
    /// Share of the file that has been read, 0 to 1.
    pub(crate) fn share(&self) -> f64 {
        if self.len == 0 { 1.0 } else { (self.offset as f64 / self.len as f64).min(1.0) }
    }

    /// The file that was read last.
    pub(crate) fn identity(&self) -> Option<Identity> {
        self.identity
    }

    /// Hands the new lines of `name` in `dir` on, of up to `budget` bytes. A file that is not there has no lines.
    ///
    /// # Errors
    /// What the system says of a file that is there.
    pub(crate) fn look<S: Sink>(
        &mut self,
        dir: &Dir,
        name: &str,
        budget: usize,
        sink: &mut S,
    ) -> io::Result<Looked> {
        let (mut file, stamp) = match dir.open(name) {
            Ok(opened) => opened,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                let anew = self.identity.is_some();
                if anew {
                    *self = Self::default();
                    sink.restart();
                }
                return Ok(Looked { lines: 0, anew });
            }
            Err(error) => return Err(error),
        };
        let mut looked = Looked::default();
        if !self.goes_on(&mut file, &stamp)? {
            looked.anew = self.identity.is_some();
            *self = Self { identity: Some(stamp.identity), ..Self::default() };
            sink.restart();
        }
        self.len = stamp.len;
        file.seek(SeekFrom::Start(self.offset))?;
        let mut buffer = Vec::new();
        let mut left = budget;
        while left > 0 {
            let before = buffer.len();
            let read = (&mut file).take(CHUNK.min(left) as u64).read_to_end(&mut buffer)?;
            if read == 0 {
                break;
            }
            left -= read;
            let mut start = 0;
            let mut search = before;
            while let Some(at) = buffer[search..].iter().position(|&byte| byte == b'\n') {
                let end = search + at;
                if !self.skipping && end - start <= S::LONGEST {
                    sink.line(buffer[start..end].strip_suffix(b"\r").unwrap_or(&buffer[start..end]));
                    looked.lines += 1;
                }
                self.skipping = false;
                start = end + 1;
                search = start;
            }
            if buffer.len() - start > S::LONGEST {
                self.skipping = true;
            }
            if self.skipping {
                start = buffer.len();
            }
            self.pass(&buffer[..start]);
            buffer.drain(..start);
        }
        Ok(looked)
    }

    /// `bytes` are done with.
    fn pass(&mut self, bytes: &[u8]) {
        self.offset += bytes.len() as u64;
        self.mark.extend_from_slice(&bytes[bytes.len().saturating_sub(MARK)..]);
        let extra = self.mark.len().saturating_sub(MARK);
        self.mark.drain(..extra);
    }

    /// Whether the file is the one that was read before, with the same bytes so far.
    fn goes_on(&self, file: &mut (impl Read + Seek), stamp: &Stamp) -> io::Result<bool> {
        if self.identity != Some(stamp.identity) || stamp.len < self.offset {
            return Ok(false);
        }
        let mut there = vec![0; self.mark.len()];
        file.seek(SeekFrom::Start(self.offset - self.mark.len() as u64))?;
        match file.read_exact(&mut there) {
            Ok(()) => Ok(there == self.mark),
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(false),
            Err(error) => Err(error),
        }
    }
}

/// The last whole lines of `name` in `dir`, from its last `bytes` bytes.
///
/// # Errors
/// What the system says.
pub(crate) fn last_lines(dir: &Dir, name: &str, bytes: u64) -> io::Result<Vec<String>> {
    let (mut file, stamp) = dir.open(name)?;
    let from = stamp.len.saturating_sub(bytes);
    file.seek(SeekFrom::Start(from))?;
    let mut end = Vec::new();
    file.take(bytes).read_to_end(&mut end)?;
    // The first line may have lost its beginning.
    let start =
        if from == 0 { 0 } else { end.iter().position(|&byte| byte == b'\n').map_or(end.len(), |at| at + 1) };
    let whole = end.iter().rposition(|&byte| byte == b'\n').map_or(0, |at| at + 1).max(start);
    let text = String::from_utf8_lossy(&end[start..whole]);
    Ok(text.lines().map(Into::into).collect())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::root::{Below, Root};
    use proptest::prelude::*;
    use std::fs;
    use std::io::Write;

    #[derive(Default)]
    struct Lines(Vec<Vec<u8>>);

    impl Sink for Lines {
        fn restart(&mut self) {
            self.0.clear();
        }
        fn line(&mut self, line: &[u8]) {
            self.0.push(line.to_vec());
        }
    }

    fn place() -> (tempfile::TempDir, Dir) {
        let place = tempfile::tempdir().unwrap();
        let dir = Root::new(place.path()).unwrap().dir(&Below::default()).unwrap();
        (place, dir)
    }

    fn read(tail: &mut Tail, dir: &Dir, lines: &mut Lines) -> Looked {
        tail.look(dir, "f", usize::MAX, lines).unwrap()
    }

    #[test]
    fn a_file_that_changes_under_the_reader_is_read_anew() {
        let (place, dir) = place();
        let (mut tail, mut lines) = (Tail::default(), Lines::default());
        assert_eq!(read(&mut tail, &dir, &mut lines), Looked::default());
        let path = place.path().join("f");
        fs::write(&path, "a\nbb\nccc").unwrap();
        assert_eq!(read(&mut tail, &dir, &mut lines), Looked { lines: 2, anew: false });
        fs::OpenOptions::new().append(true).open(&path).unwrap().write_all(b"c\n").unwrap();
        read(&mut tail, &dir, &mut lines);
        assert_eq!(lines.0, [b"a".to_vec(), b"bb".to_vec(), b"cccc".to_vec()]);
        // As long as before and other, as after a resumption.
        fs::write(&path, "a\nbb\ndddd\n").unwrap();
        assert!(read(&mut tail, &dir, &mut lines).anew);
        assert_eq!(lines.0[2], b"dddd");
        fs::write(&path, "e\n").unwrap();
        read(&mut tail, &dir, &mut lines);
        assert_eq!(lines.0, [b"e".to_vec()]);
        fs::remove_file(&path).unwrap();
        assert!(read(&mut tail, &dir, &mut lines).anew && lines.0.is_empty());
    }

    #[test]
    fn a_huge_line_is_passed_over_in_little_memory() {
        let (place, dir) = place();
        let mut file = fs::File::create(place.path().join("f")).unwrap();
        let piece = vec![b'x'; 1 << 20];
        file.write_all(b"before\n").unwrap();
        (0..100).for_each(|_| file.write_all(&piece).unwrap());
        file.write_all(b"\nafter\n").unwrap();
        let (mut tail, mut lines) = (Tail::default(), Lines::default());
        // Its end may be looked for in several goes.
        while tail.share() < 1.0 || tail.offset == 0 {
            tail.look(&dir, "f", 30 << 20, &mut lines).unwrap();
        }
        assert_eq!(lines.0, [b"before".to_vec(), b"after".to_vec()]);
        assert!(last_lines(&dir, "f", 64).unwrap() == ["after"]);
    }

    #[test]
    fn links_and_devices_are_not_opened() {
        let (place, dir) = place();
        std::os::unix::fs::symlink("/etc/passwd", place.path().join("f")).unwrap();
        let (mut tail, mut lines) = (Tail::default(), Lines::default());
        assert_eq!(read(&mut tail, &dir, &mut lines), Looked::default());
        assert!(lines.0.is_empty() && last_lines(&dir, "f", 64).is_err());
    }

    proptest! {
        /// Against splitting the whole, whatever the pieces in which the file grows and is read.
        #[test]
        fn equals_splitting(text in "[ab\n]{0,200}", cuts in proptest::collection::vec((0usize..200, 1usize..50), 0..8)) {
            let (place, dir) = place();
            let path = place.path().join("f");
            let (mut tail, mut lines) = (Tail::default(), Lines::default());
            let mut cuts = cuts;
            cuts.sort_unstable();
            cuts.push((text.len(), usize::MAX));
            let mut done = 0;
            for (cut, budget) in cuts {
                let cut = cut.clamp(done, text.len());
                let mut file = fs::OpenOptions::new().create(true).append(true).open(&path).unwrap();
                file.write_all(&text.as_bytes()[done..cut]).unwrap();
                done = cut;
                tail.look(&dir, "f", budget, &mut lines).unwrap();
            }
            let whole = text.rfind('\n').map_or("", |at| &text[..at]);
            let expected: Vec<Vec<u8>> =
                if text.contains('\n') { whole.split('\n').map(|line| line.as_bytes().to_vec()).collect() } else { Vec::new() };
            prop_assert_eq!(lines.0, expected);
        }
    }
}
