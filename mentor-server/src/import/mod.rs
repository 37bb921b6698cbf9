//! Demonstrations from the files that users have: HDF5 in the layouts of Minari, D4RL, robomimic, ManiSkill and others,
//! Minari's Arrow files, tables of text, NPY and NPZ. What is known and not read is named, with a way out.
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
mod error;
mod flat;
mod hdf5;
mod labels;
mod metadata;
mod names;
mod npy;
mod npz;
mod rows;
mod sink;
pub(crate) mod sniff;
pub(crate) mod table;

#[cfg(test)]
mod foreign_tests;
#[cfg(test)]
mod tests;

pub use choice::{Columns, Ends, Episodes};
pub(crate) use error::short;
pub use error::{ImportError, Place};
pub use npy::grid;
pub use table::Header;

use sink::Sink;
use sniff::{Kind, kind};
use std::path::{Path, PathBuf};
use trestle_algorithm::demonstration::Demonstration;
use trestle_proto::regular_file;

/// Largest source that is read, bytes. Sources are streamed, so this bounds time rather than memory.
pub const MAX_SOURCE_BYTES: u64 = 1 << 40;

/// What of a source is wanted.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Which part of the observations, where they are a dictionary, or which path of the file: names separated by `/` or `.`,
    /// where `*` stands for the numbers of episodes.
    pub key: Option<String>,
    /// Whether a table's first row names its columns.
    pub header: Header,
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
    if let Some(dir) = arrow_set(path)? {
        let mut sink = Sink::new(&dir, options);
        arrow::read(&dir, options, &mut sink)?;
        return finish(sink, "Minari (Arrow)");
    }
    let path = file_in(path);
    let io = |error: std::io::Error| ImportError::Io { path: path.clone(), message: error.to_string() };
    let file = regular_file::open(&path, MAX_SOURCE_BYTES)?;
    let mut sink = Sink::new(&path, options);
    let format = match kind(&file, &path).map_err(io)? {
        Kind::Empty => return Err(Place::of(&path).refuse("the file", "empty", "a file with states")),
        Kind::Foreign(foreign) => return Err(Place::of(&path).foreign(foreign.what, foreign.next)),
        Kind::Hdf5 => hdf5::read(&path, file, options, &mut sink)?,
        Kind::Arrow => {
            arrow::read(&path, options, &mut sink)?;
            "Minari (Arrow)"
        }
        Kind::Npy => {
            npy::read(&path, file, options, &mut sink)?;
            "NPY"
        }
        Kind::Npz => {
            npz::read(&path, &file, options, &mut sink)?;
            "NPZ"
        }
        Kind::Text => {
            csv::read(&path, file, options, &mut sink)?;
            "CSV"
        }
    };
    finish(sink, format)
}

fn finish(sink: Sink<'_>, format: &'static str) -> Result<Imported, ImportError> {
    let (demonstration, notes) = sink.done()?;
    Ok(Imported { demonstration, format, notes })
}

/// The folder with a folder an episode, if `path` is a data set of Minari's in Arrow files.
fn arrow_set(path: &Path) -> Result<Option<PathBuf>, ImportError> {
    if !path.is_dir() {
        return Ok(None);
    }
    for dir in [path.join("data"), path.into()] {
        if dir.join(MINARI_HDF5).is_file() {
            return Ok(None);
        }
        if arrow::part(&dir, 0, 0).is_file() {
            return Ok(Some(dir));
        }
    }
    let accepted =
        "a folder with main_data.hdf5, or with 0/part-0.arrow; of other data sets, one of their files";
    Err(Place::of(path).refuse("this folder", "no data set of Minari in these formats", accepted))
}

const MINARI_HDF5: &str = "main_data.hdf5";

/// The file to read: `path`, or Minari's in it.
fn file_in(path: &Path) -> PathBuf {
    let inside = [path.join("data").join(MINARI_HDF5), path.join(MINARI_HDF5)];
    inside.into_iter().find(|file| path.is_dir() && file.is_file()).unwrap_or(path.into())
}
