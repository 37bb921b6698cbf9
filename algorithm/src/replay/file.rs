//! The replay as files: *segments* that never change once they are full, and a *head* with all that does.
//!
//! A stored transition stays what it is until it is overwritten. So the history is cut at multiples of
//! [`Replay::segment_rows`] into segments, which successive checkpoints share, and a checkpoint costs what has come since the
//! one before. All is little-endian.
//!
//! The head is a header of 64 bytes.
//!
//! | bytes | what |
//! |---|---|
//! | 8, 8 | magic `TRREPLAY`, version of this layout `u64` |
//! | 8, 8, 8, 8 | `obs_dim`, capacity, transitions stored, transitions ever stored, `u64` |
//! | 8, 8 | type of the features ([`Element::code`]), zero, `u64` |
//!
//! A segment: 64 bytes of header, then each array whole, in the order of the global indices. An s' is in it only where there
//! is no successor in the same segment; then its transition's flags have [`APART`] as well.
//!
//! | bytes | what |
//! |---|---|
//! | 8, 8 | magic `TRSEGMNT`, version of this layout `u64` |
//! | 8, 8, 8 | `obs_dim`, global index of the first transition, and of the one after the last, `u64` |
//! | 8 | zero |
//! | 8, 8 | type of the features, number of s', `u64` |
//! | `rows * w` words | s, of `w` words each ([`RowKind::words`]) |
//! | `rows` words each | actions `u32`, rewards `f32`, mentor indices `u32` |
//! | `rows` bytes each | flags, actors |
//! | `w` words each | s' of those transitions that have one of their own |
//!
//! The files have no checksums of their own: the manifest of a checkpoint has them.

use super::Replay;
use bytemuck::{Pod, Zeroable, bytes_of, cast_slice, cast_slice_mut};
use std::io::{self, Read};
use std::ops::Range;
use trestle_proto::NONE;
use trestle_proto::batch::{FIRST, KNOWN_FLAGS, TERMINATED, TRUNCATED};
use trestle_proto::row::Row;
#[cfg(doc)]
use trestle_proto::row::{Element, RowKind};

// The arrays go to the file as they lie in memory.
const _: () = assert!(cfg!(target_endian = "little"), "files are little-endian, and so must be the machine");

const HEAD: [u8; 8] = *b"TRREPLAY";
const SEGMENT: [u8; 8] = *b"TRSEGMNT";
const VERSION: u64 = 4;
/// Flag of a transition whose s' is in the segment.
const APART: u8 = 0x80;

// No transition has this flag.
const _: () = assert!(KNOWN_FLAGS & APART as u32 == 0);

/// Segments that a full replay has, about: few enough for a directory, and small enough for the unfinished one, which
/// every checkpoint writes anew.
const SEGMENTS: u64 = 64;
const PREFIX: &str = "replay-";
const SUFFIX: &str = ".bin";

#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
struct Header {
    magic: [u8; 8],
    version: u64,
    obs_dim: u64,
    /// Head: capacity. Segment: first.
    a: u64,
    /// Head: stored. Segment: end.
    b: u64,
    /// Head: ever stored.
    c: u64,
    /// Type of the features.
    element: u64,
    /// Segment: number of s'.
    tails: u64,
}

/// Transitions with global indices from `first` up to, and without, `end`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Span {
    /// The first.
    pub first: u64,
    /// The one after the last.
    pub end: u64,
}

impl Span {
    /// Name of the segment's file.
    pub fn name(&self) -> String {
        format!("{PREFIX}{:012}-{:012}{SUFFIX}", self.first, self.end)
    }

    /// The span of the segment whose file is called `name`; none if it is no segment's.
    pub fn of_name(name: &str) -> Option<Self> {
        let (first, end) = name.strip_prefix(PREFIX)?.strip_suffix(SUFFIX)?.split_once('-')?;
        let span = Self { first: first.parse().ok()?, end: end.parse().ok()? };
        // Nothing but what `name` would give: no signs, no missing zeros.
        (span.first < span.end && span.name() == name).then_some(span)
    }

    /// Number of transitions.
    fn rows(&self) -> usize {
        (self.end - self.first) as usize
    }
}

