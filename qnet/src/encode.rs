//! From an environment's raw observation to the network's input.
//!
//! Plain data, so that it travels inside a configuration and the actor and the learner encode alike. Which
//! encoding the paper's experiments used is not said; all three are ours.

use serde::{Deserialize, Serialize};
use trestle_proto::row::Row;

use crate::kernels::{Kernels, Rescale, rescaled};
use crate::layout::MAX_WIDTH;

/// Below so many features it takes longer to choose an instruction set than to do without.
const FEW: usize = 16;

/// Why an encoding is not usable.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EncodingError {
    /// There is no feature at all.
    #[error("the encoding has no feature; at least one is needed")]
    Empty,
    /// Two lists that describe the same features differ in length.
    #[error("the encoding describes {left} features by `{left_name}` but {right} by `{right_name}`")]
    Lengths {
        /// Name of the first list.
        left_name: &'static str,
        /// Its length.
        left: usize,
        /// Name of the second list.
        right_name: &'static str,
        /// Its length.
        right: usize,
    },
    /// A feature's range is empty, not finite or too wide for `f32`.
    #[error("feature {index} has the range {low} to {high}; accepted are finite bounds with low below high")]
    Range {
        /// Position of the feature.
        index: usize,
        /// Its lower bound.
        low: f32,
        /// Its upper bound.
        high: f32,
    },
    /// A one-hot feature has no category, or its lowest value is not finite.
    #[error(
        "one-hot feature {index} has low = {low} and {size} categories; accepted are a finite low and 1 or more"
    )]
    Categories {
        /// Position of the feature.
        index: usize,
        /// Its lowest value.
        low: f32,
        /// Its number of categories.
        size: usize,
    },
    /// The network's input would be wider than [`MAX_WIDTH`].
    #[error("the encoded observation has {got} features; accepted are 1 to {MAX_WIDTH}")]
    Width {
        /// Encoded width.
        got: usize,
    },
}

/// How a raw observation becomes the network's input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Encoding {
    /// Feature by feature, `low..=high` onto `-1..=1`. Values outside the range go outside of -1..=1: a clamp
    /// would make different states look the same.
    Scale {
        /// Lower bound of each feature, in the observation's units.
        low: Vec<f32>,
        /// Upper bound of each feature; above its lower bound.
        high: Vec<f32>,
    },
    /// Integer-valued features, each turned into `size` inputs of which one is 1 and the rest are 0.
    OneHot {
        /// Lowest value of each feature, which becomes category 0.
        low: Vec<f32>,
        /// Number of categories of each feature; at least 1.
        sizes: Vec<usize>,
    },
    /// Some features scaled as by `Scale`, the others turned into categories as by `OneHot`; inputs in the order of the features.
    Mixed {
        /// Lower bound of each feature; of a category its lowest value.
        low: Vec<f32>,
        /// Upper bound of each feature, above its lower bound.
        high: Vec<f32>,
        /// Number of categories of each feature; 0 for one that is scaled.
        sizes: Vec<usize>,
    },
    /// The observation as it is.
    Identity {
        /// Number of features.
        dim: usize,
    },
}

impl Encoding {
    /// Checks that every list fits and every range is usable; the other methods assume it.
    ///
    /// # Errors
    /// See [`EncodingError`].
    pub fn validate(&self) -> Result<(), EncodingError> {
        match self {
            Encoding::Scale { low, high } => {
                same_length(("low", low.len()), ("high", high.len()))?;
                for (index, (&low, &high)) in low.iter().zip(high).enumerate() {
                    if !(low < high && (high - low).is_finite()) {
                        return Err(EncodingError::Range { index, low, high });
                    }
                }
            }
            Encoding::OneHot { low, sizes } => {
                same_length(("low", low.len()), ("sizes", sizes.len()))?;
                for (index, (&low, &size)) in low.iter().zip(sizes).enumerate() {
                    if size == 0 || !low.is_finite() {
                        return Err(EncodingError::Categories { index, low, size });
                    }
                }
            }
            Encoding::Mixed { low, high, sizes } => {
                same_length(("low", low.len()), ("high", high.len()))?;
                same_length(("low", low.len()), ("sizes", sizes.len()))?;
                for (index, (&low, &high)) in low.iter().zip(high).enumerate() {
                    if !(low < high && (high - low).is_finite()) {
                        return Err(EncodingError::Range { index, low, high });
                    }
                }
            }
            Encoding::Identity { .. } => {}
        }
        match self.input_dim() {
            0 => Err(EncodingError::Empty),
            got if got > MAX_WIDTH => Err(EncodingError::Width { got }),
            _ => Ok(()),
        }
    }

