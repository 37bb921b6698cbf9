//! NPY files of one array: `[T][D]`, one episode of T states with D features, `[E][T][D]`, E episodes of equal length, or `[T]`
//! of records with named fields, which are read as the columns of a table are. The first two say nothing of how an episode
//! ended. The header is a Python literal of three known keys.

use super::Options;
use super::error::{ImportError, Place};
use super::flat::Flat;
use super::labels::{Current, Labels, Row};
use super::rows::Rows;
use super::sink::Sink;
use half::f16;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::os::unix::fs::FileExt;
use std::path::Path;

const MAGIC: &[u8] = b"\x93NUMPY";
/// Longest header that is read; three dimensions need less than 200 bytes, a record of 4096 fields 200 000.
const MAX_HEADER: usize = 1 << 20;
/// About how much is read at once, bytes.
const WINDOW_BYTES: u64 = 1 << 20;

/// Reads all episodes into `sink`.
pub(super) fn read(
    path: &Path,
    file: File,
    options: &Options,
    sink: &mut Sink<'_>,
) -> Result<(), ImportError> {
    let place = Place::of(path);
    if options.key.is_some() {
        return Err(place.refuse("--key", "of no use for one array", "no --key"));
    }
    let bytes = file.metadata().map_err(|e| io_error(path, &e))?.len();
    let array = Array::open(BufReader::with_capacity(WINDOW_BYTES as usize, file), bytes, &place)?;
    match array.kind {
        Kind::Numbers(_) => array.episodes()?.read(&place, sink)?,
        Kind::Records(..) => return array.records(options, sink),
    }
    if sink.ends_recorded() {
        sink.note("NPY does not say how an episode ended: no last state is taken as terminal".into());
    }
    Ok(())
}

/// The numbers of a two-dimensional array, row by row: what `trestle map import` needs.
///
/// # Errors
/// A file that cannot be read, or that is no such array of up to `limit` rows and columns.
pub fn grid(path: &Path, limit: usize) -> Result<Vec<Vec<f64>>, ImportError> {
    let place = Place::of(path);
    let file = trestle_proto::regular_file::open(path, super::MAX_SOURCE_BYTES)?;
    let bytes = file.metadata().map_err(|e| io_error(path, &e))?.len();
    if let Some(text) = drawn(&file) {
        let (what, python) = match text {
            'O' => (
                "an array of objects",
                ", allow_pickle=True), \"%s\", \"\")'` makes text of it; as loading objects runs code, only \
                for a file that you trust",
            ),
            _ => ("an array of texts", "), \"%s\", \"\")'` makes text of it"),
        };
        let next = format!(
            "`python3 -c 'import numpy; numpy.savetxt(\"map.txt\", numpy.load(\"{}\"{python}",
            path.display()
        );
        return Err(place.foreign(what, next));
    }
    let mut array = Array::open(BufReader::new(file), bytes, &place)?;
    match (&array.kind, &array.shape[..]) {
        (Kind::Numbers(_), &[rows, columns])
            if rows.max(columns) <= limit as u64 && rows.min(columns) > 0 =>
        {
            array.lay_out(columns)?;
            let values = array.read(0, rows)?;
            Ok(values.chunks_exact(columns as usize).map(<[f64]>::to_vec).collect())
        }
        (_, shape) => {
            let accepted = format!("an array of numbers, (rows, columns) of 1 to {limit} each");
            Err(place.refuse("the shape", format!("{shape:?}"), accepted))
        }
    }
}

/// The kind of the array in `file`, where it holds the characters of a drawing: objects, or texts. The file's position stays
/// where it is.
fn drawn(file: &File) -> Option<char> {
    let mut start = vec![0; 1 << 12];
    let length = file.read_at(&mut start, 0).ok()?;
    let (header, _) = header(&mut &start[..length])?;
    let (text, _) = quoted(after(&header, "descr")?)?;
    text.trim_start_matches(['<', '>', '|', '=']).chars().next().filter(|kind| "OUSa".contains(*kind))
}

