//! The distance of states, which all processes must agree on, and exact indexes over it.
//!
//! [`metric`] makes it from a configuration and the mentor's states; [`Similarity`] names the mentor states near a
//! state. The mentor-server, actors with guided exploration and a rival measure alike.

pub mod gaussian;
mod index;
pub mod metric;
#[cfg(test)]
pub(crate) mod testing;
pub mod tree;

pub use index::{Hit, Similarity};
