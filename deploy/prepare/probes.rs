//! What the machine must offer before a run starts. `trestle doctor` reports the same.
//!
//! Limits that this user may raise are raised. Where a run could not do with what there is, it is refused by the limit's
//! name, its value and the need, before anything is written. Where it can, with less of a promise, that is said.

use crate::TRANSPORT;
use anyhow::{Context, Result, bail, ensure};
use nix::errno::Errno;
use nix::sys::resource::{RLIM_INFINITY, Resource, getrlimit, setrlimit};
use nix::sys::statvfs::statvfs;
use nix::unistd::{geteuid, getuid};
use std::fs;
use std::io::Write;
use std::os::unix::fs::{MetadataExt, symlink};
use std::path::Path;
use trestle_algorithm::replay::bytes_per_transition;
use trestle_link::Transport;
use trestle_proto::experiment::Experiment;
use trestle_proto::own_file::{cannot_link, cannot_sync};

const SHM: &str = "/dev/shm";
/// Stack of a process's first thread that is enough for all commands, bytes.
const STACK: u64 = 1 << 20;
/// Stack that is asked for where there is less, bytes: what is usual.
const USUAL_STACK: u64 = 8 << 20;

/// Address space of a process without its data and without shared memory, bytes: the program, its libraries and its stacks.
/// Half of it was enough for a build without optimisation.
const PROGRAM: u64 = 96 << 20;
/// Private memory of a process beyond what is counted one by one, bytes. A quarter was enough.
const SMALL_THINGS: u64 = 32 << 20;
/// CPU time of a process below which it could not save what it has learnt before the limit ends it, seconds.
const CPU_TIME: u64 = 3;

/// What a run takes of the machine, at the most. Measured with 1 to 24 actors in both modes, and rounded up generously: a
/// replaced process and the one that it replaces are there at once for a moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Needs {
    /// Bytes of shared memory.
    pub(crate) shared_memory: u64,
    /// Files in shared memory.
    inodes: u64,
    /// Open files of its learner, which has the most.
    open_files: u64,
    /// Open files of its supervisor.
    supervisor_files: u64,
    /// Processes and threads.
    tasks: u64,
    /// Bytes of its largest file, records aside.
    file_bytes: u64,
    /// Bytes of private memory of its learner, which has the most.
    private_memory: u64,
}

impl Needs {
    /// Of a run of `experiment`.
    pub(crate) fn of(experiment: &Experiment) -> Self {
        let shared = TRANSPORT.footprint(experiment);
        let acting = experiment.acting().words() + experiment.rooms().words();
        let actors = u64::from(experiment.config.run.actors);
        // All of the replay is reserved at the start, as if no transition had a successor.
        let (row, learner) = (experiment.spec.row(), &experiment.config.learner);
        let replay = learner.replay as u64 * (bytes_per_transition(row) + 4 * row.words()) as u64;
        // Demonstrations with what is known of them; networks with moments, gradients and copies; stacks of threads.
        let annotation = 128 + 12 * (experiment.record_words() - experiment.spec.obs_dim()) as u64;
        let mentor = experiment.mentor_len() as u64 * (8 * row.words() as u64 + annotation);
        let networks = 64 * acting as u64 + ((8 * learner.threads as u64) << 20);
        // Adam's two moments of each parameter, with a header; a segment of shared memory; iceoryx2's books.
        let optimizer = 8 * acting as u64 + (64 << 10);
        Self {
            shared_memory: shared.memory,
            inodes: shared.files,
            open_files: 112 + 10 * actors,
            supervisor_files: 64 + 2 * actors,
            tasks: 2 * (actors + 2) + 8,
            file_bytes: optimizer.max(shared.largest).max((256 << 10) + (96 << 10) * actors),
            private_memory: SMALL_THINGS + replay + mentor + networks,
        }
    }

    /// Bytes of address space of the learner, which has the most.
    fn address_space(&self) -> u64 {
        PROGRAM + self.private_memory + self.shared_memory
    }

    /// Whichever is more.
    pub(crate) fn max(self, other: Self) -> Self {
        Self {
            shared_memory: self.shared_memory.max(other.shared_memory),
            inodes: self.inodes.max(other.inodes),
            open_files: self.open_files.max(other.open_files),
            supervisor_files: self.supervisor_files.max(other.supervisor_files),
            tasks: self.tasks.max(other.tasks),
            file_bytes: self.file_bytes.max(other.file_bytes),
            private_memory: self.private_memory.max(other.private_memory),
        }
    }