fn io_error(path: &Path, error: &io::Error) -> ImportError {
    ImportError::Io { path: path.into(), message: error.to_string() }
}

/// An array behind its header.
pub(super) struct Array<R> {
    reader: R,
    place: Place,
    pub(super) shape: Vec<u64>,
    kind: Kind,
    /// Numbers in a row, and rows; of the shape, unless that is decided later.
    width: usize,
    rows: u64,
    /// The row that is read next.
    next: u64,
}

enum Kind {
    Numbers(Element),
    Records(Vec<Field>, usize),
}

/// A number of a record.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Field {
    name: String,
    element: Element,
    /// Where it is in the record, bytes.
    at: usize,
}

impl<R: Read> Array<R> {
    /// The array in `reader`, which has so many `bytes`.
    pub(super) fn open(mut reader: R, bytes: u64, place: &Place) -> Result<Self, ImportError> {
        let place = place.clone();
        let refuse =
            |what: &str, value: String, accepted: &str| Err(place.clone().refuse(what, value, accepted));
        let Some((header, start)) = header(&mut reader) else {
            return refuse(
                "the header",
                "damaged".into(),
                "a NPY header of version 1 to 3; it may be cut off",
            );
        };
        let Some(shape) = shape(&header) else {
            return refuse("the shape", "damaged".into(), "(T, D) or (E, T, D)");
        };
        let kind = kind(&header, &place)?;
        if !after(&header, "fortran_order").is_some_and(|rest| rest.starts_with("False")) && shape.len() > 1 {
            let next = "`python3 -c 'import numpy; numpy.save(\"c.npy\", numpy.ascontiguousarray(numpy.load(\"{}\")))'` makes one \
                        in C's";
            let next = next.replace("{}", &place.path().display().to_string());
            return Err(place.foreign("an array in Fortran's order", next));
        }
        let size = match &kind {
            Kind::Numbers(element) => element.size as u64,
            Kind::Records(_, bytes) => *bytes as u64,
        };
        let expected = shape.iter().try_fold(size, |a, &b| a.checked_mul(b));
        if expected.and_then(|data| data.checked_add(start)) != Some(bytes) {
            let short = expected.is_none_or(|data| data.saturating_add(start) > bytes);
            let why = if short { "it may be cut off" } else { "something follows the array" };
            let accepted = format!("as much as its shape {shape:?} says; {why}");
            return refuse("the file's length", format!("{bytes} bytes"), &accepted);
        }
        Ok(Self { reader, place, shape, kind, width: 1, rows: 0, next: 0 })
    }

    /// Decides that a row has `width` numbers.
    fn lay_out(&mut self, width: u64) -> Result<(), ImportError> {
        let numbers = self.shape.iter().product::<u64>();
        let refuse =
            |value: String| self.place.clone().refuse("the shape", value, "two states or more with features");
        self.width = usize::try_from(width).map_err(|_| refuse(format!("{:?}", self.shape)))?;
        self.rows = numbers.checked_div(width).ok_or_else(|| refuse(format!("{:?}", self.shape)))?;
        Ok(())
    }

    /// Whether there is one number in a row, as of flags.
    pub(super) fn is_a_number_a_row(&self) -> bool {
        self.shape.iter().skip(1).all(|&side| side == 1)
    }

    /// As marks, one a step.
    pub(super) fn marks(mut self) -> Result<Self, ImportError> {
        self.lay_out(1)?;
        Ok(self)
    }

    /// As states of one episode or several.
    pub(super) fn states(mut self) -> Result<(Self, u64), ImportError> {
        let (length, width) = match self.shape[..] {
            [length, width] | [_, length, width] => (length, width),
            _ => {
                let accepted = "2, (T, D), or 3, (E, T, D); of one number a state `numpy.save(\"demo.npy\", a[:, None])` makes 2";
                return Err(self.place.refuse("the number of axes", self.shape.len(), accepted));
            }
        };
        if length < 2 || width == 0 || self.shape[0] == 0 {
            let value = format!("{:?}", self.shape);
            return Err(self.place.refuse("the shape", value, "two states or more with features"));
        }
        self.lay_out(width)?;
        Ok((self, length))
    }

