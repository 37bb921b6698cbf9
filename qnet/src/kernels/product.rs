//! The matrix product behind the forward pass and both halves of the backward pass, in register tiles.
//!
//! `out[r][c] = after(bias[c] + sum over i of left(r, i) * right[i][c])`, each element one chain of fused
//! multiply-adds in ascending `i` that starts at the bias (or 0). A tile holds up to six (narrow ones: eight)
//! rows by a few registers of columns, so a loaded row of `right` serves all rows of the tile, and each
//! number of `left` all its columns. All tiles of one panel of columns are computed before the next, for the
//! panel to stay in the first-level cache.

use super::vector::{Op, Vector};

/// The left factor, seen as `rows x inner`, in tiles of `R` rows.
pub(crate) trait Left: Copy {
    /// Whether the loop of a full tile takes [`Vector::UNROLLED`] inner indices a turn.
    const UNROLLED: bool;
    /// The numbers of rows `first..first + R`.
    fn tile<const R: usize>(&self, first: usize, inner: usize) -> impl LeftTile<R>;
    /// Whether all of `rows x inner` can be read.
    fn covers(&self, rows: usize, inner: usize) -> bool;
}

/// `R` rows of the left factor.
pub(crate) trait LeftTile<const R: usize> {
    /// The numbers of all `R` rows at the inner index `i`.
    fn at(&self, i: usize) -> [f32; R];
}

/// A left factor stored row by row: `[rows][inner]`.
#[derive(Clone, Copy)]
pub(crate) struct ByRow<'a>(pub(crate) &'a [f32]);

/// A left factor stored column by column, and only the listed columns of it: the number at row `r` and inner
/// index `i` is `x[picked[i]][r]` in a row-major `x` of the given width.
#[derive(Clone, Copy)]
pub(crate) struct ByColumn<'a> {
    /// The stored matrix, `[..][width]`.
    pub(crate) x: &'a [f32],
    /// Length of its rows.
    pub(crate) width: usize,
    /// Which of its rows are the inner indices, in this order.
    pub(crate) picked: &'a [u32],
}

/// A left factor that is gathered: the number at row `r` and inner index `i` is `x[rows[r] + inner[i]]`.
#[derive(Clone, Copy)]
pub(crate) struct Gathered<'a> {
    /// Where the numbers lie.
    pub(crate) x: &'a [f32],
    /// Where each row begins.
    pub(crate) rows: &'a [u32],
    /// How far each inner index lies from there.
    pub(crate) inner: &'a [u32],
}

/// Rows of a [`Gathered`], each as far as its last number, and the inner indices.
struct GatheredTile<'a, const R: usize>([&'a [f32]; R], &'a [u32]);

impl Left for Gathered<'_> {
    const UNROLLED: bool = false;

    #[inline(always)]
    fn tile<const R: usize>(&self, first: usize, inner: usize) -> impl LeftTile<R> {
        // All slices have one length, so one comparison a step serves them all.
        let length =
            self.x.len() - self.rows[first..first + R].iter().fold(0, |most, &row| most.max(row)) as usize;
        let mut rows: [&[f32]; R] = [&[]; R];
        for (r, row) in rows.iter_mut().enumerate() {
            *row = &self.x[self.rows[first + r] as usize..][..length];
        }
        GatheredTile(rows, &self.inner[..inner])
    }

    fn covers(&self, rows: usize, inner: usize) -> bool {
        self.rows.len() >= rows && self.inner.len() >= inner
    }
}

impl<const R: usize> LeftTile<R> for GatheredTile<'_, R> {
    #[inline(always)]
    fn at(&self, i: usize) -> [f32; R] {
        let at = self.1[i] as usize;
        let mut numbers = [0.0; R];
        for (number, row) in numbers.iter_mut().zip(&self.0) {
            *number = row[at];
        }
        numbers
    }
}

impl Left for ByRow<'_> {
    const UNROLLED: bool = true;

    #[inline(always)]
    fn tile<const R: usize>(&self, first: usize, inner: usize) -> impl LeftTile<R> {
        let mut rows: [&[f32]; R] = [&[]; R];
        for (r, row) in rows.iter_mut().enumerate() {
            *row = &self.0[(first + r) * inner..][..inner];
        }
        rows
    }

    fn covers(&self, rows: usize, inner: usize) -> bool {
        self.0.len() >= rows * inner
    }
}

impl<const R: usize> LeftTile<R> for [&[f32]; R] {
    #[inline(always)]
    fn at(&self, i: usize) -> [f32; R] {
        let mut numbers = [0.0; R];
        for r in 0..R {
            numbers[r] = self[r][i];
        }
        numbers
    }
}

/// The part of a [`ByColumn`] that starts at one row of the product.
struct ColumnTile<'a>(ByColumn<'a>, usize);

