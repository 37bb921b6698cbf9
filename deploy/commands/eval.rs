//! `trestle eval`

use super::picture::{self, Drawn};
use crate::cli::{Eval, Which};
use crate::itself;
use crate::output::say;
use crate::prepare;
use crate::status::ExitCode;
use crate::stored::read_experiment;
use anyhow::{Context, Result, bail};
use serde::Serialize;
use std::path::{Path, PathBuf};
use trestle_actor::env::registry;
use trestle_actor::worker::Worker;
use trestle_learner::checkpoint;
use trestle_link::logging;
use trestle_proto::config::RivalKind;
use trestle_proto::episode::Episode;
use trestle_proto::round::Round;
use trestle_proto::rundir::RunDir;
use trestle_qnet::Layout;

/// Checkpoints that a refusal names, at most.
const MAX_NAMED: usize = 6;

/// Number of the evaluation. Those of training count up from 0: this one's stream of resets is none of theirs.
const EVALUATION: u64 = u64::MAX;

/// What `--json` prints.
#[derive(Serialize)]
struct Figures {
    /// The run's directory, as it was typed.
    run: String,
    /// The checkpoint's tick.
    checkpoint: u64,
    episodes: usize,
    mean_return: f64,
    mean_steps: f64,
    /// 0 to 1; null where success is not defined.
    success_rate: Option<f64>,
    /// The return that counts as optimal; null where none is known.
    threshold: Option<f64>,
}

pub(super) fn run(args: &Eval) -> Result<ExitCode> {
    logging::init(0, "eval", "warn");
    let dir = RunDir::new(prepare::run_at(&args.run)?);
    for aside in prepare::replaced(dir.root()) {
        say(&format!(
            "note: {} waits for the end of an --overwrite of {}",
            aside.display(),
            args.run.display()
        ));
    }
    let kind =
        args.picture.as_deref().map(|out| picture::kind(out, &picture::KINDS, args.overwrite)).transpose()?;
    let experiment = read_experiment(&dir)?;
    itself::hand_over(&experiment.config.env)?;
    let (layout, _) = trestle_qnet::network_of(&experiment)?;
    let Chosen { tick, path, weights } = choose(&dir, args.checkpoint, &layout)?;
    // The map and the network are made: only the random streams of the evaluation go by the seed from here on.
    let mut played = experiment.clone();
    played.config.run.seed = args.seed.unwrap_or(experiment.config.run.seed);
    let mut worker = Worker::new(&played, 0)?;
    let evaluation = worker.evaluate(&weights, EVALUATION, args.episodes)?;

    let episodes = &evaluation.episodes;
    let n = episodes.len() as f64;
    let mean =
        |of: &dyn Fn(&Episode) -> f64| episodes.iter().map(|played| of(&played.episode)).sum::<f64>() / n;
    let defined = episodes.iter().all(|played| played.episode.success.is_some());
    let figures = Figures {
        run: args.run.display().to_string(),
        checkpoint: tick.into(),
        episodes: episodes.len(),
        mean_return: mean(&|e| e.total_reward),
        mean_steps: mean(&|e| e.length as f64),
        success_rate: defined.then(|| mean(&|e| f64::from(u8::from(e.success == Some(true))))),
        threshold: experiment.threshold(),
    };
    if let Some((out, kind)) = args.picture.as_deref().zip(kind) {
        let path = episodes.first().map_or(&[][..], |episode| &episode.path);
        let (weights, seed) = (&weights, played.config.run.seed);
        let episode = Drawn { weights, evaluation: EVALUATION, seed, path };
        picture::write(&dir, &experiment, episode, out, kind)?;
    }
    if args.json {
        outln!("{}", serde_json::to_string(&figures).context("cannot encode the figures")?);
        return Ok(ExitCode::SUCCESS);
    }
    outln!("{}, checkpoint {}", experiment.spec.name, path.display());
    outln!("  episodes      {}", figures.episodes);
    outln!("  mean return   {:.3}", figures.mean_return);
    outln!("  mean steps    {:.1}", figures.mean_steps);
    if let Some(rate) = figures.success_rate {
        outln!("  success rate  {rate:.2}");
    }
    if let Some(threshold) = figures.threshold {
        outln!("  threshold     {threshold:.3}");
    }
    // With D-Shape every other state of a path is a goal.
    let aims = experiment.config.rival.kind == RivalKind::DShape;
    if let Some(episode) = episodes.first().filter(|episode| !episode.path.is_empty() && !aims)
        && let Some(drawn) = registry().draw(&experiment.config.env, &[(&episode.path, 'o')])?
    {
        outln!("{drawn}");
    }
    if let Some(out) = &args.picture {
        outln!("picture: {}", out.display());
    }
    Ok(ExitCode::SUCCESS)
}

/// The weights that are asked for.
pub(super) struct Chosen {
    pub(super) tick: Round,
    /// Where they are.
    pub(super) path: PathBuf,
    pub(super) weights: Vec<f32>,
}

pub(super) fn choose(dir: &RunDir, which: Which, layout: &Layout) -> Result<Chosen> {
    let root = dir.root();
    let (tick, path) = match which {
        Which::Best => {
            let (best, weights) = checkpoint::load_best(root, layout).with_context(|| {
                format!(
                    "--checkpoint best: {} has no weights of a best evaluation; accepted: last",
                    root.display()
                )
            })?;
            return Ok(Chosen { tick: best.tick, path: dir.best(), weights });
        }
        Which::Last => checkpoint::newest_complete(root)?
            .with_context(|| format!("{} holds no complete checkpoint", dir.checkpoints().display()))?,
        Which::Tick(tick) => find(root, tick.into())?,
    };
    let weights = checkpoint::load_model(&path, layout)?;
    Ok(Chosen { tick, path, weights })
}

/// Tick and directory of the checkpoint of `tick`.
fn find(root: &Path, tick: Round) -> Result<(Round, PathBuf)> {
    let mut ticks = checkpoint::complete(root)?;
    if ticks.contains(&tick) {
        return Ok((tick, checkpoint::directory(root, tick)));
    }
    let all = ticks.len();
    ticks.sort_by_key(|found| (found.since(tick).max(tick.since(*found)), *found));
    ticks.truncate(MAX_NAMED);
    ticks.sort_unstable();
    let named: Vec<String> = ticks.iter().map(Round::to_string).collect();
    let nearest = if all > MAX_NAMED { ", the nearest of them" } else { "" };
    bail!(
        "--checkpoint {tick}: {} holds no complete checkpoint of this tick; accepted: last, best{}{}{nearest}",
        root.display(),
        if named.is_empty() { "" } else { ", " },
        named.join(", ")
    )
}
