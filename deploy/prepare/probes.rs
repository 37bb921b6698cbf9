//! What the machine must offer before a run starts.

use anyhow::{Context, Result, ensure};
use nix::sys::statvfs::statvfs;
use std::fs;
use std::path::Path;

/// Refuses to start where shared memory is missing or too small.
pub(super) fn check_shared_memory(needed: u64) -> Result<()> {
    let shm = Path::new("/dev/shm");
    let stat = statvfs(shm).with_context(|| {
        format!("{} cannot be used; a run needs {} MiB of shared memory there", shm.display(), needed >> 20)
    })?;
    let free = stat.blocks_available() * stat.fragment_size();
    ensure!(
        free >= needed,
        "{} has {} MiB free; this run needs {} MiB: make room, mount it larger, or lower run.actors, run.rollout \
         or learner.hidden",
        shm.display(),
        free >> 20,
        needed.div_ceil(1 << 20)
    );
    let probe = shm.join(format!("trestle-probe-{}", std::process::id()));
    fs::write(&probe, b"x")
        .and_then(|()| fs::remove_file(&probe))
        .with_context(|| format!("{} cannot be written to", shm.display()))
}