impl Left for ByColumn<'_> {
    const UNROLLED: bool = false;

    #[inline(always)]
    fn tile<const R: usize>(&self, first: usize, _inner: usize) -> impl LeftTile<R> {
        ColumnTile(*self, first)
    }

    fn covers(&self, rows: usize, inner: usize) -> bool {
        self.width >= rows && self.picked.len() >= inner
    }
}

impl<const R: usize> LeftTile<R> for ColumnTile<'_> {
    #[inline(always)]
    fn at(&self, i: usize) -> [f32; R] {
        let ColumnTile(ByColumn { x, width, picked }, first) = self;
        let row = &x[picked[i] as usize * width + first..][..R];
        let mut numbers = [0.0; R];
        numbers.copy_from_slice(row);
        numbers
    }
}

/// The function that is applied to a finished element.
#[derive(Clone, Copy)]
pub(crate) enum After<'a> {
    /// Nothing.
    Keep,
    /// ReLU.
    Relu,
    /// The derivative of ReLU: 0 where the activation at the same place of row `picked[r]` of `activations`
    /// (whose rows are as long as those of `out`) is not positive.
    Gate {
        /// Outputs of a ReLU layer.
        activations: &'a [f32],
        /// Which of its rows belongs to each row of the product.
        picked: &'a [u32],
    },
}

/// One matrix product; see the head of the file.
pub(crate) struct Product<'a, L: Left> {
    /// Number of rows.
    pub(crate) rows: usize,
    /// Length of the sums.
    pub(crate) inner: usize,
    /// Number of columns.
    pub(crate) columns: usize,
    /// Left factor.
    pub(crate) left: L,
    /// Right factor, `[inner][columns]`.
    pub(crate) right: &'a [f32],
    /// Where the sums start, `[columns]`; 0 if absent.
    pub(crate) bias: Option<&'a [f32]>,
    /// Applied to a finished sum.
    pub(crate) after: After<'a>,
    /// Result, `[rows][columns]` or those columns of it that [`Product::within`] says; overwritten.
    pub(crate) out: &'a mut [f32],
    /// Length of the rows of `out` and of activations, and the first column of the product in them.
    pub(crate) within: Within,
}

/// Where the columns of a product lie in longer rows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Within {
    /// Length of the rows.
    pub(crate) pitch: usize,
    /// Their first column.
    pub(crate) first: usize,
}

impl Within {
    /// Rows that have `columns` columns and no others.
    pub(crate) fn all(columns: usize) -> Within {
        Within { pitch: columns, first: 0 }
    }
}

impl<L: Left> Op for Product<'_, L> {
    type Output = ();

    #[inline(always)]
    fn run<S: Vector>(mut self) {
        let Product { rows, inner, columns, .. } = self;
        assert!(self.left.covers(rows, inner), "the left factor is too small");
        let Within { pitch, first } = self.within;
        assert!(self.right.len() >= inner * columns && self.out.len() >= rows * pitch);
        assert!(first + columns <= pitch);
        let mut column = 0;
        while columns - column >= S::LANES {
            let free = (columns - column) / S::LANES;
            column += S::LANES
                * if rows == 1 {
                    self.single_row::<S>(column, free)
                } else {
                    self.full_panel::<S>(column, free)
                };
        }
        if column < columns {
            self.panel::<S, 1, true>(column);
        }
    }
}

