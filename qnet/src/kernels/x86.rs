//! AVX-512 and AVX2 forms of [`Vector`], and the two functions that are compiled for these instruction sets.
#![allow(unsafe_code)]

use std::arch::x86_64::*;
use std::hint::black_box;

use super::vector::{Op, Vector};

/// Runs `op` in code compiled for AVX-512F (which implies AVX2 and FMA).
///
/// # Safety
/// The machine must have AVX-512F.
#[target_feature(enable = "avx512f")]
pub(super) unsafe fn run_avx512<O: Op>(op: O) -> O::Output {
    op.run::<Avx512>()
}

/// Runs `op` in code compiled for AVX2 and FMA.
///
/// # Safety
/// The machine must have AVX2 and FMA.
#[target_feature(enable = "avx2,fma")]
pub(super) unsafe fn run_avx2<O: Op>(op: O) -> O::Output {
    op.run::<Avx2>()
}

/// Calls one intrinsic.
macro_rules! intrinsic {
    ($call:expr) => {
        // SAFETY: these methods are reached only from `run_avx512` or `run_avx2`, whose callers know that the
        // machine has the instructions; where an intrinsic takes a pointer, the line above it checks that the
        // slice covers every lane that is read or written.
        unsafe { $call }
    };
}

/// Up to `N` rows of a block of up to eight numbers, `stride` numbers apart; the rest is 0.
#[inline(always)]
fn lines_of_8<const N: usize>(x: &[f32], stride: usize, rows: usize, columns: usize) -> [__m256; N] {
    let mut lines = [Avx2::splat(0.0).0; N];
    if rows == N && columns == 8 {
        // One comparison for all.
        assert!(x.len() >= 8 && stride <= (x.len() - 8) / (N - 1));
        for (r, line) in lines.iter_mut().enumerate() {
            *line = intrinsic!(_mm256_loadu_ps(x.as_ptr().add(r * stride)));
        }
        return lines;
    }
    // A fixed number of turns, so that the lines stay in registers.
    for (r, line) in lines.iter_mut().enumerate() {
        if r < rows {
            let x = &x[r * stride..][..columns];
            *line = if columns == 8 { Avx2::load(x).0 } else { Avx2::load_partial(x).0 };
        }
    }
    lines
}

/// Transposes all blocks of 4 by 4 numbers in registers 0 to 3, and all in registers 4 to 7.
macro_rules! transpose_quads {
    ($lines:ident, $low:ident, $high:ident, $shuffle:ident) => {{
        let mut quads = $lines;
        for first in [0, 4] {
            let [a, b, c, d] = [$lines[first], $lines[first + 1], $lines[first + 2], $lines[first + 3]];
            let (ab, cd) = (intrinsic!($low(a, b)), intrinsic!($low(c, d)));
            quads[first] = intrinsic!($shuffle::<0x44>(ab, cd));
            quads[first + 1] = intrinsic!($shuffle::<0xee>(ab, cd));
            let (ab, cd) = (intrinsic!($high(a, b)), intrinsic!($high(c, d)));
            quads[first + 2] = intrinsic!($shuffle::<0x44>(ab, cd));
            quads[first + 3] = intrinsic!($shuffle::<0xee>(ab, cd));
        }
        quads
    }};
}

/// Sixteen lanes.
#[derive(Clone, Copy)]
pub(super) struct Avx512(__m512);

/// A mask of the first `n` of sixteen lanes; `n` below 16.
#[inline(always)]
fn first_of_16(n: usize) -> __mmask16 {
    assert!(n < 16);
    (1 << n) - 1
}

