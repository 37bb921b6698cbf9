//! Environments, the epsilon-greedy policy and the process that collects transitions.
//!
//! * [`mod@env`]: the trait that every environment fulfils, and the environments;
//! * [`error`]: what can keep an actor from its work;
//! * [`policy`]: from a flat parameter vector and an observation to an action;
//! * [`worker`]: one actor without any transport: batches, greedy evaluations, snapshots;
//! * [`rivals`]: what other people's ways to learn from a mentor change about an environment;
//! * [`run`]: the loop of an actor's process.

pub mod env;
pub mod error;
pub mod guide;
pub mod policy;
pub mod rivals;
pub mod run;
pub mod worker;
