//! From a configuration to a run that is ready to start, or a refusal that leaves nothing behind.
//!
//! - `resolve`: the configuration meets its environment and its demonstrations, and becomes an experiment;
//! - `columns`: which features of a state the columns of a demonstration are;
//! - `possible`: whether the environment can be in what was demonstrated;
//! - `probes`: what the machine must offer;
//! - `aside`: where a run is that is being replaced or removed;
//! - `fence`: the lock of a run's directory;
//! - `ground`: the map for pictures;
//! - `directory`: the run's directory is made, replaced, or taken over to go on in it;
//! - `states`: what killed starts leave there and beside it.
//!
//! Everything that can be refused is refused before the first file is written.

mod aside;
mod columns;
mod directory;
mod fence;
mod ground;
mod possible;
mod probes;
mod resolve;
mod states;

pub(crate) use aside::{has_leftovers, replaced};
pub(crate) use directory::{Existing, Prepared, draw, quoted};
pub(crate) use fence::try_lock;
pub(crate) use probes::{Needs, check, check_page, check_stack, findings, weaknesses};
pub(crate) use resolve::{Resolved, resolve, resolve_run};
pub(crate) use states::{clear_away, given_up, is_unborn, nothing_saved, recover, run_at, run_of};
