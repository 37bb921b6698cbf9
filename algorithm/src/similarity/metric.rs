//! The state distance: KL divergence of two normals that share one covariance Σ (sharing it is our choice, because
//! one state gives a mean and nothing else; the paper leaves the covariances open).
//!
//! With one Σ the divergence is half the squared Mahalanobis distance, symmetric, and 0 exactly at equality:
//! KL(a, b) = ½ (a - b)ᵀ Σ⁻¹ (a - b). States are *whitened* once, y = L⁻¹ x with L Lᵀ = Σ, after which it is half the
//! squared Euclidean distance of whitened states, and exact Euclidean indexes apply.

use super::gaussian::{GaussianError, cholesky, solve_lower};
use trestle_proto::config::CovarianceKind;

/// Whitened features are kept within this distance of 0, so that no distance is ever NaN.
const WHITENED_MAX: f64 = 1e18;

/// A metric that cannot be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MetricError {
    /// A standard deviation that is not a number above 0.
    #[error("feature {index} has standard deviation {sigma}; accepted: a number above 0")]
    Sigma {
        /// Which feature.
        index: usize,
        /// Its standard deviation.
        sigma: f64,
    },
    /// States that are not whole.
    #[error("{found} numbers are no whole states of the environment's {dim} features")]
    Dim {
        /// Numbers of all states.
        found: usize,
        /// Features of the environment.
        dim: usize,
    },
    /// The full covariance has no Cholesky factor.
    #[error(transparent)]
    Covariance(#[from] GaussianError),
}

/// A covariance, ready for whitening.
#[derive(Clone, Debug, PartialEq)]
pub struct Metric {
    dim: usize,
    whitener: Whitener,
}

#[derive(Clone, Debug, PartialEq)]
enum Whitener {
    /// 1 / σ of each feature.
    Diagonal(Vec<f64>),
    /// The Cholesky factor L of Σ.
    Full(Vec<f64>),
}

impl Metric {
    /// The metric of a configuration.
    ///
    /// `states` are all mentor states, row-major. `scale` are the environment's feature scales, the standard deviations of
    /// [`CovarianceKind::Space`]. For [`CovarianceKind::Demonstration`] each standard deviation is that of the
    /// demonstration's states, but at least `sigma_floor`. For [`CovarianceKind::Full`] `sigma_floor`² is added to every
    /// variance, so that a constant feature divides nothing by 0.
    ///
    /// # Errors
    /// Scales out of range, states that are not whole, a full covariance that is not positive definite.
    pub fn from_config(
        kind: CovarianceKind,
        sigma_floor: f64,
        scale: &[f32],
        states: &[f32],
    ) -> Result<Self, MetricError> {
        let dim = scale.len();
        if !states.len().is_multiple_of(dim) {
            return Err(MetricError::Dim { found: states.len(), dim });
        }
        match kind {
            CovarianceKind::Space => Self::diagonal(&scale.iter().map(|&s| f64::from(s)).collect::<Vec<_>>()),
            CovarianceKind::Demonstration => {
                let variance = covariance(states, dim, true);
                Self::diagonal(&variance.iter().map(|v| v.sqrt().max(sigma_floor)).collect::<Vec<_>>())
            }
            CovarianceKind::Full => {
                let mut sigma = covariance(states, dim, false);
                sigma.iter_mut().step_by(dim + 1).for_each(|v| *v += sigma_floor * sigma_floor);
                Self::full(&sigma, dim)
            }
        }
    }

    /// Independent features with these standard deviations.
    ///
    /// # Errors
    /// A standard deviation that is not a number above 0.
    pub fn diagonal(sigma: &[f64]) -> Result<Self, MetricError> {
        if let Some((index, &sigma)) = sigma.iter().enumerate().find(|(_, s)| !(s.is_finite() && **s > 0.0)) {
            return Err(MetricError::Sigma { index, sigma });
        }
        Ok(Self { dim: sigma.len(), whitener: Whitener::Diagonal(sigma.iter().map(|s| 1.0 / s).collect()) })
    }

    /// The covariance `sigma`, row-major, `dim * dim`.
    ///
    /// # Errors
    /// A covariance that is not positive definite.
    pub fn full(sigma: &[f64], dim: usize) -> Result<Self, MetricError> {
        Ok(Self { dim, whitener: Whitener::Full(cholesky(sigma, dim)?) })
    }

    /// Features of a state.
    pub fn dim(&self) -> usize {
        self.dim
    }

    /// Appends the whitened `state` to `out`. `scratch` is working memory. Computed in `f64`, rounded to `f32`.
    pub fn whiten(&self, state: &[f32], scratch: &mut Vec<f64>, out: &mut Vec<f32>) {
        debug_assert_eq!(state.len(), self.dim);
        let narrow = |x: f64| x.clamp(-WHITENED_MAX, WHITENED_MAX) as f32;
        match &self.whitener {
            Whitener::Diagonal(inverse) => {
                out.extend(state.iter().zip(inverse).map(|(&x, i)| narrow(f64::from(x) * i)));
            }
            Whitener::Full(factor) => {
                scratch.clear();
                scratch.extend(state.iter().map(|&x| f64::from(x)));
                solve_lower(factor, scratch);
                out.extend(scratch.iter().map(|&x| narrow(x)));
            }
        }
    }