    fn row_bytes(&self) -> usize {
        match &self.kind {
            Kind::Numbers(element) => self.width.saturating_mul(element.size),
            Kind::Records(_, bytes) => *bytes,
        }
    }

    /// Reads bytes of the next rows.
    fn bytes(&mut self, count: u64) -> Result<Vec<u8>, ImportError> {
        let bytes = usize::try_from(count).ok().and_then(|count| count.checked_mul(self.row_bytes()));
        let bytes = bytes
            .ok_or_else(|| self.place.clone().refuse("a row", "too long", "one that fits into memory"))?;
        let mut out = Vec::new();
        // Grown as it is read, because a damaged archive can promise anything.
        let read = (&mut self.reader).take(bytes as u64).read_to_end(&mut out);
        read.map_err(|error| io_error(self.place.path(), &error))?;
        if out.len() < bytes {
            return Err(self.place.clone().row(self.next).refuse("the array", "cut off", "all of its rows"));
        }
        self.next += count;
        Ok(out)
    }

    /// Reads records as rows of a table, whose columns are their fields.
    fn records(mut self, options: &Options, sink: &mut Sink<'_>) -> Result<(), ImportError> {
        let Kind::Records(fields, _) = &self.kind else { return Ok(()) };
        let fields = fields.clone();
        let names: Vec<String> = fields.iter().map(|field| field.name.clone()).collect();
        let rows = self.shape.iter().product::<u64>();
        if self.shape.len() != 1 {
            let value = format!("{:?}", self.shape);
            return Err(self.place.refuse("the shape of the records", value, "(T,)"));
        }
        let labels = Labels::of(&names, names.len(), &self.place, options, sink)?;
        let (size, window) = (self.row_bytes(), (WINDOW_BYTES / self.row_bytes().max(1) as u64).max(1));
        let mut current = Current::default();
        while self.next < rows && !sink.satisfied() {
            let first = self.next;
            let bytes = self.bytes(window.min(rows - first))?;
            for (i, bytes) in bytes.chunks_exact(size).enumerate() {
                if sink.satisfied() {
                    return Ok(());
                }
                let mut record = Record { fields: &fields, bytes };
                current.take(&labels, &mut record, names.len(), first + i as u64, sink)?;
            }
        }
        current.end(sink)
    }
}

impl<R: Read + 'static> Array<R> {
    /// The states as one episode or several of equal length.
    fn episodes(self) -> Result<Flat, ImportError> {
        let (states, length) = self.states()?;
        let states = Box::new(states);
        Ok(Flat { states, successors: None, marks: Vec::new(), one_episode: true, length: Some(length) })
    }
}

impl<R: Read> Rows for Array<R> {
    fn rows(&self) -> u64 {
        self.rows
    }

    fn width(&self) -> usize {
        self.width
    }

    fn window(&self) -> u64 {
        (WINDOW_BYTES / self.row_bytes().max(1) as u64).max(1)
    }

    fn read(&mut self, first: u64, count: u64) -> Result<Vec<f64>, ImportError> {
        while self.next < first {
            let skipped = self.window().min(first - self.next);
            self.bytes(skipped)?;
        }
        let Kind::Numbers(element) = self.kind else {
            return Err(self.place.clone().refuse("the array", "one of records", "one of numbers"));
        };
        let bytes = self.bytes(count)?;
        Ok(bytes.chunks_exact(element.size).map(|bytes| element.value(bytes)).collect())
    }
}

/// One record.
struct Record<'a> {
    fields: &'a [Field],
    bytes: &'a [u8],
}

