//! What π(a | s, g) sees, and what it makes of its network's outputs.
//!
//! The input is the observer's state, encoded as for the Q-network, and behind it the way to the goal: g - s, feature by
//! feature, in units of the environment's scales. Only chosen features of a goal count, such as positions: velocities of a
//! body that is built otherwise would ask for what the observer cannot do. A goal is given by its way rather than by its
//! place, so that what is learnt in one place helps in another.

use trestle_qnet::Encoding;

/// How a state and a goal become the input of π's network.
#[derive(Clone, Debug, PartialEq)]
pub struct Goal {
    encoding: Encoding,
    /// Features that a goal consists of, ascending.
    features: Vec<usize>,
    /// Their scales.
    scale: Vec<f32>,
}

impl Goal {
    /// Goals of `features` (each below the number of features of an observation), `scale` being those of all features.
    pub fn new(encoding: Encoding, features: &[usize], scale: &[f32]) -> Self {
        Self { encoding, features: features.to_vec(), scale: features.iter().map(|&f| scale[f]).collect() }
    }

    /// Numbers of the input.
    pub fn input_dim(&self) -> usize {
        self.encoding.input_dim() + self.features.len()
    }

    /// Features of a goal.
    pub fn dim(&self) -> usize {
        self.features.len()
    }

    /// The place of `state`, a whole one, among goals: its chosen features in units of their scales, appended to `out`.
    pub fn place(&self, state: &[f32], out: &mut Vec<f32>) {
        out.extend(self.features.iter().zip(&self.scale).map(|(&f, scale)| state[f] / scale));
    }

    /// Writes the input for `state`, a whole one, and the place of a goal to `out` (`[input_dim]`).
    ///
    /// # Panics
    /// If a slice has another length.
    pub fn encode(&self, state: &[f32], goal: &[f32], out: &mut [f32]) {
        let (own, way) = out.split_at_mut(self.encoding.input_dim());
        self.encoding.encode(state, own);
        for (((out, &f), scale), goal) in way.iter_mut().zip(&self.features).zip(&self.scale).zip(goal) {
            *out = goal - state[f] / scale;
        }
    }
}

/// Turns the outputs of one row into probabilities, in place. The same bits on every machine.
pub fn softmax(row: &mut [f32]) {
    let largest = row.iter().fold(f32::NEG_INFINITY, |max, &x| max.max(x));
    let mut sum = 0.0;
    for x in row.iter_mut() {
        *x = libm::expf(*x - largest);
        sum += *x;
    }
    row.iter_mut().for_each(|x| *x /= sum);
}

/// The action at which the sum of `probabilities` passes `u`, a number in [0, 1); the last one where rounding leaves the
/// sum below it.
pub fn draw(probabilities: &[f32], u: f64) -> usize {
    let mut sum = 0.0;
    let passed = probabilities.iter().position(|&p| {
        sum += f64::from(p);
        u < sum
    });
    passed.unwrap_or(probabilities.len().saturating_sub(1))
}
