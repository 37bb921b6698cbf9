//! An evaluation as a picture or a film.

use super::free;
use super::report::{led_steps, mentor_steps, squares};
use anyhow::{Context, Result, bail, ensure};
use std::fs;
use std::path::Path;
use trestle_actor::env::{Frame, registry};
use trestle_actor::worker::Worker;
use trestle_algorithm::agent::Agent;
use trestle_learner::checkpoint;
use trestle_mentor_server::demo_file;
use trestle_proto::experiment::Experiment;
use trestle_proto::mentor::MentorTransitions;
use trestle_proto::rundir::RunDir;
use trestle_report::film::gif;
use trestle_report::footage::Footage;
use trestle_report::maze::Maze;
use trestle_report::plot::{View, pdf, png};

/// The kinds of files that an evaluation can be written to: on a map, and where the environment draws itself.
pub(super) const KINDS: [&str; 4] = ["gif", "png", "svg", "pdf"];
const FILM_KINDS: [&str; 3] = ["gif", "png", "svg"];

/// The kind of file that `path` names by its end, one of `kinds`.
///
/// # Errors
/// None that can be written, or a file that is there and not to be replaced.
pub(super) fn kind<'a>(path: &Path, kinds: &[&'a str], overwrite: bool) -> Result<&'a str> {
    let end = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    let Some(kind) = kinds.iter().copied().find(|kind| *kind == end) else {
        bail!("--picture {}; accepted: a name that ends in .{}", path.display(), kinds.join(", ."));
    };
    free(path, overwrite)?;
    Ok(kind)
}

/// `svg` as a file of `kind`: as it is, as PNG or as PDF.
///
/// # Errors
/// Drawing it.
pub(super) fn as_kind(svg: String, kind: &str) -> Result<Vec<u8>> {
    Ok(match kind {
        "png" => png(&svg)?,
        "pdf" => pdf(&svg)?,
        _ => svg.into_bytes(),
    })
}

/// A greedy episode that is to be drawn.
#[derive(Clone, Copy)]
pub(super) struct Drawn<'a> {
    pub(super) weights: &'a [f32],
    /// Number of the evaluation that it is the first one of.
    pub(super) evaluation: u64,
    /// Seed of the evaluation.
    pub(super) seed: u64,
    /// Its states, one after the other.
    pub(super) path: &'a [f32],
}

/// Writes an `episode` of the run in `dir` into the file `out`: its path on the map, or where there is none what the environment
/// itself draws.
///
/// # Errors
/// The environment has neither a map nor pictures, or the file cannot be written.
pub(super) fn write(
    dir: &RunDir,
    experiment: &Experiment,
    episode: Drawn<'_>,
    out: &Path,
    kind: &str,
) -> Result<()> {
    let config = &experiment.config;
    let path = episode.path;
    let Some(ground) = registry().ground(&config.env)? else { return film(experiment, episode, out, kind) };
    let ground = ground.as_ref();
    ensure!(!path.is_empty(), "--picture: the episode is too long to be drawn");
    let size = ground.size();
    let maze = Maze {
        title: format!("{}, {}, seed {}", config.arm(), experiment.spec.name, config.run.seed),
        size,
        walls: squares(size).map(|cell| !ground.is_free(cell)).collect(),
        ends: ground.ends(),
        // A run that has lost its checkpoints still has a path.
        mentor: found_out(dir, experiment).map_or_else(
            |_| led_steps(experiment, ground),
            |(agent, states)| mentor_steps(&agent, &states, ground),
        ),
        path: ground.places(path),
        fine: ground.squares(),
        visits: Vec::new(),
        values: Vec::new(),
    };
    let bytes = match kind {
        "gif" => gif(&maze)?,
        kind => as_kind(maze.paths_svg(View::Paper)?, kind)?,
    };
    put(out, &bytes)
}

fn put(out: &Path, bytes: &[u8]) -> Result<()> {
    fs::write(out, bytes).with_context(|| format!("cannot write {}", out.display()))
}

/// Plays `episode` again in an environment that draws itself, and writes what it looked like.
fn film(experiment: &Experiment, episode: Drawn<'_>, out: &Path, kind: &str) -> Result<()> {
    let none = || {
        let name = &experiment.spec.name;
        format!(
            "--picture: {name} has neither a map nor pictures; accepted: environments with a map, or with render_mode rgb_array"
        )
    };
    ensure!(
        FILM_KINDS.contains(&kind),
        "--picture {}: what an environment draws has pixels; accepted: a name that ends in .{}",
        out.display(),
        FILM_KINDS.join(", .")
    );
    let mut filmed = experiment.clone();
    filmed.config.run.seed = episode.seed;
    filmed.config.env = registry().filmed(&experiment.config.env)?.with_context(none)?;
    let mut footage = Footage::default();
    let mut see = |frame: Frame| footage.push(frame.width, frame.height, frame.rgb);
    let shown = Worker::new(&filmed, 0)
        .and_then(|mut worker| worker.film(episode.weights, episode.evaluation, &mut see))
        .context("--picture: the environment was made with render_mode rgb_array")?;
    ensure!(shown, none());
    let bytes = match kind {
        "gif" => footage.gif()?,
        "png" => footage.png()?,
        _ => footage.svg()?.into_bytes(),
    };
    put(out, &bytes)
}

/// What the run's newest checkpoint knows of the mentor's transitions, and these.
fn found_out(dir: &RunDir, experiment: &Experiment) -> Result<(Agent, MentorTransitions)> {
    ensure!(experiment.mentor_len() > 0, "the run has no mentor");
    let states = demo_file::read(&dir.demonstration())?.transitions();
    let (_, newest) = checkpoint::newest_complete(dir.root())?.context("it has no complete checkpoint")?;
    Ok((checkpoint::load(&newest, experiment, Some(states.clone()))?.agent, states))
}
