//! What Minari's and D4RL's HDF5 files have in common: tables and flags, read window by window.

use super::Format;
use super::error::{ImportError, Place};
use hdf5_pure::{DType, Dataset, File, Group};
use std::fs;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use trestle_proto::limits::MAX_MENTOR_TRANSITIONS;

/// About how much is decoded at once, bytes.
const WINDOW_BYTES: u64 = 1 << 20;
/// As much of a superblock as is looked at.
const SUPERBLOCK_BYTES: u64 = 64;

pub(super) fn open(path: &Path) -> Result<File, ImportError> {
    let io = |error: io::Error| ImportError::Io { path: path.into(), message: error.to_string() };
    let mut file = fs::File::open(path).map_err(io)?;
    let bytes = file.metadata().map_err(io)?.len();
    let mut start = Vec::new();
    file.by_ref().take(SUPERBLOCK_BYTES).read_to_end(&mut start).map_err(io)?;
    match end_of_file(&start) {
        Some(end) if end > bytes => {
            let accepted = format!("{end}, as it says itself; it is cut off");
            Err(Place::of(path).refuse("the file's length", format!("{bytes} bytes"), accepted))
        }
        _ => File::open_streaming(path).map_err(damaged(path)),
    }
}

/// Where the file should end according to its superblock (HDF5 file format, II.A). The library does not look: a file
/// that is cut off behind what we need would pass.
fn end_of_file(start: &[u8]) -> Option<u64> {
    let (size_of_offsets, at) = match *start.get(8)? {
        0 => (13, 40),
        1 => (13, 44),
        2 | 3 => (9, 28),
        _ => return None,
    };
    if *start.get(size_of_offsets)? != 8 {
        return None;
    }
    Some(u64::from_le_bytes(start.get(at..at + 8)?.try_into().ok()?))
}

/// What the library says of a file that it cannot read, with a hint: most such files are cut off.
pub(super) fn damaged(path: &Path) -> impl Fn(hdf5_pure::Error) -> ImportError {
    let path = path.to_path_buf();
    move |error| ImportError::Io {
        path: path.clone(),
        message: format!("cannot be read as HDF5, it may be cut off or damaged: {error}"),
    }
}

/// Whose HDF5 it is.
pub(super) fn format(path: &Path) -> Result<Format, ImportError> {
    let file = open(path)?;
    let root = file.root();
    if root.datasets().map_err(damaged(path))?.iter().any(|name| name == "observations") {
        return Ok(Format::D4rl);
    }
    if root.groups().map_err(damaged(path))?.iter().any(|name| name.starts_with("episode_")) {
        return Ok(Format::MinariHdf5);
    }
    let accepted = "groups episode_0, ... as Minari has, or a dataset observations as D4RL has";
    Err(Place::of(path).refuse("the contents", "neither Minari's nor D4RL's", accepted))
}

/// The names in `group`, for messages.
pub(super) fn names(group: &Group) -> Vec<String> {
    let mut names = group.datasets().unwrap_or_default();
    names.extend(group.groups().unwrap_or_default());
    names.sort();
    names
}

/// A dataset of numbers with one row a state.
pub(super) struct Table {
    dataset: Dataset,
    path: PathBuf,
    rows: u64,
    width: usize,
    window: u64,
}

impl Table {
    /// `place` and `what` are for messages.
    pub(super) fn new(path: &Path, dataset: Dataset, place: Place, what: &str) -> Result<Self, ImportError> {
        let dtype = dataset.dtype().map_err(damaged(path))?;
        let bytes = match &dtype {
            DType::I8 | DType::U8 | DType::Enum(_) => 1,
            DType::I16 | DType::U16 => 2,
            DType::F32 | DType::I32 | DType::U32 => 4,
            DType::F64 | DType::I64 | DType::U64 => 8,
            other => return Err(place.refuse(format!("the type of {what}"), other, "numbers")),
        };
        let shape = dataset.shape().map_err(damaged(path))?;
        let [rows, features @ ..] = &shape[..] else {
            return Err(place.refuse(format!("the shape of {what}"), "()", "(T, D)"));
        };
        let width = features.iter().try_fold(1_u64, |a, &b| a.checked_mul(b)).and_then(|w| w.try_into().ok());
        let width: usize = width.ok_or_else(|| {
            place.clone().refuse(format!("the shape of {what}"), format!("{shape:?}"), "(T, D)")
        })?;
        // Whole chunks, so that none is decoded twice.
        let chunk = dataset.chunk_shape().map_err(damaged(path))?.and_then(|chunk| chunk.first().copied());
        let chunk = chunk.unwrap_or(1).max(1);
        let row_bytes = (width as u64).saturating_mul(bytes).max(1);
        let window = (WINDOW_BYTES / row_bytes / chunk).max(1).saturating_mul(chunk);
        Ok(Self { dataset, path: path.into(), rows: *rows, width, window })
    }

    pub(super) fn rows(&self) -> u64 {
        self.rows
    }

    pub(super) fn width(&self) -> usize {
        self.width
    }

    /// Rows that are best read together.
    pub(super) fn window(&self) -> u64 {
        self.window
    }

    /// `count` rows from `first` on, row-major.
    pub(super) fn read(&self, first: u64, count: u64) -> Result<Vec<f64>, ImportError> {
        let values = match self.dataset.dtype().map_err(damaged(&self.path))? {
            // Booleans.
            DType::Enum(_) => {
                let raw = self.dataset.read_raw_rows(first, count).map_err(damaged(&self.path))?;
                raw.into_iter().map(f64::from).collect()
            }
            _ => self.dataset.read_f64_rows(first, count).map_err(damaged(&self.path))?,
        };
        if values.len() as u64 != count * self.width as u64 {
            let accepted = count * self.width as u64;
            let place = Place::of(&self.path).row(first);
            return Err(place.refuse("the number of numbers", values.len(), accepted));
        }
        Ok(values)
    }
}

/// A flag a row: 0 or 1.
pub(super) fn flags(
    table: &Table,
    first: u64,
    count: u64,
    place: &Place,
    what: &str,
) -> Result<Vec<bool>, ImportError> {
    let values = table.read(first, count)?;
    let flag = |(i, value): (usize, f64)| match value {
        0.0 => Ok(false),
        1.0 => Ok(true),
        other => Err(place.clone().row(first + i as u64).refuse(what, other, "0 or 1")),
    };
    values.into_iter().enumerate().map(flag).collect()
}

/// All flags of one episode.
pub(super) fn all_flags(table: &Table, place: &Place, what: &str) -> Result<Vec<bool>, ImportError> {
    if table.width() != 1 || table.rows() > MAX_MENTOR_TRANSITIONS as u64 {
        let value = format!("({}, {})", table.rows(), table.width());
        let accepted = format!("(T,), T up to {MAX_MENTOR_TRANSITIONS}");
        return Err(place.clone().refuse(format!("the shape of {what}"), value, accepted));
    }
    flags(table, 0, table.rows(), place, what)
}
