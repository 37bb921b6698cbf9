//! Numbers by row and column, in bounded memory however many rows come.

use serde::Serialize;
use serde::ser::{SerializeMap, Serializer};

/// Rows of the same columns, in the order in which they came. Of more than `most` rows every second one is kept, then every
/// fourth, and so on; the newest is always there.
#[derive(Clone, Debug)]
pub(crate) struct Table<const N: usize> {
    names: [&'static str; N],
    most: usize,
    rows: Vec<[f64; N]>,
    last: Option<[f64; N]>,
    /// One row in 2^`level` is kept.
    level: u32,
    seen: u64,
}

impl<const N: usize> Table<N> {
    /// No rows yet, and never more than `most` + 1.
    pub(crate) fn new(names: [&'static str; N], most: usize) -> Self {
        Self { names, most, rows: Vec::new(), last: None, level: 0, seen: 0 }
    }

    /// Forgets all rows.
    pub(crate) fn clear(&mut self) {
        *self = Self::new(self.names, self.most);
    }

    /// Adds a row; NaN stands for a number that is not known.
    pub(crate) fn push(&mut self, row: [f64; N]) {
        if self.seen.is_multiple_of(1 << self.level) {
            if self.rows.len() == self.most {
                let mut at = 0;
                self.rows.retain(|_| {
                    at += 1;
                    at % 2 == 1
                });
                self.level += 1;
            }
            if self.seen.is_multiple_of(1 << self.level) {
                self.rows.push(row);
            }
        }
        self.last = Some(row);
        self.seen += 1;
    }

    /// The newest row.
    pub(crate) fn last(&self) -> Option<&[f64; N]> {
        self.last.as_ref()
    }

    /// The rows that are kept.
    pub(crate) fn rows(&self) -> impl Iterator<Item = &[f64; N]> {
        let end =
            (!(self.seen.wrapping_sub(1)).is_multiple_of(1 << self.level)).then_some(self.last.as_ref());
        self.rows.iter().chain(end.flatten())
    }
}

impl<const N: usize> Serialize for Table<N> {
    /// An array of numbers a column, `null` for those that are not known. A column in which nothing is known is left out.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        for (column, name) in self.names.iter().enumerate() {
            let cells: Vec<Option<f64>> =
                self.rows().map(|row| Some(row[column]).filter(|x| x.is_finite())).collect();
            if cells.iter().any(Option::is_some) {
                map.serialize_entry(name, &cells)?;
            }
        }
        map.end()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn columns_of_which_nothing_is_known_are_left_out() {
        let mut table = Table::new(["x", "y", "z"], 4);
        table.push([1.0, f64::NAN, f64::NAN]);
        table.push([2.0, f64::NAN, 3.0]);
        assert_eq!(serde_json::to_string(&table).unwrap(), r#"{"x":[1.0,2.0],"z":[null,3.0]}"#);
    }

    proptest! {
        #[test]
        fn first_and_last_stay_and_the_rest_is_even(count in 0u32..2000, most in 2usize..40) {
            let mut table = Table::new(["x"], most);
            (0..count).for_each(|x| table.push([f64::from(x)]));
            let kept: Vec<f64> = table.rows().map(|row| row[0]).collect();
            prop_assert!(kept.len() <= most + 1 && kept.len() * 2 >= most.min(count as usize));
            prop_assert_eq!(kept.first().copied(), (count > 0).then_some(0.0));
            prop_assert_eq!(kept.last().copied(), (count > 0).then(|| f64::from(count - 1)));
            let steps: Vec<f64> = kept.windows(2).map(|pair| pair[1] - pair[0]).collect();
            let even = steps.split_last().map_or(&[][..], |(_, rest)| rest);
            prop_assert!(even.iter().all(|step| Some(step) == steps.first()), "{:?}", kept);
        }
    }
}
