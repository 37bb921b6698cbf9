//! Copying a cut, writing the copy, and removing the checkpoints that are no longer kept.

use super::error::{CheckpointError, contents, io};
use super::manifest::{self, FORMAT, FileEntry, Manifest, fingerprint, history_of};
use super::{
    ACTORS, ACTORS_KIND, AGENT, AGENT_KIND, ANNOTATIONS, ANNOTATIONS_HEAD, COMPLETE, MANIFEST, MODEL,
    OPTIMIZER, PENDING, PENDING_HEAD, REPLAY, RUN, RUN_KIND, SCRATCH, SELECTION, SELECTION_HEAD, TARGET,
};
use super::{directory, file, name_of, read, tensors, ticks};
use serde::Serialize;
use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use trestle_algorithm::agent::Agent;
use trestle_algorithm::replay::Span;
use trestle_proto::codec::{self, Kind, MAX_BODY};
use trestle_proto::experiment::Experiment;
use trestle_proto::observe::Part;
use trestle_proto::own_file;
use trestle_proto::plan::Life;
use trestle_proto::round::Round;
use trestle_proto::run_files::{CHECKPOINTS_DIR, LAST_LINK};

/// When a checkpoint is taken.
#[derive(Clone, Copy, Debug)]
pub enum Taken<'a> {
    /// While the run goes on.
    Amid,
    /// Before the run's last tick, whose batches have come, in order, as parts ([`Part`]).
    BeforeLast(&'a [Part<'a>]),
    /// At the run's end.
    Last,
}

/// All that a checkpoint keeps: one cut through the run, after everything that belongs to its tick.
#[derive(Clone, Copy, Debug)]
pub struct Cut<'a> {
    /// What the run computes.
    pub experiment: &'a Experiment,
    /// The learner that takes it.
    pub life: &'a Life,
    /// The tick.
    pub tick: Round,
    /// The agent after it.
    pub agent: &'a Agent,
    /// What each actor gave of itself.
    pub actors: &'a [Vec<u8>],
    /// What the loop itself has to remember.
    pub run: &'a [u8],
    /// When it is taken.
    pub taken: Taken<'a>,
}

/// A file of the run that must be on the disk before a checkpoint that counts on it is complete.
#[derive(Debug)]
pub struct Unsynced {
    /// Where it is.
    pub path: PathBuf,
    /// It, with nothing left in a buffer of this process.
    pub file: File,
}

/// A complete checkpoint.
#[derive(Clone, Debug)]
pub(super) struct Saved {
    pub(super) dir: PathBuf,
    pub(super) manifest: Manifest,
}

impl Saved {
    /// Whether this very checkpoint is still in its place.
    fn is_there(&self) -> bool {
        manifest::read(&self.dir).is_ok_and(|found| found == self.manifest)
    }

    /// The segments that the checkpoint holds and that can be had from it.
    fn segments(&self) -> Vec<(Span, &FileEntry)> {
        if !self.is_there() {
            return Vec::new();
        }
        let there = |entry: &FileEntry| {
            fs::metadata(self.dir.join(&entry.name)).is_ok_and(|found| found.len() == entry.bytes)
        };
        self.manifest.segments().into_iter().filter(|(_, entry)| there(entry)).collect()
    }
}

/// A cut copied out of the run: all the bytes that are to be written, while the run goes on.
#[derive(Debug)]
pub(super) struct Frozen {
    /// All but the files.
    manifest: Manifest,
    life: Life,
    keep: usize,
    new: Vec<(String, Vec<u8>)>,
    /// Segments that the earlier checkpoint holds already.
    linked: Vec<FileEntry>,
    /// The checkpoint that this learner wrote last, or went on from.
    earlier: Option<Saved>,
    records: Vec<Unsynced>,
}

