//! `[rival]`: other people's ways to learn from a mentor's states, to compare with.

use super::accepts::{above, above_up_to, at_least, between, list};
use super::learner::MAX_HIDDEN;
use crate::limits::{MAX_RELABELLED, MAX_WIDTH};
use crate::{choices, settings};

/// The smallest ε of optimal transport: with it e^(-cost / ε) is above 1e-87, far from the smallest number.
const LEAST_EPSILON: f64 = 0.005;

settings! {
    /// `[rival]`: one of other people's ways to learn from the mentor's states.
    pub struct Rival {
        /// Which one.
        kind: RivalKind = RivalKind::None;
        /// Rewards by optimal transport.
        transport: Transport = Transport::default();
        /// Episodes that begin along the demonstration.
        resets: Resets = Resets::default();
        /// Labels of an inverse model.
        inverse: Inverse = Inverse::default();
        /// D-Shape.
        dshape: DShape = DShape::default();
        /// GAIfO.
        gaifo: Gaifo = Gaifo::default();
    }
}

settings! {
    /// `[rival.transport]`, for `rival.kind = "optimal-transport"`.
    pub struct Transport {
        /// Weight α of the term that is added to each reward of an episode.
        weight: f64 = 0.03, above(0.0);
        /// What becomes of an episode's costs.
        squash: SquashKind = SquashKind::Linear;
        /// With `squash = "exponential"`: steepness β.
        beta: f64 = 5.0, above(0.0);
        /// How blurred the plan is: the weight ε of its entropy, in units of the largest cost between two states.
        epsilon: f64 = 0.01, between(LEAST_EPSILON, 1.0);
        /// Most rounds of Sinkhorn's algorithm for an episode and a trajectory.
        rounds: usize = 100, between(1, 10_000);
    }
}

settings! {
    /// `[rival.resets]`, for `rival.kind = "resets"`.
    pub struct Resets {
        /// By which share of the trajectory the beginning of episodes moves towards its start when it moves.
        shift: f64 = 0.1, above_up_to(0.0, 1.0);
        /// It moves once this share of the newest episodes has succeeded.
        share: f64 = 0.2, above_up_to(0.0, 1.0);
        /// How many of the newest episodes of an actor are looked at.
        episodes: u32 = 5, between(1, 1000);
    }
}

settings! {
    /// `[rival.inverse]`, for `rival.kind = "inverse-dynamics"`.
    pub struct Inverse {
        /// Units of each hidden layer of the inverse model.
        hidden: Vec<usize> = vec![64, 64], hidden();
        /// Samples of an update. There is one update for each gradient step of the Q-network.
        batch: usize = 64, between(1, 1024);
        /// Adam's learning rate.
        lr: f64 = 1e-3, above(0.0);
        /// Gradient steps from one labelling of the mentor's transitions to the next.
        every: u64 = 500, at_least(1);
    }
}

settings! {
    /// `[rival.dshape]`, for `rival.kind = "d-shape"`.
    pub struct DShape {
        /// Weight of the distance to the goal, in units of the environment's scales, in the potential.
        weight: f64 = 0.01, above(0.0);
        /// Relabelled transitions for each one that is stored.
        goals: usize = 3, between(0, MAX_RELABELLED);
    }
}

settings! {
    /// `[rival.gaifo]`, for `rival.kind = "gaifo"`.
    pub struct Gaifo {
        /// Weight of the term that is added to each reward.
        weight: f64 = 0.03, above(0.0);
        /// Which function of the discriminator is added.
        reward: AdversarialKind = AdversarialKind::Mentor;
        /// Units of each hidden layer of the discriminator.
        hidden: Vec<usize> = vec![64, 64], hidden();
        /// Samples of an update of either kind. There is one update for each gradient step of the Q-network.
        batch: usize = 64, between(1, 1024);
        /// Adam's learning rate.
        lr: f64 = 1e-4, above(0.0);
    }
}

/// What the hidden layers of a rival's network accept.
fn hidden() -> super::accepts::Accepts<Vec<usize>> {
    list(1..=MAX_HIDDEN, between(1, MAX_WIDTH))
        .in_words(format!("1 to {MAX_HIDDEN} layers of 1 to {MAX_WIDTH} units"))
}

choices! {
    /// Rivals of our ways to learn from a mentor.
    pub enum RivalKind {
        /// None.
        None = "none",
        /// Rewards by the optimal transport between an episode's states and the mentor's (Luo et al. 2023).
        OptimalTransport = "optimal-transport",
        /// Episodes begin in the mentor's states, at first near their end (Salimans and Chen 2018).
        Resets = "resets",
        /// An inverse model of the observer's says what the mentor did (Torabi, Warnell and Stone 2018).
        InverseDynamics = "inverse-dynamics",
        /// The mentor's states are goals that come one after the other (Wang, Warnell and Stone 2023).
        DShape = "d-shape",
        /// Rewards by a network that tells the mentor's steps from the observer's (Torabi, Warnell and Stone 2019).
        Gaifo = "gaifo",
    }
}

choices! {
    /// What becomes of the cost c of a step, its share of the transport times the steps of the episode.
    pub enum SquashKind {
        /// -α c.
        Linear = "linear",
        /// α e^(-β c).
        Exponential = "exponential",
    }
}

choices! {
    /// What is made of D, the probability that a step is the observer's.
    pub enum AdversarialKind {
        /// -ln D, as in the paper: never below 0, so that a long episode gets more of it.
        Observer = "observer",
        /// ln(1 - D): never above 0, so that a short episode loses less by it.
        Mentor = "mentor",
    }
}

impl RivalKind {
    /// Whether it needs the mentor's states themselves.
    pub fn needs_states(self) -> bool {
        !matches!(self, Self::None | Self::InverseDynamics)
    }

    /// What a run's name says of it.
    pub(super) fn suffix(self) -> Option<&'static str> {
        match self {
            Self::None => None,
            Self::OptimalTransport => Some("+optimal-transport"),
            Self::Resets => Some("+resets"),
            Self::InverseDynamics => Some("+labels"),
            Self::DShape => Some("+d-shape"),
            Self::Gaifo => Some("+gaifo"),
        }
    }
}
