//! Point sets for properties: random ones, and sets that indexes tend to get wrong. And the formula whose special case the state
//! distance is.

#![allow(clippy::unwrap_used)]

use super::gaussian::{cholesky, solve_lower};
use super::metric::APART;
use proptest::prelude::*;

/// `few` cases, or as many as `PROPTEST_CASES` asks for.
pub(crate) fn cases(few: u32) -> ProptestConfig {
    let asked = std::env::var("PROPTEST_CASES").ok().and_then(|text| text.parse().ok());
    ProptestConfig::with_cases(asked.unwrap_or(few))
}

/// Points of 1 to 16 features, row-major, and the number of features. `count` of them: all equal, on a line, on a coarse
/// lattice (many duplicates and exact ties), anywhere, of very different magnitudes, or on a lattice with some categories.
pub(crate) fn points(count: std::ops::Range<usize>) -> impl Strategy<Value = (usize, Vec<f32>)> {
    (1usize..=16, 0u8..6, count).prop_flat_map(|(dim, kind, count)| {
        proptest::collection::vec(-3.0f32..3.0, (count + 2) * dim).prop_map(move |numbers| {
            let (first, rest) = numbers.split_at(dim);
            let (direction, rest) = rest.split_at(dim);
            let feature = |(at, &x): (usize, &f32)| match kind {
                0 => first[at % dim],
                // The same number times the direction for all features of a point.
                1 => first[at % dim] + rest[at - at % dim].round() * direction[at % dim],
                2 => x.round(),
                3 => x,
                4 if direction[at % dim] > 0.0 => x.round() * APART,
                4 => x,
                _ => x * 10f32.powi(12 * direction[at % dim] as i32 / 2),
            };
            (dim, rest.iter().enumerate().map(feature).collect())
        })
    })
}

/// KL(N0 ‖ N1) of two multivariate normals, in nats:
/// ½ [ tr(Σ1⁻¹ Σ0) + (μ1 - μ0)ᵀ Σ1⁻¹ (μ1 - μ0) - d + ln det Σ1 - ln det Σ0 ].
///
/// With Σ0 = Σ1 the trace is d and the determinants cancel, which leaves the state distance ([`super::metric`]).
pub(crate) fn kl_gaussians(mean0: &[f64], cov0: &[f64], mean1: &[f64], cov1: &[f64]) -> f64 {
    let dim = mean0.len();
    let (l0, l1) = (cholesky(cov0, dim).unwrap(), cholesky(cov1, dim).unwrap());
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
    0.5 * (trace + distance - dim as f64 + log_det(&l1) - log_det(&l0))
}
