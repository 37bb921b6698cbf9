//! AVX-512 and AVX2 forms of [`Vector`], and the two functions that are compiled for these instruction sets.
#![allow(unsafe_code)]

use std::arch::x86_64::*;

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
        let negative = intrinsic!(_mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, _mm512_setzero_ps()));
        Avx512(intrinsic!(_mm512_maskz_mov_ps(!negative, self.0)))
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
    fn transpose_8x8(rows: [&[f32]; 8]) -> [[f32; 8]; 8] {
        Avx2::transpose_8x8(rows)
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

impl Vector for Avx2 {
    const LANES: usize = 8;
    const COLUMNS: usize = 2;

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
        let negative = intrinsic!(_mm256_cmp_ps::<_CMP_LT_OQ>(self.0, _mm256_setzero_ps()));
        Avx2(intrinsic!(_mm256_andnot_ps(negative, self.0)))
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
    fn transpose_8x8(rows: [&[f32]; 8]) -> [[f32; 8]; 8] {
        let mut r = [intrinsic!(_mm256_setzero_ps()); 8];
        for i in 0..8 {
            r[i] = Avx2::load(rows[i]).0;
        }
        // Pairs of rows, then quadruples, then halves: each step doubles the length of the finished pieces.
        let mut pairs = r;
        for i in (0..8).step_by(2) {
            pairs[i] = intrinsic!(_mm256_unpacklo_ps(r[i], r[i + 1]));
            pairs[i + 1] = intrinsic!(_mm256_unpackhi_ps(r[i], r[i + 1]));
        }
        let mut quads = pairs;
        for half in [0, 4] {
            for i in 0..2 {
                let (a, b) = (pairs[half + i], pairs[half + i + 2]);
                quads[half + 2 * i] = intrinsic!(_mm256_shuffle_ps::<0x44>(a, b));
                quads[half + 2 * i + 1] = intrinsic!(_mm256_shuffle_ps::<0xee>(a, b));
            }
        }
        let mut columns = [[0.0; 8]; 8];
        for i in 0..4 {
            let (a, b) = (quads[i], quads[i + 4]);
            Avx2(intrinsic!(_mm256_permute2f128_ps::<0x20>(a, b))).store(&mut columns[i]);
            Avx2(intrinsic!(_mm256_permute2f128_ps::<0x31>(a, b))).store(&mut columns[i + 4]);
        }
        columns
    }
}
