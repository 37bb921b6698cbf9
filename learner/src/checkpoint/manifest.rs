//! MANIFEST and COMPLETE: what a checkpoint consists of, and that it is whole.

use super::error::{CheckpointError, contents};
use super::{COMPLETE, FILES, MANIFEST, PENDING, SELECTION};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::path::Path;
use trestle_algorithm::agent::Counters;
use trestle_algorithm::replay::Span;
use trestle_proto::config::Mode;
use trestle_proto::experiment::Experiment;
use trestle_proto::plan::Life;
use trestle_proto::regular_file;
use trestle_proto::round::Round;

/// Version of the layout of checkpoints: any change raises it.
pub const FORMAT: u32 = 10;
/// The oldest layout whose policy can be read. Runs go on from checkpoints of the present layout alone.
const OLDEST: u32 = 4;
/// A file that formats up to 6 had with `run.lag = 1`.
const FORMER: &str = "behaviour.safetensors";
/// Largest MANIFEST or COMPLETE that is read, bytes.
const MAX_BYTES: u64 = 1 << 16;

/// One file of a checkpoint.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileEntry {
    /// Its name in the checkpoint's directory.
    pub name: String,
    /// Its size, bytes.
    pub bytes: u64,
    /// CRC-32C of its bytes.
    pub crc32c: u32,
}

/// What a checkpoint consists of.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// [`FORMAT`].
    pub format: u32,
    /// Version of the program that wrote it.
    pub version: String,
    /// The tick after which it was taken.
    pub tick: Round,
    /// The history of the run that it belongs to, 16 hexadecimal digits ([`Life::history`]).
    #[serde(default)]
    pub history: String,
    /// Which learner of that history wrote it ([`Life::generation`]).
    #[serde(default)]
    pub generation: u16,
    /// [`fingerprint`] of the run.
    pub configuration: String,
    /// The run's counters at the tick, for people.
    pub counters: Counters,
    /// Whether the run ended with the tick: then the policy is the final one, and a longer run goes on from the checkpoint
    /// before.
    #[serde(alias = "cut_short")]
    pub ended: bool,
    /// The files.
    pub files: Vec<FileEntry>,
}