/// A file that is not a replay of this run.
#[derive(Debug, thiserror::Error)]
pub enum ReplayFileError {
    /// It cannot be read, or is shorter than its header says.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// Something else, or another version of it.
    #[error("magic {magic} and version {version}; accepted: {accepted} and version {VERSION}")]
    Kind {
        /// What it begins with.
        magic: String,
        /// Its version.
        version: u64,
        /// What it should begin with.
        accepted: String,
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
    /// A transition whose s' is not in its segment, and which has no successor there.
    #[error(
        "transition in slot {slot}: its s' is missing; accepted: a successor in its segment, or an s' of its own"
    )]
    Next {
        /// Which slot.
        slot: usize,
    },
    /// Segments that leave something out, or overlap.
    #[error("no segment begins with transition {missing}, and {stored} are stored from {first} on")]
    Gap {
        /// The transition that is missing.
        missing: u64,
        /// The first stored transition.
        first: u64,
        /// How many are stored.
        stored: u64,
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
    /// Transitions of a full segment: a power of two.
    fn segment_rows(&self) -> u64 {
        (self.capacity as u64 / SEGMENTS).next_power_of_two()
    }

    /// The segments that hold all that is stored, in order, and whether each is among those `there` already.
    /// A segment that is there may begin with transitions that are no longer stored.
    pub fn segments(&self, there: &[Span]) -> Vec<(Span, bool)> {
        let rows = self.segment_rows();
        let mut segments = Vec::new();
        let mut first = self.first_index();
        while first < self.pushed {
            let full = (first / rows + 1) * rows;
            let end = full.min(self.pushed);
            let same = |span: &&Span| span.end == end && end == full && span.first <= first;
            match there.iter().find(same) {
                Some(span) => segments.push((*span, true)),
                None => segments.push((Span { first, end }, false)),
            }
            first = end;
        }
        segments
    }

    /// The head as the bytes of a file.
    pub fn head(&self) -> Vec<u8> {
        let header = Header {
            magic: HEAD,
            version: VERSION,
            obs_dim: self.row.dim as u64,
            a: self.capacity as u64,
            b: self.len() as u64,
            c: self.pushed,
            element: self.row.element.code().into(),
            tails: 0,
        };
        bytes_of(&header).to_vec()
    }

    /// The transitions of `span`, all of which are stored, as the bytes of a file.
    pub fn segment(&self, span: Span) -> Vec<u8> {
        let width = self.row.words();
        let slots = self.slots(span);
        let apart = |index: u64| {
            let slot = self.slot(index);
            let ahead = self.successor(slot).map(|next| (next + self.capacity - slot) % self.capacity);
            ahead.is_none_or(|ahead| index + ahead as u64 >= span.end)
        };
        let tails = (span.first..span.end).filter(|&index| apart(index)).count();
        let header = Header {
            magic: SEGMENT,
            version: VERSION,
            obs_dim: self.row.dim as u64,
            a: span.first,
            b: span.end,
            c: 0,
            element: self.row.element.code().into(),
            tails: tails as u64,
        };
        let length = size_of::<Header>() + span.rows() * (4 * width + 14) + tails * 4 * width;
        let mut bytes = Vec::with_capacity(length);
        bytes.extend_from_slice(bytes_of(&header));
        put(&mut bytes, &self.obs, width, &slots);
        put(&mut bytes, &self.action, 1, &slots);
        put(&mut bytes, &self.reward, 1, &slots);
        put(&mut bytes, &self.mentor, 1, &slots);
        bytes.extend((span.first..span.end).map(|index| {
            let flags = self.flags[self.slot(index)];
            if apart(index) { flags | APART } else { flags }
        }));
        put(&mut bytes, &self.actor, 1, &slots);
        for index in (span.first..span.end).filter(|&index| apart(index)) {
            bytes.extend_from_slice(cast_slice(self.next_words(self.slot(index))));
        }
        bytes
    }

    /// The slots of `span`, no longer than the ring: up to its seam, and after it.
    fn slots(&self, span: Span) -> [Range<usize>; 2] {
        let start = self.slot(span.first);
        let before = span.rows().min(self.capacity - start);
        [start..start + before, 0..span.rows() - before]
    }

    /// Begins to read a replay with the same capacity and kind of states back: all entries are blank. After the last segment
    /// [`Replay::relink`] is due. All of `from` must be used up.
    ///
    /// # Errors
    /// Anything that [`Replay::head`] would not have given.
    pub fn read_head(&mut self, from: &mut impl Read) -> Result<(), ReplayFileError> {
        let header = read_header(from, HEAD)?;
        let capacity = self.capacity as u64;
        let stored = header.c.min(capacity);
        self.expect_states(&header)?;
        expect("capacity", header.a, capacity)?;
        expect("number of transitions", header.b, stored)?;
        self.pushed = header.c;
        self.resize(stored as usize);
        end(from, stored)
    }

    fn expect_states(&self, header: &Header) -> Result<(), ReplayFileError> {
        expect("obs_dim", header.obs_dim, self.row.dim as u64)?;
        expect("type of the features", header.element, self.row.element.code().into())
    }

    /// Whether `spans`, in order, hold all that is stored, each from where the one before ends.
    ///
    /// # Errors
    /// They leave something out, or overlap.
    pub fn check_segments(&self, spans: &[Span]) -> Result<(), ReplayFileError> {
        let gap = |missing| {
            let (first, stored) = (self.first_index(), self.len() as u64);
            Err(ReplayFileError::Gap { missing, first, stored })
        };
        let mut next = self.first_index();
        for (at, span) in spans.iter().enumerate() {
            let begins = if at == 0 { span.first <= next } else { span.first == next };
            if !begins || span.end <= next || span.end > self.pushed {
                return gap(next);
            }
            next = span.end;
        }
        if next < self.pushed { gap(next) } else { Ok(()) }
    }

    /// Reads segment `span` back, as far as its transitions are stored; after [`Replay::read_head`], and one of the
    /// segments that [`Replay::check_segments`] has found good. All of `from` must be used up.
    ///
    /// # Errors
    /// Anything that [`Replay::segment`] would not have given.
    pub fn read_segment(&mut self, span: Span, from: &mut impl Read) -> Result<(), ReplayFileError> {
        let header = read_header(from, SEGMENT)?;
        self.expect_states(&header)?;
        expect("first transition", header.a, span.first)?;
        expect("end", header.b, span.end)?;
        let stored = Span { first: span.first.max(self.first_index()), end: span.end };
        let gone = span.rows() - stored.rows();
        let slots = self.slots(stored);
        let width = self.row.words();
        take(from, &mut self.obs, width, gone, &slots)?;
        take(from, &mut self.action, 1, gone, &slots)?;
        take(from, &mut self.reward, 1, gone, &slots)?;
        take(from, &mut self.mentor, 1, gone, &slots)?;
        let mut flags = vec![0; span.rows()];
        from.read_exact(&mut flags)?;
        take(from, &mut self.actor, 1, gone, &slots)?;
        let apart = |flags: &[u8]| flags.iter().filter(|&flags| flags & APART != 0).count();
        expect("number of next states", header.tails, apart(&flags) as u64)?;
        skip(from, apart(&flags[..gone]) * 4 * width)?;
        for (index, flags) in (stored.first..).zip(&flags[gone..]) {
            let slot = self.slot(index);
            self.flags[slot] = flags & !APART;
            if flags & APART != 0 {
                let place = self.tails.take();
                self.links.set_tail(slot, place);
                from.read_exact(cast_slice_mut(self.tails.get_mut(place)))?;
            }
        }
        self.link_within(stored)?;
        end(from, span.rows() as u64)
    }

    /// Links the transitions of a segment that have no s' of their own to their successors.
    fn link_within(&mut self, span: Span) -> Result<(), ReplayFileError> {
        let mut later = [None; 256];
        for index in (span.first..span.end).rev() {
            let slot = self.slot(index);
            let next = later[usize::from(self.actor[slot])].replace(index);
            if self.links.tail(slot).is_some() {
                continue;
            }
            let flags = |slot: usize| u32::from(self.flags[slot]);
            let follows = |&next: &u64| flags(self.slot(next)) & FIRST == 0;
            match next.filter(follows) {
                Some(next) if flags(slot) & (TERMINATED | TRUNCATED) == 0 => {
                    self.links.set_ahead(slot, (next - index) as u32);
                }
                _ => return Err(ReplayFileError::Next { slot }),
            }
        }
        Ok(())
    }

    /// Makes every array `len` (at most the capacity) transitions long, within the memory that is reserved.
    fn resize(&mut self, len: usize) {
        self.obs.resize(len * self.row.words(), 0);
        self.tails.clear();
        self.action.resize(len, 0);
        self.reward.resize(len, 0.0);
        self.mentor.resize(len, NONE);
        self.flags.resize(len, 0);
        self.actor.resize(len, 0);
        self.links.blank(len);
    }

    /// Checks all that the rest of the program relies on.
    ///
    /// # Errors
    /// The first entry that is not sound.
    pub fn check(&self, bounds: &Bounds) -> Result<(), ReplayFileError> {
        let refuse = |slot, what, found: f64, accepted: String| {
            Err(ReplayFileError::Entry { slot, what, found, accepted })
        };
        for slot in 0..self.len() {
            let entry = self.get(slot);
            for row in [self.obs(slot), self.next_obs(slot), Row::F32(&[entry.reward])] {
                // A byte is always a number.
                let Row::F32(numbers) = row else { continue };
                if let Some(&x) = numbers.iter().find(|x| !x.is_finite()) {
                    return refuse(slot, "a feature or the reward", f64::from(x), "finite numbers".into());
                }
            }
            if entry.action as usize >= bounds.n_actions {
                return refuse(slot, "action", entry.action.into(), format!("below {}", bounds.n_actions));
            }
            if let Some(j) = entry.mentor.filter(|&j| j >= bounds.mentor_len) {
                return refuse(slot, "mentor index", j as f64, format!("below {}", bounds.mentor_len));
            }
            if u32::from(self.flags[slot]) & !KNOWN_FLAGS != 0 {
                return refuse(slot, "flags", self.flags[slot].into(), format!("any of {KNOWN_FLAGS:#x}"));
            }
            if entry.actor >= bounds.actors {
                return refuse(slot, "actor", entry.actor.into(), format!("below {}", bounds.actors));
            }
        }
        Ok(())
    }
}

