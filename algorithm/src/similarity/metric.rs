//! The state distance: KL divergence of two normals that share one covariance Σ (sharing it is our choice, because
//! one state gives a mean and nothing else; the paper leaves the covariances open).
//!
//! With one Σ the divergence is half the squared Mahalanobis distance, symmetric, and 0 exactly at equality:
//! KL(a, b) = ½ (a - b)ᵀ Σ⁻¹ (a - b). States are *whitened* once, y = L⁻¹ x with L Lᵀ = Σ, after which it is half the
//! squared Euclidean distance of whitened states, and exact Euclidean indexes apply.
//!
//! *Categories* are equal or different, never near. Their numbers are whitened to multiples of [`APART`], and whitened features
//! that lie [`APART`] apart count as no farther than that ([`square`]). So any two categories are equally far from each other,
//! farther than anything similar. The distance remains one: lengths of ways still add up.

use super::gaussian::{GaussianError, cholesky, solve_lower};
use trestle_proto::config::{self, CovarianceKind};
use trestle_proto::space::EnvSpec;

/// Whitened features are kept within this distance of 0, so that no distance is ever NaN.
const WHITENED_MAX: f64 = 1e18;

/// Whitened features that lie so far apart, a million standard deviations, or farther count as this far apart.
pub const APART: f32 = (1u32 << 20) as f32;
/// KL of states that differ in one category alone; those of equal categories are nearer.
pub const DIFFERENT: f32 = 0.5 * APART * APART;

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
    /// Features to compare that are none, or not different ones.
    #[error("mentor.features = {features:?}; accepted: numbers below {dim}, each once")]
    Compared {
        /// What is to be compared.
        features: Vec<usize>,
        /// Features of the environment.
        dim: usize,
    },
    /// Features to compare that have not been looked up.
    #[error("mentor.features has names that were never looked up; accepted: numbers below {dim}, each once")]
    Named {
        /// Features of the environment.
        dim: usize,
    },
    /// Standard deviations for other than all features.
    #[error("mentor.scale has {found} numbers; accepted: {dim}, one for each feature of a state")]
    Scale {
        /// How many there are.
        found: usize,
        /// Features of the environment.
        dim: usize,
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
    /// Features that are not compared, ascending: they are 0 in every whitened state.
    ignored: Vec<usize>,
    /// Features that are compared as categories, ascending.
    categories: Vec<usize>,
}

#[derive(Clone, Debug, PartialEq)]
enum Whitener {
    /// 1 / σ of each feature.
    Diagonal(Vec<f64>),
    /// The Cholesky factor L of Σ.
    Full(Vec<f64>),
}

impl Metric {
    /// The metric of a run: of `mentor`'s settings, in the environment with `spec`. `states` are all mentor states, row-major.
    /// Scale and covariance are those of the features that are no categories.
    ///
    /// # Errors
    /// As [`Metric::from_config`]; features that there are not, or a scale of other than all features.
    pub fn of(mentor: &config::Mentor, spec: &EnvSpec, states: &[f32]) -> Result<Self, MetricError> {
        let (scale, dim) = (&spec.scale[..], spec.obs_dim());
        let features = mentor.features.numbers().ok_or(MetricError::Named { dim })?;
        let own: Vec<f32> = mentor.scale.iter().map(|&sigma| sigma as f32).collect();
        if !own.is_empty() && own.len() != dim {
            return Err(MetricError::Scale { found: own.len(), dim });
        }
        let mut compared = vec![features.is_empty(); dim];
        for &feature in features {
            match compared.get_mut(feature) {
                Some(new @ false) => *new = true,
                _ => return Err(MetricError::Compared { features: features.to_vec(), dim }),
            }
        }
        let scale = if own.is_empty() { scale } else { &own };
        let ignored: Vec<usize> = (0..dim).filter(|&feature| !compared[feature]).collect();
        let categories: Vec<usize> =
            spec.categories.iter().copied().filter(|&feature| compared[feature]).collect();
        let without = |states: &[f32]| {
            let mut states = states.to_vec();
            for state in states.chunks_exact_mut(dim) {
                ignored.iter().chain(&categories).for_each(|&feature| state[feature] = 0.0);
            }
            states
        };
        // What is constant has no covariance with the others.
        let metric = match ignored.is_empty() && categories.is_empty() {
            true => Self::from_config(mentor.covariance, mentor.sigma_floor, scale, states)?,
            false => Self::from_config(mentor.covariance, mentor.sigma_floor, scale, &without(states))?,
        };
        Ok(Self { ignored, categories, ..metric })
    }

