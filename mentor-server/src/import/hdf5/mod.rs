//! HDF5: which of its layouts a file has, and tables of numbers and flags, read window by window.

mod episodes;
mod flat;
mod layout;
mod links;
mod source;
mod table;

use super::Options;
use super::error::{ImportError, Place};
use super::sink::Sink;
use hdf5_pure::{Dataset, Error, FormatError, Group};
use layout::{Choice, choose};
pub(super) use source::signature;
use std::fs::File;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

/// An open file, and what it calls things that are not there.
struct Source {
    path: PathBuf,
    file: hdf5_pure::File,
    /// Soft links of the old style that lead nowhere.
    dangling: Vec<(String, String)>,
    /// To look for links in.
    bytes: File,
}

/// Reads the episodes that are wanted into `sink`; says whose layout it is.
pub(super) fn read(
    path: &Path,
    file: File,
    options: &Options,
    sink: &mut Sink<'_>,
) -> Result<&'static str, ImportError> {
    // The library panics over no file that is known to us. Should it do so over one that is not, that file is refused.
    let read = || {
        let source = source::open(path, file)?;
        let (format, choice) = choose(&source, options)?;
        match choice {
            Choice::Episodes(episodes) => episodes::read(&source, &episodes, sink)?,
            Choice::Flat(dataset) => flat::read(&source, &dataset, options, sink)?,
        }
        Ok(format)
    };
    catch_unwind(AssertUnwindSafe(read)).unwrap_or_else(|_| {
        Err(ImportError::Io {
            path: path.into(),
            message: "cannot be read as HDF5, it may be damaged".into(),
        })
    })
}

impl Source {
    fn place(&self) -> Place {
        Place::of(&self.path)
    }

    /// The dataset at `path`, or why there is none.
    fn dataset(&self, path: &str) -> Result<Dataset, ImportError> {
        self.file.dataset(path).map_err(|error| self.missing(path, error))
    }

    /// The dataset at `path`, if there is one.
    fn dataset_if_any(&self, path: &str) -> Result<Option<Dataset>, ImportError> {
        match self.file.dataset(path) {
            Ok(dataset) => Ok(Some(dataset)),
            Err(error) if is_missing(&error) => self.link(path).map_or(Ok(None), Err),
            Err(error) => Err(damaged(&self.path)(error)),
        }
    }

    /// The group at `path`; the root is empty.
    fn group(&self, path: &str) -> Result<Group, ImportError> {
        if path.is_empty() {
            return Ok(self.file.root());
        }
        self.file.group(path).map_err(|error| self.missing(path, error))
    }

    /// Why there is nothing at `path`: a link that is not followed, or that it is missing.
    fn missing(&self, path: &str, error: Error) -> ImportError {
        if !is_missing(&error) {
            return damaged(&self.path)(error);
        }
        self.link(path)
            .unwrap_or_else(|| self.place().refuse(path, "missing", "a dataset, or a group of them"))
    }

    /// That a part of `path` is a link that is not followed, if it is one.
    fn link(&self, path: &str) -> Option<ImportError> {
        let wanted = format!("/{}", path.trim_matches('/'));
        let dead =
            self.dangling.iter().find(|(own, _)| wanted == *own || wanted.starts_with(&format!("{own}/")));
        if let Some((own, target)) = dead {
            let value = format!("a soft link to `{target}`, which is not in the file");
            return Some(self.place().refuse(own, value, "a link to something in it"));
        }
        let linked = |name: &str| Some((name.to_string(), links::link_named(&self.bytes, name).ok()??));
        let (name, what) = path.split('/').filter(|part| !part.is_empty()).find_map(linked)?;
        let next = format!(
            "`python3 -c 'import h5py; a = h5py.File(\"{}\"); b = h5py.File(\"whole.hdf5\", \"w\"); [a.copy(a[k], b, k, \
             expand_soft=True, expand_external=True) for k in a if k in a]'` makes a file without links",
            self.path.display()
        );
        Some(self.place().foreign(format!("a file in which `{name}` is {what}"), next))
    }
}

fn is_missing(error: &Error) -> bool {
    matches!(error, Error::Format(FormatError::PathNotFound(_)) | Error::NotADataset(_) | Error::NotAGroup(_))
}

/// What the library says of a file that it cannot read, with a hint: most such files are cut off.
fn damaged(path: &Path) -> impl Fn(Error) -> ImportError {
    let path = path.to_path_buf();
    move |error| ImportError::Io {
        path: path.clone(),
        message: format!("cannot be read as HDF5, it may be cut off or damaged: {error}"),
    }
}
