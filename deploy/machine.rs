//! What the kernel tells of processors and processes.

use nix::sched::{CpuSet, sched_getaffinity};
use nix::unistd::Pid;

/// The processors that this process may use.
pub(crate) fn own_processors() -> nix::Result<CpuSet> {
    sched_getaffinity(Pid::from_raw(0))
}

/// The set of one processor.
pub(crate) fn one_processor(cpu: usize) -> nix::Result<CpuSet> {
    let mut one = CpuSet::new();
    one.set(cpu)?;
    Ok(one)
}

/// The processors of a set, in ascending order.
pub(crate) fn listed(cpus: &CpuSet) -> Vec<usize> {
    (0..CpuSet::count()).filter(|&cpu| cpus.is_set(cpu) == Ok(true)).collect()
}

/// The words of a process's /proc/PID/stat from the third on. The second is its name in brackets and may hold anything.
pub(crate) fn words_of_stat(stat: &str) -> Option<impl Iterator<Item = &str>> {
    Some(stat.rsplit_once(')')?.1.split_whitespace())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn processors_are_listed() {
        assert!(listed(&CpuSet::new()).is_empty());
        assert_eq!(listed(&one_processor(3).unwrap()), [3]);
        assert!(!listed(&own_processors().unwrap()).is_empty());
        assert!(one_processor(CpuSet::count()).is_err());
    }

    #[test]
    fn a_name_with_brackets_hides_no_word() {
        assert!(words_of_stat("17 (a) b) S 1 2\n").unwrap().eq(["S", "1", "2"]));
        assert!(words_of_stat("17").is_none());
    }
}
