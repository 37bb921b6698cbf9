//! `trestle demo`

use crate::cli::Demo;
use crate::supervise::prepare::{self, Resolved};
use anyhow::{Context, Result, ensure};
use std::path::Path;
use std::process::ExitCode;
use trestle_actor::env::draw;
use trestle_mentor_server::demo_file;
use trestle_proto::config::{self, Algo, Config, Demos, PLAN};
use trestle_proto::rundir::RunDir;

pub(super) fn run(args: &Demo) -> Result<ExitCode> {
    match args {
        Demo::Plan { source, out, overwrite } => {
            let mut config = config::load(&source.config, &source.sets)?;
            config.mentor.demo = Demos::one(PLAN);
            ensure!(
                *overwrite || !out.exists(),
                "{} exists; accepted: another --out, or --overwrite",
                out.display()
            );
            let resolved = meet(config)?;
            let mentors = resolved.mentors.as_ref().context("the configuration has no mentor")?;
            let demonstration = &mentors.all;
            demo_file::write(out, demonstration)?;
            outln!(
                "{}: {} states, {} transitions",
                out.display(),
                demonstration.n_states(),
                demonstration.n_transitions()
            );
        }
        Demo::Inspect { demo, config, sets } => inspect(demo, config.as_deref(), sets)?,
    }
    Ok(ExitCode::SUCCESS)
}

/// Resolves `config` with a mentor, whatever its algorithm.
fn meet(mut config: Config) -> Result<Resolved> {
    if !config.run.algo.has_mentor() {
        config.run.algo = Algo::HaDiiqn;
    }
    prepare::resolve(config)
}

fn inspect(demo: &Path, config: Option<&str>, sets: &[String]) -> Result<()> {
    let dir = RunDir::new(demo);
    let (file, own) =
        if demo.is_dir() { (dir.demonstration(), Some(dir.config())) } else { (demo.into(), None) };
    let own = own.map(|path| path.display().to_string());
    let name = config.or(own.as_deref()).unwrap_or("maze30");
    let mut config = config::load(name, sets)?;
    config.mentor.demo = Demos::one(file.display().to_string());
    let resolved = meet(config)?;
    let mentors = resolved.mentors.as_ref().context("the configuration has no mentor")?;
    outln!("{} with the settings of {name}", file.display());
    outln!("{}", mentors.summary.to_string().trim_end());
    let mentor = &resolved.config.mentor;
    outln!("thresholds    mentor.e_th {}, mentor.e_infeas {}", mentor.e_th, mentor.e_infeas);
    for warning in resolved.warnings() {
        outln!("warning: {warning}");
    }
    outln!("{}", draw(&resolved.config.env, &[(mentors.all.states(), 'm')])?);
    Ok(())
}
