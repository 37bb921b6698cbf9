//! Writing a checkpoint, and removing those that are no longer kept.

use super::error::{CheckpointError, contents, io};
use super::manifest::{self, FORMAT, FileEntry, Manifest, fingerprint};
use super::{
    ACTORS, AGENT, ANNOTATIONS, BEHAVIOUR, CHECKPOINTS_DIR, COMPLETE, LAST_LINK, MANIFEST, MODEL, OPTIMIZER,
    REPLAY, RUN, SCRATCH, TARGET,
};
use super::{directory, file, name_of, read, tensors, ticks};
use crate::agent::Agent;
use serde::Serialize;
use std::fs;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use trestle_proto::codec::{self, Kind, MAX_BODY};
use trestle_proto::plan::RunPlan;

pub(super) const AGENT_KIND: Kind = Kind { magic: *b"TRAGENT\0", version: 1 };
pub(super) const ACTORS_KIND: Kind = Kind { magic: *b"TRACTORS", version: 1 };
pub(super) const RUN_KIND: Kind = Kind { magic: *b"TRRUNST\0", version: 1 };
/// First words of `annotations.bin`: magic, and the version of the records' layout.
pub(super) const ANNOTATIONS_HEAD: [u32; 2] = [u32::from_le_bytes(*b"TRAN"), 1];

/// All that a checkpoint keeps: one cut through the run, after everything that belongs to its tick.
#[derive(Clone, Copy, Debug)]
pub struct Cut<'a> {
    /// The run's plan.
    pub plan: &'a RunPlan,
    /// The tick.
    pub tick: u64,
    /// The agent after it.
    pub agent: &'a Agent,
    /// The parameters that actors will act with in the next tick, where they are not the agent's newest.
    pub behaviour: Option<&'a [f32]>,
    /// What each actor gave of itself.
    pub actors: &'a [Vec<u8>],
    /// What the loop itself has to remember.
    pub run: &'a [u8],
}

/// Writes `cut` into `run_dir` (which exists) as its newest checkpoint, and removes all but the newest
/// `plan.config.checkpoint.keep` complete ones as well as what was left unfinished. Returns its directory.
///
/// If there is a sound checkpoint of the tick already, it is the same cut (runs are deterministic) and stays.
/// Only one process may write into a run directory at a time.
///
/// # Errors
/// The file system refuses, or a part is too large to be read back. Older checkpoints are untouched then.
pub fn write(run_dir: &Path, cut: &Cut<'_>) -> Result<PathBuf, CheckpointError> {
    let root = run_dir.join(CHECKPOINTS_DIR);
    fs::create_dir_all(&root).map_err(io(&root, "create"))?;
    remove_scratch(&root)?;
    let dir = directory(run_dir, cut.tick);
    let same = |found: &Manifest| found.tick == cut.tick && found.configuration == fingerprint(cut.plan);
    if !read::verify(&dir).is_ok_and(|found| same(&found)) {
        remove(&root, &dir)?;
        let scratch = root.join(format!("{SCRATCH}{}", name_of(cut.tick)));
        fs::create_dir(&scratch).map_err(io(&scratch, "create"))?;
        let seal = write_files(&scratch, cut)?;
        file::sync_dir(&scratch)?;
        fs::rename(&scratch, &dir).map_err(io(&dir, "create"))?;
        file::sync_dir(&root)?;
        file::write(&dir, COMPLETE, |file| file.write_all(seal.as_bytes()))?;
        file::sync_dir(&dir)?;
    }
    link_last(run_dir, cut.tick)?;
    retain(run_dir, cut.tick, cut.plan.config.checkpoint.keep)?;
    Ok(dir)
}