impl Row for Record<'_> {
    fn number(&mut self, column: usize) -> Option<f64> {
        Some(self.value(column))
    }

    fn text(&self, column: usize) -> String {
        self.value(column).to_string()
    }
}

impl Record<'_> {
    fn value(&self, column: usize) -> f64 {
        let Field { element, at, .. } = &self.fields[column];
        element.value(&self.bytes[*at..][..element.size])
    }
}

/// The header's text, and where the numbers begin.
fn header(file: &mut impl Read) -> Option<(String, u64)> {
    let mut start = [0; 8];
    file.read_exact(&mut start).ok()?;
    let wide = match start.strip_prefix(MAGIC)? {
        [1, _] => false,
        [2 | 3, _] => true,
        _ => return None,
    };
    let mut length = [0; 4];
    file.read_exact(&mut length[..if wide { 4 } else { 2 }]).ok()?;
    let length = u32::from_le_bytes(length) as usize;
    let mut text = vec![0; (length <= MAX_HEADER).then_some(length)?];
    file.read_exact(&mut text).ok()?;
    let start = 8 + if wide { 4 } else { 2 } + length as u64;
    Some((String::from_utf8(text).ok()?, start))
}

/// What follows `'key':` in the header.
fn after<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let rest = ['\'', '"'].iter().find_map(|quote| header.split_once(&format!("{quote}{key}{quote}")))?.1;
    Some(rest.trim_start().strip_prefix(':')?.trim_start())
}

/// The text in quotes that `rest` begins with, and what follows it.
fn quoted(rest: &str) -> Option<(&str, &str)> {
    let quote = rest.chars().next().filter(|&c| c == '\'' || c == '"')?;
    rest[1..].split_once(quote)
}

fn shape(header: &str) -> Option<Vec<u64>> {
    sides(after(header, "shape")?).map(|(shape, _)| shape)
}

/// The whole numbers in the parentheses that `rest` begins with, and what follows them.
fn sides(rest: &str) -> Option<(Vec<u64>, &str)> {
    let (inside, rest) = rest.strip_prefix('(')?.split_once(')')?;
    let numbers =
        inside.split(',').map(str::trim).filter(|text| !text.is_empty()).map(|text| text.parse().ok());
    Some((numbers.collect::<Option<_>>()?, rest))
}

/// What the array is made of.
fn kind(header: &str, place: &Place) -> Result<Kind, ImportError> {
    let rest = after(header, "descr").unwrap_or_default();
    if rest.starts_with('[') {
        let fields = fields(rest, place)?;
        let accepted = "named numbers, as in dtype([(\"x\", \"f4\"), (\"y\", \"f4\"), (\"done\", \"?\")])";
        return fields
            .map(|(fields, bytes)| Kind::Records(fields, bytes))
            .ok_or_else(|| place.clone().refuse("the type of the records", rest.trim(), accepted));
    }
    let text = quoted(rest).map_or("", |(text, _)| text);
    element(text, place).map(Kind::Numbers)
}

