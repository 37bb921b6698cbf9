//! `[mentor]` and `[shaping]`: demonstration and imitation, and the shaping of `dqn`'s rewards.

use super::accepts::{Accepts, above, any, at_least, between};
use super::{Algo, Demos, Features, Learned, PLAN, Threshold};
use crate::limits::MAX_BRIDGE_DEPTH;
use crate::space::EnvSpec;
use crate::{choices, settings};

settings! {
    /// `[mentor]`, unused by `dqn` unless its rewards are shaped or its exploration is guided by learned bridges.
    pub struct Mentor {
        /// Where the demonstration comes from: `plan` is a path that the environment plans, anything else a CSV file of states. A
        /// table names several.
        demo: Demos = Demos::one(PLAN);
        /// With `demo = "plan"`: name of the mentor's action set.
        actions: String = "regular".into(), any("as `env.actions`");
        /// What e_KL compares.
        metric: MetricKind = MetricKind::Auto;
        /// Which transitions of the observer may say what the mentor did in s_m.
        inference: InferenceKind = InferenceKind::Similar;
        /// The covariance Σ of the state distance.
        covariance: CovarianceKind = CovarianceKind::Space;
        /// The features that are compared, by their numbers or names; the name of a part stands for all that is in it. All if
        /// empty. For bodies that share their position and not their velocity or their heading.
        features: Features = Features::default(), any("a list of numbers or names of features, each once");
        /// With `covariance = "space"`: the standard deviation of each feature of a state, in place of the environment's own.
        scale: Vec<f64> = Vec::new(), Accepts::when("a number above 0 for each feature of a state", |scale: &Vec<f64>| {
            scale.iter().all(|&sigma| sigma.is_finite() && sigma > 0.0)
        });
        /// Smallest standard deviation of a feature that is estimated from a demonstration.
        sigma_floor: f64 = 1e-6, above(0.0);
        /// States are similar up to this KL divergence.
        e_th: Threshold = Threshold::Kl(0.1), threshold();
        /// A mentor transition is feasible below this e_KL. `auto` takes it from the mentor's own steps.
        e_infeas: Threshold = Threshold::Kl(0.1), threshold();
        /// Most observer steps of a bridge.
        k: u32 = 4, between(1, MAX_BRIDGE_DEPTH);
        /// Most mentor steps that a bridge may span.
        n: u32 = 4, between(1, MAX_BRIDGE_DEPTH);
        /// With `ha-diiqn`: whether bridges are looked for. Without them infeasible transitions are only gated off.
        bridges: bool = true;
        /// Whether a bridge may go on from any similar stored state (paper, Fig. 5).
        cross_reference: bool = true;
        /// The reward in the mentor's loss.
        reward: RewardKind = RewardKind::Matched;
        /// The rule that weighs a sample's two losses.
        selection: String = "min-distance".into(), any("the name of a selection rule");
        /// Whether the mentor's loss takes the place of the observer's or is added to it.
        combine: CombineKind = CombineKind::Instead;
        /// Which mentor transition belongs to a sample: a similar one, or any.
        draw: DrawKind = DrawKind::Similar;
        /// Whether the mentor's loss acts only where its target is above the present value.
        one_sided: bool = false;
        /// With `selection = "confidence"`: steepness β of the sigmoid.
        beta: f64 = 1.0, above(0.0);
        /// With `selection = "confidence"`: training count c_max at which a mentor state is fully trusted.
        c_max: u64 = 100, at_least(1);
        /// With `selection = "confidence"`: e_KL at which trust is gone.
        e_max: f64 = 1.0, above(0.0);
        /// Learned bridges.
        learned: Learned = Learned::default();
    }
}

/// What `e_th` and `e_infeas` accept.
fn threshold() -> Accepts<Threshold> {
    Accepts::when("a number above 0, or auto", |threshold: &Threshold| {
        threshold.known().is_none_or(|kl| kl.is_finite() && kl > 0.0)
    })
}

settings! {
    /// `[shaping]`, a rival of the mentor's losses rather than a part of them: `dqn` alone.
    pub struct Shaping {
        /// Potential of the end of the mentor's path. 0: no shaping.
        potential: f64 = 0.0, at_least(0.0);
    }
}

choices! {
    /// What e_KL compares.
    pub enum MetricKind {
        /// `delta` where the environment's states have velocities, else `kl`.
        Auto = "auto",
        /// KL(s_o, s_m) + KL(s'_o, s'_m), as in the paper.
        Kl = "kl",
        /// KL of the changes s' - s, where s_o and s_m are similar; no comparison elsewhere.
        Delta = "delta",
    }
}

impl Mentor {
    /// Whether a run of `algo` looks for bridges among its stored transitions.
    pub fn seeks_bridges(&self, algo: Algo) -> bool {
        algo == Algo::HaDiiqn && self.bridges
    }
}

impl MetricKind {
    /// What `auto` stands for in the environment with `spec`; any other value itself.
    pub fn of(self, spec: &EnvSpec) -> Self {
        match self {
            Self::Auto if spec.velocities.is_empty() => Self::Kl,
            Self::Auto => Self::Delta,
            known => known,
        }
    }
}

choices! {
    /// Which transitions of the observer may become the estimate of a mentor transition.
    pub enum InferenceKind {
        /// Those that begin in a state similar to s_m. At the same e_KL the one that begins nearer to s_m, and from s_m itself
        /// the one with the higher reward.
        Similar = "similar",
        /// All of them, as in the papers, and at the same e_KL the one with the higher reward, wherever it begins. With
        /// `metric = "delta"` they begin in similar states, too.
        Any = "any",
    }
}

choices! {
    /// The covariance of the state distance.
    pub enum CovarianceKind {
        /// Diagonal, from the environment's feature scales.
        Space = "space",
        /// Diagonal, the variances of the demonstration's states.
        Demonstration = "demonstration",
        /// The full covariance of the demonstration's states.
        Full = "full",
    }
}

choices! {
    /// The reward in the mentor's loss.
    pub enum RewardKind {
        /// What the observer got when it took a_est, or the bridge's first step.
        Matched = "matched",
        /// The sampled observer transition's own reward, as the paper writes (3) and (6).
        Observer = "observer",
    }
}

choices! {
    /// What the mentor's loss L_m, of weight Φ, does to the observer's own L_o.
    pub enum CombineKind {
        /// (1 - Φ) L_o + Φ L_m: one takes the other's place, as in the paper.
        Instead = "instead",
        /// L_o + Φ L_m: the observer's own experience is never displaced; not the paper's.
        Beside = "beside",
    }
}

choices! {
    /// Which mentor transition belongs to a sample.
    pub enum DrawKind {
        /// One of those whose state is similar to the sample's, drawn when it is stored, as in the paper.
        Similar = "similar",
        /// Any one, drawn whenever the sample is: each is trained as often as every other, wherever the observer has been;
        /// not the paper's.
        Uniform = "uniform",
    }
}
