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
    fn run<S: Vector>(mut self) {
        let rows = self.x.len() / self.columns;
        assert!(self.x.len() == rows * self.columns && self.out.len() == self.x.len());
        // In strips of 16 rows at any height of a block: the result then comes by whole cache lines.
        for strip in (0..rows).step_by(16) {
            for column in (0..self.columns).step_by(8) {
                for row in (strip..rows.min(strip + 16)).step_by(S::LANES) {
                    self.block::<S>(rows, row, column);
                }
            }
        }
    }
}

impl Transpose<'_> {
    /// The block from one row and column on: a register high and eight columns wide, or less at the edges.
    #[inline(always)]
    fn block<S: Vector>(&mut self, rows: usize, row: usize, column: usize) {
        let (tall, wide) = ((rows - row).min(S::LANES), (self.columns - column).min(8));
        let corner = &self.x[row * self.columns + column..];
        let out = &mut self.out[column * rows + row..];
        // The same code again: where the compiler knows that a block is whole, or as wide as four actions, it is far
        // faster. The loops have a fixed number of turns for the block to stay in registers.
        if tall == S::LANES && wide == 8 {
            let block = S::columns(corner, self.columns, S::LANES, 8);
            S::store_lines::<8>(&block, out, rows);
        } else if tall == S::LANES && wide == 4 {
            let block = S::columns(corner, self.columns, S::LANES, 4);
            S::store_lines::<4>(&block, out, rows);
        } else {
            let block = S::columns(corner, self.columns, tall, wide);
            for (c, line) in block.iter().enumerate() {
                if c < wide {
                    let out = &mut out[c * rows..];
                    // In the result of a low matrix, each line begins where the one before ends. It overwrites
                    // the excess of that one, which is far cheaper than a masked store on AVX2.
                    let low = tall == rows && out.len() >= S::LANES;
                    if tall == S::LANES || low {
                        line.store(out)
                    } else {
                        line.store_partial(&mut out[..tall])
                    }
                }
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
                    prop_assert_eq!(value, ((at % rows) * columns + at / rows) as f32, "{}", isa);
                }
            }
        }
    }
}
