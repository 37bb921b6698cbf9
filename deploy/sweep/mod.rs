//! A sweep: many runs, some of them at once, each with a directory of its own that does not depend on the others.
//!
//! All runs are supervised by this one process ([`crate::supervise`]), so nothing of them outlives it, and Ctrl-C reaches
//! each of them: once, and they finish their tick and save; twice, and they stop.

pub(crate) mod arms;
pub(crate) mod estimate;
pub(crate) mod jobs;
pub(crate) mod manifest;
pub(crate) mod over;
mod progress;
pub(crate) mod seeds;
pub(crate) mod share;
pub(crate) mod suite;

use crate::flags::Limits;
use crate::prepare::{
    Existing, Prepared, Resolved, clear_away, has_leftovers, nothing_saved, recover, resolve, resolve_run,
};
use crate::supervise::display::Display;
use crate::supervise::{Ended, Signals, supervise};
use anyhow::{Context, Result};
use estimate::{Pace, most_steps};
use manifest::{PROBE, run_dir};
use progress::Progress;
use std::collections::{BTreeSet, VecDeque};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tokio::task::{JoinSet, LocalSet};
use trestle_actor::env::registry;
use trestle_proto::config::{self, Config};
use trestle_proto::run_result::RunResult;

/// Environment steps of a probe beyond its warm-up.
const PROBE_STEPS: u64 = 8_000;
/// How long a probe may take, from the start of its processes. A slow environment makes fewer steps in it.
const PROBE_TIME: Duration = Duration::from_secs(20);

/// One run of a sweep.
#[derive(Clone, Debug)]
pub(crate) struct Job {
    /// Number of its arm.
    pub(crate) arm: usize,
    /// Its seed.
    pub(crate) seed: u64,
    /// Its directory.
    pub(crate) dir: PathBuf,
    /// Its configuration as typed.
    pub(crate) config: Config,
}

/// What became of a run.
#[derive(Debug)]
pub(crate) enum Outcome {
    /// It has run its whole length, now or before.
    Complete(Box<RunResult>),
    /// It was interrupted, or not begun.
    Unfinished,
    /// It failed.
    Failed(String),
}

/// A sweep that is ready to go.
#[derive(Debug)]
pub(crate) struct Sweep {
    /// Names of the arms.
    pub(crate) arms: Vec<String>,
    /// For each arm the number of its kind, up to the number of arms: runs of one kind are taken to be equally fast.
    pub(crate) kinds: Vec<usize>,
    /// All runs, arm by arm.
    pub(crate) jobs: Vec<Job>,
    /// Its directory.
    pub(crate) out: PathBuf,
    /// Runs at once.
    pub(crate) at_once: usize,
    /// Print the summary only.
    pub(crate) quiet: bool,
}

/// What a sweep came to.
#[derive(Debug)]
pub(crate) struct Swept {
    /// An outcome for each job.
    pub(crate) outcomes: Vec<Outcome>,
    /// Whether it was interrupted.
    pub(crate) interrupted: bool,
}

/// The configuration of `arm` and `seed` in `out`: what a suite says of its task, then `sets` for all arms, then the arm's own,
/// then limits and seed.
pub(crate) fn configuration(
    source: &str,
    sets: &[String],
    limits: Limits,
    arm: &arms::Arm,
    seed: u64,
    out: &Path,
) -> Result<Config> {
    let mut below = Vec::new();
    if let Some(task) = &arm.task {
        below.clone_from(&task.sets);
        let made = task.demonstration.iter();
        below.extend(made.map(|file| format!("mentor.demo={:?}", out.join(file).display().to_string())));
    }
    let source = arm.task.as_ref().map_or(source, |task| &task.preset);
    let sets: Vec<String> = below.iter().chain(sets).chain(&arm.sets).cloned().collect();
    let flags = |config: &mut Config| {
        limits.apply(config);
        config.run.seed = seed;
    };
    config::load_with(registry(), source, &sets, flags).with_context(|| format!("arm {}", arm.name))
}

