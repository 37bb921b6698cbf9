//! Tables of text: CSV and its relatives, read row by row in bounded memory.
//!
//! Encoding, separator, decimal sign, comments and header are seen from the text itself. What could be read in two ways is
//! refused with both.

mod decode;
mod dialect;

pub(crate) use dialect::Numbers;

use csv_core::{ReadRecordResult, Reader, ReaderBuilder};
use dialect::{First, Separator, first_row};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};

/// Longest row of a table, bytes: ten times what the widest state needs.
const MAX_ROW: usize = 16 << 20;
/// As many lines, and about as many bytes, are looked at to see how a table is written.
const SAMPLE_LINES: usize = 50;
const SAMPLE_BYTES: usize = 256 << 10;

/// Whether a table's first row names its columns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Header {
    /// If it looks like that.
    #[default]
    Auto,
    /// It does.
    Yes,
    /// It is data.
    No,
}

/// Why a table cannot be read.
#[derive(Debug)]
pub(crate) enum Fault {
    /// The operating system, a decoder, or bytes that are no text.
    Io(String),
    /// What is at a line of the file.
    Content { row: u64, what: String, value: String, accepted: String },
}

impl From<io::Error> for Fault {
    fn from(error: io::Error) -> Self {
        Self::Io(error.to_string())
    }
}

/// A row: its line in the file, from 1, and its fields without the blanks around them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Record {
    pub(crate) line: u64,
    text: String,
    ends: Vec<usize>,
}

impl Record {
    pub(crate) fn len(&self) -> usize {
        self.ends.len()
    }

    /// Field `i`, which must exist.
    pub(crate) fn get(&self, i: usize) -> &str {
        let start = i.checked_sub(1).map_or(0, |before| self.ends[before]);
        self.text[start..self.ends[i]].trim()
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &str> {
        (0..self.len()).map(|i| self.get(i))
    }

    fn is_blank(&self) -> bool {
        self.iter().all(str::is_empty)
    }
}

/// The rows of one table.
pub(crate) struct Rows {
    lines: Lines,
    separator: Separator,
    parser: Reader,
    /// Names of the columns, if the table has some, and the line that they are in.
    header: Option<(u64, Vec<String>)>,
    /// Rows that have been looked at and not given.
    ahead: VecDeque<Record>,
    /// What was taken from a comment.
    pub(crate) notes: Vec<String>,
    pub(crate) numbers: Numbers,
    /// Buffers of the parser.
    bytes: Vec<u8>,
    ends: Vec<usize>,
}

impl Rows {
    /// The table in `file`, which begins at its first byte.
    pub(crate) fn open(file: File, header: Header) -> Result<Self, Fault> {
        let mut lines = Lines::new(decode::text(file)?);
        let sample = lines.look_ahead()?;
        let sample: Vec<&str> = sample.iter().map(String::as_str).collect();
        let separator = lines.declared.unwrap_or_else(|| Separator::of(&sample));
        let parser = match separator {
            Separator::Byte(byte) => ReaderBuilder::new().delimiter(byte).build(),
            Separator::Blanks => Reader::new(),
        };
        let numbers = Numbers::new(separator);
        let (ahead, notes) = (VecDeque::new(), Vec::new());
        let (bytes, ends) = (vec![0; 1 << 10], vec![0; 64]);
        let mut rows = Self { lines, separator, parser, header: None, ahead, notes, numbers, bytes, ends };
        rows.find_header(header)?;
        Ok(rows)
    }

    fn find_header(&mut self, header: Header) -> Result<(), Fault> {
        let mut record = Record::default();
        while self.ahead.len() < 2 && self.read(&mut record)? {
            self.ahead.push_back(record.clone());
        }
        let Some(first) = self.ahead.front() else { return Ok(()) };
        let (row, width) = (first.line, first.len());
        let fields: Vec<&str> = first.iter().collect();
        let second = self.ahead.get(1).map(|record| record.iter().collect::<Vec<_>>());
        let found = match header {
            Header::Yes => First::Header,
            Header::No => First::Data,
            Header::Auto => first_row(&fields, second.as_deref(), self.numbers),
        };
        match found {
            First::Header => {
                let names = fields.iter().map(|name| name.to_string()).collect();
                self.header = Some((row, names));
                self.ahead.pop_front();
            }
            First::Data | First::Ambiguous(_) if header == Header::Auto && self.commented_header(width) => {}
            First::Data => {}
            First::Ambiguous(reason) => {
                let value = format!("a header or a state: {reason}");
                let accepted = "--header yes, or --header no".into();
                let what = "the first row".into();
                return Err(Fault::Content { row, what, value, accepted });
            }
        }
        Ok(())
    }

