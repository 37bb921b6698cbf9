//! `trestle demo record`

use super::report;
use crate::cli::Record;
use crate::commands::free;
use crate::itself;
use crate::prepare;
use crate::stored::read_experiment;
use anyhow::{Context, Result, ensure};
use trestle_actor::worker::Worker;
use trestle_algorithm::demonstration::Demonstration;
use trestle_learner::checkpoint;
use trestle_link::logging;
use trestle_mentor_server::demo_file;
use trestle_proto::rundir::RunDir;
use trestle_proto::space::Success;

/// The evaluation whose stream of resets the first episode draws from; the others count down from it. Those of training
/// count up from 0, and `trestle eval` has the one above.
const FIRST_EVALUATION: u64 = u64::MAX - 1;

pub(super) fn run(args: &Record) -> Result<()> {
    logging::init(0, "record", "warn");
    free(&args.out, args.overwrite)?;
    let dir = RunDir::new(prepare::run_at(&args.run)?);
    let experiment = read_experiment(&dir)?;
    itself::hand_over(&experiment.config.env)?;
    let (_, path) = checkpoint::newest_complete(dir.root())?
        .with_context(|| format!("{} holds no complete checkpoint", dir.checkpoints().display()))?;
    let (layout, _) = trestle_qnet::network_of(&experiment)?;
    let weights = checkpoint::load_model(&path, &layout)?;
    let mut worker = Worker::new(&experiment, 0)?;
    ensure!(
        args.all || experiment.success() != Success::Undefined,
        "{}: nothing says which episodes of {} succeed; accepted: --all, or a run with eval.threshold",
        args.run.display(),
        experiment.spec.name
    );

    let mut demonstration =
        Demonstration::new((0..experiment.spec.obs_dim()).map(|i| format!("s{i}")).collect())?;
    let (mut reached, mut repeated, mut total, mut steps) = (0_u32, 0_u32, 0.0, 0);
    for episode in 0..args.episodes {
        let evaluation = FIRST_EVALUATION - u64::from(episode);
        let played = worker.evaluate(&weights, evaluation, 1)?;
        let played = played.episodes.first().context("an evaluation without an episode")?;
        total += played.episode.total_reward;
        steps += played.episode.length;
        let succeeded = played.episode.success == Some(true);
        reached += u32::from(succeeded);
        if !(succeeded || args.all) {
            continue;
        }
        ensure!(
            !played.path.is_empty(),
            "episode {episode} has {} steps, too many to record; accepted: fewer, as env.step_limit makes them",
            played.episode.length
        );
        if holds(&demonstration, &played.path, played.terminated) {
            repeated += 1;
        } else {
            demonstration.push_trajectory(&played.path, played.terminated)?;
        }
    }
    let n = f64::from(args.episodes);
    let share = match experiment.success() {
        Success::Undefined => format!("{} greedy episodes", args.episodes),
        _ => format!("{reached} of {} greedy episodes succeed", args.episodes),
    };
    let figures = format!("{share}, mean return {:.3}, mean steps {:.1}", total / n, steps as f64 / n);
    ensure!(
        demonstration.n_trajectories() > 0,
        "{}: {figures}, with checkpoint {}; accepted: a run that succeeds, or --all to record what it does instead",
        args.run.display(),
        path.display()
    );
    demo_file::write(&args.out, &demonstration)?;
    outln!("{}, checkpoint {}", experiment.spec.name, path.display());
    outln!("{figures}");
    if repeated > 0 {
        outln!("note: {repeated} episodes that repeat an earlier one state by state left out");
    }
    report(&args.out, &demonstration)
}

/// Whether `demonstration` has a trajectory of just these states.
fn holds(demonstration: &Demonstration, path: &[f32], terminal: bool) -> bool {
    let dim = demonstration.dim();
    (0..demonstration.n_trajectories()).any(|i| {
        let states = demonstration.trajectory(i);
        demonstration.terminal(i) == terminal
            && demonstration.states()[states.start * dim..states.end * dim] == *path
    })
}
