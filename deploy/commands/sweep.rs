//! `trestle sweep`

use super::{submit, watch};
use crate::cli::Sweep as Args;
use crate::flags::Limits;
use crate::prepare::{Needs, Resolved, check as check_machine, resolve, weaknesses};
use crate::status::{ExitCode, INTERRUPTED};
use crate::sweep::arms::{Arm, MAX_ARMS};
use crate::sweep::jobs::default_jobs;
use crate::sweep::manifest::Manifest;
use crate::sweep::over::cross;
use crate::sweep::suite::{SUITE, Suite, kinds, place};
use crate::sweep::{Outcome, Sweep, Swept, configuration, jobs};
use anyhow::{Context, Result, bail, ensure};
use std::collections::BTreeSet;
use std::env;
use tempfile::TempDir;
use trestle_actor::env::registry;
use trestle_link::logging;
use trestle_proto::config::Mode;
use trestle_proto::run_result::RunResult;
use trestle_report::stats::median;

pub(super) fn run(args: &Args) -> Result<ExitCode> {
    logging::init(0, "sweep", "warn");
    let Asked { source, sets, limits, arms, seeds, suite } = asked(args)?;
    // Until everything is checked, what a suite makes is somewhere else.
    let aside = suite.as_ref().map(|_| tempfile::tempdir()).transpose();
    let aside = aside.with_context(|| {
        let dir = env::temp_dir();
        format!(
            "cannot make a directory in {}; accepted: one that can be written to in TMPDIR",
            dir.display()
        )
    })?;
    let made = aside.as_ref().map_or(args.out.as_path(), TempDir::path);
    if let Some(suite) = &suite {
        suite.write(made)?;
    }
    let mut most: Vec<Needs> = Vec::new();
    for arm in &arms {
        // Each arm is resolved as a run of it would be, before anything is started or written.
        let resolved = check(configuration(&source, &sets, limits, arm, seeds[0], made)?)
            .with_context(|| format!("arm {}", arm.name))?;
        most.push(resolved.needs());
    }
    let needs = most.into_iter().reduce(Needs::max).context("a sweep without arms")?;
    let manifest = Manifest::new(&source, sets.clone(), limits, arms.clone(), seeds.clone());
    if let Some(scheduler) = args.submit {
        return submit::run(args, scheduler, &manifest, suite.as_ref(), &needs);
    }
    let at_once = args.jobs.map_or_else(|| default_jobs(needs.shared_memory), usize::from);
    let mut all = jobs(&source, &sets, limits, &arms, &seeds, &args.out)?;
    if let Some(share) = args.share {
        all = all
            .into_iter()
            .enumerate()
            .filter(|(number, _)| share.has(*number))
            .map(|(_, job)| job)
            .collect();
    }
    let together = at_once.min(all.len()).max(1);
    check_machine(&needs.times(together as u64)).with_context(|| format!("{together} runs at once"))?;
    watch::beside(args.beside, &args.out, None)?;
    if args.share.is_some() {
        // Several processes may train parts of one sweep. The process that begins the sweep makes a suite's maps and demonstrations.
        ensure!(
            suite.is_none(),
            "--share with {SUITE}; accepted: `--share PART/OF --resume --out DIR` alone"
        );
        manifest.join(&args.out)?;
    } else {
        manifest.claim(&args.out, args.resume)?;
    }
    if let Some(suite) = &suite {
        suite.write(&args.out)?;
    }
    let kinds = kinds(&arms);
    let decided: Vec<bool> = arms.iter().map(|arm| arm.decides("run.stop_when_solved")).collect();
    let of_suite = arms.iter().any(|arm| arm.task.is_some());
    for weakness in weaknesses(&args.out) {
        crate::output::say(&format!("note: {weakness}"));
    }
    let sweep = Sweep {
        arms: arms.into_iter().map(|arm| arm.name).collect(),
        kinds,
        jobs: all,
        out: args.out.clone(),
        at_once,
        quiet: args.quiet,
    };
    let swept = sweep.run()?;
    if of_suite { by_group(&sweep, &swept) } else { report(&sweep, &swept) }?;
    let longer = args.limits.episodes.is_some() || args.limits.env_steps.is_some();
    // A --set would not reach the runs of an arm that has the setting itself.
    let solved = sweep.jobs.iter().zip(&swept.outcomes).filter(|(job, outcome)| match outcome {
        Outcome::Complete(result) => {
            job.config.run.stop_when_solved && result.solved_episode.is_some() && !decided[job.arm]
        }
        _ => false,
    });
    let solved = solved.count();
    if args.resume && longer && solved > 0 {
        let (runs, them) = match solved {
            1 => ("1 run is".into(), "it"),
            _ => (format!("{solved} runs are"), "them"),
        };
        crate::output::say(&format!(
            "note: {runs} as long as it took to solve {them}; `trestle sweep --resume --out {} --set \
             run.stop_when_solved=false` prolongs {them}",
            args.out.display()
        ));
    }
    let failed = swept.outcomes.iter().filter(|outcome| matches!(outcome, Outcome::Failed(_))).count();
    if swept.interrupted {
        let out = args.out.display();
        crate::output::say(&format!("interrupted; `trestle sweep --resume --out {out}` goes on"));
        return Ok(ExitCode::from(INTERRUPTED));
    }
    ensure!(
        failed == 0,
        "{failed} of {} runs failed; `trestle sweep --resume --out {}` tries them again",
        sweep.jobs.len(),
        args.out.display()
    );
    outln!("next: trestle report {}", args.out.display());
    Ok(ExitCode::SUCCESS)
}

