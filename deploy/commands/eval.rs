//! `trestle eval`

use crate::cli::Eval;
use crate::output::say;
use crate::prepare;
use crate::stored::read_plan;
use anyhow::{Context, Result};
use std::process::ExitCode;
use trestle_actor::env::registry;
use trestle_actor::worker::Worker;
use trestle_learner::checkpoint;
use trestle_link::logging;
use trestle_proto::rundir::RunDir;

pub(super) fn run(args: &Eval) -> Result<ExitCode> {
    logging::init(0, "eval", "warn");
    let dir = RunDir::new(&args.run);
    for aside in prepare::replaced(dir.root()) {
        say(&format!(
            "note: {} waits for the end of an --overwrite of {}",
            aside.display(),
            args.run.display()
        ));
    }
    let plan = read_plan(&dir)?;
    let (_, path) = checkpoint::newest_complete(dir.root())?
        .with_context(|| format!("{} holds no complete checkpoint", dir.checkpoints().display()))?;
    let (layout, _) = trestle_qnet::network_of(&plan)?;
    let weights = checkpoint::load_model(&path, &layout)?;
    let mut worker = Worker::new(&plan, 0)?;
    // Evaluations of training count up from 0; this one's stream of resets is none of theirs.
    let evaluation = worker.evaluate(&weights, u64::MAX, args.episodes)?;

    let n = evaluation.episodes.len() as f64;
    let mean = |of: &dyn Fn(&trestle_proto::reply::EvaluationEpisode) -> f64| {
        evaluation.episodes.iter().map(of).sum::<f64>() / n
    };
    outln!("{}, checkpoint {}", plan.spec.name, path.display());
    outln!("  episodes      {}", evaluation.episodes.len());
    outln!("  mean return   {:.3}", mean(&|e| e.total_reward));
    outln!("  mean steps    {:.1}", mean(&|e| e.length as f64));
    let defined = evaluation.episodes.iter().all(|episode| episode.success.is_some());
    if defined {
        outln!("  success rate  {:.2}", mean(&|e| f64::from(u8::from(e.success == Some(true)))));
    }
    if let Some(threshold) = plan.threshold() {
        outln!("  threshold     {threshold:.3}");
    }
    if let Some(episode) = evaluation.episodes.first().filter(|episode| !episode.path.is_empty())
        && let Some(drawn) = registry().draw(&plan.config.env, &[(&episode.path, 'o')])?
    {
        outln!("{drawn}");
    }
    Ok(ExitCode::SUCCESS)
}