    /// Takes the names in the last comment before the first row, as `numpy.savetxt` writes them; says whether there are such.
    fn commented_header(&mut self, width: usize) -> bool {
        let Some((line, text)) = self.lines.comment.take() else { return false };
        let names: Vec<String> = match self.separator {
            Separator::Blanks => text.split_whitespace().map(String::from).collect(),
            Separator::Byte(byte) => text.split(byte as char).map(|name| name.trim().to_string()).collect(),
        };
        let named = |name: &String| !name.is_empty() && self.numbers.clone().number(name).is_none();
        if names.len() != width || !names.iter().all(named) {
            return false;
        }
        self.notes.push(format!("row {line}: the comment before the data names the columns"));
        self.header = Some((line, names));
        true
    }

    /// The line of the header, and the columns' names.
    pub(crate) fn header(&self) -> Option<(u64, &[String])> {
        self.header.as_ref().map(|(line, names)| (*line, names.as_slice()))
    }

    /// The number of fields in the first row of data.
    pub(crate) fn width(&self) -> Option<usize> {
        self.ahead.front().map(Record::len)
    }

    /// Reads the next row; says whether there is one. Rows of empty fields are left out.
    pub(crate) fn next(&mut self, record: &mut Record) -> Result<bool, Fault> {
        match self.ahead.pop_front() {
            Some(ahead) => *record = ahead,
            None => return self.read(record),
        }
        Ok(true)
    }

    fn read(&mut self, record: &mut Record) -> Result<bool, Fault> {
        loop {
            if !self.lines.next()? {
                return Ok(false);
            }
            record.line = self.lines.line;
            record.text.clear();
            record.ends.clear();
            match self.separator {
                Separator::Blanks => {
                    for word in self.lines.text.split_whitespace() {
                        record.text.push_str(word);
                        record.ends.push(record.text.len());
                    }
                }
                Separator::Byte(_) => self.parse(record)?,
            }
            if !record.is_blank() {
                return Ok(true);
            }
        }
    }

    /// Splits the current line, and those after it that a quoted field goes on in.
    fn parse(&mut self, record: &mut Record) -> Result<(), Fault> {
        let (mut written, mut fields, mut length) = (0, 0, 0);
        loop {
            length += 1 + self.lines.text.len();
            if length > MAX_ROW {
                return Err(self.lines.too_long(record.line));
            }
            self.lines.text.push('\n');
            let mut input = self.lines.text.as_bytes();
            let done = loop {
                let (result, read, out, ends) =
                    self.parser.read_record(input, &mut self.bytes[written..], &mut self.ends[fields..]);
                input = &input[read..];
                written += out;
                fields += ends;
                match result {
                    ReadRecordResult::OutputFull => self.bytes.resize(2 * self.bytes.len(), 0),
                    ReadRecordResult::OutputEndsFull => self.ends.resize(2 * self.ends.len(), 0),
                    ReadRecordResult::InputEmpty => break false,
                    ReadRecordResult::Record | ReadRecordResult::End => break true,
                }
            };
            if done {
                break;
            }
            if !self.lines.more()? {
                let accepted = "a quotation mark that ends it".into();
                let what = "the quoted field that begins here".into();
                return Err(Fault::Content {
                    row: record.line,
                    what,
                    value: "without an end".into(),
                    accepted,
                });
            }
        }
        // What was text stays text: fields are cut at ASCII characters.
        record.text.push_str(&String::from_utf8_lossy(&self.bytes[..written]));
        record.ends.extend_from_slice(&self.ends[..fields]);
        Ok(())
    }
}

/// What a comment begins with.
const COMMENTS: [&str; 3] = ["#", "%", "//"];

/// What a line is.
enum Line {
    Row,
    Comment,
    Blank,
    /// Excel's word for what separates fields, in the first line.
    Separator(Separator),
}

/// The lines of a text, without blank ones and comments, each of bounded length. LF, CRLF and CR end a line.
struct Lines {
    reader: BufReader<Box<dyn Read>>,
    /// The current line, and its number.
    text: String,
    line: u64,
    bytes: Vec<u8>,
    /// The number of the line that was read last.
    read: u64,
    ahead: VecDeque<(u64, String)>,
    /// The last comment before the first line.
    comment: Option<(u64, String)>,
    began: bool,
    /// What the first line says separates fields, as Excel writes it.
    declared: Option<Separator>,
}

impl Lines {
    fn new(text: Box<dyn Read>) -> Self {
        Self {
            reader: BufReader::with_capacity(1 << 16, text),
            text: String::new(),
            line: 0,
            bytes: Vec::new(),
            read: 0,
            ahead: VecDeque::new(),
            comment: None,
            began: false,
            declared: None,
        }
    }

