//! The gradient of a convolution's input from that of the numbers under its kernel.

use super::vector::{Op, Vector};

/// `out[r] = gate(activations[picked[r]], sum over the places of r)`: adds up what the kernel's positions say of each number, in
/// ascending order of the positions, and lets it through where the activation is above 0.
pub(crate) struct Fold<'a> {
    /// `[positions][runs * run]`, the positions of all rows.
    pub(crate) patches: &'a [f32],
    /// Where the first number under the kernel lies in `out`, for each position.
    pub(crate) bases: &'a [u32],
    /// Numbers that lie side by side, and how many such runs there are, how far apart.
    pub(crate) run: usize,
    /// Number of runs.
    pub(crate) runs: usize,
    /// How far apart they begin.
    pub(crate) apart: usize,
    /// Numbers of a row.
    pub(crate) width: usize,
    /// Outputs of a ReLU layer, `[..][width]`.
    pub(crate) activations: &'a [f32],
    /// Which of its rows belongs to each row.
    pub(crate) picked: &'a [u32],
    /// Result, `[rows][width]`; overwritten.
    pub(crate) out: &'a mut [f32],
}

impl Op for Fold<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Vector>(self) {
        let Fold { patches, bases, run, runs, apart, width, activations, picked, out } = self;
        let out = &mut out[..picked.len() * width];
        out.fill(0.0);
        for (patch, &base) in patches.chunks_exact(run * runs).zip(bases) {
            for (r, patch) in patch.chunks_exact(run).enumerate() {
                let out = &mut out[base as usize + r * apart..][..run];
                out.iter_mut().zip(patch).for_each(|(out, x)| *out += x);
            }
        }
        for (out, &row) in out.chunks_exact_mut(width).zip(picked) {
            let activations = &activations[row as usize * width..][..width];
            for (out, &activation) in out.iter_mut().zip(activations) {
                *out = if activation <= 0.0 { 0.0 } else { *out };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::kernels::{Isa, Kernels};

    #[test]
    fn overlapping_positions_add_up_behind_the_gate() {
        // Rows of 3 x 3 numbers, a kernel of 2 x 2 at four positions.
        let patches: Vec<f32> = (0..32).map(|i| i as f32).collect();
        let bases = [0, 1, 3, 4, 9, 10, 12, 13];
        let mut activations = [1.0; 27];
        activations[18] = 0.0;
        for isa in Isa::available() {
            let mut out = [f32::NAN; 18];
            Kernels::new(isa).unwrap().run(Fold {
                patches: &patches,
                bases: &bases,
                run: 2,
                runs: 2,
                apart: 3,
                width: 9,
                activations: &activations,
                picked: &[1, 2],
                out: &mut out,
            });
            // Position p gives its numbers 4 p to 4 p + 3 to the places b, b + 1, b + 3 and b + 4.
            let first =
                [0.0, 1.0 + 4.0, 5.0, 2.0 + 8.0, 3.0 + 6.0 + 9.0 + 12.0, 7.0 + 13.0, 10.0, 11.0 + 14.0, 15.0];
            assert_eq!(out[..9], first, "{isa}");
            assert_eq!((out[9], out[13], out[17]), (0.0, 19.0 + 22.0 + 25.0 + 28.0, 31.0), "{isa}");
        }
    }
}
