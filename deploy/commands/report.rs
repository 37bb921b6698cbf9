//! `trestle report`

use crate::cli::Report as Args;
use crate::prepare;
use crate::status::ExitCode;
use anyhow::{Context, Result};
use trestle_actor::env::{Ground, registry};
use trestle_actor::worker::Worker;
use trestle_algorithm::agent::Agent;
use trestle_learner::checkpoint;
use trestle_link::logging;
use trestle_mentor_server::demo_file;
use trestle_proto::NONE;
use trestle_proto::config::RivalKind;
use trestle_proto::experiment::Experiment;
use trestle_proto::mentor::MentorTransitions;
use trestle_proto::rundir::RunDir;
use trestle_qnet::{Workspace, forward};
use trestle_report::maze::{Maze, Place, Step};
use trestle_report::over_tasks::{Overview, Total};
use trestle_report::read::read_runs;
use trestle_report::run::Run;
use trestle_report::stats::Estimate;
use trestle_report::summary::{Group, arms, tasks};
use trestle_report::write::{MAX_DRAWN, Report, write};

/// Mazes that are drawn, at most: of the first tasks, one for each arm.
const MAX_MAZES: usize = 24;

pub(super) fn run(args: &Args) -> Result<ExitCode> {
    logging::init(0, "report", "warn");
    let of = prepare::run_at(&args.runs)?;
    let (runs, mut notes) = read_runs(&of, |config| registry().filled(&config.env.name))?;
    let out = args.out.clone().unwrap_or_else(|| of.join("report"));
    let mut mazes = Vec::new();
    let tasks_found = tasks(&runs);
    let drawn = tasks_found.len() <= MAX_DRAWN;
    if !drawn {
        notes.push(format!(
            "no pictures of single tasks: there are {}, and pictures of up to {MAX_DRAWN} are drawn; `trestle report` draws \
             them for the directory of one task",
            tasks_found.len()
        ));
    }
    for task in tasks_found.iter().filter(|_| drawn) {
        for group in &task.groups {
            let Some(run) = middle(group) else { continue };
            if mazes.len() == MAX_MAZES {
                notes.push(format!("no maze of {} on {}: {MAX_MAZES} are drawn", group.arm, task.name));
                continue;
            }
            match maze(run) {
                Ok(Some(maze)) => mazes.push((task.name.to_string(), group.arm.to_string(), maze)),
                // The environment has no map.
                Ok(None) => {}
                Err(error) => {
                    notes.push(format!("no maze of {}: {}", run.path.display(), crate::output::words(&error)))
                }
            }
        }
    }
    for run in runs.iter().filter(|run| run.complete().is_none()) {
        notes.push(format!("{} has not run its whole length", run.path.display()));
    }
    let count = if runs.len() == 1 { "1 run".into() } else { format!("{} runs", runs.len()) };
    let title = format!("Trestle: {count} in {}", of.display());
    let count = notes.len();
    notes.iter().for_each(|note| crate::output::say(&format!("note: {note}")));
    for (arm, warning) in arms(&tasks(&runs)).iter().filter_map(|arm| Some((arm, arm.mentor?.warning()?))) {
        crate::output::say(&format!("warning: {}, {}: {warning}", arm.task, arm.arm));
    }
    if let Some(overview) =
        write(&Report { title, runs: &runs, notes, titles: !args.no_titles, mazes }, &out)?
    {
        over_tasks(&overview)?;
    }
    outln!("{} runs, {count} notes: {}", runs.len(), out.join("report.html").display());
    Ok(ExitCode::SUCCESS)
}

/// A line for each arm on each group of tasks.
fn over_tasks(overview: &Overview) -> Result<()> {
    let of = |total: &Total| total.group.clone().unwrap_or_else(|| "all".into());
    let widest = |of: &dyn Fn(&Total) -> usize| overview.totals.iter().map(of).max().unwrap_or(0).max(5);
    let (group, arm) = (widest(&|total| of(total).len()), widest(&|total| total.arm.len()));
    outln!(
        "{:group$}  {:arm$}  {:>6}  {:>17}  {:>6}  {:>8}",
        "tasks",
        "arm",
        "number",
        "geometric mean",
        "losses",
        "largest"
    );
    for total in &overview.totals {
        let Estimate { mid, low, high } = total.geometric_mean;
        let mean = format!("{mid:.2} [{low:.2}, {high:.2}]");
        let (of, name, worst) = (of(total), &total.arm, total.worst);
        outln!("{of:group$}  {name:arm$}  {:>6}  {mean:>17}  {:>6}  {worst:>8.2}", total.tasks, total.losses);
    }
    outln!("ratios of median environment steps until solved, to {}'s on the same task", overview.baseline);
    Ok(())
}

/// The complete run in the middle of its group by environment steps to solved: neither the luckiest nor the unluckiest.
fn middle<'a>(group: &Group<'a>) -> Option<&'a Run> {
    let mut runs: Vec<&'a Run> = group.runs.iter().copied().filter(|run| run.complete().is_some()).collect();
    let steps = |run: &Run| run.complete().and_then(|o| o.solved_env_steps).unwrap_or(u64::MAX);
    runs.sort_by_key(|run| (steps(run), run.config.run.seed));
    runs.get(runs.len().saturating_sub(1) / 2).copied()
}