/// Writes all files but COMPLETE, whose contents are returned.
fn write_files(dir: &Path, cut: &Cut<'_>) -> Result<String, CheckpointError> {
    let (agent, network) = (cut.agent, cut.agent.network());
    let layout = network.layout();
    let bytes = |name: &str, bytes: &[u8]| file::write(dir, name, |file| file.write_all(bytes));
    let params = |name: &str, params: &[f32]| {
        let encoded = tensors::encode_params(layout, params).map_err(contents(&dir.join(name)))?;
        bytes(name, &encoded)
    };
    let agent_fault = |source| CheckpointError::Agent { path: dir.into(), source: Box::new(source) };
    let (model, target) = network
        .with_params(|online, target| (params(MODEL, online), params(TARGET, target)))
        .map_err(|e| agent_fault(e.into()))?;
    let mut files = vec![model?, target?];
    let adam = tensors::encode_adam(layout, agent.adam()).map_err(contents(&dir.join(OPTIMIZER)))?;
    files.push(bytes(OPTIMIZER, &adam)?);
    if let Some(behaviour) = cut.behaviour {
        files.push(params(BEHAVIOUR, behaviour)?);
    }
    files.push(file::write(dir, REPLAY, |file| agent.replay().write(file))?);
    let records = agent.annotation_records();
    files.push(file::write(dir, ANNOTATIONS, |file| {
        file.write_all(bytemuck::cast_slice(&ANNOTATIONS_HEAD))?;
        file.write_all(bytemuck::cast_slice(&records))
    })?);
    files.push(frame(dir, AGENT, AGENT_KIND, &agent.state())?);
    files.push(frame(dir, ACTORS, ACTORS_KIND, &cut.actors)?);
    files.push(frame(dir, RUN, RUN_KIND, &cut.run)?);
    let manifest = Manifest {
        format: FORMAT,
        version: env!("CARGO_PKG_VERSION").into(),
        tick: cut.tick,
        configuration: fingerprint(cut.plan),
        counters: agent.counters(),
        cut_short: agent.cut_short(),
        files,
    };
    let manifest = manifest.encode().map_err(contents(&dir.join(MANIFEST)))?;
    bytes(MANIFEST, &manifest)?;
    Ok(manifest::seal(&manifest))
}

/// Writes `value` as a frame.
fn frame<T: Serialize>(dir: &Path, name: &str, kind: Kind, value: &T) -> Result<FileEntry, CheckpointError> {
    let path = dir.join(name);
    let bytes = codec::encode(kind, value).map_err(contents(&path))?;
    if bytes.len() > MAX_BODY {
        return Err(CheckpointError::Size { path, found: bytes.len() as u64, expected: MAX_BODY as u64 });
    }
    file::write(dir, name, |file| file.write_all(&bytes))
}

/// Makes `last` point at the checkpoint of `tick`, in one step.
fn link_last(run_dir: &Path, tick: u64) -> Result<(), CheckpointError> {
    let (last, scratch) = (run_dir.join(LAST_LINK), run_dir.join(format!("{SCRATCH}{LAST_LINK}")));
    match fs::remove_file(&scratch) {
        Err(e) if e.kind() != ErrorKind::NotFound => return Err(io(&scratch, "remove")(e)),
        _ => {}
    }
    std::os::unix::fs::symlink(Path::new(CHECKPOINTS_DIR).join(name_of(tick)), &scratch)
        .map_err(io(&scratch, "create"))?;
    fs::rename(&scratch, &last).map_err(io(&last, "replace"))?;
    file::sync_dir(run_dir)
}

/// Removes all checkpoints up to `tick` but the newest `keep` that have a COMPLETE.
fn retain(run_dir: &Path, tick: u64, keep: usize) -> Result<(), CheckpointError> {
    let root = run_dir.join(CHECKPOINTS_DIR);
    let mut kept = 0;
    for tick in ticks(run_dir)?.into_iter().filter(|&other| other <= tick) {
        let dir = directory(run_dir, tick);
        if kept < keep && dir.join(COMPLETE).exists() {
            kept += 1;
        } else {
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
