//! Adam (Kingma and Ba, arXiv 1412.6980) on a flat parameter vector, as PyTorch computes it, and clipping of
//! the gradient's norm.
//!
//! The moments are plain vectors for a checkpoint to save and restore. The paper names no optimiser; Adam and
//! its defaults are our choice.

use serde::{Deserialize, Serialize};

use crate::kernels::{AdamStep, Kernels, Scale, SumOfSquares};
use crate::threads::{Threads, Work, share};

/// Why a setting of Adam is not usable.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("Adam's {name} is {got}; accepted are {accepted}")]
pub struct AdamError {
    /// Name of the setting.
    pub name: &'static str,
    /// The value given.
    pub got: f64,
    /// The accepted values, in words.
    pub accepted: &'static str,
}

/// Settings of Adam, in `f64` so that `1 - beta2` keeps its digits.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AdamConfig {
    /// Learning rate; finite and above 0.
    pub lr: f64,
    /// Decay of the mean gradient, per step; 0 to below 1.
    pub beta1: f64,
    /// Decay of the mean squared gradient, per step; 0 to below 1.
    pub beta2: f64,
    /// Added to the root of the mean squared gradient; finite and above 0.
    pub eps: f64,
}

impl Default for AdamConfig {
    /// PyTorch's defaults.
    fn default() -> AdamConfig {
        AdamConfig { lr: 1e-3, beta1: 0.9, beta2: 0.999, eps: 1e-8 }
    }
}

impl AdamConfig {
    /// Checks that every setting is in range.
    ///
    /// # Errors
    /// The first setting that is not.
    pub fn validate(&self) -> Result<(), AdamError> {
        for (name, got) in [("lr", self.lr), ("eps", self.eps)] {
            if !(got > 0.0 && got.is_finite()) {
                return Err(AdamError { name, got, accepted: "finite numbers above 0" });
            }
        }
        for (name, got) in [("beta1", self.beta1), ("beta2", self.beta2)] {
            if !(0.0..1.0).contains(&got) {
                return Err(AdamError { name, got, accepted: "numbers from 0 to below 1" });
            }
        }
        Ok(())
    }
}

/// The state of Adam: all that a checkpoint has to keep.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Adam {
    /// Mean of the gradient, one number a parameter.
    pub m: Vec<f32>,
    /// Mean of the squared gradient, one number a parameter.
    pub v: Vec<f32>,
    /// How many steps were taken.
    pub step: u64,
}

impl Adam {
    /// The state before the first step, for `n_params` parameters.
    pub fn new(n_params: usize) -> Adam {
        Adam { m: vec![0.0; n_params], v: vec![0.0; n_params], step: 0 }
    }

    /// One step down the gradient, in place.
    ///
    /// With `m` and `v` updated first and `t` the number of this step, from 1: `params -= lr / (1 - beta1^t)
    /// * m / (sqrt(v) / sqrt(1 - beta2^t) + eps)`. Moments below the smallest normal number become 0.
    ///
    /// # Panics
    /// If `params` or `grad` have another length than the moments.
    pub fn step(
        &mut self,
        config: &AdamConfig,
        kernels: Kernels,
        threads: &Threads,
        params: &mut [f32],
        grad: &[f32],
    ) {
        let n = params.len();
        assert!(self.m.len() == n && self.v.len() == n && grad.len() == n, "{n} parameters");
        self.step += 1;
        let [power1, power2] = powers([config.beta1, config.beta2], self.step);
        let step_size = config.lr / (1.0 - power1);
        let root_scale = 1.0 / (1.0 - power2).sqrt();
        let step = AdamStep {
            params,
            m: &mut self.m,
            v: &mut self.v,
            grad,
            new1: (1.0 - config.beta1) as f32,
            beta2: config.beta2 as f32,
            new2: (1.0 - config.beta2) as f32,
            step_size: step_size as f32,
            root_scale: root_scale as f32,
            eps: config.eps as f32,
        };
        threads.run(n * AS_MULTIPLY_ADDS, Share { kernels, whole: n, step });
    }
}

/// Cost of the step of one parameter, in multiply-adds of a matrix product. Memory decides it.
const AS_MULTIPLY_ADDS: usize = 32;

/// A step of some of the parameters.
struct Share<'a> {
    kernels: Kernels,
    /// Parameters of all parts.
    whole: usize,
    step: AdamStep<'a>,
}

impl Work for Share<'_> {
    fn split(self, part: usize, parts: usize) -> (Self, Self) {
        let Share { kernels, whole, step } = self;
        // Whole cache lines, so that no two threads write to the same one.
        let AdamStep { params, m, v, grad, .. } = step;
        let at = (16 * share(whole.div_ceil(16), part, parts)).min(params.len());
        let (params, params_rest) = params.split_at_mut(at);
        let (m, m_rest) = m.split_at_mut(at);
        let (v, v_rest) = v.split_at_mut(at);
        let (grad, grad_rest) = grad.split_at(at);
        let rest = AdamStep { params: params_rest, m: m_rest, v: v_rest, grad: grad_rest, ..step };
        let step = AdamStep { params, m, v, grad, ..rest };
        (Share { kernels, whole, step }, Share { kernels, whole, step: rest })
    }

    fn run(self) {
        self.kernels.run(self.step);
    }
}