impl<L: Left> Product<'_, L> {
    /// A single row has registers to spare, and needs more chains to hide the latency of each: up to eight
    /// registers of columns, of which `free` are left. Returns how many it took.
    #[inline(always)]
    fn single_row<S: Vector>(&mut self, column: usize, free: usize) -> usize {
        match free {
            8.. => self.tile::<S, 1, 8, false>(0, column),
            4..8 => self.tile::<S, 1, 4, false>(0, column),
            2..4 => self.tile::<S, 1, 2, false>(0, column),
            _ => self.tile::<S, 1, 1, false>(0, column),
        }
        match free {
            8.. => 8,
            4..8 => 4,
            2..4 => 2,
            _ => 1,
        }
    }

    /// All rows of up to `S::COLUMNS` registers of columns, of which `free` are left. Returns how many it
    /// took.
    #[inline(always)]
    fn full_panel<S: Vector>(&mut self, column: usize, free: usize) -> usize {
        let width = free.min(S::COLUMNS);
        // The comparisons with a constant keep tiles that are too wide for the register file out of the
        // binary.
        match width {
            4 if S::COLUMNS >= 4 => self.panel::<S, 4, false>(column),
            3 if S::COLUMNS >= 3 => self.panel::<S, 3, false>(column),
            2 => self.panel::<S, 2, false>(column),
            _ => self.panel::<S, 1, false>(column),
        }
        width
    }

    /// All rows of `V` registers of columns; if `PARTIAL`, all rows of the remaining columns, less than a
    /// register.
    #[inline(always)]
    fn panel<S: Vector, const V: usize, const PARTIAL: bool>(&mut self, column: usize) {
        // Six rows of a full tile fill the registers. Rows are spread evenly over the tiles: two tiles of
        // five rows keep the pipelines busier than one of six and one of four.
        let tiles = self.rows.div_ceil(if V >= S::COLUMNS { 6 } else { 8 });
        let mut row = 0;
        for tile in 0..tiles {
            let end = self.rows * (tile + 1) / tiles;
            match end - row {
                1 => self.tile::<S, 1, V, PARTIAL>(row, column),
                2 => self.tile::<S, 2, V, PARTIAL>(row, column),
                3 => self.tile::<S, 3, V, PARTIAL>(row, column),
                4 => self.tile::<S, 4, V, PARTIAL>(row, column),
                5 => self.tile::<S, 5, V, PARTIAL>(row, column),
                6 => self.tile::<S, 6, V, PARTIAL>(row, column),
                7 => self.tile::<S, 7, V, PARTIAL>(row, column),
                _ => self.tile::<S, 8, V, PARTIAL>(row, column),
            }
            row = end;
        }
    }

    /// `R` rows by `V` registers of columns, all sums held in registers.
    #[inline(always)]
    fn tile<S: Vector, const R: usize, const V: usize, const PARTIAL: bool>(
        &mut self,
        row: usize,
        column: usize,
    ) {
        let width = if PARTIAL { self.columns - column } else { V * S::LANES };
        let mut sums = [[S::splat(0.0); V]; R];
        if let Some(bias) = self.bias {
            let start = registers::<S, V, PARTIAL>(&bias[column..column + width]);
            sums.fill(start);
        }
        let left = self.left.tile::<R>(row, self.inner);
        let turn = if L::UNROLLED && V >= S::COLUMNS { S::UNROLLED } else { 1 };
        let mut done = 0;
        while turn > 1 && done + turn <= self.inner {
            for i in done..done + turn {
                let right = &self.right[i * self.columns + column..][..width];
                add_products::<S, R, V, PARTIAL>(left.at(i), right, &mut sums);
            }
            done += turn;
        }
        for i in done..self.inner {
            let right = &self.right[i * self.columns + column..][..width];
            add_products::<S, R, V, PARTIAL>(left.at(i), right, &mut sums);
        }
        for r in 0..R {
            let mut finished = sums[r];
            match self.after {
                After::Keep => {}
                After::Relu => {
                    for y in &mut finished {
                        *y = y.relu();
                    }
                }
                After::Gate { activations, picked } => {
                    let at = picked[row + r] as usize * self.within.pitch + self.within.first + column;
                    let activation = registers::<S, V, PARTIAL>(&activations[at..][..width]);
                    for v in 0..V {
                        finished[v] = finished[v].gate(activation[v]);
                    }
                }
            }
            let out = &mut self.out[(row + r) * self.within.pitch + self.within.first + column..][..width];
            if PARTIAL {
                finished[0].store_partial(out);
            } else {
                for v in 0..V {
                    finished[v].store(&mut out[v * S::LANES..]);
                }
            }
        }
    }
}

/// Adds the products of one inner index to the sums of a tile.
#[inline(always)]
fn add_products<S: Vector, const R: usize, const V: usize, const PARTIAL: bool>(
    left: [f32; R],
    right: &[f32],
    sums: &mut [[S; V]; R],
) {
    let right = registers::<S, V, PARTIAL>(right);
    for r in 0..R {
        let x = S::splat(left[r]);
        for v in 0..V {
            sums[r][v] = x.mul_add(right[v], sums[r][v]);
        }
    }
}

