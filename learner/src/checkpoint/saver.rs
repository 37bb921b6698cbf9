//! Checkpoints beside the training: what changes is copied, and a thread writes the copy while the run goes on.

use super::error::{CheckpointError, io};
use super::write::{Cut, Frozen, Saved, Unsynced};
use super::{directory, manifest};
use std::path::{Path, PathBuf};
use std::thread::{self, JoinHandle};
use std::time::Instant;
use trestle_proto::round::Round;
use trestle_proto::run_files::CHECKPOINTS_DIR;

/// Takes the checkpoints of one run, one at a time.
#[derive(Debug)]
pub struct Saver {
    run_dir: PathBuf,
    /// The newest checkpoint that is known to be complete: its replay's segments need not be written again.
    saved: Option<Saved>,
    writing: Option<JoinHandle<Result<Saved, CheckpointError>>>,
}

impl Saver {
    /// For a run in `run_dir`, from its beginning.
    pub fn new(run_dir: &Path) -> Self {
        Self { run_dir: run_dir.into(), saved: None, writing: None }
    }

    /// For a run in `run_dir` that goes on from the checkpoint of `tick`.
    ///
    /// # Errors
    /// The checkpoint is not complete.
    pub fn after(run_dir: &Path, tick: Round) -> Result<Self, CheckpointError> {
        let dir = directory(run_dir, tick);
        let manifest = manifest::read(&dir)?;
        Ok(Self { run_dir: run_dir.into(), saved: Some(Saved { dir, manifest }), writing: None })
    }

    /// Takes `cut` as the run's newest checkpoint: returns when it has been copied. `records` are on the disk before the
    /// checkpoint is complete. Waits for the one before, if that is still being written.
    ///
    /// # Errors
    /// The one before could not be written, or this one cannot be encoded.
    pub fn save(&mut self, cut: &Cut<'_>, records: Vec<Unsynced>) -> Result<(), CheckpointError> {
        self.wait()?;
        let frozen = Frozen::new(cut, self.saved.as_ref(), records)?;
        let run_dir = self.run_dir.clone();
        let write = move || {
            let (start, tick, bytes) = (Instant::now(), frozen.tick(), frozen.new_bytes());
            let saved = frozen.write(&run_dir)?;
            let (path, write_ms) = (saved.dir.display(), start.elapsed().as_millis() as u64);
            tracing::info!(%tick, path = %path, bytes, write_ms, "checkpoint is complete");
            Ok(saved)
        };
        let thread = thread::Builder::new().name("checkpoint".into()).spawn(write);
        self.writing = Some(thread.map_err(io(&self.run_dir.join(CHECKPOINTS_DIR), "write"))?);
        Ok(())
    }

    /// Looks whether the checkpoint that is being written has come to an end, and whether it was a good one.
    ///
    /// # Errors
    /// It could not be written.
    pub fn poll(&mut self) -> Result<(), CheckpointError> {
        if self.writing.as_ref().is_some_and(JoinHandle::is_finished) { self.wait() } else { Ok(()) }
    }

    /// Waits until the newest checkpoint is complete.
    ///
    /// # Errors
    /// It could not be written.
    pub fn wait(&mut self) -> Result<(), CheckpointError> {
        let Some(writing) = self.writing.take() else { return Ok(()) };
        let panicked = |_| {
            let fault = std::io::Error::other("its thread panicked");
            Err(io(&self.run_dir.join(CHECKPOINTS_DIR), "write")(fault))
        };
        self.saved = Some(writing.join().unwrap_or_else(panicked)?);
        Ok(())
    }
}

impl Drop for Saver {
    /// Nobody removes the directory while the thread still writes into it.
    fn drop(&mut self) {
        if let Err(error) = self.wait() {
            tracing::error!("{error}");
        }
    }
}
