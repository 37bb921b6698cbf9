//! The resolved configuration of a run: every setting, its default, its range.
//!
//! A configuration is a preset or a TOML file (which may name a preset as its `base`), then `key=value` overrides.
//! What is left out has the default of this file. Unknown keys, wrong types and values out of range are refused.

mod arm;
mod demos;
mod hazard;
mod load;
mod point_maze;
mod threshold;
mod validate;

pub use demos::{Demos, ONLY, PLAN};
pub use hazard::{Hazard, HazardKind, HazardScope};
pub use load::{ConfigError, PRESETS, load, parse_toml, to_toml};
pub use point_maze::{PhysicsBackend, PointLayout, PointMaze, PointReset};
pub use threshold::Threshold;

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// All settings of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// What is run, how long and over how many processes.
    pub run: Run,
    /// The environment.
    pub env: Env,
    /// ε-greedy exploration.
    pub exploration: Exploration,
    /// Replay, network and gradient steps.
    pub learner: Learner,
    /// Demonstration and imitation.
    pub mentor: Mentor,
    /// Shaping of `dqn`'s rewards.
    pub shaping: Shaping,
    /// Greedy evaluations and when the task counts as solved.
    pub eval: Eval,
    /// Checkpoints.
    pub checkpoint: Checkpoint,
    /// What is done about processes that die or hang.
    pub supervise: Supervise,
}

/// `[run]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Run {
    /// The algorithm.
    pub algo: Algo,
    /// Seed of every random stream, 0 to 2^63 - 1.
    pub seed: u64,
    /// The run ends with this many finished episodes (1 or more) ...
    pub episodes: Option<u64>,
    /// ... or this many environment steps over all actors, whichever comes first. At least one must be given.
    pub env_steps: Option<u64>,
    /// Whether it also ends as soon as the task counts as solved (see [`Eval`]).
    pub stop_when_solved: bool,
    /// How the processes work together.
    pub mode: Mode,
    /// Actor processes, 1 to 64.
    pub actors: u32,
    /// Environment steps that each actor takes in a tick, 1 to 4096.
    pub rollout: u32,
    /// 0: actors wait for the newest weights. 1: they collect with those before, while the learner trains.
    pub lag: u32,
    /// With `mode = "free"`: environment steps that all actors together may be ahead of what has been learnt from, 1 to
    /// 64 times `actors * rollout`; 0: twice as many as that.
    pub ahead: u64,
    /// The instruction set that the network is computed with. All give the same bits.
    pub isa: IsaKind,
}

/// Instruction sets of the network's kernels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum IsaKind {
    /// The fastest one that the machine has.
    Auto,
    /// x86-64 with AVX-512F.
    Avx512,
    /// x86-64 with AVX2 and FMA.
    Avx2,
    /// Portable code.
    Scalar,
}

/// The algorithms.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Algo {
    /// Deep Q-network, no mentor (Mnih et al. 2015).
    Dqn,
    /// Deep implicit imitation Q-network: every mentor transition counts as feasible.
    Diiqn,
    /// Heterogeneous-action DIIQN: feasibility and bridges.
    HaDiiqn,
}

impl Algo {
    /// Its name in configurations and results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Dqn => "dqn",
            Self::Diiqn => "diiqn",
            Self::HaDiiqn => "ha-diiqn",
        }
    }

    /// Whether it learns from a mentor.
    pub fn has_mentor(self) -> bool {
        self != Self::Dqn
    }
}

/// How the processes of a run work together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// Tick by tick: the result depends on the configuration alone.
    Lockstep,
    /// Every actor streams, and only a process that dies is replaced; the result depends on the timing, too.
    Free,
    /// The same algorithm in one process, without services: the oracle of `lockstep`.
    Reference,
}

