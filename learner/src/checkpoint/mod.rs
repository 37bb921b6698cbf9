//! Checkpoints: one consistent cut of a run at a tick, written so that a torn one is never mistaken for a whole one.
//!
//! ```text
//! <run>/last                          -> checkpoints/<newest>; without symbolic links a file with that path
//! <run>/checkpoints/000000001250/     the tick, 12 digits
//!     model.safetensors               online parameters: layers.0.weight [in, out], layers.0.bias [out], ...
//!     target.safetensors              target parameters, likewise
//!     optimizer.safetensors           Adam: m.layers.0.weight, ..., v.layers.0.weight, ..., step [1]
//!     replay.bin                      how many transitions the replay has
//!     replay-<first>-<end>.bin        stored transitions with these numbers, 12 digits each, and their mentor indices
//!     annotations.bin                 a record for each mentor transition
//!     selection.bin                   only with a mentor: what the selection rule remembers
//!     agent.bin                       counters, random streams, running episodes, visits and uses of mentor transitions
//!     actors.bin                      what each actor gave of itself
//!     pending.bin                     only before a run's last tick: the batches of that tick, which are not in the replay
//!     run.bin                         what the loop remembers: evaluations, recorder, and with run.lag = 1 what the actors act with
//!     MANIFEST                        JSON: format, version, tick, history, generation, configuration, size and CRC-32C of each file
//!     COMPLETE                        CRC-32C of MANIFEST; written last
//! ```
//!
//! Taking one costs the run no more than a copy of what is new ([`Saver`]): a thread writes it while training goes on. Stored
//! transitions do not change, so the segments of the replay that were full at the checkpoint before are not written again
//! but linked: successive checkpoints have these files in common, and a file goes with the last checkpoint that has it. The
//! other side of that: damage to a shared segment is damage to all of them.
//!
//! A checkpoint is written into a directory beside its final place. Every file and the directory are synced, the
//! directory is renamed, and only then COMPLETE is written and synced. What a kill leaves behind at any point has
//! no COMPLETE and is passed over, as is one whose files differ from its MANIFEST: [`newest_complete`] names the
//! fault in the log and takes the next older one.
//!
//! A run ends within a tick, and with an evaluation that a longer run would not have played there. So its last checkpoint is for
//! its policy alone, and no run goes on from it. The one before it is taken when all batches of the last tick have come and none
//! has been taken in: a run that is prolonged goes on from there, and does what it would have done if it had been that long from
//! the start. The last checkpoint does not count among those that are kept.
//!
//! A checkpoint says whose it is: its MANIFEST has the identity of the run's history, drawn when the run began anew, and the
//! number of the learner that wrote it. A learner keeps, links and goes on from checkpoints of its own past alone; the tick
//! of a checkpoint says nothing of that. Where a run has gone back behind a checkpoint, because that was damaged, the checkpoint
//! is removed with the first one that is written afterwards.
//!
//! Weight matrices are `[in, out]`, the transpose of PyTorch's `nn.Linear`.

mod best;
mod error;
mod file;
mod manifest;
mod read;
mod saver;
mod tensors;
mod write;

pub use best::{BestEvaluation, best_so_far, load_best, write_best};
pub use error::CheckpointError;
pub use manifest::{FORMAT, FileEntry, Manifest, fingerprint};
pub use read::{
    Loaded, counters, load, load_actors, load_model, load_run, newest_complete, newest_life,
    newest_resumable, newest_version,
};
pub use saver::Saver;
pub use write::{Cut, Taken, Unsynced};

use std::path::{Path, PathBuf};
use trestle_proto::codec::Kind;
use trestle_proto::regular_file;
use trestle_proto::round::Round;
use trestle_proto::run_files::{CHECKPOINTS_DIR, LAST_LINK};