/// Identifies what a checkpoint may be continued with: SHA-256 of the configuration, the spaces and the length of
/// the demonstration. Left out is what does not change how the agent learns: the limits of the run, evaluations,
/// checkpoints, supervision, an environment's failing on purpose, and whether lockstep has one process or several.
pub fn fingerprint(experiment: &Experiment) -> String {
    let mut config = experiment.config.clone();
    (config.run.episodes, config.run.env_steps) = (None, None);
    if config.run.mode == Mode::Reference {
        config.run.mode = Mode::Lockstep;
    }
    config.run.stop_when_solved = false;
    config.learner.threads = 1;
    let mut config = serde_json::json!(config);
    // Not by their defaults, which change with every key that is added.
    for part in ["/eval", "/checkpoint", "/supervise", "/env/hazard"] {
        config.pointer_mut(part).map(serde_json::Value::take);
    }
    let text = serde_json::json!([config, experiment.spec, experiment.mentor_len()]).to_string();
    Sha256::digest(text).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A history as a MANIFEST has it.
pub(super) fn history_of(life: &Life) -> String {
    format!("{:016x}", life.history)
}

/// The part of a MANIFEST that every version can read.
#[derive(Deserialize)]
pub(super) struct Head {
    format: u32,
    /// Version of the program that wrote it.
    pub(super) version: String,
}

impl Manifest {
    /// Whether the learner of `life` wrote the checkpoint.
    pub(super) fn is_by(&self, life: &Life) -> bool {
        self.history == history_of(life) && self.generation == life.generation
    }

    /// Whether the checkpoint is of the past of `life`'s learner: its own, or of a learner before it and no newer than what this one
    /// went on from. A newer one of an earlier learner is of a past that has been left: the run has gone back behind it.
    pub(super) fn is_known_to(&self, life: &Life) -> bool {
        let before = self.history == history_of(life)
            && self.generation < life.generation
            && life.resume_tick.is_some_and(|from| self.tick <= from);
        before || self.is_by(life)
    }

    /// The entry of file `name`, which [`read`] has made sure is there if it is one of every checkpoint's.
    pub(super) fn entry(&self, name: &str) -> Option<&FileEntry> {
        self.files.iter().find(|entry| entry.name == name)
    }

    /// The replay's segments, in order.
    pub(super) fn segments(&self) -> Vec<(Span, &FileEntry)> {
        let mut segments: Vec<_> =
            self.files.iter().filter_map(|entry| Some((Span::of_name(&entry.name)?, entry))).collect();
        segments.sort_by_key(|(span, _)| *span);
        segments
    }

    /// As the bytes of a file.
    pub(super) fn encode(&self) -> Result<Vec<u8>, serde_json::Error> {
        let mut bytes = serde_json::to_vec_pretty(self)?;
        bytes.push(b'\n');
        Ok(bytes)
    }

    fn check(&self, path: &Path) -> Result<(), CheckpointError> {
        let refuse = |message: String| Err(contents(path)(message));
        for (at, entry) in self.files.iter().enumerate() {
            let name = entry.name.as_str();
            let some = [PENDING, SELECTION, FORMER].contains(&name) || Span::of_name(name).is_some();
            let known = FILES.contains(&name) || some;
            if !known || self.files[..at].iter().any(|other| other.name == entry.name) {
                return refuse(format!("file {:?} is unknown or named twice", entry.name));
            }
        }
        match FILES.iter().find(|name| self.entry(name).is_none()) {
            Some(name) => refuse(format!("file {name} is not named")),
            None => Ok(()),
        }
    }
}

/// What COMPLETE says of the MANIFEST with these bytes.
pub(super) fn seal(manifest: &[u8]) -> String {
    format!("{:08x}\n", crc32c::crc32c(manifest))
}

/// Whether the checkpoint in `dir` has a COMPLETE that was written to its end, even if its text is wrong by now. A kill or a power cut in
/// that moment leaves a part of it, or zeros in the place of one.
pub(super) fn is_sealed(dir: &Path) -> bool {
    match regular_file::read(&dir.join(COMPLETE), MAX_BYTES) {
        Ok(text) => text.len() >= seal(&[]).len() && !text.contains(&0),
        Err(error) => !error.is_not_found(),
    }
}

/// The bytes of the MANIFEST of the checkpoint in `dir`, vouched for by its COMPLETE.
fn sealed(dir: &Path) -> Result<Vec<u8>, CheckpointError> {
    let complete = dir.join(COMPLETE);
    let sealed = match regular_file::read(&complete, MAX_BYTES) {
        Err(error) if error.is_not_found() => return Err(CheckpointError::Incomplete { path: complete }),
        sealed => sealed?,
    };
    let path = dir.join(MANIFEST);
    let bytes = regular_file::read(&path, MAX_BYTES)?;
    let computed = seal(&bytes);
    if computed.as_bytes() != sealed {
        let sealed = sealed.escape_ascii();
        let message = format!("says {sealed} of a MANIFEST that has CRC-32C {}", computed.trim());
        return Err(contents(&complete)(message));
    }
    Ok(bytes)
}

/// The head of the MANIFEST of the checkpoint in `dir`, vouched for by its COMPLETE, in whichever format.
pub(super) fn head(dir: &Path) -> Result<Head, CheckpointError> {
    serde_json::from_slice(&sealed(dir)?).map_err(contents(&dir.join(MANIFEST)))
}

/// The MANIFEST of the checkpoint in `dir`, vouched for by its COMPLETE. The files themselves are not looked at.
pub(super) fn read(dir: &Path) -> Result<Manifest, CheckpointError> {
    let (path, bytes) = (dir.join(MANIFEST), sealed(dir)?);
    // First of all: a newer format may have fields that this one does not know.
    let Head { format, version } = serde_json::from_slice(&bytes).map_err(contents(&path))?;
    if !(OLDEST..=FORMAT).contains(&format) {
        let message = format!("format {format} of version {version}; accepted: {OLDEST} to {FORMAT}");
        return Err(contents(&path)(message));
    }
    let manifest: Manifest = serde_json::from_slice(&bytes).map_err(contents(&path))?;
    manifest.check(&path)?;
    Ok(manifest)
}
