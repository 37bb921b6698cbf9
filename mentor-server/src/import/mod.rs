//! Demonstrations from the files that users have: Minari's data sets (HDF5 and Arrow), D4RL's HDF5, CSV and NPY.
//!
//! Whatever the format, only states and how each episode ended are taken: columns that are not asked for, actions and
//! rewards above all, are not even read where the format allows to skip them, and nothing of them is kept. A source is
//! read in windows of bounded size, so memory grows with the states that are kept alone.
//!
//! One file a format turns its source into rows for the `sink`; everything that holds for all of them, the choice of
//! columns and episodes, finite numbers and limits, is there.

mod arrow;
mod choice;
mod csv;
mod d4rl;
mod error;
mod hdf5;
mod metadata;
mod minari;
mod npy;
mod sink;

#[cfg(test)]
mod tests;

pub use choice::{Columns, Ends, Episodes};
pub use error::{ImportError, Place};

use sink::Sink;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use trestle_algorithm::demonstration::Demonstration;

/// What of a source is wanted.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Which part of the observations, where they are a dictionary: names separated by `/`.
    pub key: Option<String>,
    /// Which features; all if none are named.
    pub columns: Option<Columns>,
    /// Which episodes; all if none are named.
    pub episodes: Option<Episodes>,
    /// Which trajectories end in a terminal state.
    pub ends: Ends,
}

/// A demonstration and what there is to say of how it came about.
#[derive(Clone, Debug)]
pub struct Imported {
    /// The states.
    pub demonstration: Demonstration,
    /// What the source is.
    pub format: &'static str,
    /// What was left out, or could not be known, in sentences.
    pub notes: Vec<String>,
}

/// Reads the file or data set at `path`; what it is is seen from its contents.
///
/// # Errors
/// A source that cannot be read, is none of the formats, is damaged, or does not hold what `options` ask for. The
/// message names the file, the episode and the row where they are known.
pub fn import(path: &Path, options: &Options) -> Result<Imported, ImportError> {
    let (source, format) = locate(path)?;
    let mut sink = Sink::new(&source, options);
    match format {
        Format::MinariHdf5 => minari::read(&source, options, &mut sink)?,
        Format::D4rl => d4rl::read(&source, options, &mut sink)?,
        Format::MinariArrow => arrow::read(&source, options, &mut sink)?,
        Format::Npy => npy::read(&source, options, &mut sink)?,
        Format::Csv => csv::read(&source, options, &mut sink)?,
    }
    let (demonstration, notes) = sink.done()?;
    Ok(Imported { demonstration, format: format.name(), notes })
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    MinariHdf5,
    MinariArrow,
    D4rl,
    Npy,
    Csv,
}

impl Format {
    fn name(self) -> &'static str {
        match self {
            Self::MinariHdf5 => "Minari (HDF5)",
            Self::MinariArrow => "Minari (Arrow)",
            Self::D4rl => "D4RL (HDF5)",
            Self::Npy => "NPY",
            Self::Csv => "CSV",
        }
    }
}

const HDF5_MAGIC: &[u8] = b"\x89HDF\r\n\x1a\n";
const NPY_MAGIC: &[u8] = b"\x93NUMPY";
const ARROW_MAGIC: &[u8] = b"ARROW1";

/// The file or directory to read, and what it is.
fn locate(path: &Path) -> Result<(PathBuf, Format), ImportError> {
    if path.is_dir() {
        // A data set of Minari, or the folder `data` in it.
        for dir in [path.join("data"), path.into()] {
            let file = dir.join("main_data.hdf5");
            if file.is_file() {
                return Ok((file, Format::MinariHdf5));
            }
            if arrow::part(&dir, 0, 0).is_file() {
                return Ok((dir, Format::MinariArrow));
            }
        }
        let accepted = "a folder with main_data.hdf5, or with 0/part-0.arrow";
        return Err(Place::of(path).refuse(
            "this folder",
            "no data set of Minari in these formats",
            accepted,
        ));
    }
    let io = |error: std::io::Error| ImportError::Io { path: path.into(), message: format!("{error}") };
    let mut start = Vec::new();
    File::open(path).map_err(io)?.take(8).read_to_end(&mut start).map_err(io)?;
    let format = match &start {
        s if s.is_empty() => return Err(Place::of(path).refuse("the file", "empty", "a file with states")),
        s if s.starts_with(HDF5_MAGIC) => hdf5::format(path)?,
        s if s.starts_with(NPY_MAGIC) => Format::Npy,
        s if s.starts_with(ARROW_MAGIC) => Format::MinariArrow,
        s if s.contains(&0) => {
            let accepted = "HDF5, Arrow IPC, NPY, or CSV";
            return Err(Place::of(path).refuse("the format", "unknown", accepted));
        }
        _ => Format::Csv,
    };
    Ok((path.into(), format))
}
