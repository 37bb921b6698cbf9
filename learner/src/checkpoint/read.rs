//! Finding and reading checkpoints.

use super::error::{CheckpointError, contents};
use super::manifest::{self, FORMAT, FileEntry, Manifest, fingerprint, history_of};
use super::{
    ACTORS, ACTORS_KIND, AGENT, AGENT_KIND, ANNOTATIONS, ANNOTATIONS_HEAD, MANIFEST, MODEL, OPTIMIZER,
    PENDING, PENDING_HEAD, REPLAY, RUN, RUN_KIND, SELECTION, SELECTION_HEAD, TARGET,
};
use super::{directory, file, tensors, ticks};
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};
use trestle_algorithm::agent::{Agent, AgentState, Counters, Parts};
use trestle_algorithm::replay::{Bounds, Replay, Span};
use trestle_proto::batch::{Batch, BatchHeader, Checked};
use trestle_proto::codec::{self, Kind};
use trestle_proto::experiment::Experiment;
use trestle_proto::mentor::MentorTransitions;
use trestle_proto::observe::Part;
use trestle_proto::plan::{Life, RunPlan};
use trestle_proto::round::Round;
use trestle_qnet::Layout;

/// A run as it was at a checkpoint.
#[derive(Debug)]
pub struct Loaded {
    /// The tick of the checkpoint.
    pub tick: Round,
    /// The agent.
    pub agent: Agent,
    /// What each actor gave of itself.
    pub actors: Vec<Vec<u8>>,
    /// What the loop had to remember.
    pub run: Vec<u8>,
    /// The batches of the next tick, one of each actor in order, if they have come: then the actors are as they were after them.
    pub pending: Vec<Checked<Batch>>,
}

/// Tick and directory of the newest checkpoint in `run_dir` that is complete and whole: its MANIFEST is vouched for
/// by COMPLETE, and size and checksum of every file are as the MANIFEST says. A newer one that is not is passed
/// over with a warning that names its fault. None if there is no checkpoint.
///
/// # Errors
/// The directory cannot be listed.
pub fn newest_complete(run_dir: &Path) -> Result<Option<(Round, PathBuf)>, CheckpointError> {
    newest(run_dir, |_| true)
}

/// As [`newest_complete`], of the checkpoints that a learner after `plan`'s can go on from: not the last one of a run that has
/// ended, and none of another layout, another configuration or another history, which is passed over with a warning.
pub fn newest_resumable(run_dir: &Path, plan: &RunPlan) -> Result<Option<(Round, PathBuf)>, CheckpointError> {
    let (own, life) = (fingerprint(&plan.experiment), &plan.life);
    let history = history_of(life);
    newest(run_dir, |manifest| {
        let tick = manifest.tick;
        if manifest.configuration != own || manifest.history != history {
            tracing::warn!("the checkpoint of tick {tick} is passed over: it is of another run");
            return false;
        }
        if !manifest.is_known_to(life) {
            tracing::warn!("the checkpoint of tick {tick} is passed over: the run has gone back behind it");
            return false;
        }
        if manifest.format != FORMAT {
            let (format, version) = (manifest.format, &manifest.version);
            tracing::warn!(
                "the checkpoint of tick {tick} is passed over: it is of version {version}, with format {format}; accepted: {FORMAT}"
            );
            return false;
        }
        !manifest.ended
    })
}

/// Version of the program that wrote the newest complete checkpoint in `run_dir`, whatever its format is. None if there is no
/// checkpoint.
///
/// # Errors
/// The directory cannot be listed.
pub fn newest_version(run_dir: &Path) -> Result<Option<String>, CheckpointError> {
    let mut heads = ticks(run_dir)?.into_iter().map(|tick| manifest::head(&directory(run_dir, tick)));
    Ok(heads.find_map(Result::ok).map(|head| head.version))
}

/// The last learner of a run of `experiment`, from the checkpoints in `run_dir` alone: for a directory whose plan is lost. Its
/// history is that of the newest checkpoint of the configuration, its generation the highest in that history, and that checkpoint
/// counts as what it went on from. None if there is no checkpoint of the configuration.
///
/// # Errors
/// The directory cannot be listed.
pub fn newest_life(run_dir: &Path, experiment: &Experiment) -> Result<Option<Life>, CheckpointError> {
    let own = fingerprint(experiment);
    let mut last: Option<(String, Life)> = None;
    for tick in ticks(run_dir)? {
        let Ok(manifest) = manifest::read(&directory(run_dir, tick)) else { continue };
        match &mut last {
            Some((history, life)) if *history == manifest.history => {
                life.generation = life.generation.max(manifest.generation);
            }
            Some(_) => {}
            None if manifest.configuration == own => {
                let Ok(history) = u64::from_str_radix(&manifest.history, 16) else { continue };
                let (generation, resume_tick) = (manifest.generation, Some(tick));
                last = Some((manifest.history, Life { history, generation, resume_tick, ..Life::default() }));
            }
            None => {}
        }
    }
    Ok(last.map(|(_, life)| life))
}