fn check(config: trestle_proto::config::Config) -> Result<Resolved> {
    if config.run.mode == Mode::Reference {
        bail!("run.mode = reference; accepted in a sweep: lockstep, which ends with the same weights");
    }
    resolve(config)
}

/// What a sweep is made of.
struct Asked {
    source: String,
    /// Settings of all arms, without the limits.
    sets: Vec<String>,
    limits: Limits,
    arms: Vec<Arm>,
    seeds: Vec<u64>,
    /// The tasks whose files are to be written.
    suite: Option<Suite>,
}

/// What was typed, or without a configuration the sweep that is there; of its limits those that were typed.
fn asked(args: &Args) -> Result<Asked> {
    if let Some(source) = &args.config {
        let seeds = args.seeds.as_ref().context("--seeds is not given; accepted: seeds, such as 0..10")?;
        // Where there is no sweep yet, --resume begins it.
        let there = Manifest::read(&args.out).ok().filter(|_| args.resume);
        there.as_ref().map_or(Ok(()), |there| there.check_limits(args.limits))?;
        let limits = there.map_or(args.limits, |there| args.limits.or(there.limits));
        let (sets, seeds) = (args.sets.clone(), seeds.0.clone());
        if source == SUITE {
            let (source, arms, suite) = on_suite(args)?;
            return Ok(Asked { source, sets, limits, arms, seeds, suite: Some(suite) });
        }
        ensure!(
            args.task_set.is_none(),
            "--task-set with {source}; accepted: with {SUITE} in the place of a configuration"
        );
        return Ok(Asked {
            source: source.clone(),
            sets,
            limits,
            arms: arms(args, source)?,
            seeds,
            suite: None,
        });
    }
    if let Some(share) = args.share {
        // A share changes nothing in sweep.json, which the other shares go by.
        ensure!(
            args.sets.is_empty() && args.limits == Limits::default(),
            "--share {share} with --set, --episodes or --env-steps; accepted without the sweep's configuration: these without \
             --share, for all runs of the sweep"
        );
    }
    let there = Manifest::read(&args.out)?;
    there.check_limits(args.limits)?;
    let sets = there.sets_with(&args.sets)?;
    let Manifest { source, limits, arms, seeds, .. } = there;
    let seeds = args.seeds.as_ref().map_or(seeds, |typed| typed.0.clone());
    Ok(Asked { source, sets, limits: args.limits.or(limits), arms, seeds, suite: None })
}

/// What stands for the configuration in sweep.json, the arms on all tasks, and the tasks.
fn on_suite(args: &Args) -> Result<(String, Vec<Arm>, Suite)> {
    let name = args
        .task_set
        .as_ref()
        .context("--task-set is not given; accepted: choosing, reporting, or a file")?;
    let arms: Vec<Arm> = args.algos.iter().chain(&args.arms).cloned().collect();
    ensure!(!arms.is_empty(), "{SUITE} without arms; accepted: --algos, such as dqn,ha-diiqn, or --arm");
    ensure!(args.over.is_empty(), "--over with {SUITE}; accepted: --arm, or a set of tasks of your own");
    let suite = Suite::load(name, &args.tasks)?;
    let arms = distinct(suite.arms(&arms))?;
    Ok((format!("{SUITE}:{name}"), arms, suite))
}

