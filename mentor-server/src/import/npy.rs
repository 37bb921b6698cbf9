//! NPY files of one array: `[T][D]`, one episode of T states with D features, or `[E][T][D]`, E episodes of equal
//! length. They say nothing of how an episode ended. The header is a Python literal of three known keys.

use super::error::{ImportError, Place};
use super::sink::Sink;
use super::{NPY_MAGIC, Options};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// Longest header that is read; the longest that three dimensions can need is below 200 bytes.
const MAX_HEADER: usize = 64 << 10;

/// Reads all episodes into `sink`.
pub(super) fn read(path: &Path, options: &Options, sink: &mut Sink<'_>) -> Result<(), ImportError> {
    let place = || Place::of(path);
    let io = |error: std::io::Error| ImportError::Io { path: path.into(), message: format!("{error}") };
    if options.key.is_some() {
        return Err(place().refuse("--key", "of no use for an array", "no --key"));
    }
    let file = File::open(path).map_err(io)?;
    let bytes = file.metadata().map_err(io)?.len();
    let mut file = BufReader::with_capacity(1 << 20, file);
    let (header, start) = header(&mut file)
        .ok_or_else(|| place().refuse("the header", "damaged", "a NPY header of version 1 to 3"))?;
    let element = Element::parse(&text_of(&header, "descr").unwrap_or_default()).ok_or_else(|| {
        let accepted = "f4, f8, i1 to i8, u1 to u8 or ?, as in states.astype(\"f4\")";
        place().refuse("the type of the numbers", text_of(&header, "descr").unwrap_or_default(), accepted)
    })?;
    if !after(&header, "fortran_order").is_some_and(|rest| rest.starts_with("False")) {
        let accepted = "C, as numpy.ascontiguousarray makes it";
        return Err(place().refuse("the order of the array", "Fortran's", accepted));
    }
    let shape =
        shape(&header).ok_or_else(|| place().refuse("the shape", "damaged", "(T, D) or (E, T, D)"))?;
    let (episodes, length, width) = match shape[..] {
        [length, width] => (1, length, width),
        [episodes, length, width] => (episodes, length, width),
        _ => return Err(place().refuse("the number of axes", shape.len(), "2, (T, D), or 3, (E, T, D)")),
    };
    let expected =
        [episodes, length, width, element.size as u64].iter().try_fold(1_u64, |a, &b| a.checked_mul(b));
    if expected.and_then(|data| data.checked_add(start)) != Some(bytes) {
        let accepted = format!("as much as its shape {shape:?} says; it may be cut off");
        return Err(place().refuse("the file's length", format!("{bytes} bytes"), accepted));
    }
    if episodes == 0 || length < 2 || width == 0 {
        return Err(place().refuse("the shape", format!("{shape:?}"), "two states or more with features"));
    }
    let width = usize::try_from(width).unwrap_or(usize::MAX);
    sink.columns(width, &[])?;
    let mut row = vec![0; width * element.size];
    for _ in 0..episodes {
        if sink.satisfied() {
            break;
        }
        let wanted = sink.wanted();
        for at in 0..length {
            file.read_exact(&mut row).map_err(io)?;
            if wanted {
                sink.row(at, |column| element.value(&row[column * element.size..][..element.size]))?;
            }
        }
        sink.end(false)?;
    }
    if sink.ends_recorded() {
        sink.note("NPY does not say how an episode ended: no last state is taken as terminal".into());
    }
    Ok(())
}

/// The header's text, and where the numbers begin.
fn header(file: &mut impl Read) -> Option<(String, u64)> {
    let mut start = [0; 8];
    file.read_exact(&mut start).ok()?;
    let wide = match start.strip_prefix(NPY_MAGIC)? {
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

/// The text that belongs to `key`.
fn text_of(header: &str, key: &str) -> Option<String> {
    let rest = after(header, key)?;
    let quote = rest.chars().next().filter(|&c| c == '\'' || c == '"')?;
    Some(rest[1..].split(quote).next()?.into())
}

fn shape(header: &str) -> Option<Vec<u64>> {
    let inside = after(header, "shape")?.strip_prefix('(')?.split_once(')')?.0;
    inside.split(',').map(str::trim).filter(|text| !text.is_empty()).map(|text| text.parse().ok()).collect()
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
            (b'f', b'4' | b'8') | (b'i' | b'u', b'1' | b'2' | b'4' | b'8') | (b'b', b'1') => size - b'0',
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
        assert_eq!(value("<f4", &1.5_f32.to_le_bytes()), 1.5);
        assert_eq!(value(">f8", &(-2.25_f64).to_be_bytes()), -2.25);
        assert_eq!(value("|i1", &(-7_i8).to_le_bytes()), -7.0);
        assert_eq!(value(">i2", &(-300_i16).to_be_bytes()), -300.0);
        assert_eq!(value("<i8", &(-5_i64).to_le_bytes()), -5.0);
        assert_eq!(value("<u4", &u32::MAX.to_le_bytes()), f64::from(u32::MAX));
        assert_eq!(value("|b1", &[1]), 1.0);
        for bad in ["", "<f2", "<c8", "|O", "=f4", "f4", "<U9", "<f16"] {
            assert_eq!(Element::parse(bad), None, "{bad}");
        }
    }

    #[test]
    fn headers_as_numpy_writes_them() {
        let text = "{'descr': '<f4', 'fortran_order': False, 'shape': (3, 2), }   \n";
        assert_eq!(text_of(text, "descr").unwrap(), "<f4");
        assert_eq!(shape(text), Some(vec![3, 2]));
        assert!(after(text, "fortran_order").unwrap().starts_with("False"));
        assert_eq!(shape("{'shape': (5,)}"), Some(vec![5]));
        assert_eq!(shape("{'shape': (-5, 1)}"), None);
        assert_eq!(shape("{'shape': (5"), None);
    }
}