    /// Of `runs` runs at once, all of which one process supervises. Most runs use little of the shared memory that they may
    /// need, so each asks for its own when it starts.
    pub(crate) fn times(self, runs: u64) -> Self {
        Self {
            shared_memory: self.shared_memory,
            inodes: self.inodes * runs,
            open_files: self.open_files,
            supervisor_files: self.supervisor_files * runs,
            tasks: self.tasks * runs,
            file_bytes: self.file_bytes,
            private_memory: self.private_memory,
        }
    }
}

/// What a probe has found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Finding {
    /// Whether a run could do with it.
    pub(crate) enough: bool,
    /// The limit, its value, and the need where it is not met.
    pub(crate) text: String,
}

impl Finding {
    /// Of a limit called `name`, of which there is `value` and `needed` are needed; `remedy` says what to do.
    fn of(name: &str, value: u64, needed: u64, unit: &str, remedy: &str) -> Self {
        let enough = value >= needed;
        let text = if enough {
            format!("{name}: {value} {unit}")
        } else {
            format!("{name}: {value} {unit}; a run like this needs {needed}: {remedy}")
        };
        Self { enough, text }
    }
}

/// All that the machine limits, against `needs`. Raises what this user may raise.
pub(crate) fn findings(needs: &Needs) -> Vec<Finding> {
    let mut all = vec![shared_memory(needs)];
    all.extend(inodes(needs));
    all.extend([open_files(needs), tasks(needs), file_size(needs), stack()]);
    all.extend([
        memory("address space", Resource::RLIMIT_AS, needs.address_space(), "-v"),
        memory("private memory", Resource::RLIMIT_DATA, needs.private_memory, "-d"),
        cpu_time(),
    ]);
    all
}

/// Refuses a run that the machine cannot hold.
pub(crate) fn check(needs: &Needs) -> Result<()> {
    match findings(needs).into_iter().find(|finding| !finding.enough) {
        Some(finding) => bail!(finding.text),
        None => Ok(()),
    }
}

/// The room in /dev/shm, which must be there and take files.
fn shared_memory(needs: &Needs) -> Finding {
    match check_shared_memory(needs.shared_memory) {
        Ok(free) => {
            Finding { enough: true, text: format!("shared memory: {} MiB free in {SHM}", free >> 20) }
        }
        Err(error) => Finding { enough: false, text: crate::output::words(&error) },
    }
}

/// Bytes free in /dev/shm, which are `needed` or more.
fn check_shared_memory(needed: u64) -> Result<u64> {
    let stat = statvfs(SHM).with_context(|| {
        format!("{SHM} cannot be used; a run needs {} MiB of shared memory there", needed >> 20)
    })?;
    let free = stat.blocks_available() * stat.fragment_size();
    ensure!(
        free >= needed,
        "{SHM} has {} MiB free; this run needs {} MiB: make room, mount it larger, or lower run.actors, run.rollout \
         or learner.hidden",
        free >> 20,
        needed.div_ceil(1 << 20)
    );
    // Everybody may create files there: one without a name follows nobody's link and is left behind by no kill.
    tempfile::tempfile_in(SHM)
        .and_then(|mut probe| probe.write_all(b"x"))
        .with_context(|| format!("{SHM} cannot be written to"))?;
    Ok(free)
}

/// Files that /dev/shm has room for; none where it does not count them.
fn inodes(needs: &Needs) -> Option<Finding> {
    let stat = statvfs(SHM).ok().filter(|stat| stat.files() > 0)?;
    let remedy = "remove files there, or mount it with a larger nr_inodes";
    let name = format!("room for files in {SHM}");
    Some(Finding::of(&name, stat.files_available(), needs.inodes, "inodes", remedy))
}

/// A limit of this process, raised to `needed` if it is lower and the user may; what it is then.
fn raised(resource: Resource, needed: u64) -> Result<u64, Errno> {
    let (soft, hard) = getrlimit(resource)?;
    if soft >= needed {
        return Ok(soft);
    }
    let most = needed.min(hard);
    setrlimit(resource, most, hard).map(|()| most)
}

