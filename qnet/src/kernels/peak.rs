//! Loops that do nothing but reach the machine's limits: the yardstick that benchmarks hold the gradient step to.

use super::Kernels;
use super::vector::{Op, Vector};
use std::hint::black_box;

/// Independent chains of multiply-adds: enough to hide their latency on two pipelines, and few enough for the
/// sixteen registers of AVX2.
const CHAINS: usize = 12;

struct Chains {
    rounds: u64,
}

impl Op for Chains {
    /// Floating-point operations done.
    type Output = u64;

    #[inline(always)]
    fn run<S: Vector>(self) -> u64 {
        // Each chain runs towards 1, so its numbers stay normal.
        let (share, rest) = (S::splat(black_box(0.5)), S::splat(black_box(0.5)));
        let mut sums = [S::splat(black_box(0.25)); CHAINS];
        for _ in 0..self.rounds {
            for sum in &mut sums {
                *sum = sum.mul_add(share, rest);
            }
        }
        let mut lanes = [0.0; 64];
        for sum in sums {
            sum.store(&mut lanes);
            black_box(&lanes);
        }
        2 * self.rounds * (CHAINS * S::LANES) as u64
    }
}

/// Does `rounds` rounds of fused multiply-adds that never leave the registers, and returns the number of
/// floating-point operations, of which a multiply-add is two. The time that they take gives the highest rate of
/// arithmetic that `kernels` could reach.
pub fn multiply_adds(kernels: Kernels, rounds: u64) -> u64 {
    kernels.run(Chains { rounds })
}

struct Traffic<'a> {
    state: [&'a mut [f32]; 3],
    grad: &'a [f32],
}

impl Op for Traffic<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Vector>(self) {
        let Traffic { state: [params, m, v], grad } = self;
        let full = grad.len() - grad.len() % S::LANES;
        assert!(params.len() >= full && m.len() >= full && v.len() >= full);
        let mut at = 0;
        while at < full {
            let here = at..at + S::LANES;
            let g = S::load(&grad[here.clone()]);
            for x in [&mut *params, &mut *m, &mut *v] {
                let x = &mut x[here.clone()];
                S::load(x).add(g).store(x);
            }
            at += S::LANES;
        }
    }
}

/// Moves the bytes that a step of [`crate::Adam`] has to move, 28 a parameter: reads parameters, both moments and
/// the gradient, adds the gradient to the other three (a gradient of 0 leaves them as they are) and writes them.
/// Adam cannot take less time than this.
///
/// # Panics
/// If `params`, `m` or `v` is shorter than `grad`.
pub fn adam_traffic(kernels: Kernels, params: &mut [f32], m: &mut [f32], v: &mut [f32], grad: &[f32]) {
    kernels.run(Traffic { state: [params, m, v], grad });
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::kernels::Isa;

    #[test]
    fn operations_are_counted_and_bytes_are_moved() {
        for isa in Isa::available() {
            let kernels = Kernels::new(isa).unwrap();
            let one = multiply_adds(kernels, 1);
            assert_eq!(one % (2 * CHAINS as u64), 0, "{isa}");
            assert_eq!(multiply_adds(kernels, 5), 5 * one, "{isa}");
            let (mut params, mut m, mut v) = ([1.0; 64], [2.0; 64], [3.0; 64]);
            adam_traffic(kernels, &mut params, &mut m, &mut v, &[0.5; 64]);
            assert_eq!((params, m, v), ([1.5; 64], [2.5; 64], [3.5; 64]), "{isa}");
        }
    }
}
