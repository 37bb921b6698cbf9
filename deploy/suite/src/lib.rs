//! Sets of tasks on which algorithms are compared.
//!
//! A task is a map, a mentor, a preset with a few settings, and a budget. [`set`] reads sets of tasks, two of which are compiled
//! in: `choosing`, for whatever is chosen, and `reporting`, for what is claimed. They share no map. [`mentor`] makes a task's
//! demonstration: a function of the task alone, and by far not always a good one. [`paths`] has the paths in mazes that
//! mentors of them take.

pub mod mentor;
pub mod paths;
pub mod set;
