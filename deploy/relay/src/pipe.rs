//! Records on a pipe: `u32` length of what follows, `u64` peer, bytes; little-endian.
//!
//! The first record that this program writes is its greeting. The end of standard input is its order to leave.

use crate::Failure;
use std::io::{ErrorKind, Read, Write};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

/// Name and version of this format.
pub(crate) const GREETING: &str = "trestle-relay 1";
/// Most bytes of a record.
pub(crate) const MAX_BYTES: usize = 61_440;
/// The peer of records that are news of this program for its starter, as text.
pub(crate) const NEWS: u64 = u64::MAX;
/// Records that may wait for the pipe; more are dropped.
const WAITING: usize = 256;

/// A record: a peer and bytes.
pub(crate) type Record = (u64, Vec<u8>);

/// The next record; none at the end.
///
/// # Errors
/// A length that no record has, or a pipe that fails or ends within a record.
pub(crate) fn read(pipe: &mut impl Read) -> Result<Option<Record>, Failure> {
    let mut head = [0; 12];
    match pipe.read_exact(&mut head) {
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(None),
        read => read?,
    }
    let (length, peer) = head.split_at(4);
    let length = u32::from_le_bytes(length.try_into()?) as usize;
    let peer = u64::from_le_bytes(peer.try_into()?);
    let bytes = length.checked_sub(8).filter(|&bytes| bytes <= MAX_BYTES);
    let bytes =
        bytes.ok_or_else(|| format!("a record of {length} bytes; accepted: 8 to {}", MAX_BYTES + 8))?;
    let mut record = vec![0; bytes];
    pipe.read_exact(&mut record)?;
    Ok(Some((peer, record)))
}

/// Writes a record.
fn write(pipe: &mut impl Write, peer: u64, bytes: &[u8]) -> std::io::Result<()> {
    let mut record = Vec::with_capacity(12 + bytes.len());
    record.extend_from_slice(&(bytes.len() as u32 + 8).to_le_bytes());
    record.extend_from_slice(&peer.to_le_bytes());
    record.extend_from_slice(bytes);
    pipe.write_all(&record)?;
    pipe.flush()
}

/// Takes records for standard output; a thread of its own writes them. A record that finds no room may be dropped: see `hand_on`.
pub(crate) fn output() -> SyncSender<Record> {
    let (sender, records): (_, Receiver<Record>) = sync_channel(WAITING);
    thread::spawn(move || {
        let mut pipe = std::io::stdout();
        for (peer, bytes) in records {
            if write(&mut pipe, peer, &bytes).is_err() {
                // The reader is gone, and its end of standard input with it.
                return;
            }
        }
    });
    sender
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_record_comes_back_as_it_was() {
        let mut pipe = Vec::new();
        write(&mut pipe, 7, b"seven").unwrap();
        write(&mut pipe, NEWS, b"").unwrap();
        let mut pipe = pipe.as_slice();
        assert_eq!(read(&mut pipe).unwrap(), Some((7, b"seven".to_vec())));
        assert_eq!(read(&mut pipe).unwrap(), Some((NEWS, Vec::new())));
        assert_eq!(read(&mut pipe).unwrap(), None);
    }

    #[test]
    fn a_length_that_cannot_be_right_is_refused() {
        for length in [0, 7, MAX_BYTES as u32 + 9, u32::MAX] {
            let record = [&length.to_le_bytes()[..], &[0; 20]].concat();
            assert!(read(&mut record.as_slice()).unwrap_err().to_string().contains("accepted: 8 to"));
        }
        let cut = [&20u32.to_le_bytes()[..], &[0; 12]].concat();
        assert!(read(&mut cut.as_slice()).is_err());
    }
}