    /// Number of features of a raw observation.
    pub fn observation_dim(&self) -> usize {
        match self {
            Encoding::Scale { low, .. } | Encoding::OneHot { low, .. } | Encoding::Mixed { low, .. } => {
                low.len()
            }
            Encoding::Identity { dim } => *dim,
        }
    }

    /// Number of features of the network's input.
    pub fn input_dim(&self) -> usize {
        match self {
            Encoding::Scale { low, .. } => low.len(),
            // Saturating: sizes that were never validated must not overflow here.
            Encoding::OneHot { sizes, .. } => sizes.iter().fold(0, |sum, &size| sum.saturating_add(size)),
            Encoding::Mixed { sizes, .. } => {
                sizes.iter().fold(0, |sum, &size| sum.saturating_add(size.max(1)))
            }
            Encoding::Identity { dim } => *dim,
        }
    }

    /// Encodes one observation (`[observation_dim]`) into `out` (`[input_dim]`), overwriting it.
    ///
    /// One-hot features are rounded to the nearest integer and clamped into their range; NaN counts as the
    /// lowest value.
    ///
    /// # Panics
    /// If a slice has another length.
    pub fn encode(&self, obs: &[f32], out: &mut [f32]) {
        self.encode_features(obs, out);
    }

    /// As [`Encoding::encode`], from a state of either type: the same bits for the same values.
    ///
    /// # Panics
    /// As [`Encoding::encode`].
    pub fn encode_row(&self, obs: Row<'_>, out: &mut [f32]) {
        match obs {
            Row::F32(obs) => self.encode_features(obs, out),
            Row::U8(obs) => self.encode_features(obs, out),
        }
    }

    #[inline]
    fn encode_features<T: Copy + Into<f32>>(&self, obs: &[T], out: &mut [f32]) {
        assert_eq!(obs.len(), self.observation_dim(), "observation length");
        assert_eq!(out.len(), self.input_dim(), "encoded length");
        match self {
            Encoding::Scale { low, high } => {
                let rescale = Rescale { x: obs, low, high, out };
                if obs.len() < FEW { rescale.each() } else { Kernels::detect().run(rescale) }
            }
            Encoding::OneHot { low, sizes } => {
                out.fill(0.0);
                let mut start = 0;
                for ((&value, &low), &size) in obs.iter().zip(low).zip(sizes) {
                    out[start + category(value.into(), low, size)] = 1.0;
                    start += size;
                }
            }
            Encoding::Mixed { low, high, sizes } => {
                out.fill(0.0);
                let mut start = 0;
                for (((&value, &low), &high), &size) in obs.iter().zip(low).zip(high).zip(sizes) {
                    if size == 0 {
                        out[start] = rescaled(value.into(), low, high);
                    } else {
                        out[start + category(value.into(), low, size)] = 1.0;
                    }
                    start += size.max(1);
                }
            }
            Encoding::Identity { .. } => {
                out.iter_mut().zip(obs).for_each(|(out, &value)| *out = value.into())
            }
        }
    }

