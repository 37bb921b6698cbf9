//! `trestle config`

use crate::cli::{Config, Source};
use crate::supervise::prepare;
use anyhow::Result;
use std::process::ExitCode;
use trestle_proto::config;

pub(super) fn run(args: &Config) -> Result<ExitCode> {
    match args {
        Config::Show(source) => print!("{}", config::to_toml(&load(source)?)),
        Config::Check(source) => {
            let resolved = prepare::resolve(load(source)?)?;
            let spec = &resolved.spec;
            println!("{}: a run could start", source.config);
            println!(
                "  environment    {}, {} features, actions {}",
                spec.name,
                spec.obs_dim(),
                spec.actions.join(" ")
            );
            if let Some(best) = spec.best_return {
                println!("  best return    {best:.2}");
            }
            if let Some(demonstration) = &resolved.demonstration {
                println!("  demonstration  {} transitions", demonstration.n_transitions());
            }
            if let Some(warning) = resolved.warning() {
                println!("warning: {warning}");
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn load(source: &Source) -> Result<config::Config> {
    Ok(config::load(&source.config, &source.sets)?)
}