/// The jobs of `arms` and `seeds` in `out`, arm by arm.
pub(crate) fn jobs(
    source: &str,
    sets: &[String],
    limits: Limits,
    arms: &[arms::Arm],
    seeds: &[u64],
    out: &Path,
) -> Result<Vec<Job>> {
    let mut jobs = Vec::with_capacity(arms.len() * seeds.len());
    for (number, arm) in arms.iter().enumerate() {
        for &seed in seeds {
            let config = configuration(source, sets, limits, arm, seed, out)?;
            jobs.push(Job { arm: number, seed, dir: run_dir(out, &arm.name, seed), config });
        }
    }
    Ok(jobs)
}

impl Sweep {
    /// Runs everything that has not yet run its whole length.
    ///
    /// # Errors
    /// What concerns the sweep as a whole; what concerns a run is its outcome.
    pub(crate) fn run(&self) -> Result<Swept> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        LocalSet::new().block_on(&runtime, self.all())
    }

    async fn all(&self) -> Result<Swept> {
        let mut signals = Signals::new()?;
        let parents: BTreeSet<&Path> = self.jobs.iter().filter_map(|job| job.dir.parent()).collect();
        let disturbed: BTreeSet<&Path> = parents.into_iter().filter(|parent| has_leftovers(parent)).collect();
        let is_disturbed = |job: &Job| job.dir.parent().is_some_and(|parent| disturbed.contains(parent));
        let mut outcomes: Vec<Option<Outcome>> =
            self.jobs.iter().map(|job| finished(job, is_disturbed(job))).collect();
        for (at, outcome) in outcomes.iter().enumerate() {
            if let Some(Outcome::Failed(error)) = outcome {
                crate::output::say(&format!("{}: failed: {error}", self.name(at)));
            }
        }
        let mut queue: VecDeque<usize> = by_seed(&self.jobs);
        queue.retain(|&at| outcomes[at].is_none());
        let paces = if self.quiet || queue.is_empty() {
            Vec::new()
        } else {
            crate::output::say(&format!(
                "{} of {} runs are to do, {} at once",
                queue.len(),
                self.jobs.len(),
                self.at_once
            ));
            let known = self.paces(&outcomes);
            tokio::select! {
                paces = self.probe(known, &queue) => paces,
                _ = signals.next() => return Ok(Swept { outcomes: unfinished(outcomes), interrupted: true }),
            }
        };
        let mut progress = Progress::new(self, paces, &queue);
        progress.announce();
        let mut running: JoinSet<(usize, f64, Outcome)> = JoinSet::new();
        let mut interrupted = false;
        loop {
            while !interrupted && running.len() < self.at_once {
                let Some(at) = queue.pop_front() else { break };
                let display = progress.display(at);
                let job = self.jobs[at].clone();
                running.spawn_local(async move {
                    let start = Instant::now();
                    let outcome = train(&job, &display).await;
                    display.finish();
                    (at, start.elapsed().as_secs_f64(), outcome)
                });
            }
            tokio::select! {
                done = running.join_next() => match done {
                    Some(done) => {
                        let (at, seconds, outcome) = done.context("a run's supervision ended in the middle")?;
                        progress.ended(at, seconds, &outcome);
                        outcomes[at] = Some(outcome);
                    }
                    None => break,
                },
                _ = signals.next(), if !interrupted => interrupted = true,
            }
        }
        Ok(Swept { outcomes: unfinished(outcomes), interrupted })
    }

    /// What job `at` is called where the user sees it.
    fn name(&self, at: usize) -> String {
        let job = &self.jobs[at];
        format!("{} seed {}", self.arms[job.arm], job.seed)
    }

    /// The pace of each kind of which runs are finished already.
    fn paces(&self, outcomes: &[Option<Outcome>]) -> Vec<Option<Pace>> {
        let mut paces = vec![None; self.arms.len()];
        for (at, outcome) in outcomes.iter().enumerate() {
            if let Some(Outcome::Complete(result)) = outcome {
                let steps = most_steps(&self.jobs[at].config);
                paces[self.kind(at)].get_or_insert_with(Pace::default).ended(result.wall_s, steps);
            }
        }
        paces
    }

    /// The number of the kind of job `at`.
    fn kind(&self, at: usize) -> usize {
        self.kinds[self.jobs[at].arm]
    }

    /// The `paces` that are known, and that of each other kind with runs in `queue` from a short run of it in a directory
    /// that goes again. As many at once as there will be runs. A kind whose probe fails has no pace: what is wrong will be
    /// said of its runs.
    async fn probe(&self, mut paces: Vec<Option<Pace>>, queue: &VecDeque<usize>) -> Vec<Option<Pace>> {
        let mut waiting: VecDeque<usize> = (0..self.arms.len())
            .filter(|&kind| paces[kind].is_none())
            .filter_map(|kind| queue.iter().copied().find(|&at| self.kind(at) == kind))
            .collect();
        let mut running: JoinSet<(usize, Result<f64>)> = JoinSet::new();
        loop {
            while running.len() < self.at_once {
                let Some(at) = waiting.pop_front() else { break };
                let (job, out) = (self.jobs[at].clone(), self.out.clone());
                running.spawn_local(async move { (at, probe(&job, &out).await) });
            }
            match running.join_next().await {
                None => return paces,
                Some(Ok((at, Ok(rate)))) => {
                    paces[self.kind(at)] = Some(Pace::new(rate));
                }
                Some(Ok((at, Err(error)))) => {
                    tracing::debug!("a probe of {} failed: {error:#}", self.jobs[at].dir.display());
                }
                Some(Err(error)) => tracing::debug!("a probe's supervision ended in the middle: {error}"),
            }
        }
    }
}

