//! Demonstrations, action inference, feasibility and bridges, and the process that answers for them.
//!
//! The way of an observer transition through this crate: [`mentor`] takes it in, [`history`] stores it,
//! [`inference`] compares it with every mentor transition, [`bridge`] looks for paths that it completes, and
//! [`similarity`] names the mentor states that its own state resembles. All distances come from [`metric`].

pub mod bridge;
pub mod demo_file;
pub mod demonstration;
pub mod gaussian;
pub mod history;
pub mod inference;
pub mod mentor;
pub mod metric;
pub mod run;
pub mod similarity;
pub mod states;
pub mod summary;
#[cfg(test)]
mod testing;
pub mod tree;