fn newest(
    run_dir: &Path,
    wanted: impl Fn(&Manifest) -> bool,
) -> Result<Option<(Round, PathBuf)>, CheckpointError> {
    for tick in ticks(run_dir)? {
        let dir = directory(run_dir, tick);
        match verify(&dir) {
            Ok(manifest) if manifest.tick == tick && wanted(&manifest) => return Ok(Some((tick, dir))),
            Ok(manifest) if manifest.tick == tick => {}
            Ok(manifest) => {
                tracing::warn!(
                    "checkpoint {} is passed over: it is of tick {}",
                    dir.display(),
                    manifest.tick
                );
            }
            Err(fault) => tracing::warn!("checkpoint {} is passed over: {fault}", dir.display()),
        }
    }
    Ok(None)
}

/// The MANIFEST of the checkpoint in `dir`, if all is whole.
pub(super) fn verify(dir: &Path) -> Result<Manifest, CheckpointError> {
    let manifest = manifest::read(dir)?;
    manifest.files.iter().try_for_each(|entry| file::verify(dir, entry))?;
    Ok(manifest)
}

/// Continues from the checkpoint in `dir`: the agent that goes on from there learns bit for bit as the one that was
/// saved. `experiment` may differ from the saved run's in what [`fingerprint`] leaves out; `mentor` is as in
/// [`Agent::new`].
///
/// # Errors
/// A checkpoint that is incomplete, damaged, of another configuration, or of another demonstration.
pub fn load(
    dir: &Path,
    experiment: &Experiment,
    mentor: Option<MentorTransitions>,
) -> Result<Loaded, CheckpointError> {
    let manifest = manifest::read(dir)?;
    let expected = fingerprint(experiment);
    if manifest.configuration != expected {
        let (path, found) = (dir.join(MANIFEST), manifest.configuration);
        return Err(CheckpointError::Configuration { path, found, expected });
    }
    if manifest.version != env!("CARGO_PKG_VERSION") {
        let (theirs, ours) = (&manifest.version, env!("CARGO_PKG_VERSION"));
        tracing::warn!("checkpoint {} was written by version {theirs}; this is {ours}", dir.display());
    }
    let agent_fault = |source| CheckpointError::Agent { path: dir.into(), source: Box::new(source) };
    let mut agent = Agent::new(experiment, mentor).map_err(agent_fault)?;
    let bounds = Bounds {
        n_actions: experiment.spec.n_actions(),
        mentor_len: experiment.mentor_len(),
        actors: experiment.config.run.actors,
    };
    replay(dir, &manifest, agent.replay_mut(), &bounds)?;
    let layout = agent.network().layout();
    let optimizer = file::read_all(dir, entry(dir, &manifest, OPTIMIZER)?)?;
    let parts = Parts {
        state: frame::<AgentState>(dir, &manifest, AGENT, AGENT_KIND)?,
        online: params(dir, &manifest, MODEL, layout)?,
        target: params(dir, &manifest, TARGET, layout)?,
        adam: tensors::decode_adam(layout, &optimizer).map_err(contents(&dir.join(OPTIMIZER)))?,
        annotations: annotations(dir, &manifest)?,
        selection: selection(dir, &manifest)?,
    };
    agent.restore(&parts).map_err(agent_fault)?;
    Ok(Loaded {
        tick: manifest.tick,
        agent,
        actors: frame(dir, &manifest, ACTORS, ACTORS_KIND)?,
        run: frame(dir, &manifest, RUN, RUN_KIND)?,
        pending: match manifest.entry(PENDING) {
            Some(entry) => pending(dir, entry, experiment)?,
            None => Vec::new(),
        },
    })
}

/// Reads the replay, head and segments, into `replay`, which is of the same sizes.
fn replay(
    dir: &Path,
    manifest: &Manifest,
    replay: &mut Replay,
    bounds: &Bounds,
) -> Result<(), CheckpointError> {
    let fault = contents(&dir.join(REPLAY));
    file::read(dir, entry(dir, manifest, REPLAY)?, |file| replay.read_head(file).map_err(&fault))?;
    let segments = manifest.segments();
    let spans: Vec<Span> = segments.iter().map(|(span, _)| *span).collect();
    replay.check_segments(&spans).map_err(&fault)?;
    for (span, entry) in segments {
        file::read(dir, entry, |file| {
            replay.read_segment(span, file).map_err(contents(&dir.join(&entry.name)))
        })?;
    }
    replay.check(bounds).map_err(&fault)
}

