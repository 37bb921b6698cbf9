//! The temporal-difference loss of one sample: value and derivative.
//!
//! Both losses are zero exactly at `q = y` and grow with the error, so they have the same minimum; they
//! differ in scale. Squared is the paper's `(y - q)^2` (its equations 2, 3 and 6), without a factor of one
//! half. Huber, our default for stability, is PyTorch's `huber_loss` (and `smooth_l1_loss` at `delta = 1`):
//! within `delta` *half* the squared error, beyond it a straight line.

use serde::{Deserialize, Serialize};

/// Why a loss is not usable.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LossError {
    /// The Huber threshold is not a positive finite number.
    #[error("the Huber loss has delta = {got}; accepted are finite numbers above 0")]
    Delta {
        /// The threshold given.
        got: f32,
    },
}

/// The loss of a Q-value `q` against its target `y`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Loss {
    /// `(y - q)^2 / 2` while `|y - q| <= delta`, else `delta * (|y - q| - delta / 2)`.
    Huber {
        /// Error at which the parabola turns into a line, in units of return; finite and above 0.
        delta: f32,
    },
    /// `(y - q)^2`, the paper's equation (2).
    Squared,
}

impl Loss {
    /// Checks the parameters.
    ///
    /// # Errors
    /// A Huber `delta` that is not finite and above 0.
    pub fn validate(&self) -> Result<(), LossError> {
        match *self {
            Loss::Huber { delta: got } if !(got.is_finite() && got > 0.0) => Err(LossError::Delta { got }),
            _ => Ok(()),
        }
    }

    /// The loss at `q`. A NaN in either argument comes out as NaN.
    #[inline]
    pub fn value(&self, q: f32, y: f32) -> f32 {
        let error = q - y;
        match *self {
            Loss::Huber { delta } if error.abs() > delta => delta * (error.abs() - 0.5 * delta),
            Loss::Huber { .. } => 0.5 * error * error,
            Loss::Squared => error * error,
        }
    }

    /// The derivative of [`Loss::value`] by `q`. A NaN in either argument comes out as NaN.
    #[inline]
    pub fn derivative(&self, q: f32, y: f32) -> f32 {
        let error = q - y;
        match *self {
            Loss::Huber { delta } if error > delta => delta,
            Loss::Huber { delta } if error < -delta => -delta,
            Loss::Huber { .. } => error,
            Loss::Squared => 2.0 * error,
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn known_values() {
        let huber = Loss::Huber { delta: 1.0 };
        assert_eq!((huber.value(0.5, 0.0), huber.derivative(0.5, 0.0)), (0.125, 0.5));
        assert_eq!((huber.value(0.0, 3.0), huber.derivative(0.0, 3.0)), (2.5, -1.0));
        let wide = Loss::Huber { delta: 2.0 };
        assert_eq!((wide.value(3.0, 0.0), wide.derivative(3.0, 0.0)), (4.0, 2.0));
        assert_eq!((Loss::Squared.value(1.0, 4.0), Loss::Squared.derivative(1.0, 4.0)), (9.0, -6.0));
    }

    #[test]
    fn nan_is_passed_on() {
        for loss in [Loss::Huber { delta: 1.0 }, Loss::Squared] {
            assert!(loss.value(f32::NAN, 0.0).is_nan() && loss.derivative(0.0, f32::NAN).is_nan());
        }
    }

    #[test]
    fn only_a_positive_finite_delta_is_accepted() {
        for bad in [0.0, -1.0, f32::INFINITY, f32::NAN] {
            assert!(Loss::Huber { delta: bad }.validate().is_err());
        }
        assert_eq!(Loss::Huber { delta: 0.5 }.validate(), Ok(()));
        assert_eq!(Loss::Squared.validate(), Ok(()));
    }

    proptest! {
        #[test]
        fn derivative_is_the_slope_and_the_minimum_is_shared(
            q in -8.0f32..8.0, y in -8.0f32..8.0, delta in 0.1f32..4.0,
        ) {
            for loss in [Loss::Huber { delta }, Loss::Squared] {
                let h = 1e-2;
                let slope = (loss.value(q + h, y) - loss.value(q - h, y)) / (2.0 * h);
                prop_assert!((slope - loss.derivative(q, y)).abs() < 0.02, "{loss:?}");
                prop_assert!(loss.value(q, y) >= 0.0);
                prop_assert_eq!(loss.value(y, y), 0.0);
                prop_assert!(loss.derivative(q, y) * (q - y) >= 0.0);
            }
        }
    }
}
