//! Covariance matrices in double precision: the Cholesky factor, and what it makes of a difference of two means.
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
    /// Another dimension's.
    #[error("covariance has {found} numbers; accepted: {expected}")]
    Size {
        /// Its length.
        found: usize,
        /// The length that the dimension asks for.
        expected: usize,
    },
}

/// The lower triangular L with L Lᵀ = `covariance` (symmetric, `dim * dim`; only its lower half is read). Above the
/// diagonal the result is 0.
///
/// # Errors
/// A covariance that is not positive definite to machine precision.
pub fn cholesky(covariance: &[f64], dim: usize) -> Result<Vec<f64>, GaussianError> {
    let (found, expected) = (covariance.len(), dim * dim);
    if found != expected {
        return Err(GaussianError::Size { found, expected });
    }
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::similarity::testing::kl_gaussians;
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
            let found = kl_gaussians(&[m0], &[s0 * s0], &[m1], &[s1 * s1]);
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
                kl_gaussians(&means(|x| x.0), &diagonal(|x| x.2), &means(|x| x.1), &diagonal(|x| x.3));
            let expected: f64 = f.iter().map(|x| kl_gaussians(&[x.0], &[x.2], &[x.1], &[x.3])).sum();
            prop_assert!(close(found, expected), "{found} {expected}");
        }
    }
}
