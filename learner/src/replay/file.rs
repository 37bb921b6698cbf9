//! The replay as a file: 64 bytes of header, then each array whole, in slot order, little-endian.
//!
//! | bytes | what |
//! |---|---|
//! | 8 | magic `TRREPLAY` |
//! | 8 | version of this layout, `u64` |
//! | 8, 8, 8, 8 | `obs_dim`, capacity, transitions stored, transitions ever stored, `u64` |
//! | 16 | zero |
//! | `stored * obs_dim` words each | s, s', `f32` |
//! | `stored` words each | actions `u32`, rewards `f32`, mentor indices `u32`, Q_o^past `f32`, Q_m^past `f32` |
//! | `stored` bytes each | flags, actors |
//!
//! An array is one write. Checksums are the business of whoever writes the file (a checkpoint's manifest).

use super::Replay;
use bytemuck::{Pod, Zeroable, bytes_of, cast_slice, cast_slice_mut};
use std::io::{self, Read, Write};
use trestle_proto::NONE;
use trestle_proto::batch::{FIRST, TERMINATED, TRUNCATED};

// The arrays go to the file as they lie in memory.
const _: () = assert!(cfg!(target_endian = "little"), "files are little-endian, and so must be the machine");

const MAGIC: [u8; 8] = *b"TRREPLAY";
const VERSION: u64 = 1;
const KNOWN_FLAGS: u8 = (TERMINATED | TRUNCATED | FIRST) as u8;

#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
struct Header {
    magic: [u8; 8],
    version: u64,
    obs_dim: u64,
    capacity: u64,
    stored: u64,
    pushed: u64,
    zero: [u64; 2],
}

/// A file that is not a replay of this run.
#[derive(Debug, thiserror::Error)]
pub enum ReplayFileError {
    /// It cannot be read, or is shorter than its header says.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// Something else, or another version of it.
    #[error("magic {magic} and version {version}; accepted: TRREPLAY and version {VERSION}")]
    Kind {
        /// What it begins with.
        magic: String,
        /// Its version.
        version: u64,
    },
    /// A field of the header is not this run's, or cannot be.
    #[error("{what} is {found}; accepted: {accepted}")]
    Header {
        /// Which field.
        what: &'static str,
        /// Its value.
        found: u64,
        /// What is accepted.
        accepted: String,
    },
    /// A stored number is out of range.
    #[error("transition in slot {slot}: {what} is {found}; accepted: {accepted}")]
    Entry {
        /// Which slot.
        slot: usize,
        /// Which field.
        what: &'static str,
        /// Its value.
        found: f64,
        /// What is accepted.
        accepted: String,
    },
    /// There is more than the header says.
    #[error("bytes are left over after {0} transitions")]
    Trailing(u64),
}

/// What the entries of a restored replay may name.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Size of the action space.
    pub n_actions: usize,
    /// Number of mentor transitions.
    pub mentor_len: usize,
    /// Number of actors.
    pub actors: u32,
}

impl Replay {
    /// Writes the replay.
    pub fn write(&self, out: &mut impl Write) -> io::Result<()> {
        let header = Header {
            magic: MAGIC,
            version: VERSION,
            obs_dim: self.obs_dim as u64,
            capacity: self.capacity as u64,
            stored: self.len() as u64,
            pushed: self.pushed,
            zero: [0; 2],
        };
        out.write_all(bytes_of(&header))?;
        for words in [&self.obs, &self.next] {
            out.write_all(cast_slice(words))?;
        }
        out.write_all(cast_slice(&self.action))?;
        out.write_all(cast_slice(&self.reward))?;
        out.write_all(cast_slice(&self.mentor))?;
        out.write_all(cast_slice(&self.q_past_o))?;
        out.write_all(cast_slice(&self.q_past_m))?;
        out.write_all(&self.flags)?;
        out.write_all(&self.actor)
    }