/// Numbers of all jobs, the first seeds of all arms before the later ones: what an interrupted sweep has is then as
/// even as it can be.
fn by_seed(jobs: &[Job]) -> VecDeque<usize> {
    let mut place = std::collections::BTreeMap::new();
    let mut order: Vec<(usize, usize)> = Vec::new();
    for (at, job) in jobs.iter().enumerate() {
        let nth = place.entry(job.arm).or_insert(0);
        order.push((*nth, at));
        *nth += 1;
    }
    order.sort_unstable();
    order.into_iter().map(|(_, at)| at).collect()
}

fn unfinished(outcomes: Vec<Option<Outcome>>) -> Vec<Outcome> {
    outcomes.into_iter().map(|outcome| outcome.unwrap_or(Outcome::Unfinished)).collect()
}

/// The outcome of a job that needs nothing more: one that has run its whole length, or whose directory cannot be used. Where a
/// killed start has left something beside its directory, that is put right first.
pub(crate) fn finished(job: &Job, disturbed: bool) -> Option<Outcome> {
    if disturbed {
        match recover(&job.dir) {
            Ok(notes) => notes.iter().for_each(|note| crate::output::say(note)),
            Err(error) => return Some(Outcome::Failed(crate::output::words(&error))),
        }
    }
    if !job.dir.exists() || nothing_saved(&job.dir) {
        return None;
    }
    match existing(job) {
        Ok(resolved) => {
            let result = resolved.complete(&job.dir)?;
            // No start in its directory will do it.
            clear_away(&job.dir, false);
            Some(Outcome::Complete(Box::new(result)))
        }
        Err(error) => Some(Outcome::Failed(crate::output::words(&error))),
    }
}

/// The configuration of a run that is there already, which must be what it would be now.
fn existing(job: &Job) -> Result<Resolved> {
    resolve_run(&job.dir, &job.config)
}

