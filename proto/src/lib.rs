//! What Trestle's processes agree on, and nothing else: the messages and their layout in shared memory, the
//! services and their limits, the resolved configuration, the run directory, the framing of files, the
//! random streams, and the distance of states.
//!
//! This crate depends on no other member of the workspace.

pub mod annotation;
pub mod batch;
pub mod codec;
pub mod config;
pub mod limits;
pub mod logging;
pub mod mentor;
pub mod names;
pub mod observe;
pub mod orders;
pub mod plan;
pub mod pulse;
pub mod query;
pub mod regular_file;
pub mod reply;
pub mod rng;
pub mod rundir;
pub mod schedule;
pub mod similarity;
pub mod space;
pub mod tick;
pub mod transport;
pub mod waypoints;
pub mod weights;

/// Marks "none" wherever an index or an action travels as a plain `u32`.
pub const NONE: u32 = u32::MAX;