impl Vector for Avx512 {
    const LANES: usize = 16;
    const COLUMNS: usize = 4;
    const UNROLLED: usize = 1;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        Avx512(intrinsic!(_mm512_set1_ps(x)))
    }

    #[inline(always)]
    fn load(x: &[f32]) -> Self {
        assert!(x.len() >= 16);
        Avx512(intrinsic!(_mm512_loadu_ps(x.as_ptr())))
    }

    #[inline(always)]
    fn load_partial(x: &[f32]) -> Self {
        let mask = first_of_16(x.len());
        Avx512(intrinsic!(_mm512_maskz_loadu_ps(mask, x.as_ptr())))
    }

    type Spreading = ();

    #[inline(always)]
    fn spreading() {}

    #[inline(always)]
    fn spread<const P: usize>(x: &[f32], at: usize, (): ()) -> Self {
        const { assert!(P == 4 || P == 8 || P == 16) };
        let (x, n) = (&x[at..], 16 / P);
        assert!(x.len() >= n);
        let numbers = match n {
            4 => intrinsic!(_mm_loadu_ps(x.as_ptr())),
            2 => intrinsic!(_mm_castpd_ps(_mm_load_sd(x.as_ptr().cast()))),
            _ => return Self::splat(x[0]),
        };
        let lanes: [i32; 16] = std::array::from_fn(|lane| (lane / P) as i32);
        let index = intrinsic!(_mm512_loadu_si512(lanes.as_ptr().cast()));
        Avx512(intrinsic!(_mm512_permutexvar_ps(index, _mm512_castps128_ps512(numbers))))
    }

    #[inline(always)]
    fn store(self, out: &mut [f32]) {
        assert!(out.len() >= 16);
        intrinsic!(_mm512_storeu_ps(out.as_mut_ptr(), self.0))
    }

    #[inline(always)]
    fn store_partial(self, out: &mut [f32]) {
        let mask = first_of_16(out.len());
        intrinsic!(_mm512_mask_storeu_ps(out.as_mut_ptr(), mask, self.0))
    }

    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        Avx512(intrinsic!(_mm512_fmadd_ps(self.0, a.0, b.0)))
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Avx512(intrinsic!(_mm512_add_ps(self.0, other.0)))
    }

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Avx512(intrinsic!(_mm512_sub_ps(self.0, other.0)))
    }

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Avx512(intrinsic!(_mm512_mul_ps(self.0, other.0)))
    }

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        Avx512(intrinsic!(_mm512_div_ps(self.0, other.0)))
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Avx512(intrinsic!(_mm512_sqrt_ps(self.0)))
    }

    #[inline(always)]
    fn relu(self) -> Self {
        // Of zeros, and where one is a NaN, this takes the second.
        Avx512(intrinsic!(_mm512_max_ps(_mm512_setzero_ps(), self.0)))
    }

    #[inline(always)]
    fn gate(self, activation: Self) -> Self {
        let closed = intrinsic!(_mm512_cmp_ps_mask::<_CMP_LE_OQ>(activation.0, _mm512_setzero_ps()));
        Avx512(intrinsic!(_mm512_maskz_mov_ps(!closed, self.0)))
    }

    #[inline(always)]
    fn flush_subnormal(self) -> Self {
        let smallest = Self::splat(f32::MIN_POSITIVE);
        let tiny = intrinsic!(_mm512_cmp_ps_mask::<_CMP_LT_OQ>(_mm512_abs_ps(self.0), smallest.0));
        Avx512(intrinsic!(_mm512_maskz_mov_ps(!tiny, self.0)))
    }

    #[inline(always)]
    fn store_lines<const N: usize>(lines: &[Self; 8], out: &mut [f32], stride: usize) {
        const { assert!(1 < N && N <= 8) };
        // One comparison for all.
        assert!(out.len() >= 16 && stride <= (out.len() - 16) / (N - 1));
        for (c, line) in lines.iter().enumerate().take(N) {
            intrinsic!(_mm512_storeu_ps(out.as_mut_ptr().add(c * stride), line.0));
        }
    }

    #[inline(always)]
    fn columns(x: &[f32], stride: usize, rows: usize, columns: usize) -> [Self; 8] {
        let halves = lines_of_8::<16>(x, stride, rows, columns);
        let mut lines = [Self::splat(0.0).0; 8];
        for (i, line) in lines.iter_mut().enumerate() {
            // Rows 0 to 3 with 4 to 7 behind them, then rows 8 to 11 with 12 to 15.
            let row = i + i / 4 * 4;
            let low = intrinsic!(_mm512_castpd256_pd512(_mm256_castps_pd(halves[row])));
            let high = intrinsic!(_mm256_castps_pd(halves[row + 4]));
            *line = intrinsic!(_mm512_castpd_ps(_mm512_insertf64x4::<1>(low, high)));
        }
        let quads = transpose_quads!(lines, _mm512_unpacklo_ps, _mm512_unpackhi_ps, _mm512_shuffle_ps);
        let mut columns = [Self::splat(0.0); 8];
        for c in 0..4 {
            let (a, b) = (quads[c], quads[c + 4]);
            columns[c] = Avx512(intrinsic!(_mm512_shuffle_f32x4::<0x88>(a, b)));
            columns[c + 4] = Avx512(intrinsic!(_mm512_shuffle_f32x4::<0xdd>(a, b)));
        }
        columns
    }
}

