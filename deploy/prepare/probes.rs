//! What the machine must offer before a run starts.

use anyhow::{Context, Result, ensure};
use nix::sys::statvfs::statvfs;
use std::io::Write;
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
    // Everybody may create files there: one without a name follows nobody's link and is left behind by no kill.
    tempfile::tempfile_in(shm)
        .and_then(|mut probe| probe.write_all(b"x"))
        .with_context(|| format!("{} cannot be written to", shm.display()))
}
