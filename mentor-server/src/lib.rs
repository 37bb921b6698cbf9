//! The process that owns the demonstration and answers for it.
//!
//! [`demo_file`] reads and writes demonstrations, [`import`] makes them from the files of others, and [`run`] serves
//! [`trestle_algorithm::mentor::Mentor`] to the run's other processes.

pub mod demo_file;
pub mod import;
pub mod run;
