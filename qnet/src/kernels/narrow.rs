//! The forward pass of an output layer with few columns: one Q-value an action.
//!
//! The general product would leave most lanes of a register empty, and a single row would wait for one chain
//! of multiply-adds as long as the layer is wide. Here a register holds the columns of several inner indices
//! side by side, and each element is the sum of several chains.

use super::vector::{Op, Vector};

/// Partial sums of a row, over all its columns, on every instruction set.
const PARTIAL_SUMS: usize = 64;

/// `out[r][c] = bias[c] + sum over i of x[r][i] * weights[i][c]`, for up to [`NarrowProduct::COLUMNS`] columns.
///
/// Each element has `64 / p` partial sums, `p` being 4 or 8 for as many columns and 16 for other numbers of
/// them. Product `i` goes to partial sum `i % (64 / p)`, in ascending `i`; then the upper half of the partial
/// sums is added to the lower half until one is left, and the bias to that.
pub(crate) struct NarrowProduct<'a> {
    /// Length of the sums.
    pub(crate) inner: usize,
    /// Left factor, `[rows][inner]`.
    pub(crate) x: &'a [f32],
    /// Right factor, `[inner][columns]`, `columns` being the length of `bias`.
    pub(crate) weights: &'a [f32],
    /// Added to each column.
    pub(crate) bias: &'a [f32],
    /// Result, `[rows][columns]`; overwritten.
    pub(crate) out: &'a mut [f32],
}

impl Op for NarrowProduct<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Vector>(self) {
        let columns = self.bias.len();
        assert!((1..=Self::COLUMNS).contains(&columns) && self.weights.len() == self.inner * columns);
        assert!(self.x.len() / self.inner * columns == self.out.len());
        match columns {
            4 => self.all_rows::<S, 4>(),
            8 => self.all_rows::<S, 8>(),
            _ => self.all_rows::<S, 16>(),
        }
    }
}

impl NarrowProduct<'_> {
    /// The largest number of columns.
    pub(crate) const COLUMNS: usize = 16;

    /// All rows, in tiles whose sums fit the registers. `P` is the number of lanes for one inner index.
    #[inline(always)]
    fn all_rows<S: Vector, const P: usize>(self) {
        let (inner, columns, spreading) = (self.inner, self.bias.len(), S::spreading());
        let mut tiles = self.x.chunks_exact(4 * inner);
        let mut outs = self.out.chunks_exact_mut(4 * columns);
        if S::LANES == 16 {
            for (x, out) in (&mut tiles).zip(&mut outs) {
                rows::<S, 4, 4, P>(x, self.weights, self.bias, spreading, out);
            }
            let outs = outs.into_remainder().chunks_exact_mut(columns);
            for (x, out) in tiles.remainder().chunks_exact(inner).zip(outs) {
                rows::<S, 1, 4, P>(x, self.weights, self.bias, spreading, out);
            }
        } else {
            for (x, out) in self.x.chunks_exact(inner).zip(self.out.chunks_exact_mut(columns)) {
                rows::<S, 1, 8, P>(x, self.weights, self.bias, spreading, out);
            }
        }
    }
}

/// `R` rows, with `V` registers for the partial sums of each.
#[inline(always)]
fn rows<S: Vector, const R: usize, const V: usize, const P: usize>(
    x: &[f32],
    weights: &[f32],
    bias: &[f32],
    spreading: S::Spreading,
    out: &mut [f32],
) {
    let (inner, columns, depth) = (x.len() / R, bias.len(), PARTIAL_SUMS / P);
    let whole = inner - inner % depth;
    let mut sums = [[S::splat(0.0); V]; R];
    let mut i = 0;
    while i < whole {
        let weights = &weights[i * columns..][..depth * columns];
        add_block::<S, R, V, P>(lines(x, inner, i, depth), weights, columns, spreading, &mut sums);
        i += depth;
    }
    if whole < inner {
        // One more block, filled up with zeros.
        let rest = inner - whole;
        let (mut last_x, mut last_weights) = ([[0.0; 16]; R], [0.0; PARTIAL_SUMS]);
        for (r, last_x) in last_x.iter_mut().enumerate() {
            last_x[..rest].copy_from_slice(&x[r * inner + whole..][..rest]);
        }
        last_weights[..rest * columns].copy_from_slice(&weights[whole * columns..]);
        let (x, weights) = (lines(last_x.as_flattened(), 16, 0, depth), &last_weights[..depth * columns]);
        add_block::<S, R, V, P>(x, weights, columns, spreading, &mut sums);
    }
    for r in 0..R {
        let mut sums = sums[r];
        let mut registers = V;
        while registers * S::LANES > 16 {
            registers /= 2;
            for v in 0..registers {
                sums[v] = sums[v].add(sums[v + registers]);
            }
        }
        let mut lanes = [0.0; 16];
        for v in 0..registers {
            sums[v].store(&mut lanes[v * S::LANES..]);
        }
        let mut half = 8;
        while half >= P {
            for at in 0..half {
                lanes[at] += lanes[at + half];
            }
            half /= 2;
        }
        for (c, out) in out[r * columns..][..columns].iter_mut().enumerate() {
            *out = lanes[c] + bias[c];
        }
    }
}

