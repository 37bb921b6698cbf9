//! Kernels that add up: column sums, and the sum of squares behind the gradient's norm.

use super::vector::{Op, Vector};

/// `out[c] = sum over r of x[r][c]`, in ascending `r`.
pub(crate) struct ColumnSums<'a> {
    /// `[rows][columns]`, `columns` being the length of `out`.
    pub(crate) x: &'a [f32],
    /// Result; overwritten.
    pub(crate) out: &'a mut [f32],
}

impl Op for ColumnSums<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Vector>(mut self) {
        let columns = self.out.len();
        assert!(self.x.len().is_multiple_of(columns));
        // Several sums side by side hide the latency of each addition.
        let mut column = 0;
        while column + 8 * S::LANES <= columns {
            self.strip::<S, 8>(column);
            column += 8 * S::LANES;
        }
        while column + 2 * S::LANES <= columns {
            self.strip::<S, 2>(column);
            column += 2 * S::LANES;
        }
        if column + S::LANES <= columns {
            self.strip::<S, 1>(column);
            column += S::LANES;
        }
        if column < columns {
            let mut sum = S::splat(0.0);
            for row in self.x.chunks_exact(columns) {
                sum = sum.add(S::load_partial(&row[column..]));
            }
            sum.store_partial(&mut self.out[column..]);
        }
    }
}

impl ColumnSums<'_> {
    /// The sums of `V` registers of columns.
    #[inline(always)]
    fn strip<S: Vector, const V: usize>(&mut self, column: usize) {
        let mut sums = [S::splat(0.0); V];
        for row in self.x.chunks_exact(self.out.len()) {
            let row = &row[column..][..V * S::LANES];
            for v in 0..V {
                sums[v] = sums[v].add(S::load(&row[v * S::LANES..]));
            }
        }
        let out = &mut self.out[column..][..V * S::LANES];
        for v in 0..V {
            sums[v].store(&mut out[v * S::LANES..]);
        }
    }
}

/// How many partial sums [`SumOfSquares`] keeps, on every instruction set: four registers of AVX-512, enough
/// to hide the latency of each addition.
const PARTIAL_SUMS: usize = 64;

/// The sum of the squares of a vector: element `i` goes to partial sum `i % 64`, and the upper half of the
/// partial sums is added to the lower half until one is left.
pub(crate) struct SumOfSquares<'a> {
    /// The vector.
    pub(crate) x: &'a [f32],
}

impl Op for SumOfSquares<'_> {
    type Output = f32;

    #[inline(always)]
    fn run<S: Vector>(self) -> f32 {
        // The narrowest register has eight lanes, so eight registers always suffice.
        let registers = PARTIAL_SUMS / S::LANES;
        let mut sums = [S::splat(0.0); 8];
        let (blocks, rest) = self.x.as_chunks::<PARTIAL_SUMS>();
        for block in blocks {
            for r in 0..registers {
                let x = S::load(&block[r * S::LANES..]);
                sums[r] = x.mul_add(x, sums[r]);
            }
        }
        let mut last = [0.0; PARTIAL_SUMS];
        last[..rest.len()].copy_from_slice(rest);
        let mut partial = [0.0; PARTIAL_SUMS];
        for r in 0..registers {
            let x = S::load(&last[r * S::LANES..]);
            x.mul_add(x, sums[r]).store(&mut partial[r * S::LANES..]);
        }
        let mut half = PARTIAL_SUMS / 2;
        while half > 0 {
            for i in 0..half {
                partial[i] += partial[half + i];
            }
            half /= 2;
        }
        partial[0]
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
        fn column_sums_equal_naive(rows in 0usize..9, columns in 1usize..70, seed in 0usize..99) {
            let x: Vec<f32> = (0..rows * columns).map(|i| ((i * 37 + seed) % 101) as f32 * 0.3).collect();
            let naive = |c: usize| (0..rows).fold(0.0, |sum, r| sum + x[r * columns + c]);
            let expected: Vec<f32> = (0..columns).map(naive).collect();
            for isa in Isa::available() {
                let mut out = vec![f32::NAN; columns];
                Kernels::new(isa).unwrap().run(ColumnSums { x: &x, out: &mut out });
                prop_assert_eq!(&out, &expected, "{}", isa);
            }
        }

        #[test]
        fn sum_of_squares_is_close_to_naive_and_the_same_everywhere(
            x in prop::collection::vec(-3.0f32..3.0, 0..300),
        ) {
            let exact: f64 = x.iter().map(|&x| f64::from(x) * f64::from(x)).sum();
            let scalar = Kernels::new(Isa::Scalar).unwrap().run(SumOfSquares { x: &x });
            prop_assert!((f64::from(scalar) - exact).abs() <= 1e-5 * exact);
            for isa in Isa::available() {
                let sum = Kernels::new(isa).unwrap().run(SumOfSquares { x: &x });
                prop_assert_eq!(sum.to_bits(), scalar.to_bits(), "{}", isa);
            }
        }
    }
}
