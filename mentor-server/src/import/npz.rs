//! NPZ: a ZIP archive of NPY arrays by name. They are read as the flat arrays that they mostly are: states, and flags beside
//! them. Where `--key` has a `*`, each array that it matches is an episode.

use super::Options;
use super::error::{ImportError, Place, list};
use super::flat::Flat;
use super::labels::{Role, is_no_state, role};
use super::npy::Array;
use super::rows::Rows;
use super::sink::Sink;
use flate2::read::DeflateDecoder;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::os::unix::fs::FileExt;
use std::path::Path;
use zip::{CompressionMethod, ZipArchive};

/// What states are called, the likeliest first.
const STATES: [&str; 5] = ["observations", "obs", "states", "observation", "state"];
/// Those after each step.
const SUCCESSORS: [(&str, &str); 3] =
    [("observations", "next_observations"), ("obs", "next_obs"), ("states", "next_states")];
/// Most arrays that are looked at.
const MAX_MEMBERS: usize = 100_000;
const SUFFIX: &str = ".npy";

/// Reads the episodes that are wanted into `sink`.
pub(super) fn read(
    path: &Path,
    file: &File,
    options: &Options,
    sink: &mut Sink<'_>,
) -> Result<(), ImportError> {
    let archive = Archive::open(path, file)?;
    let key = options.key.as_deref().map(|key| key.trim_matches('/').trim_end_matches(SUFFIX));
    if let Some(key) = key.filter(|key| key.contains('*')) {
        return archive.episodes(key, sink);
    }
    let name = archive.choose(key)?;
    let (states, length) = archive.array(&name)?.states()?;
    let several = states.shape.len() == 3;
    let mut marks: Vec<(String, Role, Box<dyn Rows>)> = Vec::new();
    for own in archive.names().filter(|own| **own != name) {
        // Names can be paths: what lies beside the states, or above, is about them.
        let (folder, last) = own.rsplit_once('/').unwrap_or(("", own));
        let beside = folder.is_empty() || name.strip_prefix(folder).is_some_and(|rest| rest.starts_with('/'));
        let Some(kind) = role(last).filter(|role| beside && *role != Role::Step) else { continue };
        let array = archive.array(own)?;
        // Trajectories themselves can have the name of their numbers.
        if kind == Role::Episode && !array.is_a_number_a_row() {
            continue;
        }
        marks.push((own.clone(), kind, Box::new(array.marks()?)));
    }
    let next = SUCCESSORS.iter().find(|(own, _)| *own == name).map(|(_, next)| next.to_string());
    let mut successors: Option<(String, Box<dyn Rows>)> = None;
    if let Some(next) = next.filter(|next| archive.names().any(|own| own == next)) {
        successors = Some((next.clone(), Box::new(archive.array(&next)?.states()?.0)));
    }
    let length = (several || marks.is_empty()).then_some(length);
    let place = Place::of(path);
    let silent = marks.is_empty();
    Flat { states: Box::new(states), successors, marks, one_episode: true, length }.read(&place, sink)?;
    if silent && sink.ends_recorded() {
        let all = if several { "" } else { "all rows are one, and " };
        sink.note(format!("no array says how an episode ended (such as `terminals`): {all}no last state is taken as terminal"));
    }
    Ok(())
}

/// An archive's arrays by name.
struct Archive<'a> {
    file: &'a File,
    place: Place,
    members: Vec<Member>,
}

struct Member {
    name: String,
    start: u64,
    stored: u64,
    bytes: u64,
    deflated: bool,
}

impl<'a> Archive<'a> {
    fn open(path: &Path, file: &'a File) -> Result<Self, ImportError> {
        let place = Place::of(path);
        let damaged = |error: &dyn std::fmt::Display| ImportError::Io {
            path: path.into(),
            message: format!("cannot be read as NPZ, it may be cut off or damaged: {error}"),
        };
        let mut archive = ZipArchive::new(BufReader::new(Region::whole(file).map_err(|e| damaged(&e))?))
            .map_err(|e| damaged(&e))?;
        if archive.len() > MAX_MEMBERS {
            return Err(place.refuse("the number of arrays", archive.len(), format!("up to {MAX_MEMBERS}")));
        }
        let mut members = Vec::new();
        for i in 0..archive.len() {
            let member = archive.by_index_raw(i).map_err(|e| damaged(&e))?;
            let name = member.name().map_err(|e| damaged(&e))?.into_owned();
            let Some(name) = name.strip_suffix(SUFFIX) else { continue };
            let deflated = match member.compression() {
                CompressionMethod::Stored => false,
                CompressionMethod::Deflated => true,
                other => {
                    return Err(place.refuse(
                        format!("the compression of {name}"),
                        other,
                        "none, or deflate",
                    ));
                }
            };
            if member.encrypted() {
                return Err(place.refuse(name, "encrypted", "an array that is not"));
            }
            let start = member.data_start().ok_or_else(|| damaged(&format!("no place of {name}")))?;
            let (stored, bytes) = (member.compressed_size(), member.size());
            members.push(Member { name: name.into(), start, stored, bytes, deflated });
        }
        Ok(Self { file, place, members })
    }