/// `run` on its map, from its newest checkpoint; none where its environment has no map, or where the network sees a goal beside the
/// state, so that a place alone has no value.
fn maze(run: &Run) -> Result<Option<Maze>> {
    let dir = RunDir::new(&run.path);
    let aims = run.config.rival.kind == RivalKind::DShape;
    let Some(ground) = registry().ground(&run.config.env)?.filter(|_| !aims) else { return Ok(None) };
    let ground = ground.as_ref();
    let experiment = dir.read_plan()?.experiment;
    let (_, path) = checkpoint::newest_complete(dir.root())?.context("it has no complete checkpoint")?;
    let demonstration = match experiment.mentor_len() {
        0 => None,
        _ => Some(demo_file::read(&dir.demonstration())?.transitions()),
    };
    let agent = checkpoint::load(&path, &experiment, demonstration.clone())?.agent;
    let size = ground.size();
    let mentor = match &demonstration {
        Some(states) => mentor_steps(&agent, states, ground),
        None => led_steps(&experiment, ground),
    };
    let replay = agent.replay();
    let fine = ground.squares();
    let [columns, rows] = size.map(|side| side * fine);
    let mut visits = vec![0.0; columns * rows];
    let mut wide = Vec::new();
    for index in replay.first_index()..replay.next_index() {
        for place in ground.places(replay.obs(replay.slot(index)).wide(&mut wide)) {
            let [column, row] = place.map(|at| ((at + 0.5) * fine as f64).floor());
            if (0.0..columns as f64).contains(&column) && (0.0..rows as f64).contains(&row) {
                visits[row as usize * columns + column as usize] += 1.0;
            }
        }
    }
    Ok(Some(Maze {
        title: format!("{}, {}, seed {}", run.arm, run.task, run.config.run.seed),
        size,
        walls: squares(size).map(|cell| !ground.is_free(cell)).collect(),
        ends: ground.ends(),
        mentor,
        path: ground.places(&greedy_path(&experiment, agent.weights())?),
        fine,
        visits,
        values: values(&experiment, ground, agent.weights())?,
    }))
}

/// The mentor's steps in `states` on the map, with what `agent` has found out about each.
pub(super) fn mentor_steps(
    agent: &Agent,
    states: &MentorTransitions,
    ground: &dyn Ground,
) -> Vec<(Place, Place, Step)> {
    let mut steps = Vec::new();
    for (j, row) in agent.mentor_rows().into_iter().flatten().enumerate() {
        let step = match row.bridge {
            _ if row.feasible => Step::Feasible,
            Some(_) => Step::Bridged,
            None => Step::Infeasible,
        };
        let [from, to] = [row.state, states.next_state(j)].map(|state| ground.places(state));
        steps.extend(from.first().zip(to.first()).map(|(&from, &to)| (from, to, step)));
    }
    steps
}

/// The mentor's steps on the map where its path is only led along; none without a mentor.
pub(super) fn led_steps(experiment: &Experiment, ground: &dyn Ground) -> Vec<(Place, Place, Step)> {
    let Some(waypoints) = &experiment.waypoints else { return Vec::new() };
    let places = ground.places(&waypoints.states);
    let steps = waypoints.transition_of.iter().zip(places.windows(2)).filter(|(of, _)| **of != NONE);
    steps.map(|(_, pair)| (pair[0], pair[1], Step::Led)).collect()
}

/// All squares of a map, row by row.
pub(super) fn squares([columns, rows]: [usize; 2]) -> impl Iterator<Item = [usize; 2]> {
    (0..rows).flat_map(move |row| (0..columns).map(move |column| [column, row]))
}

/// The states of a greedy episode.
fn greedy_path(experiment: &Experiment, weights: &[f32]) -> Result<Vec<f32>> {
    let mut worker = Worker::new(experiment, 0)?;
    // As `trestle eval`: this evaluation's stream of resets is none of the training's.
    let evaluation = worker.evaluate(weights, u64::MAX, 1)?;
    Ok(evaluation.episodes.into_iter().next().map(|episode| episode.path).unwrap_or_default())
}

/// The largest Q-value in the middle of each square, at rest.
fn values(experiment: &Experiment, ground: &dyn Ground, weights: &[f32]) -> Result<Vec<f64>> {
    let (layout, encoding) = trestle_qnet::network_of(experiment)?;
    let fine = ground.squares();
    let size = ground.size().map(|side| side * fine);
    let middle = |square: [usize; 2]| square.map(|at| (at as f64 + 0.5) / fine as f64 - 0.5);
    let states: Vec<f32> = squares(size).flat_map(|square| ground.state(middle(square))).collect();
    let rows = size[0] * size[1];
    let mut x = vec![0.0; rows * layout.input()];
    encoding.encode_batch(&states, rows, &mut x);
    let mut q = vec![0.0; rows * layout.output()];
    forward(&layout, weights, &x, rows, &mut Workspace::new(&layout, rows), &mut q);
    let largest = |q: &[f32]| q.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    Ok(q.chunks_exact(layout.output()).map(|q| f64::from(largest(q))).collect())
}
