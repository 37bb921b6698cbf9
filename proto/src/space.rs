//! What the other processes know of an environment: the shape of its observations and actions.

use crate::limits::{MAX_ACTIONS, MAX_OBS_DIM};
use crate::row::{Element, RowKind};
use serde::{Deserialize, Serialize};

/// The spaces of an environment, and how its returns are to be read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EnvSpec {
    /// Name for people, e.g. `maze maze30`.
    pub name: String,
    /// The type that holds every feature in the replay and in messages. A state with another value is an error of the environment.
    pub element: Element,
    /// Shape of an observation that is one array whose numbers, row-major, are the features; empty where it is none. A
    /// convolution needs two or three dimensions.
    pub shape: Vec<usize>,
    /// Smallest value of each feature; its length is the observation's dimension.
    pub low: Vec<f32>,
    /// Largest value of each feature.
    pub high: Vec<f32>,
    /// Scale of each feature (one "step" of it), the default standard deviations of the state distance.
    pub scale: Vec<f32>,
    /// Whether every feature takes whole numbers only (needed for the one-hot encoding).
    pub integral: bool,
    /// Features that are numbers of categories, ascending: whole numbers whose differences mean nothing. The network sees each
    /// as a one-hot vector, whatever the encoding of the others.
    pub categories: Vec<usize>,
    /// Features that are velocities of others, ascending; empty where an action shows in the next state at once. Where there
    /// are some, `mentor.metric = "auto"` compares changes of states.
    pub velocities: Vec<usize>,
    /// Names of the discrete actions; their number is the size of the action space.
    pub actions: Vec<String>,
    /// The best return that is possible, where it is known.
    pub best_return: Option<f64>,
    /// The return that counts as the goal where the configuration has none, if it is not the best one.
    pub threshold: Option<f64>,
    /// Part of the reward of a step that succeeds which is the learner's alone: returns leave it out.
    pub goal_bonus: f32,
    /// Whether the environment says which episodes succeed. Where it does not, a return threshold may.
    pub defines_success: bool,
}

/// An environment whose spaces are out of range.
#[derive(Debug, thiserror::Error)]
pub enum SpaceError {
    /// Dimension of the observation.
    #[error("environment {name}: {dim} features in an observation; accepted: 1 to {MAX_OBS_DIM}")]
    ObsDim {
        /// Name of the environment.
        name: String,
        /// What it says.
        dim: usize,
    },
    /// Shape of the observation.
    #[error(
        "environment {name}: an array of the shape {shape:?}; accepted: as many numbers as it has features, {dim}, or no shape"
    )]
    Shape {
        /// Name of the environment.
        name: String,
        /// The shape that it gives.
        shape: Vec<usize>,
        /// Features of an observation.
        dim: usize,
    },
    /// Number of actions.
    #[error("environment {name}: {n} actions; accepted: 2 to {MAX_ACTIONS}")]
    Actions {
        /// Name of the environment.
        name: String,
        /// What it says.
        n: usize,
    },
    /// A feature that is said to be a velocity.
    #[error(
        "environment {name}: velocities {velocities:?}; accepted: features below {dim}, each once, in ascending order"
    )]
    Velocities {
        /// Name of the environment.
        name: String,
        /// What it says.
        velocities: Vec<usize>,
        /// Features of an observation.
        dim: usize,
    },
    /// A feature whose values are said to be categories.
    #[error(
        "environment {name}: categories {categories:?}; accepted: features below {dim} between whole numbers, each once, in ascending order"
    )]
    Categories {
        /// Name of the environment.
        name: String,
        /// What it says.
        categories: Vec<usize>,
        /// Features of an observation.
        dim: usize,
    },
    /// Bounds or scale of a feature.
    #[error(
        "environment {name}: feature {index} has bounds [{low}, {high}] and scale {scale}; accepted: finite, low < high, scale > 0"
    )]
    Feature {
        /// Name of the environment.
        name: String,
        /// Which feature.
        index: usize,
        /// Its lower bound.
        low: f32,
        /// Its upper bound.
        high: f32,
        /// Its scale.
        scale: f32,
    },
}

/// What a step with `reward` adds to the return that is reported: see [`EnvSpec::goal_bonus`].
pub fn reported(reward: f32, succeeded: bool, goal_bonus: f32) -> f64 {
    f64::from(reward) - if succeeded { f64::from(goal_bonus) } else { 0.0 }
}

/// What counts as the success of an episode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Success {
    /// What the environment says.
    Said,
    /// A return, as it is reported, from this one on.
    Return(f64),
    /// Nothing: neither does the environment say it, nor is there a threshold.
    Undefined,
}

impl Success {
    /// Whether an episode succeeded, of which the environment `said` so or not and which had the return `total_reward`; none
    /// where success is not defined.
    pub fn of(self, said: bool, total_reward: f64) -> Option<bool> {
        match self {
            Self::Said => Some(said),
            Self::Return(least) => Some(total_reward >= least),
            Self::Undefined => None,
        }
    }
}