fn limit(name: &str, resource: Resource, needed: u64, flag: &str) -> Finding {
    match raised(resource, needed) {
        Ok(value) => {
            Finding::of(name, value, needed, "allowed", &format!("raise it with `ulimit {flag} {needed}`"))
        }
        Err(errno) => Finding { enough: false, text: format!("{name}: the limit cannot be read: {errno}") },
    }
}

/// Memory of a process that a shell's `ulimit` limits: a process that meets the limit is ended by it in no good order.
fn memory(name: &str, resource: Resource, needed: u64, flag: &str) -> Finding {
    match raised(resource, needed) {
        Ok(RLIM_INFINITY) => Finding { enough: true, text: format!("{name}: unlimited") },
        Ok(value) => {
            let needed = needed.div_ceil(1 << 10);
            let remedy =
                format!("raise it with `ulimit {flag} {needed}`, or lower learner.replay or learner.hidden");
            Finding::of(name, value >> 10, needed, "KiB allowed", &remedy)
        }
        Err(errno) => Finding { enough: false, text: format!("{name}: the limit cannot be read: {errno}") },
    }
}

/// The processor time of a process. At the hard limit the kernel kills it without a warning, so the soft limit, at which it
/// asks the process to save and leave, is set before that.
fn cpu_time() -> Finding {
    let name = "CPU time of a process";
    let warned = |(soft, hard): (u64, u64)| {
        let before = hard.saturating_sub((hard / 10).clamp(2, 60)).max(1);
        let soft = if hard == RLIM_INFINITY { soft } else { soft.min(before) };
        setrlimit(Resource::RLIMIT_CPU, soft, hard).map(|()| (soft, hard))
    };
    match getrlimit(Resource::RLIMIT_CPU).and_then(warned) {
        Ok((RLIM_INFINITY, _)) => Finding { enough: true, text: format!("{name}: unlimited") },
        Ok((soft, RLIM_INFINITY)) => Finding { enough: true, text: format!("{name}: {soft} s allowed") },
        Ok((_, hard)) => {
            Finding::of(name, hard, CPU_TIME, "s allowed", "raise it with `ulimit -t unlimited`")
        }
        Err(errno) => Finding { enough: false, text: format!("{name}: the limit cannot be read: {errno}") },
    }
}

fn open_files(needs: &Needs) -> Finding {
    limit("open files", Resource::RLIMIT_NOFILE, needs.open_files.max(needs.supervisor_files), "-n")
}

/// Refuses to serve the live page with fewer open files than its browsers and the runs that it reads need.
pub(crate) fn check_page() -> Result<()> {
    const NEEDED: u64 = 64;
    let finding = limit("open files", Resource::RLIMIT_NOFILE, NEEDED, "-n");
    ensure!(finding.enough, finding.text);
    Ok(())
}

/// The size that a file may have. A process that writes beyond it would be killed, or get no further.
fn file_size(needs: &Needs) -> Finding {
    match raised(Resource::RLIMIT_FSIZE, needs.file_bytes) {
        Ok(most) if most < needs.file_bytes => Finding {
            enough: false,
            text: format!(
                "cannot write a run's files: File too large (ulimit -f): {} KiB a file are allowed; this run needs {} KiB",
                most >> 10,
                needs.file_bytes.div_ceil(1 << 10)
            ),
        },
        Ok(u64::MAX) => Finding { enough: true, text: "size of files: unlimited".into() },
        Ok(most) => Finding { enough: true, text: format!("size of files: {} KiB", most >> 10) },
        Err(errno) => {
            Finding { enough: false, text: format!("size of files: the limit cannot be read: {errno}") }
        }
    }
}

/// Processes and threads that this user may still start.
fn tasks(needs: &Needs) -> Finding {
    let remedy = "raise it with `ulimit -u`, or lower run.actors";
    let of_user = raised(Resource::RLIMIT_NPROC, u64::MAX).ok().filter(|&most| most != u64::MAX);
    // Root's are not limited.
    let of_user = of_user.filter(|_| !geteuid().is_root()).map(|most| most.saturating_sub(own_tasks()));
    let left = of_user.into_iter().chain(of_control_group()).min();
    match left {
        Some(left) => Finding::of("processes and threads", left, needs.tasks, "more allowed", remedy),
        None => Finding { enough: true, text: "processes and threads: unlimited".into() },
    }
}

