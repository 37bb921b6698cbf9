//! `trestle resume`

use super::train;
use crate::cli::Resume;
use crate::prepare::{self, Existing};
use crate::status::ExitCode;
use crate::sweep::manifest::Manifest;
use anyhow::{Context, Result, ensure};
use trestle_actor::env::registry;
use trestle_link::logging;
use trestle_proto::config;
use trestle_proto::rundir::RunDir;

pub(super) fn run(args: &Resume) -> Result<ExitCode> {
    logging::init(0, "supervisor", "warn");
    let root = prepare::run_of(&args.run).unwrap_or_else(|| args.run.clone());
    // What a killed --overwrite has left may be the very run.
    prepare::recover(&root)?.iter().for_each(|note| crate::output::say(note));
    let path = RunDir::new(&root).config();
    ensure!(
        path.exists() || !Manifest::path(&root).exists(),
        "{0} holds a sweep and not one run; accepted: `trestle sweep --resume --out {0}`, which goes on with all of its runs",
        root.display()
    );
    // A start that gives the directory up removes the configuration before the plan. Then there is nothing to put back.
    ensure!(
        path.exists() || !RunDir::new(&root).plan().exists() || prepare::nothing_saved(&root),
        "{} is missing, which says what the run in {} is; accepted: to put it back, from a copy or from a run of the same \
         command",
        path.display(),
        root.display()
    );
    // A start writes the configuration first, and what belongs to it before the plan.
    ensure!(
        path.exists() && !prepare::is_unborn(&root),
        "{0} holds no run to go on with; accepted: a run's directory, or `trestle train CONFIG --resume --out {0}`, which \
         begins one there",
        root.display()
    );
    let config = config::load_with(registry(), &path.display().to_string(), &args.sets, |config| {
        args.limits.apply(config);
    })
    .with_context(|| format!("{} is no run to go on with", root.display()))?;
    train::show(args.beside, &root)?;
    train::go(config, &root, Existing::Resume, &args.remote, args.quiet)
}
