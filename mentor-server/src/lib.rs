//! Demonstrations, action inference, feasibility and bridges, and the process that answers for them.
//!
//! The way of an observer transition through this crate: [`mentor`] takes it in, [`history`] stores it,
//! [`inference`] compares it with every mentor transition, [`bridge`] looks for paths that it completes, and
//! [`trestle_proto::similarity`] names the mentor states that its own state resembles; all distances come from there.
//! [`import`] makes demonstrations from the files of others.

pub mod bridge;
pub mod demo_file;
pub mod demonstration;
pub mod history;
pub mod import;
pub mod inference;
pub mod mentor;
pub mod run;
pub mod states;
pub mod summary;
#[cfg(test)]
// Its properties meet the same point sets as those of the index.
#[path = "../../proto/src/similarity/testing.rs"]
mod testing;