/// `[env]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Env {
    /// Which environment.
    pub kind: EnvKind,
    /// The map: a built-in name, a file, or `random:<seed>:<columns>x<rows>`.
    pub map: String,
    /// The map's text itself; filled in when the configuration is resolved, so that a run needs no other file.
    pub layout: Option<String>,
    /// Name of the observer's action set.
    pub actions: String,
    /// Action sets besides the built-in ones: names of compass directions.
    pub action_sets: BTreeMap<String, Vec<String>>,
    /// Steps after which an episode is cut off, 1 or more.
    pub step_limit: u32,
    /// What the network sees of a state.
    pub encoding: EncodingKind,
    /// What only `kind = "point-maze"` has.
    pub point_maze: PointMaze,
    /// How the environment fails on purpose, if it does.
    pub hazard: Hazard,
}

/// The environments.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EnvKind {
    /// A maze of cells.
    Maze,
    /// A ball with inertia in a maze of walls.
    PointMaze,
}

/// How a state becomes the network's input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EncodingKind {
    /// Each feature scaled to [-1, 1].
    Coordinates,
    /// Each (whole-numbered) feature as a one-hot vector.
    OneHot,
}

/// `[exploration]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Exploration {
    /// ε at the first step, 0 to 1.
    pub epsilon_start: f64,
    /// ε from `epsilon_decay_steps` on, 0 to 1.
    pub epsilon_end: f64,
    /// Environment steps of all actors over which ε falls linearly.
    pub epsilon_decay_steps: u64,
    /// Actor i of N acts with ε to the power of `1 + epsilon_spread * i / (N - 1)`, 0 to 100 (Horgan et al. 2018,
    /// "Distributed Prioritized Experience Replay", with 7); 0: all with the same.
    pub epsilon_spread: f64,
    /// Guided exploration, not the paper's: share of the exploring steps, at the first step, that take the action known
    /// for the nearest similar mentor state, 0 to 1. Both 0: none.
    pub guide_start: f64,
    /// That share from `guide_decay_steps` on, 0 to 1.
    pub guide_end: f64,
    /// Environment steps of all actors over which that share falls linearly.
    pub guide_decay_steps: u64,
}

/// `[learner]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Learner {
    /// Units of the hidden layers, one to six of them, each 1 to 4096.
    pub hidden: Vec<usize>,
    /// Discount γ, 0 to 1.
    pub gamma: f64,
    /// Adam's learning rate, above 0.
    pub lr: f64,
    /// Adam's decay of the first moment, 0 to below 1.
    pub adam_beta1: f64,
    /// Adam's decay of the second moment, 0 to below 1.
    pub adam_beta2: f64,
    /// Adam's ε, above 0.
    pub adam_eps: f64,
    /// Largest norm of the whole gradient; 0 for no clipping.
    pub max_grad_norm: f64,
    /// Samples of a gradient step, 1 to 1024.
    pub batch: usize,
    /// Environment steps before the first gradient step, at least `batch`.
    pub warmup: u64,
    /// Environment steps for each gradient step, 1 or more.
    pub train_every: u64,
    /// Transitions that the replay holds, at least `batch`.
    pub replay: usize,
    /// How the target network follows.
    pub target: TargetKind,
    /// `hard`: gradient steps between copies.
    pub target_every: u64,
    /// `polyak`: share of the online weights that each gradient step mixes in, above 0 to 1.
    pub tau: f64,
    /// Double DQN: the online network chooses the next action, the target network values it.
    pub double: bool,
    /// The loss of a sample.
    pub loss: LossKind,
    /// `huber`: error at which it turns from quadratic to linear, above 0.
    pub huber_delta: f64,
    /// What computes the gradient.
    pub backend: Backend,
}

/// How the target network follows the online network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TargetKind {
    /// A copy every `target_every` gradient steps.
    Hard,
    /// θ- <- (1 - τ) θ- + τ θ after every gradient step.
    Polyak,
}

/// The loss of a sample, of its error e = target - Q.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LossKind {
    /// Quadratic near 0, linear beyond `huber_delta`.
    Huber,
    /// e^2, as the paper writes it.
    Squared,
}

