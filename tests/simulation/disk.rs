//! A disk that loses power: what has been synced is there afterwards, and of everything else whatever the seed decides.
//!
//! The files themselves are real ones. Beside them the model keeps, for each directory, the entries that are safe, all
//! changes since in order, and for each file the contents that are safe.
//!
//! - *Syncing a file* makes its contents safe, and not its name.
//! - *Syncing a directory* makes all changes of its entries safe, those of renamings to and from it included.
//! - *A power cut* keeps either the first n of the other changes, as a journal does, or each by a throw of the coin. A renaming
//!   is kept as a whole or not at all. Contents that are not safe are the old ones, the new ones, the beginning of the new
//!   ones, or new ones with zeros at the end.

use super::world::{State, aside};
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::fs;
use std::io::{self, ErrorKind};
use std::os::unix::fs::{MetadataExt, symlink};
use std::path::{Path, PathBuf};
use trestle_proto::rng::mix;

/// What a call has changed.
#[derive(Clone, Copy, Debug)]
pub(super) enum Change<'a> {
    /// There is a file, a link or a directory at the path, new or not.
    Made {
        path: &'a Path,
    },
    /// The entry is gone.
    Removed {
        path: &'a Path,
    },
    Renamed {
        from: &'a Path,
        to: &'a Path,
    },
    Written {
        path: &'a Path,
        fd: i32,
    },
    Synced {
        path: &'a Path,
        fd: i32,
    },
    /// Nothing that the disk would lose.
    Other,
}

type Ino = u64;
type Entry = (Ino, OsString);

#[derive(Clone, Debug)]
enum Op {
    Add(Entry, Ino),
    Drop(Entry),
    Move(Entry, Entry, Ino),
}

#[derive(Clone, Debug)]
enum Kind {
    Dir,
    File,
    Link(PathBuf),
}

/// The disk below one directory.
#[derive(Debug, Default)]
pub(super) struct Disk {
    root: PathBuf,
    /// Whether there may be a power cut: otherwise nothing is kept.
    modelled: bool,
    kinds: BTreeMap<Ino, Kind>,
    /// The entries as they are, and as they are safe.
    present: BTreeMap<Entry, Ino>,
    safe: BTreeMap<Entry, Ino>,
    pending: Vec<Op>,
    /// Safe contents; a file that was never synced has none.
    contents: BTreeMap<Ino, Vec<u8>>,
    dirty: BTreeSet<Ino>,
    /// The last contents of files that have no name any more, but might have one again.
    gone: BTreeMap<Ino, Vec<u8>>,
}

impl Disk {
    pub(super) fn new(root: &Path, modelled: bool) -> io::Result<Self> {
        let mut disk = Self { root: root.into(), modelled, ..Self::default() };
        disk.begin()?;
        Ok(disk)
    }

    /// Takes all that is there for safe.
    fn begin(&mut self) -> io::Result<()> {
        *self = Self { root: self.root.clone(), modelled: self.modelled, ..Self::default() };
        if self.modelled {
            let root = self.root.clone();
            self.take_in(&root)?;
            self.safe = self.present.clone();
        }
        Ok(())
    }

    fn take_in(&mut self, dir: &Path) -> io::Result<()> {
        let ino = fs::metadata(dir)?.ino();
        self.kinds.insert(ino, Kind::Dir);
        for entry in fs::read_dir(dir)? {
            let entry = entry?;
            let (path, kind) = (entry.path(), entry.file_type()?);
            let child = entry.metadata()?.ino();
            self.present.insert((ino, entry.file_name()), child);
            if kind.is_dir() {
                self.take_in(&path)?;
            } else if kind.is_symlink() {
                self.kinds.insert(child, Kind::Link(fs::read_link(&path)?));
            } else {
                self.kinds.insert(child, Kind::File);
                self.contents.insert(child, fs::read(&path)?);
            }
        }
        Ok(())
    }

    fn entry(&self, path: &Path) -> Option<Entry> {
        let inside = self.modelled && path.starts_with(&self.root);
        let (parent, name) = (path.parent().filter(|_| inside)?, path.file_name()?);
        Some((inode(parent)?, name.to_os_string()))
    }