/// Rounding of a summed return that is forgiven, as a share of `max(1, |threshold|)`. Rewards are `f32`, so a
/// return that equals the threshold on paper may fall short of it by some 1e-7 of its size; the differences
/// that matter, a single step's reward, are many times larger than this.
pub const ROUNDING: f64 = 1e-6;

/// The least return that is no more than `tolerance` below `threshold`, [`ROUNDING`] forgiven.
pub fn least(threshold: f64, tolerance: f64) -> f64 {
    threshold - tolerance - ROUNDING * threshold.abs().max(1.0)
}

impl EnvSpec {
    /// The spaces of an environment called `name`, whose features are numbers with these bounds (smallest, largest) and steps of a
    /// hundredth of them, and that knows neither its best return nor who succeeds.
    pub fn of(name: &str, bounds: &[[f32; 2]], actions: &[&str]) -> Self {
        Self {
            name: name.into(),
            element: Element::F32,
            shape: Vec::new(),
            low: bounds.iter().map(|[low, _]| *low).collect(),
            high: bounds.iter().map(|[_, high]| *high).collect(),
            scale: bounds.iter().map(|[low, high]| (high - low) / 100.0).collect(),
            integral: false,
            categories: Vec::new(),
            velocities: Vec::new(),
            actions: actions.iter().map(ToString::to_string).collect(),
            best_return: None,
            threshold: None,
            goal_bonus: 0.0,
            defines_success: false,
        }
    }

    /// Number of features in an observation.
    pub fn obs_dim(&self) -> usize {
        self.low.len()
    }

    /// The kind of its states, as they are stored and sent.
    pub fn row(&self) -> RowKind {
        RowKind { dim: self.obs_dim(), element: self.element }
    }

    /// Number of discrete actions.
    pub fn n_actions(&self) -> usize {
        self.actions.len()
    }

    /// The same where each observation is followed by a goal, a state like itself.
    pub fn with_goals(&self) -> Self {
        let twice = |values: &[f32]| [values, values].concat();
        let both = |features: &[usize]| -> Vec<usize> {
            let goals = features.iter().map(|&feature| feature + self.obs_dim());
            features.iter().copied().chain(goals).collect()
        };
        Self {
            // The mentor's states may have other numbers, and two arrays are not one.
            element: Element::F32,
            shape: Vec::new(),
            low: twice(&self.low),
            high: twice(&self.high),
            scale: twice(&self.scale),
            categories: both(&self.categories),
            velocities: both(&self.velocities),
            ..self.clone()
        }
    }

    /// The spaces of which [`EnvSpec::with_goals`] are these.
    pub fn without_goals(&self) -> Self {
        let dim = self.obs_dim() / 2;
        let own = |features: &[usize]| features.iter().copied().filter(|&feature| feature < dim).collect();
        Self {
            shape: Vec::new(),
            low: self.low[..dim].to_vec(),
            high: self.high[..dim].to_vec(),
            scale: self.scale[..dim].to_vec(),
            categories: own(&self.categories),
            velocities: own(&self.velocities),
            ..self.clone()
        }
    }

    /// Checks all that the other processes rely on.
    pub fn validate(&self) -> Result<(), SpaceError> {
        let dim = self.obs_dim();
        if dim == 0 || dim > MAX_OBS_DIM || self.high.len() != dim || self.scale.len() != dim {
            return Err(SpaceError::ObsDim { name: self.name.clone(), dim });
        }
        let numbers = self.shape.iter().try_fold(1usize, |all, &side| all.checked_mul(side));
        if !self.shape.is_empty() && numbers != Some(dim) {
            return Err(SpaceError::Shape { name: self.name.clone(), shape: self.shape.clone(), dim });
        }
        if !(2..=MAX_ACTIONS).contains(&self.n_actions()) {
            return Err(SpaceError::Actions { name: self.name.clone(), n: self.n_actions() });
        }
        let whole = |&i: &usize| i < dim && self.low[i].fract() == 0.0 && self.high[i].fract() == 0.0;
        if !self.categories.is_sorted_by(|a, b| a < b) || !self.categories.iter().all(whole) {
            let categories = self.categories.clone();
            return Err(SpaceError::Categories { name: self.name.clone(), categories, dim });
        }
        let ascending = self.velocities.is_sorted_by(|a, b| a < b);
        if !ascending || self.velocities.last().is_some_and(|&last| last >= dim) {
            let velocities = self.velocities.clone();
            return Err(SpaceError::Velocities { name: self.name.clone(), velocities, dim });
        }
        for (index, ((&low, &high), &scale)) in self.low.iter().zip(&self.high).zip(&self.scale).enumerate() {
            let sound = low.is_finite() && high.is_finite() && scale.is_finite() && low < high && scale > 0.0;
            if !sound {
                return Err(SpaceError::Feature { name: self.name.clone(), index, low, high, scale });
            }
        }
        Ok(())
    }
}