async fn train(job: &Job, display: &Display) -> Outcome {
    match attempt(job, display).await {
        Ok(Ended::Complete(result)) => Outcome::Complete(Box::new(result)),
        Ok(Ended::Interrupted(_)) => Outcome::Unfinished,
        Err(error) => Outcome::Failed(crate::output::words(&error)),
    }
}

/// Trains a run to its end.
async fn attempt(job: &Job, display: &Display) -> Result<Ended> {
    let mut signals = Signals::new()?;
    let mut prepared = ready(job)?;
    prepared.from().iter().for_each(|from| display.remark(from));
    supervise(&mut prepared, &mut signals, display).await
}

/// Prepares a run: to go on from its newest checkpoint, or anew where there is none.
pub(crate) fn ready(job: &Job) -> Result<Prepared> {
    let (resolved, way) = if nothing_saved(&job.dir) {
        (resolve(job.config.clone())?, Existing::Unsaved)
    } else if job.dir.exists() {
        let resolved = existing(job)?;
        match resolved.has_checkpoint(&job.dir)? {
            true => (resolved, Existing::Resume),
            false => (resolve(job.config.clone())?, Existing::Overwrite),
        }
    } else {
        (resolve(job.config.clone())?, Existing::Keep)
    };
    resolved.prepare(&job.dir, way)
}

/// Environment steps a second of a short run like `job`'s, in a directory within `out` that goes with it, also where the sweep
/// is interrupted meanwhile: on the disk that the runs write to.
async fn probe(job: &Job, out: &Path) -> Result<f64> {
    let place = tempfile::Builder::new().prefix(PROBE).tempdir_in(out).context("cannot make a directory")?;
    let mut config = job.config.clone();
    let steps = config.learner.warmup + PROBE_STEPS;
    config.run.env_steps = Some(config.run.env_steps.map_or(steps, |most| most.min(steps)));
    let mut prepared = resolve(config)?.prepare(place.path(), Existing::Keep)?;
    let mut signals = Signals::within(PROBE_TIME)?;
    match supervise(&mut prepared, &mut signals, &Display::quiet()).await? {
        Ended::Complete(result) | Ended::Interrupted(Some(result)) if result.env_steps > 0 => {
            Ok(result.env_steps as f64 / result.wall_s.max(1e-3))
        }
        _ => anyhow::bail!("it made no step in {} s", PROBE_TIME.as_secs()),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn the_first_seeds_of_all_arms_come_first() {
        let arms = [config::Algo::Dqn, config::Algo::Diiqn].map(arms::Arm::plain);
        let jobs = jobs("maze-small", &[], Limits::default(), &arms, &[7, 3], Path::new("out")).unwrap();
        let order: Vec<_> =
            by_seed(&jobs).into_iter().map(|at| (jobs[at].dir.clone(), jobs[at].seed)).collect();
        let expected = [("dqn", 7), ("diiqn", 7), ("dqn", 3), ("diiqn", 3)];
        let expected =
            expected.map(|(arm, seed)| (Path::new("out").join(arm).join(format!("seed-{seed}")), seed));
        assert_eq!(order, expected);
    }

    #[test]
    fn an_arms_settings_come_after_those_of_all() {
        let arm: arms::Arm = "x:learner.lr=0.5".parse().unwrap();
        let config = configuration(
            "maze-small",
            &["learner.lr=0.1".into()],
            Limits::default(),
            &arm,
            4,
            Path::new("o"),
        )
        .unwrap();
        assert_eq!((config.learner.lr, config.run.seed), (0.5, 4));
        let wrong: arms::Arm = "x:learner.rate=0.5".parse().unwrap();
        let error = format!(
            "{:#}",
            configuration("maze-small", &[], Limits::default(), &wrong, 4, Path::new("o")).unwrap_err()
        );
        assert!(error.contains("arm x") && error.contains("learner.rate"), "{error}");
    }
}