    /// Looks at what a call is about to take away.
    pub(super) fn before(&mut self, change: &Change<'_>) {
        let path = match change {
            Change::Removed { path } => path,
            Change::Renamed { to, .. } => to,
            _ => return,
        };
        let Some(ino) = self.entry(path).and_then(|entry| self.present.get(&entry).copied()) else { return };
        if matches!(self.kinds.get(&ino), Some(Kind::File))
            && let Some(bytes) = read(path)
        {
            self.gone.insert(ino, bytes);
        }
    }

    pub(super) fn changed(&mut self, change: &Change<'_>) {
        match *change {
            Change::Made { path } => {
                let Some(entry) = self.entry(path) else { return };
                let Some((ino, kind)) = kind(path) else { return };
                if self.present.get(&entry) != Some(&ino) {
                    self.kinds.entry(ino).or_insert(kind);
                    self.present.insert(entry.clone(), ino);
                    self.pending.push(Op::Add(entry, ino));
                }
            }
            Change::Removed { path } => {
                let Some(entry) = self.entry(path) else { return };
                self.present.remove(&entry);
                self.pending.push(Op::Drop(entry));
            }
            Change::Renamed { from, to } => {
                let (Some(from), Some(to)) = (self.entry(from), self.entry(to)) else { return };
                let Some(ino) = self.present.remove(&from) else { return };
                self.present.insert(to.clone(), ino);
                self.pending.push(Op::Move(from, to, ino));
            }
            Change::Written { path, fd } => {
                if self.modelled && path.starts_with(&self.root) {
                    self.dirty.extend(inode_of(fd));
                }
            }
            Change::Synced { path, fd } => {
                if !self.modelled || !path.starts_with(&self.root) {
                    return;
                }
                let Some(ino) = inode_of(fd) else { return };
                if matches!(self.kinds.get(&ino), Some(Kind::Dir)) {
                    self.sync_entries(ino);
                } else if let Some(bytes) = read(&open_file(fd)) {
                    self.contents.insert(ino, bytes);
                    self.dirty.remove(&ino);
                }
            }
            Change::Other => {}
        }
    }

    fn sync_entries(&mut self, dir: Ino) {
        let touches = |op: &Op| match op {
            Op::Add((at, _), _) | Op::Drop((at, _)) => *at == dir,
            Op::Move((from, _), (to, _), _) => *from == dir || *to == dir,
        };
        for op in self.pending.extract_if(.., |op| touches(op)).collect::<Vec<_>>() {
            apply(&mut self.safe, &op);
        }
    }

    /// The power fails. `word` decides what is left.
    pub(super) fn cut(&mut self, word: u64) -> io::Result<()> {
        aside(|| self.lose(word))
    }

    fn lose(&mut self, word: u64) -> io::Result<()> {
        let mut word = word;
        let mut random = |below: u64| {
            word = mix(word.wrapping_add(0x9e37_79b9_7f4a_7c15));
            word % below.max(1)
        };
        let mut left = self.safe.clone();
        let pending = std::mem::take(&mut self.pending);
        if random(2) == 0 {
            let kept = random(pending.len() as u64 + 1) as usize;
            pending[..kept].iter().for_each(|op| apply(&mut left, op));
        } else {
            for op in &pending {
                if random(2) == 0 {
                    apply(&mut left, op);
                }
            }
        }
        // What is there now, for the contents that are not safe.
        let mut newest = std::mem::take(&mut self.gone);
        let mut open = vec![self.root.clone()];
        while let Some(dir) = open.pop() {
            for entry in fs::read_dir(&dir)? {
                let entry = entry?;
                if entry.file_type()?.is_dir() {
                    open.push(entry.path());
                } else if entry.file_type()?.is_file() {
                    newest.insert(entry.metadata()?.ino(), fs::read(entry.path())?);
                }
            }
        }
        let mut contents = BTreeMap::new();
        for (ino, kind) in &self.kinds {
            if !matches!(kind, Kind::File) {
                continue;
            }
            let old = self.contents.get(ino);
            let bytes = match newest.get(ino) {
                Some(new) if old.is_none() || self.dirty.contains(ino) => {
                    // What was safe and has not changed stays.
                    let same =
                        old.map_or(0, |old| old.iter().zip(new).take_while(|(old, new)| old == new).count());
                    let from = same + random((new.len() - same) as u64 + 1) as usize;
                    match random(4) {
                        0 => old.cloned().unwrap_or_default(),
                        1 => new.clone(),
                        2 => new[..from].to_vec(),
                        _ => [&new[..from], &vec![0; new.len() - from]].concat(),
                    }
                }
                _ => old.cloned().unwrap_or_default(),
            };
            contents.insert(*ino, bytes);
        }
        let root = fs::metadata(&self.root)?.ino();
        let after = self.root.with_extension("after");
        fs::create_dir(&after)?;
        self.lay_out(&left, &contents, root, &after, &mut BTreeMap::new(), 0)?;
        fs::remove_dir_all(&self.root)?;
        fs::rename(&after, &self.root)?;
        let shm = self.root.with_file_name("shm");
        fs::remove_dir_all(&shm)?;
        fs::create_dir(&shm)?;
        self.begin()
    }