/// What computes the gradient.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Backend {
    /// Trestle's own kernels.
    Kernels,
    /// candle's automatic differentiation: slower, for comparison.
    Candle,
}

/// `[mentor]`, unused by `dqn`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Mentor {
    /// `plan` (an optimal path through the maze), a CSV file of states, or several of these by name.
    pub demo: Demos,
    /// `plan`: name of the mentor's action set.
    pub actions: String,
    /// What e_KL compares.
    pub metric: MetricKind,
    /// The covariance Σ of the state distance.
    pub covariance: CovarianceKind,
    /// Smallest standard deviation of a feature that is estimated from a demonstration, above 0.
    pub sigma_floor: f64,
    /// States are similar up to this KL divergence, above 0.
    pub e_th: Threshold,
    /// A mentor transition is feasible below this e_KL, above 0.
    pub e_infeas: Threshold,
    /// Most observer steps of a bridge, 1 to 64.
    pub k: u32,
    /// Most mentor steps that a bridge may span, 1 to 64.
    pub n: u32,
    /// Whether bridges are looked for (`ha-diiqn`); without them infeasible transitions are only gated off.
    pub bridges: bool,
    /// Whether a bridge may go on from any similar stored state (paper, Fig. 5).
    pub cross_reference: bool,
    /// The reward in the mentor's loss.
    pub reward: RewardKind,
    /// How a sample's loss is chosen.
    pub selection: SelectionKind,
    /// Whether the mentor's loss takes the place of the observer's or is added to it.
    pub combine: CombineKind,
    /// Which mentor transition belongs to a sample.
    pub draw: DrawKind,
    /// Whether the mentor's loss acts only where its target is above the present value.
    pub one_sided: bool,
    /// `confidence`: steepness β of the sigmoid, above 0.
    pub beta: f64,
    /// `confidence`: training count c_max at which a mentor state is fully trusted, 1 or more.
    pub c_max: u64,
    /// `confidence`: e_KL at which trust is gone, above 0.
    pub e_max: f64,
}

/// What e_KL compares.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MetricKind {
    /// KL(s_o, s_m) + KL(s'_o, s'_m), as in the paper.
    Kl,
    /// KL of the changes s' - s, where s_o and s_m are similar; no comparison elsewhere.
    Delta,
}

/// The covariance of the state distance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CovarianceKind {
    /// Diagonal, from the environment's feature scales.
    Space,
    /// Diagonal, the variances of the demonstration's states.
    Demonstration,
    /// The full covariance of the demonstration's states.
    Full,
}

/// The reward in the mentor's loss.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RewardKind {
    /// What the observer got when it took a_est, or the bridge's first step.
    Matched,
    /// The sampled observer transition's own reward, as the paper writes (3) and (6).
    Observer,
}

/// How a sample's loss is chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SelectionKind {
    /// The loss whose Q-value moved less, (4) and (5).
    MinDistance,
    /// Both, weighted by the confidence Φ in the mentor (arXiv 2511.03616).
    Confidence,
    /// The mentor's wherever there is one; not the paper's.
    Always,
}

/// What the mentor's loss L_m, of weight Φ, does to the observer's own L_o.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CombineKind {
    /// (1 - Φ) L_o + Φ L_m: one takes the other's place, as in the paper.
    Instead,
    /// L_o + Φ L_m: the observer's own experience is never displaced; not the paper's.
    Beside,
}

/// Which mentor transition belongs to a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DrawKind {
    /// One of those whose state is similar to the sample's, drawn when it is stored, as in the paper.
    Similar,
    /// Any one, drawn whenever the sample is: each is trained as often as every other, wherever the observer has been;
    /// not the paper's.
    Uniform,
}

/// `[shaping]`, a rival of the mentor's losses rather than a part of them: `dqn` alone.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Shaping {
    /// Potential of the end of the mentor's path, 0 or more; 0: no shaping.
    pub potential: f64,
}

