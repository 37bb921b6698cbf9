//! The program as its users have it: every test drives the real binary, with all processes of a run, in a directory
//! of its own. Nothing here waits for longer than a limit, and nothing is left running.

#![allow(clippy::unwrap_used)]

mod util;

mod cases;
mod client;
mod commands;
mod concurrency;
mod demonstrations;
mod determinism;
mod doctor;
mod documentation;
mod errors;
mod eval;
mod faults;
mod fencing;
mod free;
mod hazards;
mod host;
mod hostile;
mod hosts;
mod leftovers;
mod maps;
mod mentors;
mod modules;
mod point_maze;
mod prolong;
mod query;
mod resume;
mod rivals;
mod room;
mod schedule;
mod shutdown;
mod submit;
mod suite;
mod sweep;
mod train;
mod versions;
mod watch;