/// The arms as typed: plain algorithms first; without any, the configuration as it is.
fn arms(args: &Args, source: &str) -> Result<Vec<Arm>> {
    let mut arms: Vec<Arm> = args.algos.iter().chain(&args.arms).cloned().collect();
    if arms.is_empty() {
        let config = trestle_proto::config::load(registry(), source, &args.sets)?;
        arms.push(Arm::plain(config.run.algo));
    }
    distinct(cross(arms, &args.over))
}

/// `arms`, if there are not too many and their names differ.
fn distinct(arms: Vec<Arm>) -> Result<Vec<Arm>> {
    ensure!(
        arms.len() <= MAX_ARMS,
        "{} arms, those of --over and of tasks included; accepted: up to {MAX_ARMS}",
        arms.len()
    );
    let mut known = BTreeSet::new();
    for arm in &arms {
        ensure!(known.insert(&arm.name), "two arms are called {}; accepted: names that differ", arm.name);
    }
    Ok(arms)
}

/// A line an arm on standard output.
fn report(sweep: &Sweep, swept: &Swept) -> Result<()> {
    let width = sweep.arms.iter().map(String::len).max().unwrap_or(0).max("arm".len());
    outln!(
        "{:width$}  {:>8}  {:>6}  {:>18}  {:>20}  {:>6}",
        "arm",
        "complete",
        "solved",
        "median episodes",
        "median env steps",
        "failed"
    );
    for (number, name) in sweep.arms.iter().enumerate() {
        let of_arm = || {
            let both = sweep.jobs.iter().zip(&swept.outcomes);
            both.filter(|(job, _)| job.arm == number).map(|(_, outcome)| outcome)
        };
        // A share need not have runs of every arm.
        if of_arm().next().is_none() {
            continue;
        }
        let results: Vec<&RunResult> = of_arm()
            .filter_map(|outcome| match outcome {
                Outcome::Complete(result) => Some(result.as_ref()),
                _ => None,
            })
            .collect();
        let middle = |of: fn(&RunResult) -> Option<u64>| {
            let mut times: Vec<f64> =
                results.iter().map(|r| of(r).map_or(f64::INFINITY, |n| n as f64)).collect();
            let middle = median(&mut times);
            if middle.is_finite() { format!("{middle:.0}") } else { "not reached".into() }
        };
        let solved = results.iter().filter(|r| r.solved_episode.is_some()).count();
        let failed = of_arm().filter(|outcome| matches!(outcome, Outcome::Failed(_))).count();
        outln!(
            "{name:width$}  {:>8}  {solved:>6}  {:>18}  {:>20}  {failed:>6}",
            format!("{}/{}", results.len(), of_arm().count()),
            middle(|r| r.solved_episode),
            middle(|r| r.solved_env_steps)
        );
    }
    outln!(
        "medians are to \"solved\" over complete runs; one that was not solved counts as later than all others"
    );
    Ok(())
}

/// A line for each arm on each group of a suite's tasks.
fn by_group(sweep: &Sweep, swept: &Swept) -> Result<()> {
    let mut rows: Vec<((&str, &str), [usize; 4])> = Vec::new();
    for (job, outcome) in sweep.jobs.iter().zip(&swept.outcomes) {
        let place = place(&sweep.arms[job.arm]);
        let at = rows.iter().position(|(known, _)| *known == place).unwrap_or_else(|| {
            rows.push((place, [0; 4]));
            rows.len() - 1
        });
        let [runs, complete, solved, failed] = &mut rows[at].1;
        *runs += 1;
        match outcome {
            Outcome::Complete(result) => {
                *complete += 1;
                *solved += usize::from(result.solved_episode.is_some());
            }
            Outcome::Failed(_) => *failed += 1,
            Outcome::Unfinished => {}
        }
    }
    let width =
        |of: fn(&(&str, &str)) -> usize| rows.iter().map(|(place, _)| of(place)).max().unwrap_or(0).max(5);
    let (group, arm) = (width(|place| place.0.len()), width(|place| place.1.len()));
    outln!("{:group$}  {:arm$}  {:>11}  {:>6}  {:>6}", "tasks", "arm", "complete", "solved", "failed");
    for ((of, name), [runs, complete, solved, failed]) in rows {
        outln!("{of:group$}  {name:arm$}  {:>11}  {solved:>6}  {failed:>6}", format!("{complete}/{runs}"));
    }
    Ok(())
}
