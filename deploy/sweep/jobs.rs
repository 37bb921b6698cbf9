//! How many runs go on at once, where the user does not say.

use nix::sys::statvfs::statvfs;
use std::fs;
use std::thread::available_parallelism;

/// Runs at once, at most.
pub(crate) const MAX_JOBS: usize = 256;
/// Memory that is set aside for a run: what one with a replay of 100,000 transitions takes over all its processes.
const RUN_MEMORY: u64 = 256 << 20;

/// One run a core, as far as memory and shared memory allow: `shared` bytes of it go into each run. The processes of a run
/// in lockstep wait for each other, so together they keep about one core busy.
pub(crate) fn default_jobs(shared: u64) -> usize {
    let cores = available_parallelism().map_or(1, usize::from);
    let fits = |room: Option<u64>, each: u64| room.map_or(usize::MAX, |room| (room / each.max(1)) as usize);
    cores.min(fits(available_memory(), RUN_MEMORY)).min(fits(shared_memory(), shared)).clamp(1, MAX_JOBS)
}

/// Bytes that the kernel says can still be used.
fn available_memory() -> Option<u64> {
    let text = fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes << 10)
}

/// Bytes free in /dev/shm.
fn shared_memory() -> Option<u64> {
    let room = statvfs("/dev/shm").ok()?;
    Some(room.blocks_available() * room.fragment_size())
}
