//! `[exploration]` and `[learner]`: ε-greedy exploration; replay, network and gradient steps.

use super::accepts::{Accepts, above, above_up_to, at_least, below, between, list};
use super::conv::ConvLayer;
use crate::limits::{MAX_N_STEP, MAX_REPLAY, MAX_SIZES, MAX_THREADS, MAX_WIDTH};
use crate::{choices, settings};

settings! {
    /// `[exploration]`
    pub struct Exploration {
        /// ε at the first step.
        epsilon_start: f64 = 1.0, between(0.0, 1.0);
        /// ε from `epsilon_decay_steps` on.
        epsilon_end: f64 = 0.05, between(0.0, 1.0);
        /// Environment steps of all actors over which ε falls linearly.
        epsilon_decay_steps: u64 = 50_000;
        /// Actor i of N acts with ε to the power of 1 + `epsilon_spread` i / (N - 1). 0: all with the same ε. Horgan et al.
        /// (2018, "Distributed Prioritized Experience Replay") have 7.
        epsilon_spread: f64 = 0.0, between(0.0, 100.0);
        /// What guides exploration, which the paper does not have.
        guide: GuideKind = GuideKind::Auto;
        /// The share of the exploring steps, at the first step, that are guided.
        guide_start: f64 = 0.0, between(0.0, 1.0);
        /// That share from `guide_decay_steps` on.
        guide_end: f64 = 0.0, between(0.0, 1.0);
        /// Environment steps of all actors over which that share falls linearly. 0: as many as ε takes, `epsilon_decay_steps`.
        guide_decay_steps: u64 = 50_000;
        /// With known actions and bridges: whether a guided step that begins a bridge is followed by the bridge's other steps, until
        /// a state is not similar to the one that the bridge had there.
        guide_whole: bool = false;
    }
}

choices! {
    /// What guides exploration.
    pub enum GuideKind {
        /// The action that is known for the nearest similar mentor state. Without effect for `dqn`, which has no annotations.
        Known = "known",
        /// A policy that leads along the mentor's path, learnt in hindsight from the observer's own steps: `[mentor.learned]`.
        Learned = "learned",
        /// `learned` for `trestle`, and `known` for every other algorithm.
        Auto = "auto",
    }
}

choices! {
    /// Where an observation has its channels.
    pub enum Channels {
        /// Height, width, channels.
        Last = "last",
        /// Channels, height, width.
        First = "first",
    }
}

/// Hidden layers at most: input and output are sizes of the network, too.
pub(super) const MAX_HIDDEN: usize = MAX_SIZES - 2;

settings! {
    /// `[learner]`
    pub struct Learner {
        /// Convolutions in front of the hidden layers, each `{ channels = 16, kernel = 3, stride = 1 }`: a square kernel wherever it fits,
        /// and a ReLU. Only for an observation that is one array of 2 or 3 dimensions. Convolutions and hidden layers are at most 6
        /// together.
        conv: Vec<ConvLayer> = Vec::new(), Accepts::when(
            Vec::<ConvLayer>::accepted(),
            |layers: &Vec<ConvLayer>| layers.len() < MAX_HIDDEN && layers.iter().all(ConvLayer::in_range),
        );
        /// Which dimension of an observation with 3 has the channels of the convolution; the others are height and width.
        conv_channels: Channels = Channels::Last;
        /// Units of each hidden layer.
        hidden: Vec<usize> = vec![128, 128], list(1..=MAX_HIDDEN, between(1, MAX_WIDTH))
            .in_words(format!("1 to {MAX_HIDDEN} layers of 1 to {MAX_WIDTH} units"));
        /// Discount γ.
        gamma: f64 = 0.99, between(0.0, 1.0);
        /// Adam's learning rate.
        lr: f64 = 5e-4, above(0.0);
        /// Adam's decay of the first moment.
        adam_beta1: f64 = 0.9, below(0.0, 1.0);
        /// Adam's decay of the second moment.
        adam_beta2: f64 = 0.999, below(0.0, 1.0);
        /// Adam's ε.
        adam_eps: f64 = 1e-8, above(0.0);
        /// Largest norm of the whole gradient. 0: no clipping.
        max_grad_norm: f64 = 0.0, at_least(0.0);
        /// Samples of a gradient step.
        batch: usize = 32, between(1, 1024);
        /// Environment steps before gradient steps are counted.
        warmup: u64 = 1_000, at_least(1).in_words("learner.batch or more");
        /// Environment steps for each gradient step.
        train_every: u64 = 4, at_least(1);
        /// Transitions that the replay holds.
        replay: usize = 100_000, between(1, MAX_REPLAY).in_words(format!("learner.batch to {MAX_REPLAY}"));
        /// How the target network follows.
        target: TargetKind = TargetKind::Polyak;
        /// With `target = "hard"`: gradient steps between copies.
        target_every: u64 = 1_000, at_least(1);
        /// With `target = "polyak"`: share of the online weights that each gradient step mixes in.
        tau: f64 = 0.005, above_up_to(0.0, 1.0);
        /// Double DQN: the online network chooses the next action, and the target network values it.
        double: bool = true;
        /// Steps of the observer that the target of its own loss L_o looks ahead. 1: one, as in the papers. The mentor's loss
        /// always looks one step ahead.
        n_step: usize = 1, between(1, MAX_N_STEP);
        /// The loss of a sample.
        loss: LossKind = LossKind::Huber;
        /// With `loss = "huber"`: error at which it turns from quadratic to linear.
        huber_delta: f64 = 1.0, above(0.0);
        /// What computes the gradient.
        backend: Backend = Backend::Kernels;
        /// With `backend = "kernels"`: threads that share a gradient step of the Q-network, where it is large enough for that to be
        /// faster; no more than there are processors. The results are the same to the bit for any number.
        threads: usize = 1, between(1, MAX_THREADS);
    }
}

choices! {
    /// How the target network follows the online network.
    pub enum TargetKind {
        /// A copy every `target_every` gradient steps.
        Hard = "hard",
        /// θ- <- (1 - τ) θ- + τ θ after every gradient step.
        Polyak = "polyak",
    }
}

choices! {
    /// The loss of a sample, of its error e = target - Q.
    pub enum LossKind {
        /// Quadratic near 0, linear beyond `huber_delta`.
        Huber = "huber",
        /// e^2, as the paper writes it.
        Squared = "squared",
    }
}

choices! {
    /// What computes the gradient.
    pub enum Backend {
        /// Trestle's own kernels.
        Kernels = "kernels",
        /// candle's automatic differentiation: slower, for comparison.
        Candle = "candle",
    }
}
