//! Runs as other versions of the program have left them, for the commands that only look at them.

use anyhow::Result;
use std::cmp::Ordering;
use trestle_actor::env::registry;
use trestle_proto::config;
use trestle_proto::limits::MAX_TEXT_BYTES;
use trestle_proto::plan::RunPlan;
use trestle_proto::regular_file;
use trestle_proto::rundir::RunDir;

/// The plan of the run in `dir`. Where an earlier version of the program wrote it, its configuration stands in, without the mentor,
/// which no greedy episode needs.
///
/// # Errors
/// There is no run, a newer version wrote it, or neither its plan nor its configuration can be read.
pub(crate) fn read_plan(dir: &RunDir) -> Result<RunPlan> {
    match dir.read_plan() {
        Err(error) if error.other_version() == Some(Ordering::Less) => {}
        plan => return Ok(plan?),
    }
    let path = dir.config();
    let text = regular_file::read_to_string(&path, MAX_TEXT_BYTES)?;
    let mut config = config::parse_toml(&path.display().to_string(), &text)?;
    (config.exploration.guide_start, config.exploration.guide_end) = (0.0, 0.0);
    let spec = registry().build(&config.env)?.spec().clone();
    Ok(RunPlan {
        history: 0,
        run: 0,
        config,
        spec,
        mentors: Vec::new(),
        waypoints: None,
        resume_tick: None,
        restarts: 0,
        generation: 0,
    })
}