    /// Encodes `rows` observations, `[rows][observation_dim]` into `[rows][input_dim]`.
    ///
    /// # Panics
    /// If a slice has another length.
    pub fn encode_batch(&self, obs: &[f32], rows: usize, out: &mut [f32]) {
        let (from, to) = (self.observation_dim(), self.input_dim());
        assert_eq!(obs.len(), rows * from, "observations length");
        assert_eq!(out.len(), rows * to, "encoded length");
        for (obs, out) in obs.chunks_exact(from).zip(out.chunks_exact_mut(to)) {
            self.encode(obs, out);
        }
    }
}

/// Which of `size` categories, 1 or more, `value` is.
fn category(value: f32, low: f32, size: usize) -> usize {
    // A float-to-integer cast saturates and maps NaN to 0.
    ((value - low).round() as usize).min(size - 1)
}

fn same_length(left: (&'static str, usize), right: (&'static str, usize)) -> Result<(), EncodingError> {
    if left.1 == right.1 {
        return Ok(());
    }
    Err(EncodingError::Lengths { left_name: left.0, left: left.1, right_name: right.0, right: right.1 })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use proptest::prelude::*;

    use super::*;
    use crate::kernels::Isa;

    fn encoded(encoding: &Encoding, obs: &[f32]) -> Vec<f32> {
        let mut out = vec![f32::NAN; encoding.input_dim()];
        encoding.encode(obs, &mut out);
        out
    }

    #[test]
    fn scale_maps_the_bounds_to_one() {
        let encoding = Encoding::Scale { low: vec![0.0, -4.0], high: vec![29.0, 4.0] };
        assert_eq!(encoding.validate(), Ok(()));
        assert_eq!(encoded(&encoding, &[0.0, 4.0]), [-1.0, 1.0]);
        assert_eq!(encoded(&encoding, &[14.5, 8.0]), [0.0, 2.0]);
    }

    #[test]
    fn one_hot_rounds_clamps_and_concatenates() {
        let encoding = Encoding::OneHot { low: vec![0.0, -1.0], sizes: vec![3, 2] };
        assert_eq!(encoding.validate(), Ok(()));
        assert_eq!(encoded(&encoding, &[1.0, -1.0]), [0.0, 1.0, 0.0, 1.0, 0.0]);
        assert_eq!(encoded(&encoding, &[1.6, 0.2]), [0.0, 0.0, 1.0, 0.0, 1.0]);
        assert_eq!(encoded(&encoding, &[-9.0, 9.0]), [1.0, 0.0, 0.0, 0.0, 1.0]);
        assert_eq!(encoded(&encoding, &[f32::NAN, f32::INFINITY]), [1.0, 0.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn mixed_features_are_encoded_each_in_its_own_way() {
        let encoding =
            Encoding::Mixed { low: vec![-1.0, 3.0, 0.0], high: vec![1.0, 5.0, 8.0], sizes: vec![0, 3, 0] };
        assert_eq!(encoding.validate(), Ok(()));
        assert_eq!((encoding.observation_dim(), encoding.input_dim()), (3, 5));
        assert_eq!(encoded(&encoding, &[0.5, 4.0, 2.0]), [0.5, 0.0, 1.0, 0.0, -0.5]);
    }

    #[test]
    fn unusable_encodings_are_named() {
        let scale = |low: &[f32], high: &[f32]| Encoding::Scale { low: low.to_vec(), high: high.to_vec() };
        let one_hot =
            |low: &[f32], sizes: &[usize]| Encoding::OneHot { low: low.to_vec(), sizes: sizes.to_vec() };
        assert_eq!(scale(&[], &[]).validate(), Err(EncodingError::Empty));
        assert!(matches!(
            scale(&[0.0], &[]).validate(),
            Err(EncodingError::Lengths { left: 1, right: 0, .. })
        ));
        for (low, high) in
            [(1.0, 1.0), (2.0, 1.0), (f32::NAN, 1.0), (0.0, f32::INFINITY), (f32::MIN, f32::MAX)]
        {
            let result = scale(&[0.0, low], &[1.0, high]).validate();
            assert!(matches!(result, Err(EncodingError::Range { index: 1, .. })), "{low} {high}");
        }
        assert!(matches!(one_hot(&[0.0], &[0]).validate(), Err(EncodingError::Categories { index: 0, .. })));
        assert!(matches!(one_hot(&[f32::NAN], &[2]).validate(), Err(EncodingError::Categories { .. })));
        assert!(matches!(
            one_hot(&[0.0; 2], &[usize::MAX; 2]).validate(),
            Err(EncodingError::Width { got: usize::MAX })
        ));
        assert_eq!(Encoding::Identity { dim: 4097 }.validate(), Err(EncodingError::Width { got: 4097 }));
    }

    proptest! {
        #[test]
        fn batch_equals_rows(rows in 1usize..5, values in prop::collection::vec(-3.0f32..9.0, 8)) {
            for encoding in [
                Encoding::Scale { low: vec![0.0, 1.0], high: vec![2.0, 4.0] },
                Encoding::OneHot { low: vec![0.0, -2.0], sizes: vec![4, 7] },
                Encoding::Mixed { low: vec![0.0, -2.0], high: vec![2.0, 4.0], sizes: vec![0, 7] },
                Encoding::Identity { dim: 2 },
            ] {
                prop_assert_eq!(encoding.validate(), Ok(()));
                let mut out = vec![f32::NAN; rows * encoding.input_dim()];
                encoding.encode_batch(&values[..rows * 2], rows, &mut out);
                let each: Vec<f32> =
                    values.chunks(2).take(rows).flat_map(|obs| encoded(&encoding, obs)).collect();
                prop_assert_eq!(out, each);
            }
        }

        #[test]
        fn bytes_are_encoded_as_the_same_numbers_are(bytes in prop::collection::vec(any::<u8>(), 4)) {
            let values: Vec<f32> = bytes.iter().copied().map(f32::from).collect();
            for encoding in [
                Encoding::Scale { low: vec![0.0, 1.0, -3.0, 0.0], high: vec![255.0, 4.0, 7.0, 0.1] },
                Encoding::OneHot { low: vec![0.0; 4], sizes: vec![4, 7, 256, 1] },
                Encoding::Mixed { low: vec![0.0; 4], high: vec![2.0; 4], sizes: vec![0, 7, 0, 3] },
                Encoding::Identity { dim: 4 },
            ] {
                let mut out = vec![f32::NAN; encoding.input_dim()];
                encoding.encode_row(Row::U8(&bytes), &mut out);
                prop_assert_eq!(out, encoded(&encoding, &values));
            }
        }

        #[test]
        fn every_instruction_set_scales_with_the_same_bits(
            x in prop::collection::vec(prop_oneof![-9.0f32..9.0, Just(f32::NAN), Just(f32::MAX)], 1..80), seed in 1u32..9,
        ) {
            let low: Vec<f32> = (0..x.len()).map(|i| (i as f32 * 0.3 - seed as f32) / 7.0).collect();
            let high: Vec<f32> = low.iter().map(|low| low + 0.1 * seed as f32).collect();
            let expected: Vec<u32> =
                x.iter().zip(&low).zip(&high).map(|((&x, &low), &high)| rescaled(x, low, high).to_bits()).collect();
            for isa in Isa::available() {
                let mut out = vec![0.0; x.len()];
                Kernels::new(isa).unwrap().run(Rescale { x: &x, low: &low, high: &high, out: &mut out });
                for (out, &expected) in out.iter().zip(&expected) {
                    prop_assert!(out.to_bits() == expected || out.is_nan() && f32::from_bits(expected).is_nan(), "{}", isa);
                }
            }
        }

        #[test]
        fn survives_a_round_trip_through_json(low in -5.0f32..0.0, size in 1usize..40) {
            let encoding = Encoding::OneHot { low: vec![low], sizes: vec![size] };
            let text = serde_json::to_string(&encoding).unwrap();
            prop_assert_eq!(serde_json::from_str::<Encoding>(&text).unwrap(), encoding);
        }
    }
}
