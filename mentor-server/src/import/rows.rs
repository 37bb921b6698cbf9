//! Tables of numbers that are read window by window, wherever they are.

use super::error::{ImportError, Place};

/// A table of numbers with one row a state, or one a step.
pub(super) trait Rows {
    /// Number of rows.
    fn rows(&self) -> u64;

    /// Numbers in a row.
    fn width(&self) -> usize;

    /// Rows that are best read together, 1 or more.
    fn window(&self) -> u64;

    /// `count` rows from `first` on, row-major. Within one table `first` does not fall from call to call.
    ///
    /// # Errors
    /// What cannot be read.
    fn read(&mut self, first: u64, count: u64) -> Result<Vec<f64>, ImportError>;
}

/// A flag a row, 0 or 1; `place` and `what` are for messages.
pub(super) fn flags(
    table: &mut (impl Rows + ?Sized),
    first: u64,
    count: u64,
    place: &Place,
    what: &str,
) -> Result<Vec<bool>, ImportError> {
    let values = table.read(first, count)?;
    let flag = |(i, value): (usize, f64)| match value {
        0.0 => Ok(false),
        1.0 => Ok(true),
        other => Err(place.clone().row(first + i as u64).refuse(what, other, "0 or 1")),
    };
    values.into_iter().enumerate().map(flag).collect()
}
