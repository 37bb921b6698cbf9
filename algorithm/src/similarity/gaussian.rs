//! Covariance matrices in double precision: the Cholesky factor, and the KL divergence of two normals with different
//! covariances. The state distance is a special case of that formula.
//!
//! Matrices are square, row-major slices of `dim * dim` numbers.

/// A covariance that has no Cholesky factor.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GaussianError {
    /// A pivot is not positive.
    #[error(
        "the covariance is not positive definite: pivot {index} is {pivot}; accepted: above 0 (a larger mentor.sigma_floor helps)"
    )]
    NotPositiveDefinite {
        /// Row of the pivot, from 0.
        index: usize,
        /// Its value.
        pivot: f64,
    },
    /// Sizes that do not belong together.
    #[error("{what} has {found} numbers; accepted: {expected}")]
    Size {
        /// Which argument.
        what: &'static str,
        /// Its length.
        found: usize,
        /// The length that the first mean asks for.
        expected: usize,
    },
}

/// The lower triangular L with L Lᵀ = `covariance` (symmetric, `dim * dim`; only its lower half is read). Above the
/// diagonal the result is 0.
///
/// # Errors
/// A covariance that is not positive definite to machine precision.
pub fn cholesky(covariance: &[f64], dim: usize) -> Result<Vec<f64>, GaussianError> {
    check("covariance", covariance.len(), dim * dim)?;
    let mut factor = vec![0.0; dim * dim];
    for row in 0..dim {
        for col in 0..=row {
            let (a, b) = (&factor[row * dim..][..col], &factor[col * dim..][..col]);
            let rest = covariance[row * dim + col] - a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
            if row == col {
                let least = f64::EPSILON * covariance[row * dim + row].abs();
                if rest.is_nan() || rest.is_infinite() || rest <= least {
                    return Err(GaussianError::NotPositiveDefinite { index: row, pivot: rest });
                }
                factor[row * dim + row] = rest.sqrt();
            } else {
                factor[row * dim + col] = rest / factor[col * dim + col];
            }
        }
    }
    Ok(factor)
}

/// Solves L y = x in place, for the lower triangular `factor` of [`cholesky`].
pub fn solve_lower(factor: &[f64], x: &mut [f64]) {
    let dim = x.len();
    for row in 0..dim {
        let (known, rest) = x.split_at_mut(row);
        let dot: f64 = factor[row * dim..][..row].iter().zip(known.iter()).map(|(l, y)| l * y).sum();
        rest[0] = (rest[0] - dot) / factor[row * dim + row];
    }
}

/// KL(N0 ‖ N1) of two multivariate normals, in nats:
/// ½ [ tr(Σ1⁻¹ Σ0) + (μ1 - μ0)ᵀ Σ1⁻¹ (μ1 - μ0) - d + ln det Σ1 - ln det Σ0 ].
///
/// With Σ0 = Σ1 the trace is d and the determinants cancel, which leaves the state distance ([`super::metric`]).
///
/// # Errors
/// Sizes that do not fit, or a covariance that is not positive definite.
pub fn kl_gaussians(mean0: &[f64], cov0: &[f64], mean1: &[f64], cov1: &[f64]) -> Result<f64, GaussianError> {
    let dim = mean0.len();
    check("second mean", mean1.len(), dim)?;
    let (l0, l1) = (cholesky(cov0, dim)?, cholesky(cov1, dim)?);
    // tr(Σ1⁻¹ Σ0) is the squared Frobenius norm of L1⁻¹ L0.
    let mut trace = 0.0;
    let mut column = vec![0.0; dim];
    for col in 0..dim {
        for row in 0..dim {
            column[row] = l0[row * dim + col];
        }
        solve_lower(&l1, &mut column);
        trace += column.iter().map(|x| x * x).sum::<f64>();
    }
    let mut difference: Vec<f64> = mean1.iter().zip(mean0).map(|(b, a)| b - a).collect();
    solve_lower(&l1, &mut difference);
    let distance: f64 = difference.iter().map(|x| x * x).sum();
    let log_det = |l: &[f64]| (0..dim).map(|i| 2.0 * l[i * dim + i].ln()).sum::<f64>();
    Ok(0.5 * (trace + distance - dim as f64 + log_det(&l1) - log_det(&l0)))
}

fn check(what: &'static str, found: usize, expected: usize) -> Result<(), GaussianError> {
    if found == expected { Ok(()) } else { Err(GaussianError::Size { what, found, expected }) }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() <= 1e-9 * (1.0 + a.abs().max(b.abs()))
    }

    #[test]
    fn factor_of_a_known_matrix() {
        let l = cholesky(&[4.0, 2.0, 2.0, 5.0], 2).unwrap();
        assert_eq!(l, [2.0, 0.0, 1.0, 2.0]);
        let mut x = [2.0, 5.0];
        solve_lower(&l, &mut x);
        assert_eq!(x, [1.0, 2.0]);
    }

    #[test]
    fn what_is_not_positive_definite_is_refused() {
        let singular = cholesky(&[1.0, 1.0, 1.0, 1.0], 2).unwrap_err();
        assert!(singular.to_string().contains("pivot 1 is 0"));
        assert!(cholesky(&[-1.0], 1).is_err());
        assert!(cholesky(&[f64::NAN], 1).is_err());
        assert!(cholesky(&[1.0; 3], 2).unwrap_err().to_string().contains("3 numbers; accepted: 4"));
    }

    proptest! {
        #[test]
        fn one_dimension_in_closed_form(m0 in -5.0..5.0, m1 in -5.0..5.0, s0 in 0.1..4.0, s1 in 0.1..4.0) {
            let (m0, m1, s0, s1): (f64, f64, f64, f64) = (m0, m1, s0, s1);
            let expected = (s1 / s0).ln() + (s0 * s0 + (m0 - m1) * (m0 - m1)) / (2.0 * s1 * s1) - 0.5;
            let found = kl_gaussians(&[m0], &[s0 * s0], &[m1], &[s1 * s1]).unwrap();
            prop_assert!(close(found, expected), "{found} {expected}");
            prop_assert!(found > -1e-9);
        }

        #[test]
        fn independent_features_add_up(
            f in proptest::collection::vec((-5.0..5.0, -5.0..5.0, 0.1..4.0, 0.1..4.0), 1..5),
        ) {
            let f: Vec<(f64, f64, f64, f64)> = f;
            let dim = f.len();
            let diagonal = |pick: fn(&(f64, f64, f64, f64)) -> f64| {
                let mut m = vec![0.0; dim * dim];
                f.iter().enumerate().for_each(|(i, x)| m[i * dim + i] = pick(x));
                m
            };
            let means = |pick: fn(&(f64, f64, f64, f64)) -> f64| f.iter().map(pick).collect::<Vec<_>>();
            let found =
                kl_gaussians(&means(|x| x.0), &diagonal(|x| x.2), &means(|x| x.1), &diagonal(|x| x.3)).unwrap();
            let expected: f64 = f.iter().map(|x| kl_gaussians(&[x.0], &[x.2], &[x.1], &[x.3]).unwrap()).sum();
            prop_assert!(close(found, expected), "{found} {expected}");
        }
    }
}