    /// All `states` (row-major) whitened.
    pub fn whiten_all(&self, states: &[f32]) -> Vec<f32> {
        let (mut out, mut scratch) = (Vec::with_capacity(states.len()), Vec::with_capacity(self.dim));
        states.chunks_exact(self.dim).for_each(|state| self.whiten(state, &mut scratch, &mut out));
        out
    }
}

/// KL divergence of two whitened states: half the squared Euclidean distance, summed in the order of the features, so
/// that equal inputs give equal bits everywhere. Never NaN, never negative, 0 for equal states.
pub fn kl(a: &[f32], b: &[f32]) -> f32 {
    0.5 * a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum::<f32>()
}

/// Covariance of the rows of `states` (population form): the diagonal alone, or the whole `dim * dim` matrix.
fn covariance(states: &[f32], dim: usize, diagonal: bool) -> Vec<f64> {
    let n = (states.len() / dim).max(1) as f64;
    let mut mean = vec![0.0; dim];
    for row in states.chunks_exact(dim) {
        mean.iter_mut().zip(row).for_each(|(m, &x)| *m += f64::from(x) / n);
    }
    let mut out = vec![0.0; if diagonal { dim } else { dim * dim }];
    let mut centred = vec![0.0; dim];
    for row in states.chunks_exact(dim) {
        centred.iter_mut().zip(row).zip(&mean).for_each(|((c, &x), m)| *c = f64::from(x) - m);
        if diagonal {
            out.iter_mut().zip(&centred).for_each(|(v, c)| *v += c * c / n);
        } else {
            for (i, line) in out.chunks_exact_mut(dim).enumerate() {
                line.iter_mut().zip(&centred).for_each(|(v, c)| *v += centred[i] * c / n);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::similarity::gaussian::kl_gaussians;
    use proptest::prelude::*;

    #[test]
    fn scales_floor_and_estimates() {
        let demo = [0.0, 7.0, 4.0, 7.0];
        let whitened = |kind| {
            let metric = Metric::from_config(kind, 0.5, &[2.0, 4.0], &demo).unwrap();
            metric.whiten_all(&[8.0, 8.0])
        };
        assert_eq!(whitened(CovarianceKind::Space), [4.0, 2.0]);
        // Standard deviation 2, and a constant feature at the floor.
        assert_eq!(whitened(CovarianceKind::Demonstration), [4.0, 16.0]);
        let full = whitened(CovarianceKind::Full);
        assert!((full[0] - 8.0 / 4.25f32.sqrt()).abs() < 1e-5 && (full[1] - 16.0).abs() < 1e-5, "{full:?}");
    }

    #[test]
    fn refusals_name_the_feature() {
        assert!(Metric::diagonal(&[1.0, 0.0]).unwrap_err().to_string().starts_with("feature 1"));
        assert!(Metric::diagonal(&[f64::NAN]).is_err());
        let error = Metric::from_config(CovarianceKind::Space, 1.0, &[1.0; 3], &[0.0; 4]).unwrap_err();
        assert_eq!(error, MetricError::Dim { found: 4, dim: 3 });
        // Two features that move together, and a floor too small for double precision.
        let line: Vec<f32> = (0..40).map(|i| (i / 2) as f32 * 1e3).collect();
        let error = Metric::from_config(CovarianceKind::Full, 1e-9, &[1.0; 2], &line).unwrap_err();
        assert!(error.to_string().contains("not positive definite"), "{error}");
    }

    #[test]
    fn the_largest_numbers_have_a_distance() {
        let metric = Metric::diagonal(&[1e-6]).unwrap();
        let y = metric.whiten_all(&[f32::MAX, -f32::MAX]);
        assert_eq!(kl(&y[..1], &y[..1]), 0.0);
        assert!(kl(&y[..1], &y[1..]) > 1e30);
    }

    proptest! {
        #[test]
        fn equals_the_general_formula_with_equal_covariances(
            a in proptest::array::uniform3(-3.0f32..3.0),
            b in proptest::array::uniform3(-3.0f32..3.0),
            root in proptest::array::uniform9(-1.0f64..1.0),
        ) {
            let mut sigma = vec![0.0; 9];
            for i in 0..3 {
                for j in 0..3 {
                    sigma[i * 3 + j] = (0..3).map(|k| root[i * 3 + k] * root[j * 3 + k]).sum::<f64>();
                }
                sigma[i * 3 + i] += 0.5;
            }
            let wide = |x: [f32; 3]| x.map(f64::from);
            let expected = kl_gaussians(&wide(a), &sigma, &wide(b), &sigma).unwrap();
            let metric = Metric::full(&sigma, 3).unwrap();
            let y = metric.whiten_all(&[a, b].concat());
            let found = f64::from(kl(&y[..3], &y[3..]));
            prop_assert!((found - expected).abs() <= 1e-4 * (1.0 + expected), "{found} {expected}");
            prop_assert_eq!(kl(&y[..3], &y[3..]), kl(&y[3..], &y[..3]));
            prop_assert_eq!(kl(&y[..3], &y[..3]), 0.0);
        }
    }
}
