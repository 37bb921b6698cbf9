//! What a run has for itself while it starts and trains: its directory, and, for the moment between two states, the
//! signals that would end it in the middle.

use anyhow::{Context, Result, bail};
use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};
use nix::sys::signal::{SigSet, Signal};
use std::fs::{self, File};
use std::path::Path;

/// Keeps other supervisors off the run directory `root` until the lock is dropped or this process ends, however it
/// ends. None where the file system knows no locks.
///
/// # Errors
/// Another process has it.
pub(crate) fn lock(root: &Path) -> Result<Option<Flock<File>>> {
    let dir = File::open(root).with_context(|| format!("cannot open {}", root.display()))?;
    match Flock::lock(dir, FlockArg::LockExclusiveNonblock) {
        Ok(lock) => Ok(Some(lock)),
        Err((_, Errno::EWOULDBLOCK)) => {
            bail!(
                "{}: a run is in progress there; accepted: another --out, or to wait for its end",
                root.display()
            )
        }
        Err((_, errno)) => {
            tracing::warn!(
                "{} cannot be locked ({errno}): see to it that no other run uses it",
                root.display()
            );
            Ok(None)
        }
    }
}

/// Ctrl-C and its like, held back until this is dropped: they then end what has been prepared meanwhile in good
/// order.
pub(crate) struct HeldSignals(SigSet);

impl HeldSignals {
    pub(crate) fn new() -> Result<Self> {
        let signals = SigSet::from_iter([Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP]);
        signals.thread_block().context("cannot hold signals back")?;
        Ok(Self(signals))
    }
}

impl Drop for HeldSignals {
    fn drop(&mut self) {
        if let Err(error) = self.0.thread_unblock() {
            tracing::error!("cannot let signals through again: {error}");
        }
    }
}

/// Whether SIGHUP is ignored, as `nohup` asks of a program.
pub(super) fn ignores_hangup() -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask & 1 << (Signal::SIGHUP as u32 - 1) != 0)
}
