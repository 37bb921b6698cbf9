//! Trestle as a library: the whole program, with environments of one's own.
//!
//! [`Program`] is the program `trestle`. A binary that registers its environments and then calls [`Program::main`] has every
//! subcommand, and its runs consist of processes of that binary:
//!
//! ```ignore
//! use std::process::ExitCode;
//!
//! fn main() -> ExitCode {
//!     trestle::Program::new().environment::<CartPole>("cart-pole").main()
//! }
//! ```
//!
//! An environment is a type that implements [`env::Environment`] and [`env::Kind`]. What these need is here as well:
//!
//! - [`settings!`] and [`choices!`] declare its table `[env.<name>]`, with ranges from [`config::accepts`];
//! - [`EnvSpec`] describes its spaces;
//! - [`Stream`] is the source of all its randomness, and [`rand::Rng`] draws from it;
//! - [`codec`] turns a state into the bytes of a snapshot and back.
//!
//! `examples/own-environment` is a complete one.

#[macro_use]
mod output;

mod build_info;
mod carrier;
mod cli;
mod commands;
mod export;
mod flags;
mod itself;
mod prepare;
mod program;
mod reference;
mod screen;
mod status;
mod stored;
mod submit;
mod supervise;
mod sweep;

use trestle_link::iceoryx::SharedMemory;

/// How the processes of this program's runs exchange their messages. Beside this line only the joining of hosts names a transport.
const TRANSPORT: SharedMemory = SharedMemory;

pub use build_info::BUILD;
pub use program::Program;
pub use rand;
pub use trestle_actor::env;
pub use trestle_proto::rng::Stream;
pub use trestle_proto::row::Element;
pub use trestle_proto::space::EnvSpec;
pub use trestle_proto::{choices, codec, config, settings};