    /// Reads lines that say how the table is written; gives those that are neither blank nor comments.
    fn look_ahead(&mut self) -> Result<Vec<String>, Fault> {
        let (mut sample, mut bytes) = (Vec::new(), 0);
        while sample.len() < SAMPLE_LINES && bytes < SAMPLE_BYTES && self.read_any()? {
            bytes += 1 + self.text.len();
            match self.kind() {
                Line::Separator(separator) if sample.is_empty() => self.declared = Some(separator),
                Line::Row | Line::Separator(_) => sample.push(self.text.clone()),
                Line::Comment | Line::Blank => {}
            }
            self.ahead.push_back((self.line, std::mem::take(&mut self.text)));
        }
        Ok(sample)
    }

    /// Makes the next line of a row the current one, if there is one.
    fn next(&mut self) -> Result<bool, Fault> {
        // Blank lines and comments without an end are not read for ever.
        let mut skipped = 0;
        while self.more()? {
            match self.kind() {
                Line::Separator(_) if !self.began => {}
                Line::Row | Line::Separator(_) => {
                    self.began = true;
                    return Ok(true);
                }
                Line::Comment if !self.began => {
                    let text = self.text.trim().trim_start_matches(['#', '%', '/']).trim();
                    self.comment = Some((self.line, text.into()));
                }
                Line::Comment | Line::Blank => {}
            }
            skipped += 1 + self.text.len();
            if skipped > MAX_ROW {
                return Err(self.too_long(self.line));
            }
        }
        Ok(false)
    }

    /// As [`Lines::next`] within a quoted field, where blank lines and comments are text.
    fn more(&mut self) -> Result<bool, Fault> {
        match self.ahead.pop_front() {
            Some((line, text)) => (self.line, self.text) = (line, text),
            None => return self.read_any(),
        }
        Ok(true)
    }

    /// What the current line is outside of a quoted field.
    fn kind(&self) -> Line {
        let text = self.text.trim();
        match text.strip_prefix("sep=").map(str::as_bytes) {
            Some(&[byte]) => Line::Separator(Separator::Byte(byte)),
            _ if text.is_empty() => Line::Blank,
            _ if COMMENTS.iter().any(|mark| text.starts_with(mark)) => Line::Comment,
            _ => Line::Row,
        }
    }

    /// Reads a line, whatever is in it.
    fn read_any(&mut self) -> Result<bool, Fault> {
        self.bytes.clear();
        let mut ended = None;
        while ended.is_none() {
            let ready = self.reader.fill_buf()?;
            if ready.is_empty() {
                break;
            }
            let end = ready.iter().position(|&byte| byte == b'\n' || byte == b'\r');
            self.bytes.extend_from_slice(&ready[..end.unwrap_or(ready.len())]);
            ended = end.map(|end| ready[end]);
            let used = end.map_or(ready.len(), |end| end + 1);
            self.reader.consume(used);
            if self.bytes.len() > MAX_ROW {
                return Err(self.too_long(self.read + 1));
            }
        }
        if ended == Some(b'\r') && self.reader.fill_buf()?.first() == Some(&b'\n') {
            self.reader.consume(1);
        }
        if ended.is_none() && self.bytes.is_empty() {
            return Ok(false);
        }
        self.read += 1;
        self.line = self.read;
        self.text.clear();
        let text = std::str::from_utf8(&self.bytes).map_err(|_| Fault::Content {
            row: self.read,
            what: "the text".into(),
            value: "not UTF-8".into(),
            accepted: "UTF-8, or UTF-16 with a byte-order mark; `iconv -f LATIN1 -t UTF-8` makes UTF-8 of older text".into(),
        })?;
        self.text.push_str(text);
        Ok(true)
    }

