//! From an experiment to the shape of its network, the encoding of its input, and the kernels that compute it.

use crate::encode::{Encoding, EncodingError};
use crate::kernels::{Isa, Kernels};
use crate::layout::{Grid, Layout, LayoutError};
use crate::threads::{Threads, ThreadsError};
use trestle_proto::config::{Channels, EncodingKind, IsaKind};
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
    /// Convolutions of an observation that is no grid.
    #[error(
        "learner.conv has {convs} convolutions; accepted for {env}: none, as its observation is {found}, and not one array of 2 or 3 dimensions"
    )]
    NoGrid {
        /// How many there are.
        convs: usize,
        /// Name of the environment.
        env: String,
        /// What an observation is.
        found: String,
    },
    /// Convolutions of something else than the observation itself.
    #[error("learner.conv has {convs} convolutions; accepted for {env}: none, as {why}")]
    Encoded {
        /// How many there are.
        convs: usize,
        /// Name of the environment.
        env: String,
        /// The input that the network sees instead.
        why: &'static str,
    },
    /// Threads that cannot be started.
    #[error(transparent)]
    Threads(#[from] ThreadsError),
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
    Ok((layout_of(experiment, &encoding)?, encoding))
}

/// The layers of `experiment`'s network.
fn layout_of(experiment: &Experiment, encoding: &Encoding) -> Result<Layout, PlanError> {
    let (sizes, learner, spec) = (experiment.sizes(), &experiment.config.learner, &experiment.spec);
    let convs = learner.conv.len();
    let Some(&[height, width, channels]) = experiment.grids().first() else {
        return Ok(Layout::new(&sizes)?);
    };
    if !(2..=3).contains(&spec.shape.len()) {
        let found = match &spec.shape[..] {
            [] => format!("{} separate features", spec.obs_dim()),
            shape => format!("an array of the shape {shape:?}"),
        };
        return Err(PlanError::NoGrid { convs, env: spec.name.clone(), found });
    }
    if !matches!(encoding, Encoding::Scale { .. }) {
        let why = "categories or env.encoding = one-hot give it another input than the array";
        return Err(PlanError::Encoded { convs, env: spec.name.clone(), why });
    }
    let channels_first = learner.conv_channels == Channels::First && spec.shape.len() == 3;
    let grid = Grid { height, width, channels, channels_first };
    let layers: Vec<_> = learner.conv.iter().map(|conv| (conv.channels, conv.kernel, conv.stride)).collect();
    Ok(Layout::with_conv(grid, &layers, &sizes[1 + convs..])?)
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

/// The threads that share a gradient step of `experiment`'s network.
///
/// # Errors
/// One of them cannot be started.
pub fn threads_of(experiment: &Experiment) -> Result<Threads, PlanError> {
    Ok(Threads::new(experiment.config.learner.threads)?)
}
