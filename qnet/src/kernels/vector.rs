//! One register of `f32` lanes: the trait that the kernels are generic over, and its portable form.

/// Lanes that are computed alike. Each method is one IEEE operation a lane.
///
/// Implementations for an instruction set may be used only inside an [`Op`] that [`super::Kernels::run`]
/// started, which makes sure that the machine has the instructions. They must be inlined all the way
/// into it, or each operation becomes a function call.
pub(crate) trait Vector: Copy {
    /// Number of lanes; a divisor of 64.
    const LANES: usize;
    /// Registers side by side in a full tile of a matrix product, chosen so that six rows of them fit the
    /// register file.
    const COLUMNS: usize;
    /// Inner indices in one turn of the loop of a full tile. Branch prediction misses the end of a long loop, which is dear
    /// where there are many small tiles.
    const UNROLLED: usize;

    /// The same number in every lane.
    fn splat(x: f32) -> Self;
    /// The first `LANES` numbers of a slice that has at least as many.
    fn load(x: &[f32]) -> Self;
    /// All numbers of a slice with fewer than `LANES`; the other lanes are 0.
    fn load_partial(x: &[f32]) -> Self;
    /// What [`Vector::spread`] needs in registers.
    type Spreading: Copy;
    /// Puts it there, once for many calls.
    fn spreading() -> Self::Spreading;
    /// Each of some numbers of a slice, from `x[at]` on, in `P` lanes side by side: lane `l` is `x[at + l / P]`. `P` is 4, 8
    /// or 16; `at` is a multiple of `LANES / P`, and the slice has a multiple of four numbers.
    fn spread<const P: usize>(x: &[f32], at: usize, with: Self::Spreading) -> Self;
    /// Writes the lanes to the first `LANES` places of a slice that has at least as many.
    fn store(self, out: &mut [f32]);
    /// Writes the first lanes to a slice with fewer than `LANES` places.
    fn store_partial(self, out: &mut [f32]);
    /// `self * a + b`, rounded once.
    fn mul_add(self, a: Self, b: Self) -> Self;
    /// `self + other`.
    fn add(self, other: Self) -> Self;
    /// `self - other`.
    fn sub(self, other: Self) -> Self;
    /// `self * other`.
    fn mul(self, other: Self) -> Self;
    /// `self / other`.
    fn div(self, other: Self) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// 0 where negative. NaN and -0 stay.
    fn relu(self) -> Self;
    /// 0 where `activation` is 0 or below: the derivative of [`Vector::relu`] at its output.
    fn gate(self, activation: Self) -> Self;
    /// 0 where the magnitude is below the smallest normal number.
    fn flush_subnormal(self) -> Self;
    /// The columns of a block with up to `LANES` rows, `stride` numbers apart, of up to eight numbers: lane `r`
    /// of register `c` is `x[r * stride + c]`, or 0 outside the block. The compiler does not find the shuffles
    /// for it by itself.
    fn columns(x: &[f32], stride: usize, rows: usize, columns: usize) -> [Self; 8];
    /// Writes the first `N` of eight registers to places `stride` numbers apart.
    #[inline(always)]
    fn store_lines<const N: usize>(lines: &[Self; 8], out: &mut [f32], stride: usize) {
        for (c, line) in lines.iter().enumerate().take(N) {
            line.store(&mut out[c * stride..]);
        }
    }
}

/// A kernel with its arguments.
pub(crate) trait Op {
    /// Type of its result.
    type Output;
    /// Runs it. Implementations are `#[inline(always)]`, see [`Vector`].
    fn run<S: Vector>(self) -> Self::Output;
}

/// Eight lanes in plain Rust. Miri and machines other than x86-64 run this form, too.
pub(super) type Portable = [f32; 8];

/// Applies a function lane by lane.
#[inline(always)]
fn map(mut x: Portable, f: impl Fn(f32, usize) -> f32) -> Portable {
    for (lane, x) in x.iter_mut().enumerate() {
        *x = f(*x, lane);
    }
    x
}

