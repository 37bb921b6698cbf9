//! Text as UTF-8, whatever it was stored in: a byte-order mark is dropped, UTF-16 is decoded, gzip is undone.

use crate::import::sniff::is_bare_utf16;
use flate2::read::MultiGzDecoder;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};

const BUFFER: usize = 1 << 16;

/// The text of `file`, from its beginning.
pub(super) fn text(file: File) -> io::Result<Box<dyn Read>> {
    let mut reader = BufReader::with_capacity(BUFFER, file);
    if reader.fill_buf()?.starts_with(&[0x1f, 0x8b]) {
        return utf8(BufReader::with_capacity(BUFFER, MultiGzDecoder::new(reader)));
    }
    utf8(reader)
}

fn utf8<R: BufRead + 'static>(mut reader: R) -> io::Result<Box<dyn Read>> {
    let start = reader.fill_buf()?;
    let (skip, big_endian) = match start {
        [0xef, 0xbb, 0xbf, ..] => (3, None),
        [0xff, 0xfe, ..] => (2, Some(false)),
        [0xfe, 0xff, ..] => (2, Some(true)),
        start if is_bare_utf16(start) => (0, Some(start[0] == 0)),
        _ => (0, None),
    };
    reader.consume(skip);
    Ok(match big_endian {
        None => Box::new(reader),
        Some(big_endian) => Box::new(Utf16 { reader, big_endian, ready: Vec::new(), given: 0 }),
    })
}

/// UTF-16 as UTF-8.
struct Utf16<R> {
    reader: R,
    big_endian: bool,
    /// Text that is decoded, and as much of it as has been given on.
    ready: Vec<u8>,
    given: usize,
}

impl<R: BufRead> Utf16<R> {
    fn unit(&mut self) -> io::Result<Option<u16>> {
        let mut bytes = [0; 2];
        let mut filled = 0;
        while filled < 2 {
            match self.reader.read(&mut bytes[filled..])? {
                0 if filled == 0 => return Ok(None),
                0 => {
                    return Err(io::Error::new(
                        io::ErrorKind::UnexpectedEof,
                        "UTF-16 text ends within a character",
                    ));
                }
                n => filled += n,
            }
        }
        Ok(Some(if self.big_endian { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) }))
    }
}

impl<R: BufRead> Read for Utf16<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.given == self.ready.len() {
            self.ready.clear();
            self.given = 0;
            while self.ready.len() < BUFFER {
                let Some(unit) = self.unit()? else { break };
                let pair = if (0xd800..0xdc00).contains(&unit) { self.unit()? } else { None };
                for decoded in char::decode_utf16([unit].into_iter().chain(pair)) {
                    let letter = decoded.map_err(|_| {
                        io::Error::new(io::ErrorKind::InvalidData, "characters that are not UTF-16")
                    })?;
                    self.ready.extend(letter.encode_utf8(&mut [0; 4]).as_bytes());
                }
            }
        }
        let count = buffer.len().min(self.ready.len() - self.given);
        buffer[..count].copy_from_slice(&self.ready[self.given..][..count]);
        self.given += count;
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn every_encoding_gives_the_same_text() {
        let expected = "x,größe\n1,\u{1f600}\n";
        let wide = |order: fn(u16) -> [u8; 2]| expected.encode_utf16().flat_map(order).collect::<Vec<u8>>();
        let (little, big) = (wide(u16::to_le_bytes), wide(u16::to_be_bytes));
        let with = |mark: &[u8], bytes: &[u8]| [mark, bytes].concat();
        for bytes in [
            expected.as_bytes().to_vec(),
            with(&[0xef, 0xbb, 0xbf], expected.as_bytes()),
            with(&[0xff, 0xfe], &little),
            with(&[0xfe, 0xff], &big),
        ] {
            let mut text = String::new();
            utf8(io::Cursor::new(bytes)).unwrap().read_to_string(&mut text).unwrap();
            assert_eq!(text, expected);
        }
        let mut plain = String::new();
        let bare: Vec<u8> = "x,y\n1,2\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
        utf8(io::Cursor::new(bare.clone())).unwrap().read_to_string(&mut plain).unwrap();
        assert_eq!(plain, "x,y\n1,2\n");
        let cut = with(&[0xff, 0xfe], &bare[..5]);
        assert!(utf8(io::Cursor::new(cut)).unwrap().read_to_string(&mut plain).is_err());
    }
}
