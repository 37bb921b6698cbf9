//! Runs as other versions of the program have left them, for the commands that only look at them.

use anyhow::Result;
use std::cmp::Ordering;
use trestle_actor::env::registry;
use trestle_proto::config;
use trestle_proto::experiment::Experiment;
use trestle_proto::limits::MAX_TEXT_BYTES;
use trestle_proto::regular_file;
use trestle_proto::rundir::RunDir;

/// The experiment of the run in `dir`. Where an earlier version of the program wrote its plan, its configuration stands in, without
/// the mentor, which no greedy episode needs.
///
/// # Errors
/// There is no run, a newer version wrote it, or neither its plan nor its configuration can be read.
pub(crate) fn read_experiment(dir: &RunDir) -> Result<Experiment> {
    match dir.read_plan() {
        Err(error) if error.other_version() == Some(Ordering::Less) => {}
        plan => return Ok(plan?.experiment),
    }
    let path = dir.config();
    let text = regular_file::read_to_string(&path, MAX_TEXT_BYTES)?;
    let mut config = config::parse_toml(&path.display().to_string(), &text)?;
    (config.exploration.guide_start, config.exploration.guide_end) = (0.0, 0.0);
    let spec = registry().build(&config.env)?.spec().clone();
    Ok(Experiment { config, spec, mentors: Vec::new(), waypoints: None })
}
