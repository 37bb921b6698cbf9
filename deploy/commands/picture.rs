//! An evaluation as a picture or a film.

use super::demo::free;
use super::report::{mentor_steps, squares};
use anyhow::{Context, Result, bail, ensure};
use std::fs;
use std::path::Path;
use trestle_actor::env::registry;
use trestle_algorithm::agent::Agent;
use trestle_learner::checkpoint;
use trestle_mentor_server::demo_file;
use trestle_proto::experiment::Experiment;
use trestle_proto::mentor::MentorTransitions;
use trestle_proto::rundir::RunDir;
use trestle_report::film::gif;
use trestle_report::maze::Maze;
use trestle_report::plot::{View, png};

/// The kinds of files that can be written.
const KINDS: [&str; 3] = ["gif", "png", "svg"];

/// The kind of file that `path` names by its end.
///
/// # Errors
/// None that can be written, or a file that is there and not to be replaced.
pub(super) fn kind(path: &Path, overwrite: bool) -> Result<&'static str> {
    let end = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    let Some(kind) = KINDS.into_iter().find(|kind| *kind == end) else {
        bail!("--picture {}; accepted: a name that ends in .{}", path.display(), KINDS.join(", ."));
    };
    free(path, overwrite)?;
    Ok(kind)
}

/// Writes the `path` of a greedy episode of the run in `dir`, into the file `out`.
///
/// # Errors
/// The environment has no map, or the file cannot be written.
pub(super) fn write(
    dir: &RunDir,
    experiment: &Experiment,
    path: &[f32],
    out: &Path,
    kind: &str,
) -> Result<()> {
    let config = &experiment.config;
    let Some(ground) = registry().ground(&config.env)? else {
        bail!(
            "--picture: {} has no map to draw; accepted: runs of environments with a map",
            experiment.spec.name
        );
    };
    let ground = ground.as_ref();
    ensure!(!path.is_empty(), "--picture: the episode is too long to be drawn");
    let size = ground.size();
    let maze = Maze {
        title: format!("{}, {}, seed {}", config.arm(), experiment.spec.name, config.run.seed),
        size,
        walls: squares(size).map(|cell| !ground.is_free(cell)).collect(),
        ends: ground.ends(),
        // A run that has lost its checkpoints still has a path.
        mentor: found_out(dir, experiment)
            .map_or_else(|_| Vec::new(), |(agent, states)| mentor_steps(&agent, &states, ground)),
        path: ground.places(path),
        fine: ground.squares(),
        visits: Vec::new(),
        values: Vec::new(),
    };
    let bytes = match kind {
        "gif" => gif(&maze)?,
        "png" => png(&maze.paths_svg(View::Paper)?)?,
        _ => maze.paths_svg(View::Paper)?.into_bytes(),
    };
    fs::write(out, bytes).with_context(|| format!("cannot write {}", out.display()))
}

/// What the run's newest checkpoint knows of the mentor's transitions, and these.
fn found_out(dir: &RunDir, experiment: &Experiment) -> Result<(Agent, MentorTransitions)> {
    ensure!(experiment.mentor_len() > 0, "the run has no mentor");
    let states = demo_file::read(&dir.demonstration())?.transitions();
    let (_, newest) = checkpoint::newest_complete(dir.root())?.context("it has no complete checkpoint")?;
    Ok((checkpoint::load(&newest, experiment, Some(states.clone()))?.agent, states))
}