impl Frozen {
    /// Copies `cut`; what `saved` holds already is not copied.
    pub(super) fn new(
        cut: &Cut<'_>,
        saved: Option<&Saved>,
        records: Vec<Unsynced>,
    ) -> Result<Self, CheckpointError> {
        let (agent, network) = (cut.agent, cut.agent.network());
        let layout = network.layout();
        let params = |name: &str, params: &[f32]| {
            let bytes = tensors::encode_params(layout, params).map_err(contents(Path::new(name)))?;
            Ok::<_, CheckpointError>((name.into(), bytes))
        };
        let agent_fault = |source| CheckpointError::Agent { path: AGENT.into(), source: Box::new(source) };
        let (model, target) = network
            .with_params(|online, target| (params(MODEL, online), params(TARGET, target)))
            .map_err(|e| agent_fault(e.into()))?;
        let adam = tensors::encode_adam(layout, agent.adam()).map_err(contents(Path::new(OPTIMIZER)))?;
        let mut new = vec![model?, target?, (OPTIMIZER.into(), adam)];
        let records_of = agent.annotation_records();
        let annotations =
            [bytemuck::cast_slice(&ANNOTATIONS_HEAD), bytemuck::cast_slice(&records_of)].concat();
        new.push((ANNOTATIONS.into(), annotations));
        if let Some(memory) = agent.selection() {
            new.push((SELECTION.into(), [&SELECTION_HEAD[..], &memory].concat()));
        }
        new.push(frame(AGENT, AGENT_KIND, &agent.state())?);
        new.push(frame(ACTORS, ACTORS_KIND, &cut.actors)?);
        new.push(frame(RUN, RUN_KIND, &cut.run)?);
        if let Taken::BeforeLast(parts) = cut.taken {
            let mut words = PENDING_HEAD.to_vec();
            for part in parts {
                words.extend(part.header());
                words.extend(part.payload);
            }
            new.push((PENDING.into(), bytemuck::cast_slice(&words).to_vec()));
        }
        new.push((REPLAY.into(), agent.replay().head()));
        let there = saved.map(Saved::segments).unwrap_or_default();
        let spans: Vec<Span> = there.iter().map(|(span, _)| *span).collect();
        let mut linked = Vec::new();
        for (span, is_there) in agent.replay().segments(&spans) {
            match there.iter().find(|(other, _)| is_there && *other == span) {
                Some((_, entry)) => linked.push((*entry).clone()),
                None => new.push((span.name(), agent.replay().segment(span))),
            }
        }
        let (experiment, life) = (cut.experiment, *cut.life);
        let manifest = Manifest {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION").into(),
            tick: cut.tick,
            history: history_of(&life),
            generation: life.generation,
            configuration: fingerprint(experiment),
            counters: agent.counters(),
            ended: matches!(cut.taken, Taken::Last),
            files: Vec::new(),
        };
        let keep = experiment.config.checkpoint.keep;
        Ok(Self { manifest, life, keep, new, linked, earlier: saved.cloned(), records })
    }

    /// The tick of the cut.
    pub(super) fn tick(&self) -> Round {
        self.manifest.tick
    }

    /// Bytes of the files that have to be written.
    pub(super) fn new_bytes(&self) -> usize {
        self.new.iter().map(|(_, bytes)| bytes.len()).sum()
    }

    /// Writes the checkpoint into `run_dir` (which exists) as its newest, and removes all but the newest `keep` complete
    /// ones as well as what was left unfinished.
    ///
    /// A sound checkpoint of the tick stays if this learner wrote it or went on from it: then it is the same cut. Any other
    /// is replaced. Checkpoints of a past that the run has left are removed. Only one process, with one thread, may write into a
    /// run directory at a time.
    ///
    /// # Errors
    /// The file system refuses. Older checkpoints are untouched then.
    pub(super) fn write(self, run_dir: &Path) -> Result<Saved, CheckpointError> {
        let root = run_dir.join(CHECKPOINTS_DIR);
        fs::create_dir_all(&root).map_err(io(&root, "create"))?;
        remove_scratch(&root)?;
        for record in &self.records {
            own_file::synced(record.file.sync_data()).map_err(io(&record.path, "write"))?;
        }
        // Their names as well: a checkpoint that counts on a file is of no use without it.
        file::sync_dir(run_dir)?;
        let (tick, keep, life) = (self.tick(), self.keep, self.life);
        let dir = directory(run_dir, tick);
        let same = |found: &Manifest| {
            let own = found.is_by(&life) && found.configuration == self.manifest.configuration;
            found.tick == tick && (own || self.earlier.as_ref().is_some_and(|saved| saved.manifest == *found))
        };
        let manifest = match read::verify(&dir) {
            Ok(found) if same(&found) => found,
            _ => {
                let scratch = root.join(format!("{SCRATCH}{}", name_of(tick)));
                fs::create_dir(&scratch).map_err(io(&scratch, "create"))?;
                let (manifest, seal) = self.write_files(&scratch)?;
                file::sync_dir(&scratch)?;
                remove(&root, &dir)?;
                fs::rename(&scratch, &dir).map_err(io(&dir, "create"))?;
                file::sync_dir(&root)?;
                file::write(&dir, COMPLETE, seal.as_bytes())?;
                file::sync_dir(&dir)?;
                manifest
            }
        };
        link_last(run_dir, tick)?;
        retain(run_dir, &life, keep)?;
        Ok(Saved { dir, manifest })
    }

