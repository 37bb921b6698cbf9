//! `trestle config`

use crate::cli::{Config, Source};
use crate::prepare;
use anyhow::Result;
use std::process::ExitCode;
use trestle_proto::config;

pub(super) fn run(args: &Config) -> Result<ExitCode> {
    match args {
        Config::Show(source) => show(&load(source)?)?,
        Config::Check(source) => {
            let resolved = prepare::resolve(load(source)?)?;
            let spec = &resolved.spec;
            outln!("{}: a run could start", source.config);
            outln!(
                "  environment    {}, {} features, actions {}",
                spec.name,
                spec.obs_dim(),
                spec.actions.join(" ")
            );
            if let Some(best) = spec.best_return {
                outln!("  best return    {best:.2}");
            }
            if let Some(threshold) = resolved.config.eval.threshold {
                outln!("  threshold      {threshold:.2}");
            }
            if let Some(mentors) = &resolved.mentors {
                outln!("  demonstration  {} transitions", mentors.all.n_transitions());
            }
            for warning in resolved.warnings() {
                outln!("warning: {warning}");
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Every setting; what is not set, which TOML cannot say, as comments.
fn show(config: &config::Config) -> Result<()> {
    outln!("{}", config::to_toml(config).trim_end());
    let unset = [
        ("run.episodes", config.run.episodes.is_none()),
        ("run.env_steps", config.run.env_steps.is_none()),
        ("env.layout", config.env.layout.is_none()),
        ("eval.threshold", config.eval.threshold.is_none()),
    ];
    for (key, _) in unset.iter().filter(|(_, unset)| *unset) {
        outln!("# {key} is not set");
    }
    Ok(())
}

fn load(source: &Source) -> Result<config::Config> {
    Ok(config::load(&source.config, &source.sets)?)
}
