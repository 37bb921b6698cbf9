//! What π(a | s, g) sees, and what it makes of its network's outputs.
//!
//! The input is the observer's state, encoded as for the Q-network, and behind it the way to the goal: g - s, feature by
//! feature, in units of the features' scales. Only chosen features of a goal count, such as positions: velocities of a
//! body that is built otherwise would ask for what the observer cannot do. A goal is given by its way rather than by its
//! place, so that what is learnt in one place helps in another. Categories have no way between them: that of the goal is given
//! itself, one-hot.

use crate::similarity::metric::APART;
use trestle_proto::config;
use trestle_proto::space::EnvSpec;
use trestle_qnet::Encoding;

/// The scale of each feature in the lengths of learned bridges: `mentor.scale`, or else that of the environment.
pub(super) fn scales<'a>(mentor: &config::Mentor, spec: &'a EnvSpec) -> std::borrow::Cow<'a, [f32]> {
    match mentor.scale.len() == spec.obs_dim() {
        true => mentor.scale.iter().map(|&scale| scale as f32).collect(),
        false => spec.scale.as_slice().into(),
    }
}

/// How a state and a goal become the input of π's network.
#[derive(Clone, Debug, PartialEq)]
pub struct Goal {
    encoding: Encoding,
    /// Features that a goal consists of, ascending.
    features: Vec<usize>,
    /// Their scales.
    scale: Vec<f32>,
    /// Of each that is a category: the number of the first, and how many there are.
    categories: Vec<Option<(f32, usize)>>,
}

impl Goal {
    /// Goals of `features` (each below the number of features of an observation), `scale` being those of all features, none
    /// of which is a category.
    pub fn new(encoding: Encoding, features: &[usize], scale: &[f32]) -> Self {
        let scale = features.iter().map(|&f| scale[f]).collect();
        Self { encoding, features: features.to_vec(), scale, categories: vec![None; features.len()] }
    }

    /// The same where features are the categories of `spec`, each of as many as `sizes` says, which has a number for each feature.
    #[must_use]
    pub fn with_categories(mut self, spec: &EnvSpec, sizes: &[usize]) -> Self {
        for ((category, scale), &f) in self.categories.iter_mut().zip(&mut self.scale).zip(&self.features) {
            if spec.categories.contains(&f) {
                *category = Some((spec.low[f], sizes[f]));
                // As whitened features are: equal or different, never near.
                *scale = 1.0 / APART;
            }
        }
        self
    }

    /// Numbers of the input.
    pub fn input_dim(&self) -> usize {
        let way = self.categories.iter().map(|category| category.map_or(1, |(_, size)| size));
        self.encoding.input_dim() + way.sum::<usize>()
    }

    /// Features of a goal.
    pub fn dim(&self) -> usize {
        self.features.len()
    }

    /// The place of `state`, a whole one, among goals: its chosen features in units of their scales, appended to `out`. A category
    /// is its number times [`APART`].
    pub fn place(&self, state: &[f32], out: &mut Vec<f32>) {
        out.extend(self.features.iter().zip(&self.scale).map(|(&f, scale)| state[f] / scale));
    }

    /// Writes the input for `state`, a whole one, and the place of a goal to `out` (`[input_dim]`).
    ///
    /// # Panics
    /// If a slice has another length.
    pub fn encode(&self, state: &[f32], goal: &[f32], out: &mut [f32]) {
        let (own, mut way) = out.split_at_mut(self.encoding.input_dim());
        self.encoding.encode(state, own);
        let features = self.features.iter().zip(&self.scale).zip(&self.categories);
        for (((&f, scale), category), goal) in features.zip(goal) {
            let (out, rest) = way.split_at_mut(category.map_or(1, |(_, size)| size));
            way = rest;
            match category {
                None => out[0] = goal - state[f] / scale,
                Some((first, size)) => {
                    out.fill(0.0);
                    out[((goal * scale - first) as usize).min(size - 1)] = 1.0;
                }
            }
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::similarity::metric::{DIFFERENT, kl};
    use trestle_proto::row::Element;

    #[test]
    fn categories_are_given_themselves_and_never_near() {
        let spec = EnvSpec {
            element: Element::F32,
            shape: Vec::new(),
            low: vec![0.0, 2.0],
            high: vec![9.0, 4.0],
            scale: vec![0.5, 1.0],
            categories: vec![1],
            velocities: Vec::new(),
            ..crate::testing::spec()
        };
        let encoding = Encoding::Scale { low: vec![0.0; 2], high: vec![10.0; 2] };
        let goal = Goal::new(encoding, &[0, 1], &spec.scale).with_categories(&spec, &[10, 3]);
        assert_eq!((goal.dim(), goal.input_dim()), (2, 2 + 1 + 3));
        let place = |state: &[f32]| {
            let mut out = Vec::new();
            goal.place(state, &mut out);
            out
        };
        let mut input = [9.0; 6];
        for (category, expected) in [(2.0, [1.0, 0.0, 0.0]), (3.0, [0.0, 1.0, 0.0]), (4.0, [0.0, 0.0, 1.0])] {
            goal.encode(&[5.0, 3.0], &place(&[6.0, category]), &mut input);
            assert_eq!(input[2], 2.0);
            assert_eq!(input[3..], expected);
        }
        assert!(kl(&place(&[5.0, 2.0]), &place(&[5.0, 3.0])) >= DIFFERENT);
    }
}
