//! Reports: statistics, pictures and a page from the records of any number of runs.
//!
//! - [`read`]: the runs below a directory, one after the other, each reduced to its tables and curves ([`run`]); `apart` tells
//!   apart what one name would put together;
//! - [`stats`]: means, intervals, comparisons, as plain functions over numbers;
//! - [`summary`]: runs grouped by task and arm, with the figures of each group and pair;
//! - [`over_tasks`]: arms compared over many tasks;
//! - [`effect`]: how much of a mentor reached the training;
//! - [`curves`]: many runs' records on one axis;
//! - [`plot`]: pictures, as SVG and PNG; [`maze`]: pictures of a maze; [`film`]: an episode in it, in motion;
//!   [`footage`]: one of an environment that draws itself;
//! - [`mod@write`]: everything into a directory, with the page that shows it.
//!
//! Nothing here knows networks or environments: the caller hands in the data for pictures of a maze.

mod apart;
pub mod curves;
pub mod effect;
pub mod film;
pub mod footage;
pub mod maze;
pub mod over_tasks;
mod page;
pub mod plot;
pub mod read;
pub mod run;
pub mod stats;
pub mod summary;
pub mod write;
