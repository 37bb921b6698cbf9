//! bincode in one place, behind two functions. bincode is no longer maintained, so nothing else may depend on it.
//!
//! A frame is: 8 bytes of magic that name what it holds, its version (`u32`), length of the body (`u64`), CRC-32C of
//! the body (`u32`), all little-endian, then the body.

use serde::{Serialize, de::DeserializeOwned};
use std::cmp::Ordering;

/// Largest body that is read, bytes.
pub const MAX_BODY: usize = 1 << 30;
const HEADER: usize = 24;

/// What a frame holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kind {
    /// Names the contents.
    pub magic: [u8; 8],
    /// Version of the contents' layout: any change raises it.
    pub version: u32,
}

/// A frame that cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum CodecError {
    /// Shorter or longer than its header says.
    #[error("{found} bytes; a {kind} of {expected} bytes is expected")]
    Length {
        /// Name of the kind.
        kind: String,
        /// Bytes there.
        found: usize,
        /// Bytes expected.
        expected: usize,
    },
    /// Something else, or another version of it.
    #[error("this is {found}{}; expected {expected}", found.age(expected))]
    Kind {
        /// What the header says.
        found: Kind,
        /// What was asked for.
        expected: Kind,
    },
    /// Damaged.
    #[error("checksum of {kind} is {found:08x}; its header says {expected:08x}")]
    Checksum {
        /// Name of the kind.
        kind: String,
        /// What was computed.
        found: u32,
        /// What the header says.
        expected: u32,
    },
    /// The body is not what its kind promises.
    #[error("body of {kind}: {message}")]
    Body {
        /// Name of the kind.
        kind: String,
        /// What the decoder says.
        message: String,
    },
}

impl CodecError {
    /// How the version of the frame compares with the expected one, if it holds what was asked for in another version.
    pub fn other_version(&self) -> Option<Ordering> {
        match self {
            Self::Kind { found, expected } if found.magic == expected.magic => {
                Some(found.version.cmp(&expected.version))
            }
            _ => None,
        }
    }
}

impl Kind {
    /// What a message adds to the name of this kind where `expected` was expected.
    fn age(&self, expected: &Self) -> &'static str {
        if self.magic == expected.magic && self.version > expected.version {
            ", of a newer version of Trestle"
        } else {
            ""
        }
    }
}

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} v{}", self.magic.escape_ascii(), self.version)
    }
}

/// `value` as a frame of `kind`.
pub fn encode<T: Serialize>(kind: Kind, value: &T) -> Result<Vec<u8>, CodecError> {
    let body = bincode::serde::encode_to_vec(value, bincode::config::standard())
        .map_err(|e| CodecError::Body { kind: kind.to_string(), message: e.to_string() })?;
    let mut frame = Vec::with_capacity(HEADER + body.len());
    frame.extend_from_slice(&kind.magic);
    frame.extend_from_slice(&kind.version.to_le_bytes());
    frame.extend_from_slice(&(body.len() as u64).to_le_bytes());
    frame.extend_from_slice(&crc32c::crc32c(&body).to_le_bytes());
    frame.extend_from_slice(&body);
    Ok(frame)
}

/// The value in a frame of `kind`. The whole of `frame` must be used up.
pub fn decode<T: DeserializeOwned>(kind: Kind, frame: &[u8]) -> Result<T, CodecError> {
    let name = || kind.to_string();
    let wrong_length = |expected| CodecError::Length { kind: name(), found: frame.len(), expected };
    let (head, body) = frame.split_at_checked(HEADER).ok_or_else(|| wrong_length(HEADER))?;
    let word = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
    let mut magic = [0; 8];
    magic.copy_from_slice(&head[..8]);
    let found = Kind { magic, version: word(8) };
    if found != kind {
        return Err(CodecError::Kind { found, expected: kind });
    }
    let length = u64::from(word(12)) | u64::from(word(16)) << 32;
    if length > MAX_BODY as u64 || length != body.len() as u64 {
        return Err(wrong_length(HEADER.saturating_add(usize::try_from(length).unwrap_or(usize::MAX))));
    }
    let checksum = crc32c::crc32c(body);
    if checksum != word(20) {
        return Err(CodecError::Checksum { kind: name(), found: checksum, expected: word(20) });
    }
    let config = bincode::config::standard().with_limit::<MAX_BODY>();
    let (value, used) = bincode::serde::decode_from_slice(body, config)
        .map_err(|e| CodecError::Body { kind: name(), message: e.to_string() })?;
    if used != body.len() {
        return Err(CodecError::Body {
            kind: name(),
            message: format!("{} bytes are left over", body.len() - used),
        });
    }
    Ok(value)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    const KIND: Kind = Kind { magic: *b"TESTTEST", version: 3 };

    proptest! {
        #[test]
        fn any_single_fault_is_refused(value in any::<(u32, String, Vec<f32>)>(), at in any::<prop::sample::Index>(), bit in 0u8..8) {
            let mut frame = encode(KIND, &value).unwrap();
            let back: (u32, String, Vec<f32>) = decode(KIND, &frame).unwrap();
            prop_assert_eq!(format!("{back:?}"), format!("{value:?}"));
            let cut = at.index(frame.len());
            prop_assert!(decode::<(u32, String, Vec<f32>)>(KIND, &frame[..cut]).is_err());
            frame[cut] ^= 1u8 << bit;
            prop_assert!(decode::<(u32, String, Vec<f32>)>(KIND, &frame).is_err());
        }

        #[test]
        fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = decode::<Vec<String>>(KIND, &bytes);
        }
    }

    #[test]
    fn other_kinds_and_versions_are_named() {
        let frame = encode(KIND, &1u8).unwrap();
        let other = |kind| {
            let error = decode::<u8>(kind, &frame).unwrap_err();
            (error.to_string(), error.other_version())
        };
        let [older, newer] = [2, 4].map(|version| Kind { version, ..KIND });
        let message = "this is TESTTEST v3; expected TESTTEST v4";
        assert_eq!(other(newer), (message.into(), Some(Ordering::Less)));
        let message = "this is TESTTEST v3, of a newer version of Trestle; expected TESTTEST v2";
        assert_eq!(other(older), (message.into(), Some(Ordering::Greater)));
        let message = "this is TESTTEST v3; expected OTHERONE v2";
        assert_eq!(other(Kind { magic: *b"OTHERONE", version: 2 }), (message.into(), None));
    }
}
