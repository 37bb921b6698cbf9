//! The process that learns: it feeds [`trestle_algorithm::agent::Agent`], and keeps records and checkpoints.

pub mod checkpoint;
mod rebuild;
pub mod record;
pub mod run;
pub mod session;
mod timeline;

// The run that the algorithm's own tests are about.
#[cfg(test)]
#[path = "../../algorithm/src/testing.rs"]
mod testing;

/// The plan of [`testing::experiment`].
#[cfg(test)]
fn plan(sets: &[&str]) -> trestle_proto::plan::RunPlan {
    let life = trestle_proto::plan::Life { run: 1, history: 7, ..Default::default() };
    trestle_proto::plan::RunPlan { life, experiment: testing::experiment(sets) }
}