    /// Makes the directory `dir` as it is left at `path`.
    fn lay_out(
        &self,
        left: &BTreeMap<Entry, Ino>,
        contents: &BTreeMap<Ino, Vec<u8>>,
        dir: Ino,
        path: &Path,
        known: &mut BTreeMap<Ino, PathBuf>,
        depth: usize,
    ) -> io::Result<()> {
        if depth > 16 {
            return Err(io::Error::new(ErrorKind::InvalidData, "a directory within itself"));
        }
        for ((_, name), ino) in left.range((dir, OsString::new())..).take_while(|((of, _), _)| *of == dir) {
            let at = path.join(name);
            match self.kinds.get(ino) {
                Some(Kind::Dir) => {
                    fs::create_dir(&at)?;
                    self.lay_out(left, contents, *ino, &at, known, depth + 1)?;
                }
                Some(Kind::Link(to)) => symlink(to, &at)?,
                Some(Kind::File) => match known.get(ino) {
                    Some(other) => fs::hard_link(other, &at)?,
                    None => {
                        fs::write(&at, contents.get(ino).map_or(&[][..], Vec::as_slice))?;
                        known.insert(*ino, at);
                    }
                },
                None => {}
            }
        }
        Ok(())
    }
}

/// Makes `op` safe, as far as what it is about is there.
fn apply(safe: &mut BTreeMap<Entry, Ino>, op: &Op) {
    match op {
        Op::Add(entry, ino) => {
            safe.insert(entry.clone(), *ino);
        }
        Op::Drop(entry) => {
            safe.remove(entry);
        }
        Op::Move(from, to, ino) => {
            if safe.get(from) == Some(ino) {
                safe.remove(from);
            }
            safe.insert(to.clone(), *ino);
        }
    }
}

impl State {
    /// `process` has changed something.
    pub(super) fn has_changed(&mut self, process: usize, change: &Change<'_>) {
        self.disk.changed(change);
        let path = match *change {
            Change::Made { path } | Change::Removed { path } | Change::Written { path, .. } => path,
            Change::Renamed { to, .. } => to,
            Change::Synced { .. } | Change::Other => return,
        };
        let Ok(within) = path.strip_prefix(&self.disk.root) else { return };
        let within = within.to_path_buf();
        self.note_writer(process, &within);
        if let Change::Renamed { from, .. } = *change
            && let Ok(from) = from.strip_prefix(&self.disk.root)
        {
            let from = from.to_path_buf();
            self.note_leaver(process, &from);
        }
    }
}

/// The number of what is at `path`, links followed.
fn inode(path: &Path) -> Option<Ino> {
    aside(|| fs::metadata(path)).ok().map(|meta| meta.ino())
}

/// The number of the open file `fd`.
fn inode_of(fd: i32) -> Option<Ino> {
    inode(&open_file(fd))
}

fn open_file(fd: i32) -> PathBuf {
    format!("/proc/self/fd/{fd}").into()
}

fn read(path: &Path) -> Option<Vec<u8>> {
    aside(|| fs::read(path)).ok()
}

fn kind(path: &Path) -> Option<(Ino, Kind)> {
    aside(|| {
        let meta = fs::symlink_metadata(path).ok()?;
        let kind = match meta.file_type() {
            kind if kind.is_dir() => Kind::Dir,
            kind if kind.is_symlink() => Kind::Link(fs::read_link(path).ok()?),
            _ => Kind::File,
        };
        Some((meta.ino(), kind))
    })
}