/// The online parameters of the checkpoint in `dir` alone, of a network of `layout`.
///
/// # Errors
/// As [`load`], as far as that file is concerned.
pub fn load_model(dir: &Path, layout: &Layout) -> Result<Vec<f32>, CheckpointError> {
    params(dir, &manifest::read(dir)?, MODEL, layout)
}

/// What the run had counted when the checkpoint in `dir` was taken.
///
/// # Errors
/// As [`load`], as far as the MANIFEST is concerned.
pub fn counters(dir: &Path) -> Result<Counters, CheckpointError> {
    Ok(manifest::read(dir)?.counters)
}

/// What the run's loop gave of itself to the checkpoint in `dir`.
///
/// # Errors
/// As [`load`], as far as that file is concerned.
pub fn load_run(dir: &Path) -> Result<Vec<u8>, CheckpointError> {
    frame(dir, &manifest::read(dir)?, RUN, RUN_KIND)
}

/// What each actor gave of itself to the checkpoint in `dir`, in the order of the actors.
///
/// # Errors
/// As [`load`], as far as that file is concerned.
pub fn load_actors(dir: &Path) -> Result<Vec<Vec<u8>>, CheckpointError> {
    frame(dir, &manifest::read(dir)?, ACTORS, ACTORS_KIND)
}

fn entry<'a>(dir: &Path, manifest: &'a Manifest, name: &str) -> Result<&'a FileEntry, CheckpointError> {
    manifest.entry(name).ok_or_else(|| contents(&dir.join(MANIFEST))(format!("file {name} is not named")))
}

fn params(dir: &Path, manifest: &Manifest, name: &str, layout: &Layout) -> Result<Vec<f32>, CheckpointError> {
    let bytes = file::read_all(dir, entry(dir, manifest, name)?)?;
    tensors::decode_params(layout, &bytes).map_err(contents(&dir.join(name)))
}

fn frame<T: DeserializeOwned>(
    dir: &Path,
    manifest: &Manifest,
    name: &str,
    kind: Kind,
) -> Result<T, CheckpointError> {
    let bytes = file::read_all(dir, entry(dir, manifest, name)?)?;
    codec::decode(kind, &bytes).map_err(contents(&dir.join(name)))
}

fn annotations(dir: &Path, manifest: &Manifest) -> Result<Vec<u32>, CheckpointError> {
    words(dir, entry(dir, manifest, ANNOTATIONS)?, ANNOTATIONS_HEAD)
}

/// What the selection rule remembers; nothing where no file is named.
fn selection(dir: &Path, manifest: &Manifest) -> Result<Vec<u8>, CheckpointError> {
    let Some(entry) = manifest.entry(SELECTION) else { return Ok(Vec::new()) };
    let bytes = file::read_all(dir, entry)?;
    let memory = bytes.strip_prefix(&SELECTION_HEAD).map(<[u8]>::to_vec);
    memory.ok_or_else(|| contents(&dir.join(SELECTION))("another kind of file, or another version of it"))
}

/// The batches of a tick of a run of `experiment`.
fn pending(
    dir: &Path,
    entry: &FileEntry,
    experiment: &Experiment,
) -> Result<Vec<Checked<Batch>>, CheckpointError> {
    let path = dir.join(&entry.name);
    let refuse = |message: &str| contents(&path)(message);
    let words = words(dir, entry, PENDING_HEAD)?;
    let (row, run) = (experiment.spec.row(), &experiment.config.run);
    let (mut rest, mut batches) = (&words[..], Vec::new());
    for actor in 0..run.actors {
        let part = Part::take(&mut rest, row)
            .filter(|part| part.actor == actor && part.count == run.rollout)
            .ok_or_else(|| refuse("not a batch of each actor"))?;
        let (count, obs_dim, element) = (part.count, row.dim as u32, row.element.code());
        let header = BatchHeader { actor, count, obs_dim, element, ..BatchHeader::default() };
        let mut batch = Checked::<Batch>::default();
        batch.receive(header, part.payload, &experiment.spaces()).map_err(contents(&path))?;
        batches.push(batch);
    }
    if rest.is_empty() { Ok(batches) } else { Err(refuse("more than a batch of each actor")) }
}

/// The words of a file that begins with `head`.
fn words(dir: &Path, entry: &FileEntry, head: [u32; 2]) -> Result<Vec<u32>, CheckpointError> {
    let bytes = file::read_all(dir, entry)?;
    let refuse = contents(&dir.join(&entry.name));
    let head: &[u8] = bytemuck::cast_slice(&head);
    match bytes.strip_prefix(head).map(|records| records.as_chunks::<4>()) {
        Some((words, [])) => Ok(words.iter().map(|word| u32::from_le_bytes(*word)).collect()),
        Some(_) => Err(refuse("not a whole number of words")),
        None => Err(refuse("another kind of file, or another version of it")),
    }
}