/// Processes and threads of this user, as far as /proc shows them.
fn own_tasks() -> u64 {
    let uid = getuid().as_raw();
    let of = |entry: fs::DirEntry| {
        entry.file_name().to_str()?.parse::<u32>().ok()?;
        entry.metadata().ok().filter(|meta| meta.uid() == uid)?;
        let status = fs::read_to_string(entry.path().join("status")).ok()?;
        status.lines().find_map(|line| line.strip_prefix("Threads:"))?.trim().parse::<u64>().ok()
    };
    fs::read_dir("/proc").into_iter().flatten().flatten().filter_map(of).sum()
}

/// What the control group, version 2, of this process and those above it leave of processes and threads.
fn of_control_group() -> Option<u64> {
    let text = fs::read_to_string("/proc/self/cgroup").ok()?;
    let group = text.lines().find_map(|line| line.strip_prefix("0::/"))?;
    let number = |path: &Path| fs::read_to_string(path).ok()?.trim().parse::<u64>().ok();
    let root = Path::new("/sys/fs/cgroup");
    let own = root.join(group);
    let left = own.ancestors().take_while(|dir| dir.starts_with(root)).filter_map(|dir| {
        // "max" is no number: no limit here.
        let (most, now) = (number(&dir.join("pids.max"))?, number(&dir.join("pids.current"))?);
        Some(most.saturating_sub(now))
    });
    left.min()
}

/// The stack of a process's first thread.
fn stack() -> Finding {
    let value = match getrlimit(Resource::RLIMIT_STACK) {
        Ok((soft, _)) if soft >= STACK => Ok(soft),
        _ => raised(Resource::RLIMIT_STACK, USUAL_STACK),
    };
    match value {
        Ok(u64::MAX) => Finding { enough: true, text: "stack: unlimited".into() },
        Ok(value) => Finding::of(
            "stack",
            value >> 10,
            STACK >> 10,
            "KiB allowed",
            &format!("raise it with `ulimit -s {}`", USUAL_STACK >> 10),
        ),
        Err(errno) => Finding { enough: false, text: format!("stack: the limit cannot be read: {errno}") },
    }
}

/// Refuses a stack on which this program could not even say so later. Takes little of it itself.
pub(crate) fn check_stack() -> Result<(), String> {
    let finding = stack();
    if finding.enough { Ok(()) } else { Err(finding.text) }
}

/// What the file system of `dir` cannot do, or a limit cuts short, and what a run promises less for it. Leaves nothing behind.
pub(crate) fn weaknesses(dir: &Path) -> Vec<String> {
    let mut found = Vec::new();
    if let Ok((soft, _)) = getrlimit(Resource::RLIMIT_CPU)
        && soft != RLIM_INFINITY
    {
        found.push(format!(
            "a process may use {soft} s of CPU time (`ulimit -t`): then the run saves and ends, and can be resumed"
        ));
    }
    let probe = tempfile::Builder::new().prefix(".probe-").make_in(dir, |path| symlink("nowhere", path));
    if let Err(error) = probe
        && cannot_link(&error)
    {
        found.push(format!(
            "{} has no symbolic links ({error}): `last` is a file with the path of the newest checkpoint",
            dir.display()
        ));
    }
    let synced = fs::File::open(dir).and_then(|dir| dir.sync_all());
    if let Err(error) = synced
        && cannot_sync(&error)
    {
        found.push(format!(
            "{} cannot be synced ({error}): after a power cut the newest checkpoints may be missing",
            dir.display()
        ));
    }
    found
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_limit_is_named_with_its_value_and_the_need() {
        let found = Finding::of("open files", 64, 122, "allowed", "raise it");
        assert!(!found.enough);
        assert_eq!(found.text, "open files: 64 allowed; a run like this needs 122: raise it");
        assert!(Finding::of("open files", 122, 122, "allowed", "raise it").enough);
    }

    #[test]
    fn this_machine_has_tasks_and_an_ordinary_file_system() {
        assert!(own_tasks() > 0);
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(weaknesses(dir.path()), [] as [String; 0]);
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
    }
}