/// Numbers `at..at + n` of `R` rows of a width.
#[inline(always)]
fn lines<const R: usize>(x: &[f32], width: usize, at: usize, n: usize) -> [&[f32]; R] {
    let mut lines: [&[f32]; R] = [&[]; R];
    for (r, line) in lines.iter_mut().enumerate() {
        *line = &x[r * width + at..][..n];
    }
    lines
}

/// Adds the products of as many inner indices as there are partial sums for.
#[inline(always)]
fn add_block<S: Vector, const R: usize, const V: usize, const P: usize>(
    x: [&[f32]; R],
    weights: &[f32],
    columns: usize,
    spreading: S::Spreading,
    sums: &mut [[S; V]; R],
) {
    for v in 0..V {
        let (i, column) = (v * S::LANES / P, (v * S::LANES % P).min(columns));
        let w = if P < 16 {
            S::load(&weights[v * S::LANES..])
        } else {
            let row = &weights[i * columns + column..(i + 1) * columns];
            if row.len() >= S::LANES { S::load(row) } else { S::load_partial(row) }
        };
        for r in 0..R {
            sums[r][v] = S::spread::<P>(x[r], i, spreading).mul_add(w, sums[r][v]);
        }
    }
}

/// One element by its definition, for tests: from a row of `x`, a column of `columns`, and its bias.
#[cfg(test)]
pub(crate) fn by_definition(x: &[f32], column: &[f32], bias: f32, columns: usize) -> f32 {
    let n = PARTIAL_SUMS / if columns == 4 || columns == 8 { columns } else { 16 };
    let mut sums = vec![0.0f32; n];
    for (i, (x, w)) in x.iter().zip(column).enumerate() {
        sums[i % n] = x.mul_add(*w, sums[i % n]);
    }
    while sums.len() > 1 {
        let upper = sums.split_off(sums.len() / 2);
        sums.iter_mut().zip(upper).for_each(|(sum, upper)| *sum += upper);
    }
    sums[0] + bias
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use proptest::prelude::*;

    use super::*;
    use crate::kernels::{Isa, Kernels};

    proptest! {
        #[test]
        fn equals_its_definition_bit_by_bit(
            rows in 1usize..10, inner in 1usize..100, columns in 1usize..=NarrowProduct::COLUMNS, seed in 0usize..99,
        ) {
            let numbers = |n: usize, step: usize| -> Vec<f32> {
                (0..n).map(|i| ((i * step + seed) % 101) as f32 * 0.3 - 15.0).collect()
            };
            let (x, weights, bias) = (numbers(rows * inner, 37), numbers(inner * columns, 53), numbers(columns, 7));
            for isa in Isa::available() {
                let mut out = vec![f32::NAN; rows * columns];
                Kernels::new(isa).unwrap().run(NarrowProduct {
                    inner, x: &x, weights: &weights, bias: &bias, out: &mut out,
                });
                for (at, got) in out.iter().enumerate() {
                    let (r, c) = (at / columns, at % columns);
                    let column: Vec<f32> = weights.iter().skip(c).step_by(columns).copied().collect();
                    let expected = by_definition(&x[r * inner..][..inner], &column, bias[c], columns);
                    prop_assert_eq!(*got, expected, "{} row {} column {}", isa, r, c);
                }
            }
        }
    }
}
