//! `trestle sweep --submit`

use crate::cli::{Scheduler, Sweep as Args};
use crate::itself;
use crate::output::say;
use crate::prepare::Needs;
use crate::status::ExitCode;
use crate::submit::kubernetes::{self, without};
use crate::submit::options::Options;
use crate::submit::{slurm, tasks, unfinished};
use crate::sweep::jobs;
use crate::sweep::manifest::Manifest;
use crate::sweep::suite::{SUITE, Suite};
use anyhow::{Context, Result, ensure};
use std::env::{current_dir, current_exe};
use std::path::{Path, absolute};
use trestle_actor::env::again;

/// Flags of `sweep` that say where and how it runs, and whether they have a value.
const PLACE: [(&str, bool); 9] = [
    ("--submit", true),
    ("--slurm", true),
    ("--kubernetes", true),
    ("--dry-run", false),
    ("--out", true),
    ("--jobs", true),
    ("--resume", false),
    ("--watch", false),
    ("--quiet", false),
];

/// Hands the sweep `manifest` to `scheduler`. Each arm has been resolved, and a run `needs` no more than that.
pub(super) fn run(
    args: &Args,
    scheduler: Scheduler,
    manifest: &Manifest,
    suite: Option<&Suite>,
    needs: &Needs,
) -> Result<ExitCode> {
    ensure!(
        scheduler == Scheduler::Slurm || args.slurm.is_empty(),
        "--slurm with --submit kubernetes; accepted: --kubernetes"
    );
    ensure!(
        scheduler == Scheduler::Kubernetes || args.kubernetes.is_empty(),
        "--kubernetes with --submit slurm; accepted: --slurm"
    );
    match scheduler {
        Scheduler::Slurm => to_slurm(args, manifest, suite),
        Scheduler::Kubernetes => to_kubernetes(args, manifest, suite, needs),
    }
}

fn to_slurm(args: &Args, manifest: &Manifest, suite: Option<&Suite>) -> Result<ExitCode> {
    let out = absolute(&args.out).with_context(|| format!("cannot find {}", args.out.display()))?;
    let here = current_dir().context("cannot find the working directory")?;
    let union = match args.dry_run {
        true => manifest.united(&args.out, args.resume)?,
        false => manifest.claim(&args.out, args.resume)?,
    };
    if let Some(suite) = suite.filter(|_| !args.dry_run) {
        suite.write(&args.out)?;
    }
    // A dry run of a suite has no demonstrations yet, and so nothing that could be finished.
    let Manifest { source, sets, limits, arms, seeds, .. } = &union;
    let runs = arms.len() * seeds.len();
    let left = match args.dry_run && !args.resume {
        true => (0..tasks(runs)).collect(),
        false => unfinished(&jobs(source, sets, *limits, arms, seeds, &args.out)?, tasks(runs)),
    };
    if left.is_empty() {
        say(&format!("all {runs} runs are complete; next: trestle report {}", args.out.display()));
        return Ok(ExitCode::SUCCESS);
    }
    let program = program_words()?;
    let options = Options::joined(&args.slurm);
    let job = slurm::Job {
        program: &program,
        out: &out,
        here: &here,
        runs,
        left: &left,
        at_once: args.jobs,
        options: &options,
    };
    if args.dry_run {
        outln!("{}", job.script()?.trim_end());
        return Ok(ExitCode::SUCCESS);
    }
    outln!("{}", job.submit()?);
    let out = args.out.display();
    say(&format!("next: trestle watch {out}; when it is done, trestle report {out}"));
    Ok(ExitCode::SUCCESS)
}

fn to_kubernetes(args: &Args, manifest: &Manifest, suite: Option<&Suite>, needs: &Needs) -> Result<ExitCode> {
    ensure!(
        args.config.is_some() && suite.is_none(),
        "--submit kubernetes {}; accepted: a preset or a configuration file, and --seeds",
        if suite.is_some() { format!("with {SUITE}") } else { "without a configuration".into() }
    );
    let typed: Vec<String> = itself::args()
        .iter()
        .skip_while(|arg| *arg != "sweep")
        .skip(1)
        .map(|arg| arg.to_str().map(Into::into).context("an argument that is no text; accepted: UTF-8"))
        .collect::<Result<_>>()?;
    let typed = without(&typed, &PLACE);
    let options = Options::joined(&args.kubernetes);
    let job = kubernetes::Job {
        typed: &typed,
        source: &manifest.source,
        out: &args.out,
        runs: manifest.arms.len() * manifest.seeds.len(),
        shared_memory: needs.shared_memory,
        at_once: args.jobs,
        options: &options,
    };
    if args.dry_run {
        outln!("{}", job.manifest()?.trim_end());
    } else {
        job.submit()?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The words that start this program on another host, where the same file is in the same place.
fn program_words() -> Result<Vec<String>> {
    let words = again();
    if words.iter().all(|word| Path::new(word).starts_with("/proc")) {
        let file = current_exe().context("cannot find this program's file")?;
        return Ok(vec![file.to_str().context("this program's path is no text; accepted: UTF-8")?.into()]);
    }
    Ok(words)
}