impl Vector for Portable {
    const LANES: usize = 8;
    const COLUMNS: usize = 2;
    const UNROLLED: usize = 1;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        [x; 8]
    }

    #[inline(always)]
    fn load(x: &[f32]) -> Self {
        let mut lanes = [0.0; 8];
        lanes.copy_from_slice(&x[..8]);
        lanes
    }

    #[inline(always)]
    fn load_partial(x: &[f32]) -> Self {
        let mut lanes = [0.0; 8];
        lanes[..x.len()].copy_from_slice(x);
        lanes
    }

    type Spreading = ();

    #[inline(always)]
    fn spreading() {}

    #[inline(always)]
    fn spread<const P: usize>(x: &[f32], at: usize, (): ()) -> Self {
        map([0.0; 8], |_, lane| x[at + lane / P])
    }

    #[inline(always)]
    fn store(self, out: &mut [f32]) {
        out[..8].copy_from_slice(&self);
    }

    #[inline(always)]
    fn store_partial(self, out: &mut [f32]) {
        out.copy_from_slice(&self[..out.len()]);
    }

    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        map(self, |x, lane| x.mul_add(a[lane], b[lane]))
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        map(self, |x, lane| x + other[lane])
    }

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        map(self, |x, lane| x - other[lane])
    }

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        map(self, |x, lane| x * other[lane])
    }

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        map(self, |x, lane| x / other[lane])
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        map(self, |x, _| x.sqrt())
    }

    #[inline(always)]
    fn relu(self) -> Self {
        map(self, |x, _| if 0.0 > x { 0.0 } else { x })
    }

    #[inline(always)]
    fn gate(self, activation: Self) -> Self {
        map(self, |x, lane| if activation[lane] <= 0.0 { 0.0 } else { x })
    }

    #[inline(always)]
    fn flush_subnormal(self) -> Self {
        map(self, |x, _| if x.abs() < f32::MIN_POSITIVE { 0.0 } else { x })
    }

    #[inline(always)]
    fn columns(x: &[f32], stride: usize, rows: usize, columns: usize) -> [Self; 8] {
        let mut lanes = [[0.0; 8]; 8];
        for r in 0..rows {
            for (c, &x) in x[r * stride..][..columns].iter().enumerate() {
                lanes[c][r] = x;
            }
        }
        lanes
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::kernels::{Isa, Kernels};

    /// Every operation of [`Vector`] on every number, one after the other.
    struct Everything<'a> {
        a: &'a [f32],
        b: &'a [f32],
    }

    impl Op for Everything<'_> {
        type Output = Vec<f32>;

        #[inline(always)]
        fn run<S: Vector>(self) -> Vec<f32> {
            let mut out = Vec::new();
            let mut keep = |y: S, n: usize| {
                let at = out.len();
                out.resize(at + n, f32::NAN);
                if n == S::LANES { y.store(&mut out[at..]) } else { y.store_partial(&mut out[at..]) }
            };
            for op in 0..10 {
                for (a, b) in self.a.chunks(S::LANES).zip(self.b.chunks(S::LANES)) {
                    let n = a.len();
                    let (x, y) = if n == S::LANES {
                        (S::load(a), S::load(b))
                    } else {
                        (S::load_partial(a), S::load_partial(b))
                    };
                    keep(
                        match op {
                            0 => x.mul_add(y, S::splat(0.1)),
                            1 => x.add(y),
                            2 => x.sub(y),
                            3 => x.mul(y),
                            4 => x.div(y),
                            5 => x.sqrt(),
                            6 => x.relu(),
                            7 => x.gate(y),
                            8 => x.flush_subnormal(),
                            _ => y,
                        },
                        n,
                    );
                }
            }
            out
        }
    }

    fn bits(x: &[f32]) -> Vec<u32> {
        // All NaNs count as one: only their payload may differ.
        x.iter().map(|x| if x.is_nan() { f32::NAN.to_bits() } else { x.to_bits() }).collect()
    }

    proptest! {
        #[test]
        fn every_instruction_set_computes_the_same_bits(
            pairs in prop::collection::vec((prop::num::f32::ANY, prop::num::f32::ANY), 1..70),
        ) {
            let (mut a, mut b): (Vec<f32>, Vec<f32>) = pairs.into_iter().unzip();
            a.extend([0.0, -0.0, f32::NAN, 1.0, 1.0, f32::MIN_POSITIVE, -1e-45]);
            b.extend([-0.0, 1.0, 1.0, f32::NAN, 0.0, -1.0, 1e-39]);
            let n = a.len();
            let expected = Everything { a: &a, b: &b }.run::<Portable>();
            for (i, (&x, &y)) in a.iter().zip(&b).enumerate() {
                let naive = [x.mul_add(y, 0.1), x + y, x - y, x * y, x / y, x.sqrt()];
                for (op, value) in naive.into_iter().enumerate() {
                    prop_assert_eq!(bits(&[expected[op * n + i]]), bits(&[value]));
                }
                prop_assert_eq!(expected[9 * n + i].to_bits(), y.to_bits());
            }
            for isa in Isa::available() {
                let got = Kernels::new(isa).map(|kernels| kernels.run(Everything { a: &a, b: &b }));
                prop_assert_eq!(got.map(|got| bits(&got)), Some(bits(&expected)), "{}", isa);
            }
        }
    }
}
