//! The arithmetic of a gradient step, vectorised for the machine at hand and bit-identical on all of them.
//!
//! A kernel is a struct of slices that implements `Op`: its code is written once, generic over `Vector`,
//! one register of `f32` lanes. `Kernels::run` instantiates it for AVX-512, for AVX2 with FMA and portably,
//! and picks one at run time. No `target-cpu` flag is needed, and one binary serves every x86-64 machine.
//!
//! Why the bits agree: every output element is one chain of fused multiply-adds in ascending order of the
//! inner index, whatever tile or lane it happens to be computed in; reductions, and the few columns of an
//! output layer, always run over 64 partial sums and one fixed tree; all other operations are single IEEE
//! operations an element. Only the payload of a NaN may differ.
//!
//! `unsafe` is confined to two places: calling the intrinsics of an instruction set (`x86.rs`), and entering
//! the code compiled for it (`Kernels::run`), which is sound because a [`Kernels`] can only be had for an
//! instruction set that the machine was found to have.

mod elementwise;
mod fold;
mod narrow;
mod output_layer;
pub mod peak;
mod product;
mod reduce;
mod transpose;
mod vector;
#[cfg(target_arch = "x86_64")]
mod x86;

pub(crate) use elementwise::{AdamStep, Blend, Rescale, Scale, rescaled};
pub(crate) use fold::Fold;
pub(crate) use narrow::NarrowProduct;
#[cfg(test)]
pub(crate) use narrow::by_definition;
pub(crate) use output_layer::OutputLayer;
pub(crate) use product::{After, ByColumn, ByRow, Gathered, Left, Product, Within};
pub(crate) use reduce::{ColumnSums, SumOfSquares};
pub(crate) use transpose::Transpose;
pub(crate) use vector::Op;

/// An instruction set that the kernels are compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Isa {
    /// x86-64 with AVX-512F: 16 lanes.
    Avx512,
    /// x86-64 with AVX2 and FMA: 8 lanes.
    Avx2,
    /// Portable Rust; where the compiler's baseline has no fused multiply-add, slow but still correct.
    Scalar,
}

impl Isa {
    /// All instruction sets, fastest first.
    pub const ALL: [Isa; 3] = [Isa::Avx512, Isa::Avx2, Isa::Scalar];

    /// Whether this machine has the instruction set.
    pub fn is_available(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Isa::Avx512 => is_x86_feature_detected!("avx512f") && Isa::Avx2.is_available(),
            #[cfg(target_arch = "x86_64")]
            Isa::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            #[cfg(not(target_arch = "x86_64"))]
            Isa::Avx512 | Isa::Avx2 => false,
            Isa::Scalar => true,
        }
    }

    /// The instruction sets of this machine, fastest first; never empty.
    pub fn available() -> impl Iterator<Item = Isa> {
        Isa::ALL.into_iter().filter(|isa| isa.is_available())
    }

    /// The fastest instruction set of this machine.
    pub fn detect() -> Isa {
        Isa::available().next().unwrap_or(Isa::Scalar)
    }
}

impl std::fmt::Display for Isa {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Isa::Avx512 => "avx512",
            Isa::Avx2 => "avx2",
            Isa::Scalar => "scalar",
        })
    }
}

/// Permission to run the kernels on one instruction set: proof that this machine has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kernels {
    /// Private, so that only [`Kernels::new`] sets it.
    isa: Isa,
}

impl Kernels {
    /// Kernels on `isa`, or `None` if this machine lacks it.
    pub fn new(isa: Isa) -> Option<Kernels> {
        isa.is_available().then_some(Kernels { isa })
    }

    /// Kernels on the fastest instruction set of this machine.
    pub fn detect() -> Kernels {
        Kernels { isa: Isa::detect() }
    }

    /// The instruction set.
    pub fn isa(self) -> Isa {
        self.isa
    }

    /// Runs `op` in code compiled for the instruction set.
    #[inline]
    #[allow(unsafe_code)]
    pub(crate) fn run<O: Op>(self, op: O) -> O::Output {
        match self.isa {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `self` exists, so this machine was found to have AVX-512F.
            Isa::Avx512 => unsafe { x86::run_avx512(op) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `self` exists, so this machine was found to have AVX2 and FMA.
            Isa::Avx2 => unsafe { x86::run_avx2(op) },
            #[cfg(not(target_arch = "x86_64"))]
            Isa::Avx512 | Isa::Avx2 => op.run::<vector::Portable>(),
            Isa::Scalar => op.run::<vector::Portable>(),
        }
    }
}

impl Default for Kernels {
    fn default() -> Kernels {
        Kernels::detect()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn kernels_exist_for_what_the_machine_has() {
        let available: Vec<Isa> = Isa::available().collect();
        assert_eq!(available.last(), Some(&Isa::Scalar));
        assert_eq!(available[0], Isa::detect());
        for isa in Isa::ALL {
            assert_eq!(Kernels::new(isa).map(Kernels::isa), available.contains(&isa).then_some(isa));
        }
        assert_eq!(Kernels::default(), Kernels::new(Isa::detect()).unwrap());
        assert_eq!(Isa::Avx2.to_string(), "avx2");
    }
}
