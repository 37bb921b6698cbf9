//! What is measured, apart from how: used by `trestle bench`, by `benches/functions.rs` and by
//! `benches/instructions.rs`.

pub(crate) mod gradient;
pub(crate) mod walk;
