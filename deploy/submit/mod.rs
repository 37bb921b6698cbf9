//! A sweep for the schedulers of clusters. Its runs know nothing of each other, so a scheduler needs no more than a way to
//! start each of them: `trestle sweep --share PART/OF` in the sweep's directory, which all hosts see.

pub(crate) mod kubernetes;
pub(crate) mod options;
pub(crate) mod slurm;

use crate::sweep::{Job, Outcome, finished};

/// Tasks of a sweep, at most: SLURM's own limit unless its administrator has raised it.
const MAX_TASKS: usize = 1000;

/// Tasks of a sweep of so many runs: one a run, or several runs a task where there are many.
pub(crate) fn tasks(runs: usize) -> usize {
    runs.clamp(1, MAX_TASKS)
}

/// The numbers of those of `tasks` tasks that have something left to do.
pub(crate) fn unfinished(jobs: &[Job], tasks: usize) -> Vec<usize> {
    let is_complete = |job: &Job| matches!(finished(job, false), Some(Outcome::Complete(_)));
    let mut left = vec![false; tasks];
    for (number, job) in jobs.iter().enumerate() {
        left[number % tasks] |= !is_complete(job);
    }
    (0..tasks).filter(|&task| left[task]).collect()
}
