//! A transposed copy of a weight matrix, for the backward pass to read it by rows.

use super::vector::{Op, Vector};

/// `out[c][r] = x[r][c]`.
pub(crate) struct Transpose<'a> {
    /// `[rows][columns]`.
    pub(crate) x: &'a [f32],
    /// Number of columns of `x`; `rows` follows from its length.
    pub(crate) columns: usize,
    /// `[columns][rows]`; overwritten.
    pub(crate) out: &'a mut [f32],
}

impl Op for Transpose<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Vector>(self) {
        let Transpose { x, columns, out } = self;
        let rows = x.len() / columns;
        assert!(x.len() == rows * columns && out.len() == x.len());
        let (tall, wide) = (rows - rows % 8, columns - columns % 8);
        for row in (0..tall).step_by(8) {
            for column in (0..wide).step_by(8) {
                let mut block: [&[f32]; 8] = [&[]; 8];
                for (r, line) in block.iter_mut().enumerate() {
                    *line = &x[(row + r) * columns + column..][..8];
                }
                let block = S::transpose_8x8(block);
                for (c, line) in block.iter().enumerate() {
                    out[(column + c) * rows + row..][..8].copy_from_slice(line);
                }
            }
        }
        for row in 0..rows {
            for column in if row < tall { wide } else { 0 }..columns {
                out[column * rows + row] = x[row * columns + column];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use proptest::prelude::*;

    use super::*;
    use crate::kernels::{Isa, Kernels};

    proptest! {
        #[test]
        fn every_element_changes_its_indices(rows in 1usize..40, columns in 1usize..40) {
            let x: Vec<f32> = (0..rows * columns).map(|i| i as f32).collect();
            for isa in Isa::available() {
                let mut out = vec![f32::NAN; x.len()];
                Kernels::new(isa).unwrap().run(Transpose { x: &x, columns, out: &mut out });
                for (at, &value) in out.iter().enumerate() {
                    prop_assert_eq!(value, ((at % rows) * columns + at / rows) as f32);
                }
            }
        }
    }
}
