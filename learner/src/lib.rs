//! Replay, losses, gradient schedule, checkpoints and the process that learns.

pub mod agent;
pub mod checkpoint;
mod free;
pub mod losses;
pub mod record;
pub mod replay;
pub mod run;
pub mod session;
pub mod shaping;

#[cfg(test)]
mod testing;