/// Loads `V` registers; if `PARTIAL`, one that the slice does not fill.
#[inline(always)]
fn registers<S: Vector, const V: usize, const PARTIAL: bool>(x: &[f32]) -> [S; V] {
    let mut loaded = [S::splat(0.0); V];
    if PARTIAL {
        loaded[0] = S::load_partial(x);
    } else {
        for v in 0..V {
            loaded[v] = S::load(&x[v * S::LANES..]);
        }
    }
    loaded
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use proptest::prelude::*;

    use super::*;
    use crate::kernels::{Isa, Kernels};

    /// `n` numbers between -1 and 1, some of them 0, that depend on `seed`.
    fn numbers(seed: u32, n: usize) -> Vec<f32> {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 8_388_608.0 - 1.0
        };
        (0..n).map(|_| Some(next()).filter(|x| x.abs() > 0.1).unwrap_or(0.0)).collect()
    }

    /// The product element by element.
    fn naive(
        (rows, inner, columns): (usize, usize, usize),
        left: impl Fn(usize, usize) -> f32,
        right: &[f32],
        bias: Option<&[f32]>,
        after: impl Fn(usize, usize, f32) -> f32,
    ) -> Vec<f32> {
        let element = |r: usize, c: usize| {
            let start = bias.map_or(0.0, |bias| bias[c]);
            let sum = (0..inner).fold(start, |sum, i| left(r, i).mul_add(right[i * columns + c], sum));
            after(r, c, sum)
        };
        (0..rows * columns).map(|at| element(at / columns, at % columns)).collect()
    }

    proptest! {
        #[test]
        fn rows_times_matrix_equals_naive_bit_by_bit(
            rows in 1usize..20, inner in 1usize..20, columns in 1usize..150, seed: u32,
        ) {
            let (x, w) = (numbers(seed, rows * inner), numbers(!seed, inner * columns));
            let bias = numbers(seed ^ 1, columns);
            let left = |r: usize, i: usize| x[r * inner + i];
            let expected = naive((rows, inner, columns), left, &w, Some(&bias), |_, _, y: f32| y.max(0.0));
            for isa in Isa::available() {
                let mut out = vec![f32::NAN; rows * columns];
                Kernels::new(isa).unwrap().run(Product {
                    rows, inner, columns,
                    left: ByRow(&x), right: &w, bias: Some(&bias), after: After::Relu, out: &mut out,
                    within: Within::all(columns),
                });
                prop_assert_eq!(&out, &expected, "{}", isa);
            }
        }

        #[test]
        fn gathered_numbers_equal_naive_bit_by_bit(
            rows in prop::collection::vec(0u32..50, 1..24), inner in prop::collection::vec(0u32..50, 1..24),
            columns in 1usize..80, seed: u32,
        ) {
            let (x, right) = (numbers(seed, 100), numbers(!seed, inner.len() * columns));
            let left = |r: usize, i: usize| x[(rows[r] + inner[i]) as usize];
            let expected = naive((rows.len(), inner.len(), columns), left, &right, None, |_, _, y| y);
            for isa in Isa::available() {
                let mut out = vec![f32::NAN; rows.len() * columns];
                Kernels::new(isa).unwrap().run(Product {
                    rows: rows.len(), inner: inner.len(), columns,
                    left: Gathered { x: &x, rows: &rows, inner: &inner }, right: &right, bias: None,
                    after: After::Keep, out: &mut out, within: Within::all(columns),
                });
                prop_assert_eq!(&out, &expected, "{}", isa);
            }
        }

        #[test]
        fn picked_columns_and_gates_equal_naive_bit_by_bit(
            rows in 1usize..12, columns in 1usize..80, stored in 1u32..9, seed: u32,
            picks in prop::collection::vec(any::<u32>(), 1..24),
        ) {
            let picked: Vec<u32> = picks.iter().map(|pick| pick % stored).collect();
            let inner = picked.len();
            let (x, right) = (numbers(seed, stored as usize * rows), numbers(!seed, inner * columns));
            let activations = numbers(seed ^ 1, stored as usize * columns);
            let gated: Vec<u32> = (0..rows as u32).map(|r| r % stored).collect();
            let left = |r: usize, i: usize| x[picked[i] as usize * rows + r];
            let expected = naive((rows, inner, columns), left, &right, None, |r, c, y| {
                if activations[gated[r] as usize * columns + c] > 0.0 { y } else { 0.0 }
            });
            for isa in Isa::available() {
                let mut out = vec![f32::NAN; rows * columns];
                Kernels::new(isa).unwrap().run(Product {
                    rows, inner, columns,
                    left: ByColumn { x: &x, width: rows, picked: &picked },
                    right: &right, bias: None,
                    after: After::Gate { activations: &activations, picked: &gated },
                    out: &mut out, within: Within::all(columns),
                });
                prop_assert_eq!(&out, &expected, "{}", isa);
                // The same in two halves.
                let mut halves = vec![f32::NAN; rows * columns];
                for (first, end) in [(0, columns / 2), (columns / 2, columns)] {
                    let of_row = |row: &[f32]| row[first..end].to_vec();
                    let right: Vec<f32> = right.chunks(columns).flat_map(of_row).collect();
                    Kernels::new(isa).unwrap().run(Product {
                        rows, inner, columns: end - first,
                        left: ByColumn { x: &x, width: rows, picked: &picked },
                        right: &right, bias: None,
                        after: After::Gate { activations: &activations, picked: &gated },
                        out: &mut halves, within: Within { pitch: columns, first },
                    });
                }
                prop_assert_eq!(&halves, &expected, "{}", isa);
            }
        }
    }
}
