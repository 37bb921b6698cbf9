//! HDF5: which of its layouts a file has, and tables of numbers and flags, read window by window.

mod episodes;
mod flat;
mod layout;
mod links;
mod objects;
mod source;
mod table;

use super::Options;
use super::error::{ImportError, Place};
use super::sink::Sink;
use hdf5_pure::{Dataset, Error, FormatError, Group};
use layout::{Choice, choose, join};
use links::{Finder, Found};
pub(super) use source::signature;
use std::fs::File;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

/// An open file, and where its links lead.
struct Source {
    path: PathBuf,
    file: hdf5_pure::File,
    finder: Finder,
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
            message: format!("cannot be read as HDF5; where h5py can read it, {}", copied(path, "")),
        })
    })
}

impl Source {
    fn place(&self) -> Place {
        Place::of(&self.path)
    }

    /// The dataset at `path`, or why there is none.
    fn dataset(&self, path: &str) -> Result<Dataset, ImportError> {
        self.dataset_if_any(path)?.ok_or_else(|| self.missing(path))
    }

    /// The dataset at `path`, if there is one.
    fn dataset_if_any(&self, path: &str) -> Result<Option<Dataset>, ImportError> {
        let found = |dataset: Result<Dataset, Error>| match dataset {
            Ok(dataset) => Ok(Some(dataset)),
            Err(error) if is_missing(&error) => Ok(None),
            Err(error) => Err(unreadable(&self.path)(error)),
        };
        match found(self.file.dataset(path))? {
            Some(dataset) => Ok(Some(dataset)),
            None => self.elsewhere(path)?.map_or(Ok(None), |real| found(self.file.dataset(&real))),
        }
    }

    /// The group at `path`; the root is empty.
    fn group(&self, path: &str) -> Result<Group, ImportError> {
        if path.is_empty() {
            return Ok(self.file.root());
        }
        match self.file.group(path) {
            Ok(group) => Ok(group),
            Err(error) if !is_missing(&error) => Err(unreadable(&self.path)(error)),
            Err(_) => {
                let real = self.elsewhere(path)?.ok_or_else(|| self.missing(path))?;
                self.file.group(&real).map_err(|_| self.missing(path))
            }
        }
    }

    fn missing(&self, path: &str) -> ImportError {
        self.place().refuse(path, "missing", "a dataset, or a group of them")
    }

    /// The path, free of soft links, of the object at `path`, where the library finds nothing; none if there is no object.
    ///
    /// # Errors
    /// A link that leads to another file, or nowhere.
    fn elsewhere(&self, path: &str) -> Result<Option<String>, ImportError> {
        match self.finder.find(path) {
            Found::Object(real, _) => Ok(Some(real).filter(|real| real != path.trim_matches('/'))),
            Found::Nothing => Ok(None),
            Found::Unread(own, what) => {
                let kind = format!("a file in which `{own}` is {what}");
                Err(self.place().foreign(kind, copied(&self.path, "")))
            }
            Found::Dead(own, what) => Err(self.place().refuse(own, what, "a link to something in it")),
        }
    }

    /// Refuses a link of the group at `path` whose object cannot be read, if `wanted` says so of its name.
    fn refuse_unread(&self, path: &str, wanted: impl Fn(&str) -> bool) -> Result<(), ImportError> {
        for name in self.finder.linked(path).into_iter().filter(|name| wanted(name)) {
            self.elsewhere(&join(path, &name))?;
        }
        Ok(())
    }
}

fn is_missing(error: &Error) -> bool {
    matches!(error, Error::Format(FormatError::PathNotFound(_)) | Error::NotADataset(_) | Error::NotAGroup(_))
}

/// The library's error about a file that it cannot read.
fn unreadable(path: &Path) -> impl Fn(Error) -> ImportError {
    let path = path.to_path_buf();
    move |error| match error {
        Error::Format(error) if is_newer(&error) => {
            let kind = format!("a file with a part of HDF5 that is not known here ({error})");
            Place::of(&path).foreign(kind, copied(&path, ""))
        }
        error => ImportError::Io {
            path: path.clone(),
            message: format!(
                "cannot be read as HDF5 ({error}): it is cut off or damaged, or has a part that is not known here; where h5py can \
                 read it, {}",
                copied(&path, "")
            ),
        },
    }
}

/// Whether the library has met something sound that it does not know: newer than it, or rare.
fn is_newer(error: &FormatError) -> bool {
    use FormatError as E;
    matches!(
        error,
        E::UnsupportedVersion(_)
            | E::UnsupportedMessage(_)
            | E::InvalidLayoutVersion(5..=9)
            | E::UnsupportedFilteredHeapObject
            | E::UnsupportedSohmReference
            | E::UnsupportedFillValueVersion(_)
            | E::NestingDepthExceeded
    )
}

/// A command that makes a plain file of all that h5py reads in the one at `path`, links followed; `import`: further modules that
/// it needs.
fn copied(path: &Path, import: &str) -> String {
    format!(
        "`python3 -c 'import h5py{import}; copy = lambda a, b: [copy(v, b.create_group(k)) if isinstance(v, h5py.Group) else \
         b.create_dataset(k, data=v[()]) for k, v in a.items() if v is not None]; copy(h5py.File(\"{}\"), \
         h5py.File(\"plain.hdf5\", \"w\"))'` makes a file that is read",
        path.display()
    )
}