/// The fields of a record type, a field of several numbers as so many, and the bytes of a record.
fn fields(text: &str, place: &Place) -> Result<Option<(Vec<Field>, usize)>, ImportError> {
    let mut rest = text.trim_start_matches('[').trim_start();
    let (mut out, mut at) = (Vec::new(), 0);
    let part = |rest: &mut &str| -> Option<(String, String, Vec<u64>)> {
        let inside = rest.strip_prefix('(')?.trim_start();
        let (name, inside) = quoted(inside)?;
        let (kind, inside) = quoted(inside.trim_start().strip_prefix(',')?.trim_start())?;
        let inside = inside.trim_start().trim_start_matches(',').trim_start();
        let (shape, inside) = if inside.starts_with('(') { sides(inside)? } else { (Vec::new(), inside) };
        *rest = inside.trim_start().strip_prefix(')')?.trim_start().trim_start_matches(',').trim_start();
        Some((name.into(), kind.into(), shape))
    };
    while !rest.starts_with(']') {
        let Some((name, kind, shape)) = part(&mut rest) else { return Ok(None) };
        // Bytes between fields, so that these lie where the processor likes them.
        if let ("", Some(bytes)) = (name.as_str(), kind.strip_prefix("|V")) {
            let bytes: usize = match bytes.parse() {
                Ok(bytes) if bytes <= MAX_HEADER => bytes,
                _ => return Ok(None),
            };
            at += bytes;
            continue;
        }
        let element = element(&kind, place)?;
        let count = shape
            .iter()
            .try_fold(1_u64, |a, &b| a.checked_mul(b))
            .filter(|&count| count <= MAX_HEADER as u64);
        let Some(count) = count else { return Ok(None) };
        for i in 0..count {
            let name = if shape.is_empty() { name.clone() } else { format!("{name}_{i}") };
            out.push(Field { name, element, at });
            at += element.size;
        }
        if out.len() > MAX_HEADER {
            return Ok(None);
        }
    }
    Ok((!out.is_empty()).then_some((out, at)))
}

/// How a number is stored, or a refusal of what is none.
fn element(text: &str, place: &Place) -> Result<Element, ImportError> {
    if let Some(element) = Element::parse(text) {
        return Ok(element);
    }
    let file = place.path().display().to_string();
    let next = |python: &str| python.replace("{}", &file);
    Err(match text.trim_start_matches(['<', '>', '|', '=']).as_bytes() {
        [b'O', ..] => {
            // Only NumPy can unpickle it, so it must make the table as well.
            let python = "one file an episode, or CSV with a column `episode`, which (as loading objects runs code, only for a file \
                that you trust) `python3 -c 'import numpy as n; a = [n.asarray(e) for e in n.load(\"{}\", allow_pickle=True)]; \
                n.savetxt(\"demo.csv\", [[i, *s] for i, e in enumerate(a) for s in e], \"%.9g\", \",\", header=\",\".join([\"episode\"] \
                + [f\"s{k}\" for k in range(a[0].shape[1])]), comments=\"\")'` makes";
            place.clone().foreign("an array of objects, such as episodes of unequal length", next(python))
        }
        [b'f' | b'g', ..] => {
            let python = "`python3 -c 'import numpy; numpy.save(\"demo.npy\", numpy.load(\"{}\").astype(\"f8\"))'` makes one that is read";
            place.clone().foreign("an array of numbers of more than 64 bits", next(python))
        }
        [b'U' | b'S' | b'a', ..] => {
            let python = "`python3 -c 'import numpy; numpy.save(\"demo.npy\", numpy.load(\"{}\").astype(\"f4\"))'` makes numbers of them \
                          if they are such";
            place.clone().foreign("an array of texts", next(python))
        }
        _ => {
            let accepted = "floating-point numbers, whole numbers or booleans of up to 64 bits (f2 to f8, i1 to i8, u1 to u8, ?)";
            place.clone().refuse("the type of the numbers", text, accepted)
        }
    })
}

/// How a number is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Element {
    big_endian: bool,
    kind: u8,
    size: usize,
}

impl Element {
    /// From NumPy's notation, such as `<f4`.
    fn parse(text: &str) -> Option<Self> {
        let [order, kind, size] = *text.as_bytes() else { return None };
        let size = match (kind, size) {
            (b'f', b'2' | b'4' | b'8') | (b'i' | b'u', b'1' | b'2' | b'4' | b'8') | (b'b', b'1') => {
                size - b'0'
            }
            _ => return None,
        };
        let big_endian = match order {
            b'<' | b'|' => false,
            b'>' => true,
            _ => return None,
        };
        Some(Self { big_endian, kind, size: size.into() })
    }