/// Appends the entries of `column` in `slots`, each `width` numbers.
fn put<T: Pod>(bytes: &mut Vec<u8>, column: &[T], width: usize, slots: &[Range<usize>; 2]) {
    for range in slots {
        bytes.extend_from_slice(cast_slice(&column[range.start * width..range.end * width]));
    }
}

/// Reads a column whose first `gone` entries are of no use into `slots`.
fn take<T: Pod>(
    from: &mut impl Read,
    column: &mut [T],
    width: usize,
    gone: usize,
    slots: &[Range<usize>; 2],
) -> io::Result<()> {
    skip(from, gone * width * size_of::<T>())?;
    for range in slots {
        from.read_exact(cast_slice_mut(&mut column[range.start * width..range.end * width]))?;
    }
    Ok(())
}

/// Reads `bytes` bytes that are of no use.
fn skip(from: &mut impl Read, bytes: usize) -> io::Result<()> {
    let bytes = bytes as u64;
    if io::copy(&mut from.by_ref().take(bytes), &mut io::sink())? < bytes {
        return Err(io::ErrorKind::UnexpectedEof.into());
    }
    Ok(())
}

fn read_header(from: &mut impl Read, accepted: [u8; 8]) -> Result<Header, ReplayFileError> {
    let mut header = Header::default();
    from.read_exact(bytemuck::bytes_of_mut(&mut header))?;
    if (header.magic, header.version) == (accepted, VERSION) {
        return Ok(header);
    }
    let [magic, accepted] = [header.magic, accepted].map(|magic| magic.escape_ascii().to_string());
    Err(ReplayFileError::Kind { magic, version: header.version, accepted })
}

fn expect(what: &'static str, found: u64, accepted: u64) -> Result<(), ReplayFileError> {
    if found == accepted {
        return Ok(());
    }
    Err(ReplayFileError::Header { what, found, accepted: accepted.to_string() })
}

/// Refuses what comes after the last of `rows` transitions.
fn end(from: &mut impl Read, rows: u64) -> Result<(), ReplayFileError> {
    if from.read(&mut [0])? == 0 { Ok(()) } else { Err(ReplayFileError::Trailing(rows)) }
}
