//! `trestle demo`

mod import;
mod inspect;
mod picture;
mod record;

use super::free;
use crate::cli::{Demo, Plan, Source};
use crate::prepare::{self, Resolved};
use crate::status::ExitCode;
use anyhow::Result;
use std::path::Path;
use trestle_actor::env::registry;
use trestle_algorithm::demonstration::Demonstration;
use trestle_mentor_server::demo_file;
use trestle_proto::config::{self, Algo, Config, Demos, PLAN};
use trestle_suite::mentor::{Wanted, demonstration};

pub(super) fn run(args: &Demo) -> Result<ExitCode> {
    match args {
        Demo::Plan(args) => plan(args)?,
        Demo::Record(args) => record::run(args)?,
        Demo::Import(args) => import::run(args)?,
        Demo::Inspect(args) => inspect::run(args)?,
    }
    Ok(ExitCode::SUCCESS)
}

fn plan(args: &Plan) -> Result<()> {
    let Source { config: source, sets } = &args.source;
    let mut config = config::load(registry(), source, sets)?;
    free(&args.out, args.overwrite)?;
    let map = config.env.own.get("map").and_then(|map| map.as_str()).unwrap_or_default().to_string();
    // All else that the configuration names is checked, too.
    config.mentor.demo = Demos::one(PLAN);
    meet(config)?;
    let demonstration = demonstration(&Wanted {
        source,
        sets,
        map: &map,
        mentor: args.mentor,
        seed: args.mentor_seed,
        trajectories: args.trajectories,
    })?;
    demo_file::write(&args.out, &demonstration)?;
    report(&args.out, &demonstration)
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