    /// Replaces the contents by those that [`Replay::write`] wrote, of a replay with the same capacity and
    /// `obs_dim`. All of `from` must be used up.
    ///
    /// # Errors
    /// Anything that `write` would not have written; the replay is empty then.
    pub fn read(&mut self, from: &mut impl Read, bounds: &Bounds) -> Result<(), ReplayFileError> {
        let read = self.read_unchecked(from).and_then(|()| self.check(bounds));
        if read.is_err() {
            self.pushed = 0;
            self.resize(0);
        }
        read
    }

    fn read_unchecked(&mut self, from: &mut impl Read) -> Result<(), ReplayFileError> {
        let mut header = Header::default();
        from.read_exact(bytemuck::bytes_of_mut(&mut header))?;
        if (header.magic, header.version) != (MAGIC, VERSION) {
            let magic = header.magic.escape_ascii().to_string();
            return Err(ReplayFileError::Kind { magic, version: header.version });
        }
        let (dim, capacity) = (self.obs_dim as u64, self.capacity as u64);
        let stored = header.pushed.min(capacity);
        for (what, found, accepted) in [
            ("obs_dim", header.obs_dim, dim),
            ("capacity", header.capacity, capacity),
            ("number of transitions", header.stored, stored),
        ] {
            if found != accepted {
                return Err(ReplayFileError::Header { what, found, accepted: accepted.to_string() });
            }
        }
        self.pushed = header.pushed;
        self.resize(stored as usize);
        for words in [&mut self.obs, &mut self.next] {
            from.read_exact(cast_slice_mut(words))?;
        }
        from.read_exact(cast_slice_mut(&mut self.action))?;
        from.read_exact(cast_slice_mut(&mut self.reward))?;
        from.read_exact(cast_slice_mut(&mut self.mentor))?;
        from.read_exact(cast_slice_mut(&mut self.q_past_o))?;
        from.read_exact(cast_slice_mut(&mut self.q_past_m))?;
        from.read_exact(&mut self.flags)?;
        from.read_exact(&mut self.actor)?;
        if from.read(&mut [0])? != 0 {
            return Err(ReplayFileError::Trailing(stored));
        }
        Ok(())
    }

    /// Makes every array `len` (at most the capacity) transitions long, within the memory that is reserved.
    fn resize(&mut self, len: usize) {
        self.obs.resize(len * self.obs_dim, 0.0);
        self.next.resize(len * self.obs_dim, 0.0);
        self.action.resize(len, 0);
        self.reward.resize(len, 0.0);
        self.mentor.resize(len, NONE);
        self.q_past_o.resize(len, f32::NAN);
        self.q_past_m.resize(len, f32::NAN);
        self.flags.resize(len, 0);
        self.actor.resize(len, 0);
    }

    /// Checks all that the rest of the program relies on. Past values may be anything: NaN means "never computed".
    fn check(&self, bounds: &Bounds) -> Result<(), ReplayFileError> {
        let refuse = |slot, what, found: f64, accepted: String| {
            Err(ReplayFileError::Entry { slot, what, found, accepted })
        };
        for slot in 0..self.len() {
            let entry = self.get(slot);
            let t = entry.transition;
            let mut numbers = t.obs.iter().chain(t.next_obs).chain([&t.reward]);
            if let Some(&x) = numbers.find(|x| !x.is_finite()) {
                return refuse(slot, "a feature or the reward", f64::from(x), "finite numbers".into());
            }
            if t.action as usize >= bounds.n_actions {
                return refuse(slot, "action", t.action.into(), format!("below {}", bounds.n_actions));
            }
            if let Some(j) = entry.mentor.filter(|&j| j >= bounds.mentor_len) {
                return refuse(slot, "mentor index", j as f64, format!("below {}", bounds.mentor_len));
            }
            if self.flags[slot] & !KNOWN_FLAGS != 0 {
                return refuse(slot, "flags", self.flags[slot].into(), format!("any of {KNOWN_FLAGS:#x}"));
            }
            if entry.actor >= bounds.actors {
                return refuse(slot, "actor", entry.actor.into(), format!("below {}", bounds.actors));
            }
        }
        Ok(())
    }
}