/// Eight lanes.
#[derive(Clone, Copy)]
pub(super) struct Avx2(__m256);

/// A mask of the first `n` of eight lanes; `n` below 8.
#[inline(always)]
fn first_of_8(n: usize) -> __m256i {
    const SLIDING: [i32; 16] = [-1, -1, -1, -1, -1, -1, -1, -1, 0, 0, 0, 0, 0, 0, 0, 0];
    let mask: &[i32] = &SLIDING[8 - n..16 - n];
    intrinsic!(_mm256_loadu_si256(mask.as_ptr().cast()))
}

/// The columns of a block of eight rows, `stride` numbers apart, of eight or four numbers.
///
/// Loads rows 0 to 3 with rows 4 to 7 behind them, four numbers of each, so that nothing is left to do across the halves.
#[inline(always)]
fn whole_columns(x: &[f32], stride: usize, columns: usize) -> [Avx2; 8] {
    let mut lines = [Avx2::splat(0.0).0; 8];
    assert!((columns == 4 || columns == 8) && x.len() >= columns && stride <= (x.len() - columns) / 7);
    for (i, line) in lines.iter_mut().enumerate().take(columns) {
        let at = i % 4 * stride + i / 4 * 4;
        let (low, high) = intrinsic!((x.as_ptr().add(at), x.as_ptr().add(at + 4 * stride)));
        *line = intrinsic!(_mm256_loadu2_m128(high, low));
    }
    let quads = transpose_quads!(lines, _mm256_unpacklo_ps, _mm256_unpackhi_ps, _mm256_shuffle_ps);
    let mut found = [Avx2::splat(0.0); 8];
    for (found, quad) in found.iter_mut().zip(quads) {
        found.0 = quad;
    }
    found
}

