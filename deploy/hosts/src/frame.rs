//! Frames: what travels between two relays, one message of the wire each.
//!
//! A frame is a header and up to [`CHUNK`] bytes. It is believed only if its length, its version and its checksum are right. A
//! frame that is not is dropped without an answer: it is as if it had been lost.

use crate::limits::{CHUNK, MAX_TEXT};
use bytemuck::{Pod, Zeroable, bytes_of, pod_read_unaligned};

/// The first bytes of every frame.
const MAGIC: [u8; 4] = *b"TRRL";
/// Version of this layout, and of everything that is carried in it.
const VERSION: u16 = 1;
pub(crate) const HEADER: usize = size_of::<Header>();
/// Largest frame, bytes.
pub const MAX_FRAME: usize = HEADER + CHUNK;

/// The purpose of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A host wants to join. It has no session yet.
    Hello,
    /// It is let in: from here on both say the session.
    Welcome,
    /// It is not let in, for the reason in the frame. It may ask again.
    Refused,
    /// Part of a message.
    Chunk,
    /// The last part of a message.
    Last,
    /// Nothing but what every frame has: an acknowledgement, or a sign of life.
    Sign,
    /// The session is over, for the reason in the frame, and may be followed by another one.
    Farewell,
    /// The session is over, and so is the run, for the reason in the frame.
    Over,
}

impl Kind {
    const ALL: [Self; 8] = [
        Self::Hello,
        Self::Welcome,
        Self::Refused,
        Self::Chunk,
        Self::Last,
        Self::Sign,
        Self::Farewell,
        Self::Over,
    ];

    /// Most bytes that follow the header of such a frame.
    fn most(self) -> usize {
        match self {
            Self::Welcome | Self::Sign => 0,
            Self::Chunk | Self::Last => CHUNK,
            Self::Hello | Self::Refused | Self::Farewell | Self::Over => MAX_TEXT,
        }
    }
}

/// The header as it travels, little-endian.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
struct Header {
    magic: [u8; 4],
    version: u16,
    kind: u8,
    reserved: u8,
    session: u64,
    number: u64,
    acknowledged: u64,
    room: u64,
    /// Bytes that follow.
    length: u32,
    /// CRC-32C of the header with 0 in this place, and of the bytes that follow.
    checksum: u32,
}

/// A frame, with its bytes by reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Its purpose.
    pub kind: Kind,
    /// The head's number of the present session, the same for all hosts: drawn when its relay started. 0 in a hello.
    pub session: u64,
    /// Of a chunk: its number, from 0.
    pub number: u64,
    /// All chunks below this number have come.
    pub acknowledged: u64,
    /// Chunks below this number may be sent.
    pub room: u64,
    /// What follows the header.
    pub bytes: &'a [u8],
}

impl<'a> Frame<'a> {
    /// A frame without numbers.
    pub fn bare(kind: Kind, session: u64, bytes: &'a [u8]) -> Self {
        let bytes = &bytes[..bytes.len().min(kind.most())];
        Self { kind, session, number: 0, acknowledged: 0, room: 0, bytes }
    }

    /// The frame as it travels. Its bytes must not be more than such a frame may have.
    pub fn encode(&self) -> Vec<u8> {
        let mut header = Header {
            magic: MAGIC,
            version: VERSION,
            kind: Kind::ALL.iter().position(|&kind| kind == self.kind).unwrap_or(0) as u8,
            reserved: 0,
            session: self.session,
            number: self.number,
            acknowledged: self.acknowledged,
            room: self.room,
            length: self.bytes.len() as u32,
            checksum: 0,
        };
        header.checksum = checksum(&header, self.bytes);
        [bytes_of(&header), self.bytes].concat()
    }

    /// The frame in `bytes`; none if these are no sound frame of this version.
    pub fn decode(bytes: &'a [u8]) -> Option<Self> {
        let (head, bytes) = bytes.split_at_checked(HEADER)?;
        let header: Header = pod_read_unaligned(head);
        let kind = *Kind::ALL.get(usize::from(header.kind))?;
        let sound = header.magic == MAGIC
            && header.version == VERSION
            && header.length as usize == bytes.len()
            && bytes.len() <= kind.most()
            && header.checksum == checksum(&Header { checksum: 0, ..header }, bytes);
        let Header { session, number, acknowledged, room, .. } = header;
        sound.then_some(Self { kind, session, number, acknowledged, room, bytes })
    }

    /// What follows the header, as text for people: one line without control characters.
    pub fn text(&self) -> String {
        let text = String::from_utf8_lossy(self.bytes);
        text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
    }
}

fn checksum(header: &Header, bytes: &[u8]) -> u32 {
    crc32c::crc32c_append(crc32c::crc32c(bytes_of(header)), bytes)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_frame_comes_back_and_a_damaged_one_does_not(
            kind in 0..Kind::ALL.len(), numbers in any::<[u64; 4]>(), bytes in prop::collection::vec(any::<u8>(), 0..300),
            at in any::<prop::sample::Index>(), bit in 0u8..8,
        ) {
            let kind = Kind::ALL[kind];
            let [session, number, acknowledged, room] = numbers;
            let bytes = &bytes[..bytes.len().min(kind.most())];
            let frame = Frame { kind, session, number, acknowledged, room, bytes };
            let mut encoded = frame.encode();
            prop_assert_eq!(Frame::decode(&encoded), Some(frame));
            let at = at.index(encoded.len());
            prop_assert_eq!(Frame::decode(&encoded[..at]), None);
            encoded[at] ^= 1 << bit;
            prop_assert_eq!(Frame::decode(&encoded), None);
        }

        #[test]
        fn junk_is_no_frame(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            prop_assert_eq!(Frame::decode(&bytes), None);
        }
    }

    #[test]
    fn the_largest_frame_fits_into_one_message_of_zenoh() {
        assert_eq!(HEADER, 48);
        let chunk = vec![7; CHUNK];
        let frame = Frame::bare(Kind::Last, 1, &chunk);
        assert_eq!(frame.encode().len(), MAX_FRAME);
        const { assert!(MAX_FRAME < 61_440) };
        let long = vec![b'x'; 2 * MAX_TEXT];
        assert_eq!(Frame::bare(Kind::Refused, 1, &long).bytes.len(), MAX_TEXT, "a long reason is cut");
    }
}
