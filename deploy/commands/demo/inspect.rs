//! `trestle demo inspect`

use super::meet;
use super::picture::Picture;
use crate::cli::Inspect;
use crate::commands::picture::{as_kind, kind};
use crate::prepare;
use anyhow::{Context, Result};
use std::fs;
use trestle_actor::env::{Ground, registry};
use trestle_algorithm::demonstration::Demonstration;
use trestle_algorithm::similarity::metric::Metric;
use trestle_algorithm::summary::summarise;
use trestle_mentor_server::demo_file;
use trestle_proto::config::{self, CovarianceKind, Demos, Mentor};
use trestle_proto::rundir::RunDir;

/// The kinds of files that a demonstration can be drawn into.
const KINDS: [&str; 3] = ["svg", "png", "pdf"];

pub(super) fn run(args: &Inspect) -> Result<()> {
    let kind = args.picture.as_deref().map(|out| kind(out, &KINDS, args.overwrite)).transpose()?;
    let run = prepare::run_of(&args.demo);
    let dir = RunDir::new(run.as_ref().unwrap_or(&args.demo));
    let (file, own) = if run.is_some() || args.demo.is_dir() {
        (dir.demonstration(), Some(dir.config().display().to_string()))
    } else {
        (args.demo.clone(), None)
    };
    match args.config.as_ref().or(own.as_ref()) {
        Some(name) => {
            let mut config = config::load(registry(), name, &args.sets)?;
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
            let env = &resolved.config.env;
            let drawn = registry().draw(env, &[(mentors.all.states(), 'm')])?;
            let ground = registry().ground(env)?;
            let down = ground.as_ref().is_some_and(|ground| grows_down(ground.as_ref(), mentors.all.dim()));
            picture(args, kind, &mentors.all, down, drawn, ground.as_deref())
        }
        None => {
            let demonstration = demo_file::read(&file)?;
            let Mentor { n, sigma_floor, .. } = Mentor::default();
            let scale = vec![1.0; demonstration.dim()];
            let metric = Metric::from_config(
                CovarianceKind::Demonstration,
                sigma_floor,
                &scale,
                demonstration.states(),
            )?;
            outln!("{} by itself, KL in standard deviations of its own features", file.display());
            outln!("{}", summarise(&demonstration, &metric, n as usize, &[]).to_string().trim_end());
            outln!("With --config PRESET|CONFIG.TOML: the metric of that, its thresholds and its map");
            picture(args, kind, &demonstration, false, None, None)
        }
    }
}

/// Whether the second of `dim` features is a row of the map, which are counted from the top.
fn grows_down(ground: &dyn Ground, dim: usize) -> bool {
    let row = |second: f32| {
        let state: Vec<f32> = (0..dim).map(|feature| if feature == 1 { second } else { 0.0 }).collect();
        ground.places(&state).first().map(|place| place[1])
    };
    row(0.0) < row(1.0)
}

/// Draws on the terminal, on the map `drawn` where there is one and no axes are asked for, and into a file of `kind`; `down`
/// if the second feature grows downwards.
fn picture(
    args: &Inspect,
    kind: Option<&str>,
    demonstration: &Demonstration,
    down: bool,
    drawn: Option<String>,
    ground: Option<&dyn Ground>,
) -> Result<()> {
    let picture = Picture::new(demonstration, args.axes, down)?;
    match drawn {
        Some(map) if args.axes.is_none() => outln!("{map}"),
        _ => outln!("{}", picture.text()),
    }
    if let (Some(out), Some(kind)) = (&args.picture, kind) {
        // Walls are where the first two features say.
        let svg = picture.svg(ground.filter(|_| args.axes.is_none()));
        fs::write(out, as_kind(svg, kind)?).with_context(|| format!("cannot write {}", out.display()))?;
        outln!("drawing       {}", out.display());
    }
    Ok(())
}
