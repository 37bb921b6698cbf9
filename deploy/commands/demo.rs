//! `trestle demo`

mod import;
mod inspect;
mod picture;
mod record;

use crate::cli::Demo;
use crate::prepare::{self, Resolved};
use anyhow::{Context, Result, ensure};
use std::path::Path;
use std::process::ExitCode;
use trestle_actor::env::registry;
use trestle_algorithm::demonstration::Demonstration;
use trestle_mentor_server::demo_file;
use trestle_proto::config::{self, Algo, Config, Demos, PLAN};

pub(super) fn run(args: &Demo) -> Result<ExitCode> {
    match args {
        Demo::Plan { source, out, overwrite } => {
            let mut config = config::load(registry(), &source.config, &source.sets)?;
            config.mentor.demo = Demos::one(PLAN);
            free(out, *overwrite)?;
            let resolved = meet(config)?;
            let mentors = resolved.mentors.as_ref().context("the configuration has no mentor")?;
            let demonstration = &mentors.all;
            demo_file::write(out, demonstration)?;
            report(out, demonstration)?;
        }
        Demo::Record(args) => record::run(args)?,
        Demo::Import(args) => import::run(args)?,
        Demo::Inspect(args) => inspect::run(args)?,
    }
    Ok(ExitCode::SUCCESS)
}

/// Refuses to write where something is, unless that was asked for.
pub(super) fn free(out: &Path, overwrite: bool) -> Result<()> {
    ensure!(overwrite || !out.exists(), "{} exists; accepted: another --out, or --overwrite", out.display());
    Ok(())
}

/// What has been written.
fn report(out: &Path, demonstration: &Demonstration) -> Result<()> {
    let count = demonstration.n_trajectories();
    outln!(
        "{}: {} states, {} transitions in {count} trajectories, {} ending in a terminal state",
        out.display(),
        demonstration.n_states(),
        demonstration.n_transitions(),
        (0..count).filter(|&i| demonstration.terminal(i)).count()
    );
    Ok(())
}

/// Resolves `config` with a mentor, whatever its algorithm.
fn meet(mut config: Config) -> Result<Resolved> {
    if !config.run.algo.has_mentor() {
        config.run.algo = Algo::HaDiiqn;
    }
    prepare::resolve(config)
}
