//! What is measured, apart from how: used by the program `trestle-bench`, by `functions.rs` and by `instructions.rs`.

pub mod gradient;
pub mod server;
pub mod walk;