/// `[eval]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Eval {
    /// Finished episodes between greedy evaluations, 1 or more.
    pub every: u64,
    /// Greedy episodes of an evaluation, 1 to 4096.
    pub episodes: u32,
    /// Return that counts as the goal; without it the best possible return, where the environment knows it.
    pub threshold: Option<f64>,
    /// How far below the threshold a return may be and count as solved, 0 or more.
    pub tolerance: f64,
}

/// `[checkpoint]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Checkpoint {
    /// Environment steps between checkpoints; 0 for one at the end alone.
    pub every_env_steps: u64,
    /// Complete checkpoints that are kept, 1 to 1000.
    pub keep: usize,
}

/// `[supervise]`
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Supervise {
    /// How often the run may be started again after the death of a process without getting ahead, 0 to 1000.
    pub restarts: u32,
    /// Seconds without a sign of life after which a process counts as dead, 3 to 86400; 0 for never.
    pub silence_s: u32,
    /// Seconds without progress in its work after which a process counts as dead, 3 to 86400; 0 for never.
    pub stall_s: u32,
}

impl Default for Run {
    fn default() -> Self {
        Self {
            algo: Algo::HaDiiqn,
            seed: 0,
            episodes: None,
            env_steps: None,
            stop_when_solved: false,
            mode: Mode::Lockstep,
            actors: 1,
            rollout: 32,
            lag: 0,
            ahead: 0,
            isa: IsaKind::Auto,
        }
    }
}

impl Default for Env {
    fn default() -> Self {
        Self {
            kind: EnvKind::Maze,
            map: "maze-small".into(),
            layout: None,
            actions: "irregular".into(),
            action_sets: BTreeMap::new(),
            step_limit: 4000,
            encoding: EncodingKind::Coordinates,
            point_maze: PointMaze::default(),
            hazard: Hazard::default(),
        }
    }
}

impl Default for Exploration {
    fn default() -> Self {
        Self {
            epsilon_start: 1.0,
            epsilon_end: 0.05,
            epsilon_decay_steps: 50_000,
            epsilon_spread: 0.0,
            guide_start: 0.0,
            guide_end: 0.0,
            guide_decay_steps: 50_000,
        }
    }
}

impl Default for Learner {
    fn default() -> Self {
        Self {
            hidden: vec![128, 128],
            gamma: 0.99,
            lr: 5e-4,
            adam_beta1: 0.9,
            adam_beta2: 0.999,
            adam_eps: 1e-8,
            max_grad_norm: 0.0,
            batch: 32,
            warmup: 1_000,
            train_every: 4,
            replay: 100_000,
            target: TargetKind::Polyak,
            target_every: 1_000,
            tau: 0.005,
            double: true,
            loss: LossKind::Huber,
            huber_delta: 1.0,
            backend: Backend::Kernels,
        }
    }
}

impl Default for Mentor {
    fn default() -> Self {
        Self {
            demo: Demos::one(PLAN),
            actions: "regular".into(),
            metric: MetricKind::Kl,
            covariance: CovarianceKind::Space,
            sigma_floor: 1e-6,
            e_th: Threshold::Kl(0.1),
            e_infeas: Threshold::Kl(0.1),
            k: 4,
            n: 4,
            bridges: true,
            cross_reference: true,
            reward: RewardKind::Matched,
            selection: SelectionKind::MinDistance,
            combine: CombineKind::Instead,
            draw: DrawKind::Similar,
            one_sided: false,
            beta: 1.0,
            c_max: 100,
            e_max: 1.0,
        }
    }
}

impl Default for Eval {
    fn default() -> Self {
        Self { every: 5, episodes: 1, threshold: None, tolerance: 0.5 }
    }
}

impl Default for Supervise {
    fn default() -> Self {
        Self { restarts: 5, silence_s: 10, stall_s: 300 }
    }
}

impl Default for Checkpoint {
    fn default() -> Self {
        Self { every_env_steps: 250_000, keep: 2 }
    }
}
