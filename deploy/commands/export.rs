//! `trestle export`

use super::eval::{Chosen, choose};
use super::free;
use crate::cli::{Export, Format};
use crate::export::{Network, file, model};
use crate::prepare;
use crate::status::ExitCode;
use crate::stored::read_experiment;
use anyhow::{Context, Result};
use std::io::Write;
use trestle_actor::env::registry;
use trestle_proto::rundir::{Durable, RunDir, write_atomically};

pub(super) fn run(args: &Export) -> Result<ExitCode> {
    free(&args.out, args.overwrite)?;
    let dir = RunDir::new(prepare::run_at(&args.run)?);
    let experiment = read_experiment(&dir)?;
    let (layout, encoding) = trestle_qnet::network_of(&experiment)?;
    let Chosen { tick, path, weights } = choose(&dir, args.checkpoint, &layout)?;
    let env = registry().build(&experiment.config.env)?;
    let features = env.features().into_iter().map(String::from).collect();
    let network = Network::new(&experiment, tick, features, &layout, encoding, &weights);
    let bytes = match args.format {
        Format::Onnx => model(&network),
        Format::Safetensors => file(&network)?,
    };
    write_atomically(&args.out, Durable::Later, |file| file.write_all(&bytes))
        .with_context(|| format!("cannot write {}", args.out.display()))?;
    outln!(
        "{}: {} features to the values of {} actions, checkpoint {}",
        args.out.display(),
        network.low.len(),
        network.actions.len(),
        path.display()
    );
    Ok(ExitCode::SUCCESS)
}