/// Longest path in the file that stands for the link, bytes.
const MAX_PATH: u64 = 4096;
const MANIFEST: &str = "MANIFEST";
const COMPLETE: &str = "COMPLETE";
const MODEL: &str = "model.safetensors";
const TARGET: &str = "target.safetensors";
const OPTIMIZER: &str = "optimizer.safetensors";
const REPLAY: &str = "replay.bin";
const ANNOTATIONS: &str = "annotations.bin";
const AGENT: &str = "agent.bin";
const ACTORS: &str = "actors.bin";
const RUN: &str = "run.bin";
const PENDING: &str = "pending.bin";
const SELECTION: &str = "selection.bin";
/// The files of a checkpoint that [`load_actors`] reads.
pub const FOR_ACTORS: [&str; 3] = [MANIFEST, ACTORS, COMPLETE];
/// The files of every checkpoint beside MANIFEST and COMPLETE; SELECTION, PENDING and the replay's segments come on top.
const FILES: [&str; 8] = [MODEL, TARGET, OPTIMIZER, REPLAY, ANNOTATIONS, AGENT, ACTORS, RUN];
/// Beginning of the name of a directory that is being written or removed.
const SCRATCH: &str = ".scratch-";

const AGENT_KIND: Kind = Kind { magic: *b"TRAGENT\0", version: 7 };
const ACTORS_KIND: Kind = Kind { magic: *b"TRACTORS", version: 1 };
const RUN_KIND: Kind = Kind { magic: *b"TRRUNST\0", version: 1 };
/// First words of `annotations.bin`: magic, and the version of the records' layout.
const ANNOTATIONS_HEAD: [u32; 2] = [u32::from_le_bytes(*b"TRAN"), 1];
/// The same of `selection.bin`, whose contents are the rule's own.
const SELECTION_HEAD: [u8; 8] = *b"TRSE\x01\0\0\0";
/// The same of `pending.bin`, whose parts are those of [`trestle_proto::observe`].
const PENDING_HEAD: [u32; 2] = [u32::from_le_bytes(*b"TRPE"), 1];

/// Where the checkpoint of `tick` is in the run directory `run_dir`.
pub fn directory(run_dir: &Path, tick: Round) -> PathBuf {
    run_dir.join(CHECKPOINTS_DIR).join(name_of(tick))
}

fn name_of(tick: Round) -> String {
    format!("{tick:012}")
}

/// The tick that `last` in `run_dir` names, whether as a link or as a file, and whether its checkpoint is sound or not.
pub fn last(run_dir: &Path) -> Option<Round> {
    let path = run_dir.join(LAST_LINK);
    let target = std::fs::read_link(&path).or_else(|_| {
        let text = regular_file::read_to_string(&path, MAX_PATH).map_err(std::io::Error::other)?;
        Ok::<_, std::io::Error>(PathBuf::from(text.trim_end()))
    });
    target.ok()?.file_name()?.to_str()?.parse().ok()
}

/// Whether `run_dir` holds a checkpoint that was finished, sound or not. One whose COMPLETE is empty, or cut off, was not.
///
/// # Errors
/// The directory cannot be listed.
pub fn any_complete(run_dir: &Path) -> Result<bool, CheckpointError> {
    Ok(!complete(run_dir)?.is_empty())
}

/// The ticks of the checkpoints in `run_dir` that were finished, sound or not, the newest first.
///
/// # Errors
/// The directory cannot be listed.
pub fn complete(run_dir: &Path) -> Result<Vec<Round>, CheckpointError> {
    let mut found = ticks(run_dir)?;
    found.retain(|&tick| manifest::is_sealed(&directory(run_dir, tick)));
    Ok(found)
}

/// The ticks of which there is a directory in `run_dir`, complete or not, the newest first.
fn ticks(run_dir: &Path) -> Result<Vec<Round>, CheckpointError> {
    let dir = run_dir.join(CHECKPOINTS_DIR);
    let entries = match std::fs::read_dir(&dir) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(error::io(&dir, "list"))?,
    };
    let mut ticks = Vec::new();
    for entry in entries {
        let name = entry.map_err(error::io(&dir, "list"))?.file_name();
        let tick = name.to_str().and_then(|name| name.parse().ok());
        // Nothing but what this module would write: no "+12", no missing zeros.
        ticks.extend(tick.filter(|&tick| name.to_str() == Some(&name_of(tick))));
    }
    ticks.sort_unstable_by(|a, b| b.cmp(a));
    Ok(ticks)
}

#[cfg(test)]
mod tests;