    /// The metric of a covariance of all features.
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
        let whitener = Whitener::Diagonal(sigma.iter().map(|s| 1.0 / s).collect());
        Ok(Self { dim: sigma.len(), whitener, ignored: Vec::new(), categories: Vec::new() })
    }

    /// The covariance `sigma`, row-major, `dim * dim`.
    ///
    /// # Errors
    /// A covariance that is not positive definite.
    pub fn full(sigma: &[f64], dim: usize) -> Result<Self, MetricError> {
        let whitener = Whitener::Full(cholesky(sigma, dim)?);
        Ok(Self { dim, whitener, ignored: Vec::new(), categories: Vec::new() })
    }

    /// Features of a state.
    pub fn dim(&self) -> usize {
        self.dim
    }

    /// How many features are compared as numbers.
    pub fn numbers(&self) -> usize {
        self.dim - self.ignored.len() - self.categories.len()
    }

    /// Features that are compared as categories, ascending.
    pub fn categories(&self) -> &[usize] {
        &self.categories
    }

    /// Appends the whitened `state` to `out`. `scratch` is working memory. Computed in `f64`, rounded to `f32`.
    pub fn whiten(&self, state: &[f32], scratch: &mut Vec<f64>, out: &mut Vec<f32>) {
        debug_assert_eq!(state.len(), self.dim);
        let narrow = |x: f64| x.clamp(-WHITENED_MAX, WHITENED_MAX) as f32;
        let begin = out.len();
        match &self.whitener {
            Whitener::Diagonal(inverse) => {
                out.extend(state.iter().zip(inverse).map(|(&x, i)| narrow(f64::from(x) * i)));
            }
            Whitener::Full(factor) => {
                scratch.clear();
                scratch.extend(state.iter().map(|&x| f64::from(x)));
                self.ignored.iter().chain(&self.categories).for_each(|&feature| scratch[feature] = 0.0);
                solve_lower(factor, scratch);
                out.extend(scratch.iter().map(|&x| narrow(x)));
            }
        }
        self.ignored.iter().for_each(|&feature| out[begin + feature] = 0.0);
        self.categories.iter().for_each(|&feature| out[begin + feature] = APART * state[feature]);
    }

    /// All `states` (row-major) whitened.
    pub fn whiten_all(&self, states: &[f32]) -> Vec<f32> {
        let (mut out, mut scratch) = (Vec::with_capacity(states.len()), Vec::with_capacity(self.dim));
        states.chunks_exact(self.dim).for_each(|state| self.whiten(state, &mut scratch, &mut out));
        out
    }
}

/// The square of `difference`, up to that of [`APART`].
#[inline]
pub fn square(difference: f32) -> f32 {
    let square = difference * difference;
    // Unlike `f32::min` this is a single instruction.
    if square < APART * APART { square } else { APART * APART }
}