    fn too_long(&self, row: u64) -> Fault {
        let (what, value) = ("the row".into(), format!("longer than {MAX_ROW} bytes"));
        Fault::Content { row, what, value, accepted: format!("rows of up to {MAX_ROW} bytes") }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::io::{Seek, Write};

    type Rows2 = (Option<Vec<String>>, Vec<(u64, Vec<String>)>);

    fn rows(bytes: &[u8], header: Header) -> Result<Rows2, String> {
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(bytes).unwrap();
        file.rewind().unwrap();
        let text = |fault| match fault {
            Fault::Io(message) => message,
            Fault::Content { row, what, value, accepted } => format!("{row}: {what} is {value}; {accepted}"),
        };
        let mut rows = Rows::open(file, header).map_err(text)?;
        let (mut record, mut all) = (Record::default(), Vec::new());
        while rows.next(&mut record).map_err(text)? {
            all.push((record.line, record.iter().map(String::from).collect()));
        }
        Ok((rows.header().map(|(_, names)| names.to_vec()), all))
    }

    fn simple(bytes: &[u8]) -> Rows2 {
        rows(bytes, Header::Auto).unwrap()
    }

    #[test]
    fn every_way_of_writing_gives_the_same_rows() {
        let expected = |first: u64, step: u64| {
            let row = |i: u64, [x, y]: [&str; 2]| (first + step * i, vec![x.to_string(), y.to_string()]);
            (Some(vec!["x".to_string(), "y".to_string()]), vec![row(0, ["1", "2"]), row(1, ["3", "4"])])
        };
        assert_eq!(simple(b"x,y\n1,2\n3,4\n"), expected(2, 1));
        for text in [
            "x,y\r\n1,2\r\n3,4",
            "x;y\n1;2\n3;4",
            "x\ty\n1\t2\n3\t4",
            "x y\n 1  2\n3 4\n",
            "\"x\",y\n\"1\",2\n3,4\n",
            "x,y\r1,2\r3,4",
            " x , y\n1 ,2\n3, 4\n",
            "\u{feff}x,y\n1,2\n3,4",
        ] {
            assert_eq!(simple(text.as_bytes()), expected(2, 1), "{text:?}");
        }
        assert_eq!(simple(b"# made by hand\n\nx,y\n\n1,2\n# half\n3,4\n,\n  \n"), expected(5, 2));
        assert_eq!(simple(b"sep=;\nx;y\n1;2\n3;4\n"), expected(3, 1));
        assert_eq!(simple(b"# x y\n1 2\n3 4\n"), expected(2, 1));
        assert_eq!(simple(b"%x,y\n1,2\n3,4\n"), expected(2, 1));
    }

    #[test]
    fn quoted_fields_hold_separators_lines_and_marks() {
        let (names, all) = simple("x,note\n1,\"a, \"\"b\"\"\n# c\n\nd\"\n2,é\n".as_bytes());
        assert_eq!(names.unwrap(), ["x", "note"]);
        assert_eq!(
            all,
            [(2, vec!["1".into(), "a, \"b\"\n# c\n\nd".into()]), (6, vec!["2".into(), "é".into()])]
        );
        assert!(rows(b"x,y\n1,\"2\n", Header::Auto).unwrap_err().starts_with("2: the quoted field"));
    }

    #[test]
    fn a_first_row_of_numbers_is_data() {
        assert_eq!(simple(b"0,0\n1,0\n").0, None);
        assert_eq!(simple(b"0,0\n1,0\n").1.len(), 2);
        assert!(rows(b"0,1\n1,1\n", Header::Auto).unwrap_err().ends_with("--header yes, or --header no"));
        assert_eq!(rows(b"0,1\n1,1\n", Header::No).unwrap().1.len(), 2);
        assert_eq!(rows(b"0,1\n1,1\n", Header::Yes).unwrap().0.unwrap(), ["0", "1"]);
        assert_eq!(simple(b"").1.len(), 0);
    }

    #[test]
    fn rows_are_bounded_and_text() {
        let long = |bytes: &[u8]| rows(bytes, Header::Auto).unwrap_err();
        assert!(long(&vec![b'1'; MAX_ROW + 2]).starts_with("1: the row is longer than 16777216 bytes"));
        assert!(long(&vec![b'\n'; MAX_ROW + 2]).contains("longer than"));
        assert!(
            long(&[b"x,y\n1,\"".to_vec(), b"abcdefg\n".repeat(MAX_ROW / 8 + 2)].concat())
                .starts_with("2: the row")
        );
        assert!(long(b"x,y\n1,2\n\xe9,3\n").starts_with("3: the text is not UTF-8; UTF-8"));
    }
}