    /// Writes all files but COMPLETE, whose contents are returned with the MANIFEST.
    fn write_files(self, dir: &Path) -> Result<(Manifest, String), CheckpointError> {
        let mut manifest = self.manifest;
        for (name, bytes) in &self.new {
            manifest.files.push(file::write(dir, name, bytes)?);
        }
        if let Some(earlier) = self.earlier.filter(|_| !self.linked.is_empty()) {
            if !earlier.is_there() {
                let message = "another checkpoint has taken its place while its segments were to be linked";
                return Err(contents(&earlier.dir.join(MANIFEST))(message));
            }
            for entry in self.linked {
                file::link(&earlier.dir, dir, &entry)?;
                manifest.files.push(entry);
            }
        }
        let bytes = manifest.encode().map_err(contents(&dir.join(MANIFEST)))?;
        file::write(dir, MANIFEST, &bytes)?;
        let seal = manifest::seal(&bytes);
        Ok((manifest, seal))
    }
}

/// `value` as a frame, with the name of its file.
fn frame<T: Serialize>(name: &str, kind: Kind, value: &T) -> Result<(String, Vec<u8>), CheckpointError> {
    let path = Path::new(name);
    let bytes = codec::encode(kind, value).map_err(contents(path))?;
    if bytes.len() > MAX_BODY {
        let (path, found) = (path.into(), bytes.len() as u64);
        return Err(CheckpointError::Size { path, found, expected: MAX_BODY as u64 });
    }
    Ok((name.into(), bytes))
}

/// Makes `last` name the checkpoint of `tick`, in one step: a link to it or, where the file system has none, a file with the
/// path in it.
fn link_last(run_dir: &Path, tick: Round) -> Result<(), CheckpointError> {
    let (last, scratch) = (run_dir.join(LAST_LINK), run_dir.join(format!("{SCRATCH}{LAST_LINK}")));
    match fs::remove_file(&scratch) {
        Err(e) if e.kind() != ErrorKind::NotFound => return Err(io(&scratch, "remove")(e)),
        _ => {}
    }
    let target = Path::new(CHECKPOINTS_DIR).join(name_of(tick));
    match std::os::unix::fs::symlink(&target, &scratch) {
        Err(error) if own_file::cannot_link(&error) => {
            let mut line = target.into_os_string().into_encoded_bytes();
            line.push(b'\n');
            file::write(run_dir, &format!("{SCRATCH}{LAST_LINK}"), &line)?;
        }
        linked => linked.map_err(io(&scratch, "create"))?,
    }
    fs::rename(&scratch, &last).map_err(io(&last, "replace"))?;
    file::sync_dir(run_dir)
}

/// Removes all checkpoints but those of the past of `life` that have a COMPLETE: the newest `keep` that a run can go on from, and
/// the run's last one if that is the newest of all.
fn retain(run_dir: &Path, life: &Life, keep: usize) -> Result<(), CheckpointError> {
    let root = run_dir.join(CHECKPOINTS_DIR);
    let (mut kept, mut ended) = (0, false);
    for tick in ticks(run_dir)? {
        let dir = directory(run_dir, tick);
        let stays = match manifest::read(&dir).ok().filter(|found| found.is_known_to(life)) {
            Some(found) if found.ended => kept == 0 && !std::mem::replace(&mut ended, true),
            Some(_) => {
                kept += 1;
                kept <= keep
            }
            None => false,
        };
        if !stays {
            remove(&root, &dir)?;
        }
    }
    Ok(())
}

/// Removes a checkpoint, if it is there: out of the way first, so that a kill leaves no half of it.
fn remove(root: &Path, dir: &Path) -> Result<(), CheckpointError> {
    let name = dir.file_name().unwrap_or_default().to_string_lossy();
    let scratch = root.join(format!("{SCRATCH}old-{name}"));
    match fs::rename(dir, &scratch) {
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(()),
        renamed => renamed.and_then(|()| fs::remove_dir_all(&scratch)).map_err(io(dir, "remove")),
    }
}

/// Removes what a kill in the middle of [`write`] has left.
fn remove_scratch(root: &Path) -> Result<(), CheckpointError> {
    for entry in fs::read_dir(root).map_err(io(root, "list"))? {
        let entry = entry.map_err(io(root, "list"))?;
        if entry.file_name().to_string_lossy().starts_with(SCRATCH) {
            fs::remove_dir_all(entry.path()).map_err(io(&entry.path(), "remove"))?;
        }
    }
    Ok(())
}
