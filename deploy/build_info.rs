//! What was built, for `build.json`: version, commit, processor features, back ends.

use serde::Serialize;
use trestle_actor::env::registry;
use trestle_proto::config::{self, Environments, Table};

/// What tells the sources that this was built from: 16 digits that another source would hardly have.
pub const BUILD: &str = env!("TRESTLE_SOURCES");

/// The contents of `build.json`.
#[derive(Debug, Serialize)]
pub(crate) struct BuildInfo {
    version: &'static str,
    /// Commit of the sources, if they were built in a checkout.
    commit: Option<&'static str>,
    /// The sources themselves; all hosts of a run must have the same.
    sources: &'static str,
    profile: &'static str,
    target: String,
    /// Instruction set that the kernels use on this machine, and all that they could use.
    isa: String,
    cpu_features: Vec<String>,
    /// The environments that a configuration can choose.
    backends: Vec<&'static str>,
    /// What computes this run's environment; none where that is Trestle itself.
    physics: Option<Table>,
}

impl BuildInfo {
    /// For a run with the resolved environment `env`.
    pub(crate) fn new(env: &config::Env) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION"),
            commit: option_env!("TRESTLE_COMMIT"),
            sources: BUILD,
            profile: if cfg!(debug_assertions) { "dev" } else { "release" },
            target: format!("{}-{}", std::env::consts::ARCH, std::env::consts::OS),
            isa: trestle_qnet::Isa::detect().to_string(),
            cpu_features: trestle_qnet::Isa::available().map(|isa| isa.to_string()).collect(),
            backends: registry().names(),
            // A resolved configuration's settings are accepted.
            physics: registry().engine(env).ok().flatten(),
        }
    }
}