impl Vector for Avx2 {
    const LANES: usize = 8;
    const COLUMNS: usize = 2;
    const UNROLLED: usize = 4;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        Avx2(intrinsic!(_mm256_set1_ps(x)))
    }

    #[inline(always)]
    fn load(x: &[f32]) -> Self {
        assert!(x.len() >= 8);
        Avx2(intrinsic!(_mm256_loadu_ps(x.as_ptr())))
    }

    #[inline(always)]
    fn load_partial(x: &[f32]) -> Self {
        let mask = first_of_8(x.len());
        Avx2(intrinsic!(_mm256_maskload_ps(x.as_ptr(), mask)))
    }

    /// Numbers 0 and 1 of each half, and numbers 2 and 3, four times each.
    type Spreading = [__m256i; 2];

    #[inline(always)]
    fn spreading() -> [__m256i; 2] {
        // Where the compiler knows the indices, it makes two shuffles of one, and one of them across the halves.
        let [low, high]: [[i32; 8]; 2] = black_box([[0, 0, 0, 0, 1, 1, 1, 1], [2, 2, 2, 2, 3, 3, 3, 3]]);
        let low = intrinsic!(_mm256_loadu_si256(low.as_ptr().cast()));
        let high = intrinsic!(_mm256_loadu_si256(high.as_ptr().cast()));
        [low, high]
    }

    #[inline(always)]
    fn spread<const P: usize>(x: &[f32], at: usize, with: [__m256i; 2]) -> Self {
        const { assert!(P == 4 || P == 8 || P == 16) };
        if P >= 8 {
            return Self::splat(x[at]);
        }
        // Four numbers in each half; of two of them this takes one for each half.
        let four = &x[at / 4 * 4..][..4];
        let both = intrinsic!(_mm256_broadcast_ps(&_mm_loadu_ps(four.as_ptr())));
        Avx2(intrinsic!(_mm256_permutevar_ps(both, with[at % 4 / 2])))
    }

    #[inline(always)]
    fn store(self, out: &mut [f32]) {
        assert!(out.len() >= 8);
        intrinsic!(_mm256_storeu_ps(out.as_mut_ptr(), self.0))
    }

    #[inline(always)]
    fn store_partial(self, out: &mut [f32]) {
        let mask = first_of_8(out.len());
        intrinsic!(_mm256_maskstore_ps(out.as_mut_ptr(), mask, self.0))
    }

    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        Avx2(intrinsic!(_mm256_fmadd_ps(self.0, a.0, b.0)))
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Avx2(intrinsic!(_mm256_add_ps(self.0, other.0)))
    }

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Avx2(intrinsic!(_mm256_sub_ps(self.0, other.0)))
    }

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Avx2(intrinsic!(_mm256_mul_ps(self.0, other.0)))
    }

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        Avx2(intrinsic!(_mm256_div_ps(self.0, other.0)))
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Avx2(intrinsic!(_mm256_sqrt_ps(self.0)))
    }

    #[inline(always)]
    fn relu(self) -> Self {
        // Of zeros, and where one is a NaN, this takes the second.
        Avx2(intrinsic!(_mm256_max_ps(_mm256_setzero_ps(), self.0)))
    }

    #[inline(always)]
    fn gate(self, activation: Self) -> Self {
        let closed = intrinsic!(_mm256_cmp_ps::<_CMP_LE_OQ>(activation.0, _mm256_setzero_ps()));
        Avx2(intrinsic!(_mm256_andnot_ps(closed, self.0)))
    }

    #[inline(always)]
    fn flush_subnormal(self) -> Self {
        let (sign, smallest) = (Self::splat(-0.0), Self::splat(f32::MIN_POSITIVE));
        let magnitude = intrinsic!(_mm256_andnot_ps(sign.0, self.0));
        let tiny = intrinsic!(_mm256_cmp_ps::<_CMP_LT_OQ>(magnitude, smallest.0));
        Avx2(intrinsic!(_mm256_andnot_ps(tiny, self.0)))
    }

    #[inline(always)]
    fn store_lines<const N: usize>(lines: &[Self; 8], out: &mut [f32], stride: usize) {
        const { assert!(1 < N && N <= 8) };
        // One comparison for all.
        assert!(out.len() >= 8 && stride <= (out.len() - 8) / (N - 1));
        for (c, line) in lines.iter().enumerate().take(N) {
            intrinsic!(_mm256_storeu_ps(out.as_mut_ptr().add(c * stride), line.0));
        }
    }

    #[inline(always)]
    fn columns(x: &[f32], stride: usize, rows: usize, columns: usize) -> [Self; 8] {
        if rows == 8 && (columns == 8 || columns == 4) {
            return whole_columns(x, stride, columns);
        }
        let lines = lines_of_8::<8>(x, stride, rows, columns);
        let quads = transpose_quads!(lines, _mm256_unpacklo_ps, _mm256_unpackhi_ps, _mm256_shuffle_ps);
        let mut columns = [Self::splat(0.0); 8];
        for c in 0..4 {
            let (a, b) = (quads[c], quads[c + 4]);
            columns[c] = Avx2(intrinsic!(_mm256_permute2f128_ps::<0x20>(a, b)));
            columns[c + 4] = Avx2(intrinsic!(_mm256_permute2f128_ps::<0x31>(a, b)));
        }
        columns
    }
}