    fn names(&self) -> impl Iterator<Item = &String> {
        self.members.iter().map(|member| &member.name)
    }

    /// The array that holds the states.
    fn choose(&self, key: Option<&str>) -> Result<String, ImportError> {
        let candidates: Vec<&String> =
            self.names().filter(|name| role(name).is_none() && !is_no_state(name)).collect();
        let refuse = |value: String| {
            let accepted = match candidates.len() {
                0 => "an archive with an array of states in it".into(),
                _ => format!("one of {}", list(&candidates)),
            };
            self.place.clone().refuse("--key", value, accepted)
        };
        if let Some(key) = key {
            let found = self.names().find(|name| *name == key && !is_no_state(name));
            return found.map(|name| name.to_string()).ok_or_else(|| refuse(format!("`{key}`")));
        }
        let usual = STATES.iter().find(|name| candidates.iter().any(|own| own == *name));
        match (usual, &candidates[..]) {
            (Some(name), _) => Ok(name.to_string()),
            (None, [only]) => Ok(only.to_string()),
            (None, _) => Err(refuse("missing".into())),
        }
    }

    fn array(&self, name: &str) -> Result<Array<Box<dyn Read>>, ImportError> {
        let place = || self.place.clone();
        let member = self.members.iter().find(|member| member.name == name);
        let member = member.ok_or_else(|| place().refuse(name, "missing", "an array of that name"))?;
        let file = self.file.try_clone();
        let file = file.map_err(|error| ImportError::Io {
            path: self.place.path().into(),
            message: error.to_string(),
        })?;
        let end = member.start.saturating_add(member.stored);
        let region = BufReader::with_capacity(1 << 16, Region { file, at: member.start, end });
        let reader: Box<dyn Read> =
            if member.deflated { Box::new(DeflateDecoder::new(region)) } else { Box::new(region) };
        Array::open(reader, member.bytes, &self.place)
    }

    /// Each array that `key` matches is an episode.
    fn episodes(&self, key: &str, sink: &mut Sink<'_>) -> Result<(), ImportError> {
        let names: Vec<String> = self.names().cloned().collect();
        let names =
            super::names::sorted(names.into_iter().filter(|name| super::names::matches(key, name)).collect());
        if names.is_empty() {
            let accepted = list(&self.names().collect::<Vec<_>>());
            return Err(self.place.clone().refuse(
                "--key",
                format!("`{key}`, which matches nothing"),
                accepted,
            ));
        }
        for name in names {
            if sink.satisfied() {
                break;
            }
            if sink.wanted() {
                let (mut states, length) = self.array(&name)?.states()?;
                if states.shape.len() != 2 {
                    let value = format!("{:?}", states.shape);
                    return Err(sink.place().refuse(format!("the shape of {name}"), value, "(T, D)"));
                }
                sink.columns(states.width(), &[])?;
                let mut first = 0;
                while first < length {
                    let count = states.window().min(length - first);
                    let values = states.read(first, count)?;
                    for (i, state) in values.chunks_exact(states.width()).enumerate() {
                        sink.row(first + i as u64, |column| state[column])?;
                    }
                    first += count;
                }
            }
            sink.end(false)?;
        }
        if sink.ends_recorded() {
            sink.note("arrays do not say how an episode ended: no last state is taken as terminal".into());
        }
        Ok(())
    }
}

/// A part of a file with a position of its own.
struct Region {
    file: File,
    at: u64,
    end: u64,
}

impl Region {
    fn whole(file: &File) -> io::Result<Self> {
        Ok(Self { at: 0, end: file.metadata()?.len(), file: file.try_clone()? })
    }
}

impl Read for Region {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let most = usize::try_from(self.end.saturating_sub(self.at)).unwrap_or(usize::MAX).min(buffer.len());
        let count = self.file.read_at(&mut buffer[..most], self.at)?;
        self.at += count as u64;
        Ok(count)
    }
}

impl io::Seek for Region {
    fn seek(&mut self, to: io::SeekFrom) -> io::Result<u64> {
        let at = match to {
            io::SeekFrom::Start(at) => Some(at),
            io::SeekFrom::End(by) => self.end.checked_add_signed(by),
            io::SeekFrom::Current(by) => self.at.checked_add_signed(by),
        };
        self.at =
            at.ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "a place before the beginning"))?;
        Ok(self.at)
    }
}
