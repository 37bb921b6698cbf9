//! What Trestle's processes agree on, as plain data: the experiment (configuration, spaces, limits, schedules,
//! random streams), the plan of a run, the messages with their layout and validation, the run directory, and the framing of files.
//!
//! Nothing here sends, waits or starts anything, and this crate depends on no other member of the workspace.

pub mod acting;
pub mod annotation;
pub mod batch;
pub mod codec;
pub mod config;
pub mod episode;
pub mod experiment;
pub mod hosts_file;
pub mod incarnation;
pub mod limits;
pub mod map_file;
pub mod mentor;
pub mod message;
pub mod names;
pub mod observe;
pub mod orders;
pub mod own_file;
pub mod plan;
pub mod query;
pub mod regular_file;
pub mod reply;
pub mod rng;
pub mod round;
pub mod row;
pub mod run_files;
pub mod run_result;
pub mod rundir;
pub mod schedule;
pub mod space;
pub mod waypoints;

/// Marks "none" wherever an index or an action travels as a plain `u32`.
pub const NONE: u32 = u32::MAX;