/// KL divergence of two whitened states: half the squared Euclidean distance, summed in the order of the features, so
/// that equal inputs give equal bits everywhere. Never NaN, never negative, 0 for equal states.
pub fn kl(a: &[f32], b: &[f32]) -> f32 {
    0.5 * a.iter().zip(b).map(|(x, y)| square(x - y)).sum::<f32>()
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
    use crate::similarity::testing::kl_gaussians;
    use proptest::prelude::*;
    use trestle_proto::row::Element;

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

    /// Features of these scales, the last `categories` of which are categories.
    fn spec(scale: &[f32], categories: usize) -> EnvSpec {
        let dim = scale.len();
        EnvSpec {
            name: "any".into(),
            element: Element::F32,
            shape: Vec::new(),
            low: vec![0.0; dim],
            high: vec![20.0; dim],
            scale: scale.to_vec(),
            integral: false,
            categories: (dim - categories..dim).collect(),
            velocities: Vec::new(),
            actions: vec!["a".into(), "b".into()],
            best_return: None,
            threshold: None,
            goal_bonus: 0.0,
            defines_success: false,
        }
    }

    #[test]
    fn features_that_are_not_compared_count_for_nothing() {
        let demo: Vec<f32> = (0..30).map(|i| ((i * i) % 17) as f32).collect();
        for covariance in [CovarianceKind::Space, CovarianceKind::Demonstration, CovarianceKind::Full] {
            let mut mentor = config::Mentor {
                covariance,
                features: config::Features::Numbers(vec![2, 0]),
                ..config::Mentor::default()
            };
            let some = Metric::of(&mentor, &spec(&[2.0, 3.0, 4.0], 0), &demo).unwrap().whiten_all(&demo);
            assert!(some.chunks_exact(3).all(|state| state[1] == 0.0));
            // As if they were not there.
            mentor.features = config::Features::default();
            let pick = |states: &[f32]| -> Vec<f32> {
                states.chunks_exact(3).flat_map(|state| [state[0], state[2]]).collect()
            };
            let alone =
                Metric::of(&mentor, &spec(&[2.0, 4.0], 0), &pick(&demo)).unwrap().whiten_all(&pick(&demo));
            let far = |(a, b): (&f32, &f32)| (a - b).abs() > 1e-5 * b.abs().max(1.0);
            assert!(!pick(&some).iter().zip(&alone).any(far), "{covariance}");
        }
    }

    #[test]
    fn own_scales_take_the_place_of_the_environment_s() {
        let mut mentor = config::Mentor { scale: vec![0.5, 4.0], ..config::Mentor::default() };
        let metric = Metric::of(&mentor, &spec(&[1.0, 1.0], 0), &[0.0; 4]).unwrap();
        assert_eq!(metric.whiten_all(&[1.0, 1.0]), [2.0, 0.25]);
        let refused =
            |mentor: &config::Mentor| Metric::of(mentor, &spec(&[1.0; 3], 0), &[]).unwrap_err().to_string();
        assert_eq!(
            refused(&mentor),
            "mentor.scale has 2 numbers; accepted: 3, one for each feature of a state"
        );
        mentor.scale.clear();
        for features in [vec![3], vec![1, 1]] {
            mentor.features = config::Features::Numbers(features.clone());
            let expected = format!("mentor.features = {features:?}; accepted: numbers below 3, each once");
            assert_eq!(refused(&mentor), expected);
        }
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
        assert_eq!(kl(&y[..1], &y[1..]), DIFFERENT);
    }

    proptest! {
        /// Whatever the covariance of the other features is, and whether or not some of them are compared.
        #[test]
        fn categories_are_equal_or_different_and_never_near(
            states in proptest::collection::vec((-3.0f32..3.0, 0u8..9, 0u8..5, 0u8..5), 2..12),
            covariance in prop_oneof![
                Just(CovarianceKind::Space), Just(CovarianceKind::Demonstration), Just(CovarianceKind::Full)
            ],
            compared in prop_oneof![Just(vec![]), Just(vec![0, 2, 3]), Just(vec![1, 3])],
        ) {
            let rows: Vec<[f32; 4]> =
                states.iter().map(|&(x, y, c, d)| [x, f32::from(y), f32::from(c), f32::from(d)]).collect();
            let all = rows.concat();
            let mentor =
                config::Mentor {
                    covariance,
                    features: config::Features::Numbers(compared.clone()),
                    sigma_floor: 0.1,
                    ..config::Mentor::default()
                };
            let whole = Metric::of(&mentor, &spec(&[2.0, 3.0, 1.0, 1.0], 2), &all).unwrap();
            // The same without the categories.
            let numbers: Vec<f32> = rows.iter().flat_map(|row| row[..2].to_vec()).collect();
            let features: Vec<usize> = compared.iter().copied().filter(|&f| f < 2).collect();
            let mentor = config::Mentor { features: config::Features::Numbers(features), ..mentor };
            let part = Metric::of(&mentor, &spec(&[2.0, 3.0], 0), &numbers).unwrap();
            let is_compared = |f: usize| compared.is_empty() || compared.contains(&f);
            let (whole, part) = (whole.whiten_all(&all), part.whiten_all(&numbers));
            for (i, a) in rows.iter().enumerate() {
                for (j, b) in rows.iter().enumerate() {
                    let differing = [2, 3].into_iter().filter(|&f| is_compared(f) && a[f] != b[f]).count();
                    let found = kl(&whole[4 * i..][..4], &whole[4 * j..][..4]);
                    let near = kl(&part[2 * i..][..2], &part[2 * j..][..2]);
                    if differing == 0 {
                        prop_assert_eq!(found, near);
                    } else {
                        let expected = DIFFERENT * differing as f32 + near;
                        prop_assert!((found - expected).abs() <= 1e-6 * expected, "{} {}", found, expected);
                    }
                }
            }
        }

        #[test]
        fn ways_add_up(points in proptest::array::uniform3(proptest::array::uniform3(-4i8..4)), far in 0usize..4) {
            let place = |p: [i8; 3]| -> Vec<f32> {
                let scale = |f: usize| if f < far { APART } else { 0.3 };
                p.iter().enumerate().map(|(f, &x)| f32::from(x) * scale(f)).collect()
            };
            let way = |a: usize, b: usize| f64::from(kl(&place(points[a]), &place(points[b]))).sqrt();
            prop_assert!(way(0, 2) <= (way(0, 1) + way(1, 2)) * (1.0 + 1e-6));
        }

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
            let expected = kl_gaussians(&wide(a), &sigma, &wide(b), &sigma);
            let metric = Metric::full(&sigma, 3).unwrap();
            let y = metric.whiten_all(&[a, b].concat());
            let found = f64::from(kl(&y[..3], &y[3..]));
            prop_assert!((found - expected).abs() <= 1e-4 * (1.0 + expected), "{found} {expected}");
            prop_assert_eq!(kl(&y[..3], &y[3..]), kl(&y[3..], &y[..3]));
            prop_assert_eq!(kl(&y[..3], &y[..3]), 0.0);
        }
    }
}