/// `bases` to the power of `exponent` by squaring: unlike the standard library's, with the same bits
/// everywhere. Both at once, and without a branch that depends on the exponent's bits.
fn powers(mut bases: [f64; 2], mut exponent: u64) -> [f64; 2] {
    let mut results = [1.0; 2];
    while exponent > 0 {
        for (result, base) in results.iter_mut().zip(&mut bases) {
            *result *= if exponent & 1 == 1 { *base } else { 1.0 };
            *base *= *base;
        }
        exponent >>= 1;
    }
    results
}

/// Scales `grad` down so that its Euclidean norm is at most `max_norm`, and returns the norm it had.
///
/// As PyTorch's `clip_grad_norm_`: the factor is `max_norm / (norm + 1e-6)` if that is below 1. A NaN in the
/// gradient makes the norm and the whole gradient NaN; a norm too large for `f32` (squares are summed in
/// `f32`) comes back as infinity and makes every finite element 0.
pub fn clip_grad_norm(kernels: Kernels, grad: &mut [f32], max_norm: f32) -> f32 {
    let norm = kernels.run(SumOfSquares { x: grad }).sqrt();
    let factor = max_norm / (norm + 1e-6);
    if factor < 1.0 || factor.is_nan() {
        kernels.run(Scale { x: grad, factor });
    }
    norm
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use proptest::prelude::*;

    use super::*;
    use crate::kernels::Isa;

    #[test]
    fn settings_out_of_range_are_named() {
        let good = AdamConfig::default();
        assert_eq!(good.validate(), Ok(()));
        let message = AdamConfig { beta2: 1.0, ..good }.validate().unwrap_err().to_string();
        assert_eq!(message, "Adam's beta2 is 1; accepted are numbers from 0 to below 1");
        for bad in [
            AdamConfig { lr: 0.0, ..good },
            AdamConfig { lr: f64::INFINITY, ..good },
            AdamConfig { eps: f64::NAN, ..good },
            AdamConfig { beta1: -0.1, ..good },
        ] {
            assert!(bad.validate().is_err(), "{bad:?}");
        }
    }

    #[test]
    fn moments_of_a_dead_unit_reach_zero() {
        let config = AdamConfig { beta2: 0.9, ..AdamConfig::default() };
        let mut adam = Adam::new(1);
        let mut params = [0.0];
        adam.step(&config, Kernels::detect(), &Threads::default(), &mut params, &[1.0]);
        for _ in 0..1000 {
            adam.step(&config, Kernels::detect(), &Threads::default(), &mut params, &[0.0]);
        }
        assert_eq!((adam.m[0], adam.v[0]), (0.0, 0.0));
        assert!(params[0] < 0.0 && params[0].is_finite());
    }

    #[test]
    fn clipping_follows_pytorch_at_the_edges() {
        let kernels = Kernels::detect();
        let mut grad = [3.0, 4.0];
        assert_eq!(clip_grad_norm(kernels, &mut grad, 10.0), 5.0);
        assert_eq!(grad, [3.0, 4.0]);
        assert_eq!(clip_grad_norm(kernels, &mut grad, 1.0), 5.0);
        assert!((grad[0] - 0.6).abs() < 1e-6 && (grad[1] - 0.8).abs() < 1e-6);
        let mut huge = [f32::MAX, 1.0];
        assert_eq!(clip_grad_norm(kernels, &mut huge, 1.0), f32::INFINITY);
        assert_eq!(huge, [0.0, 0.0]);
        let mut broken = [f32::NAN, 1.0];
        assert!(clip_grad_norm(kernels, &mut broken, 1.0).is_nan());
        assert!(broken.iter().all(|g| g.is_nan()));
    }

    proptest! {
        #[test]
        fn equals_the_textbook_and_is_the_same_on_every_instruction_set(
            grads in prop::collection::vec(prop::collection::vec(-2.0f32..2.0, 37), 1..6), beta1 in 0.0f64..0.99,
        ) {
            let config = AdamConfig { lr: 0.01, beta1, ..AdamConfig::default() };
            let run = |isa: Isa, threads: usize| {
                let threads = Threads::eager(threads);
                let mut adam = Adam::new(37);
                let mut params = vec![0.5; 37];
                for grad in &grads {
                    adam.step(&config, Kernels::new(isa).unwrap(), &threads, &mut params, grad);
                }
                (params, adam)
            };
            let (params, adam) = run(Isa::Scalar, 1);
            prop_assert_eq!(adam.step, grads.len() as u64);
            for i in 0..37 {
                let (mut p, mut m, mut v) = (0.5, 0.0, 0.0);
                for (t, grad) in (1..).zip(&grads) {
                    let g = f64::from(grad[i]);
                    m = beta1 * m + (1.0 - beta1) * g;
                    v = 0.999 * v + 0.001 * g * g;
                    let (m_hat, v_hat) = (m / (1.0 - beta1.powi(t)), v / (1.0 - 0.999f64.powi(t)));
                    p -= 0.01 * m_hat / (v_hat.sqrt() + 1e-8);
                }
                prop_assert!((f64::from(params[i]) - p).abs() < 2e-6, "{} {}", params[i], p);
            }
            for isa in Isa::available() {
                for threads in 1..4 {
                    let got = run(isa, threads);
                    prop_assert_eq!(&got, &(params.clone(), adam.clone()), "{}, {} threads", isa, threads);
                }
            }
        }
    }
}