    /// The number in `bytes`, `size` of them.
    fn value(self, bytes: &[u8]) -> f64 {
        let mut wide = [0; 8];
        let wide_bytes = &mut wide[..self.size];
        wide_bytes.copy_from_slice(bytes);
        if self.big_endian {
            wide_bytes.reverse();
        }
        let bits = u64::from_le_bytes(wide);
        match (self.kind, self.size) {
            (b'f', 2) => f16::from_bits(bits as u16).to_f64(),
            (b'f', 4) => f32::from_bits(bits as u32).into(),
            (b'f', _) => f64::from_bits(bits),
            (b'i', size) => {
                let unused = 64 - 8 * size as u32;
                ((bits << unused) as i64 >> unused) as f64
            }
            _ => bits as f64,
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn numbers_of_every_kind() {
        let value = |text: &str, bytes: &[u8]| Element::parse(text).unwrap().value(bytes);
        assert_eq!(value("<f2", &[0x00, 0xc5]), -5.0);
        assert_eq!(value(">f2", &[0x3c, 0x00]), 1.0);
        assert_eq!(value("<f4", &1.5_f32.to_le_bytes()), 1.5);
        assert_eq!(value(">f8", &(-2.25_f64).to_be_bytes()), -2.25);
        assert_eq!(value("|i1", &(-7_i8).to_le_bytes()), -7.0);
        assert_eq!(value(">i2", &(-300_i16).to_be_bytes()), -300.0);
        assert_eq!(value("<i8", &(-5_i64).to_le_bytes()), -5.0);
        assert_eq!(value("<u4", &u32::MAX.to_le_bytes()), f64::from(u32::MAX));
        assert_eq!(value("|b1", &[1]), 1.0);
        for bad in ["", "<c8", "|O", "=f4", "f4", "<U9", "<f16"] {
            assert_eq!(Element::parse(bad), None, "{bad}");
        }
    }

    #[test]
    fn headers_as_numpy_writes_them() {
        let text = "{'descr': '<f4', 'fortran_order': False, 'shape': (3, 2), }   \n";
        assert_eq!(quoted(after(text, "descr").unwrap()).unwrap().0, "<f4");
        assert_eq!(shape(text), Some(vec![3, 2]));
        assert!(after(text, "fortran_order").unwrap().starts_with("False"));
        assert_eq!(shape("{'shape': (5,)}"), Some(vec![5]));
        assert_eq!(shape("{'shape': (-5, 1)}"), None);
        assert_eq!(shape("{'shape': (5"), None);
    }

    #[test]
    fn records_have_named_fields() {
        let place = Place::of(Path::new("a.npy"));
        let text = "[('x', '<f4'), ('v', '>f8', (2,)), ('done', '|b1')], 'fortran_order': False";
        let (found, bytes) = fields(text, &place).unwrap().unwrap();
        let found: Vec<_> =
            found.iter().map(|field| (field.name.as_str(), field.element.size, field.at)).collect();
        assert_eq!(found, [("x", 4, 0), ("v_0", 8, 4), ("v_1", 8, 12), ("done", 1, 20)]);
        assert_eq!(bytes, 21);
        // As NumPy writes an aligned type: bytes without a name between the fields and at the end.
        let text =
            "[('b', '|b1'), ('', '|V7'), ('x', '<f8'), ('n', '<i4'), ('', '|V4')], 'fortran_order': False";
        let (found, bytes) = fields(text, &place).unwrap().unwrap();
        let places: Vec<usize> = found.iter().map(|field| field.at).collect();
        assert_eq!((places, bytes), (vec![0, 8, 16], 24));
        for bad in ["[]", "[('x',)]", "[('x', [('y', '<f4')])]", "[(('title', 'x'), '<f4')]", "[('x', '<f4'"]
        {
            assert_eq!(fields(bad, &place).unwrap(), None, "{bad}");
        }
        assert!(fields("[('x', '<U3')]", &place).unwrap_err().to_string().contains("an array of texts"));
        let objects = element("|O", &place).err().unwrap().to_string();
        assert!(objects.contains("allow_pickle") && objects.contains("range(a[0]"), "{objects}");
    }
}
