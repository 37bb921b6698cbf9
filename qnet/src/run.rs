//! From an experiment to the shape of its network, the encoding of its input, and the kernels that compute it.

use crate::encode::{Encoding, EncodingError};
use crate::kernels::{Isa, Kernels};
use crate::layout::{Layout, LayoutError};
use trestle_proto::config::{EncodingKind, IsaKind};
use trestle_proto::experiment::Experiment;

/// An experiment that gives no network.
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
    /// An instruction set that this machine lacks.
    #[error("run.isa = {asked}; accepted on this machine: auto, {available}")]
    Isa {
        /// The instruction set.
        asked: Isa,
        /// Those that it has.
        available: String,
    },
}

/// The network of `experiment`, and how an observation becomes its input.
pub fn network_of(experiment: &Experiment) -> Result<(Layout, Encoding), PlanError> {
    let spec = &experiment.spec;
    let (low, high) = (spec.low.clone(), spec.high.clone());
    let encoding = match experiment.config.env.encoding {
        EncodingKind::Coordinates if spec.categories.is_empty() => Encoding::Scale { low, high },
        EncodingKind::Coordinates => Encoding::Mixed { low, high, sizes: experiment.mixed_sizes() },
        EncodingKind::OneHot if spec.integral => Encoding::OneHot { low, sizes: experiment.one_hot_sizes() },
        EncodingKind::OneHot => return Err(PlanError::OneHot { env: spec.name.clone() }),
    };
    encoding.validate()?;
    Ok((Layout::new(&experiment.sizes())?, encoding))
}

/// The kernels that compute the network of `experiment`.
///
/// # Errors
/// The machine lacks the instruction set that the experiment asks for.
pub fn kernels_of(experiment: &Experiment) -> Result<Kernels, PlanError> {
    let asked = match experiment.config.run.isa {
        IsaKind::Auto => Isa::detect(),
        IsaKind::Avx512 => Isa::Avx512,
        IsaKind::Avx2 => Isa::Avx2,
        IsaKind::Scalar => Isa::Scalar,
    };
    Kernels::new(asked).ok_or_else(|| {
        let available: Vec<String> = Isa::available().map(|isa| isa.to_string()).collect();
        PlanError::Isa { asked, available: available.join(", ") }
    })
}
