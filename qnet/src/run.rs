//! From a run's plan to the shape of its network and the encoding of its input.

use crate::encode::{Encoding, EncodingError};
use crate::layout::{Layout, LayoutError};
use trestle_proto::config::EncodingKind;
use trestle_proto::plan::RunPlan;

/// A plan that gives no network.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// Sizes out of range.
    #[error(transparent)]
    Layout(#[from] LayoutError),
    /// Features out of range.
    #[error(transparent)]
    Encoding(#[from] EncodingError),
    /// A one-hot encoding of features that are not whole numbers.
    #[error("env.encoding = one-hot; accepted for {env}: coordinates, as its features are not whole numbers")]
    OneHot {
        /// Name of the environment.
        env: String,
    },
}

/// The network of `plan`, and how an observation becomes its input.
pub fn network_of(plan: &RunPlan) -> Result<(Layout, Encoding), PlanError> {
    let spec = &plan.spec;
    let (low, high) = (spec.low.clone(), spec.high.clone());
    let encoding = match plan.config.env.encoding {
        EncodingKind::Coordinates => Encoding::Scale { low, high },
        EncodingKind::OneHot if spec.integral => Encoding::OneHot { low, sizes: plan.one_hot_sizes() },
        EncodingKind::OneHot => return Err(PlanError::OneHot { env: spec.name.clone() }),
    };
    encoding.validate()?;
    Ok((Layout::new(&plan.sizes())?, encoding))
}
