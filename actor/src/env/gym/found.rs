//! What is found when an environment is made before a run. Python writes it (`deploy/python/python/trestle/_gym.py`), and every
//! process of the run reads it.

use super::GymError;
use serde::{Deserialize, Serialize};
use trestle_proto::row::Element;
use trestle_proto::space::EnvSpec;

/// An environment as it was found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// Version of Trestle's package, and the build that it is of.
    pub version: String,
    /// See [`build`](crate::env::build).
    pub build: String,
    /// The Python that ran it, and its version.
    pub executable: String,
    /// Version of Python.
    pub python: String,
    /// Version of Gymnasium.
    pub gymnasium: String,
    /// Name for people.
    pub name: String,
    /// The directory where it was found, in which its modules may lie; none in runs that did not keep it.
    #[serde(default)]
    pub directory: Option<String>,
    /// The space of observations, as the host takes it.
    pub space: serde_json::Value,
    /// The features that the agent observes.
    pub features: Features,
    /// The actions that the agent has.
    pub actions: Actions,
    /// `reward_threshold` of the environment's specification.
    pub threshold: Option<f64>,
    /// Whether it tells which episodes succeed, by `info["is_success"]`.
    #[serde(default)]
    pub success: bool,
    /// How two episodes with the same seed and actions differed, if they did.
    pub difference: Option<String>,
    /// What is odd about it.
    pub warnings: Vec<String>,
}

/// The features that the agent observes, in their order; every list has an entry for each.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Features {
    /// Names.
    pub names: Vec<String>,
    /// Places in the flat observation.
    pub places: Vec<usize>,
    /// Bounds of the space, where they are finite.
    pub bounds: Vec<[Option<f64>; 2]>,
    /// The range that the network's input is scaled by.
    pub range: Vec<[f64; 2]>,
    /// How far a step goes, the deviation of the state distance.
    pub step: Vec<f64>,
    /// Features that are categories, ascending.
    pub categories: Vec<usize>,
    /// Whether all of them are whole numbers.
    pub integral: bool,
    /// The type that holds each of them: one byte where their spaces say so.
    pub element: Element,
    /// Shape of the one array that they are, whole and in its order; empty where they are none.
    pub shape: Vec<usize>,
}

impl Features {
    /// Scales the network's input by `states`, row-major: to twice their range, around its middle. A category, and a feature in
    /// which all states are equal, stays as it is.
    pub(super) fn spread_over(&mut self, states: &[f32]) {
        let dim = self.range.len();
        for (feature, range) in self.range.iter_mut().enumerate() {
            let values = states.iter().skip(feature).step_by(dim);
            let (low, high) =
                values.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &x| (low.min(x), high.max(x)));
            if low < high && !self.categories.contains(&feature) {
                let (middle, width) =
                    ((f64::from(low) + f64::from(high)) / 2.0, f64::from(high) - f64::from(low));
                *range = [middle - width, middle + width].map(|x| f64::from(x as f32));
            }
        }
    }
}

/// The actions that the agent has, in their order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Actions {
    /// Names.
    pub names: Vec<String>,
    /// Type of a value: `int`, or the dtype of an array.
    pub dtype: String,
    /// What the environment gets: a number, or an array's numbers.
    pub values: Vec<serde_json::Value>,
    /// Shape of an array; empty for a number.
    pub shape: Vec<usize>,
}

impl Found {
    /// Reads what [`Found::to_json`] wrote.
    ///
    /// # Errors
    /// Text of another form.
    pub fn parse(text: &str) -> Result<Self, GymError> {
        serde_json::from_str(text).map_err(|error| GymError::Found(error.to_string()))
    }

    /// The text for a configuration.
    ///
    /// # Errors
    /// Numbers that JSON does not have.
    pub fn to_json(&self) -> Result<String, GymError> {
        serde_json::to_string(self).map_err(|error| GymError::Found(error.to_string()))
    }

    /// The environment's spaces.
    pub fn spec(&self) -> EnvSpec {
        let f = &self.features;
        EnvSpec {
            name: format!("gym {}", self.name),
            element: f.element,
            shape: f.shape.clone(),
            low: f.range.iter().map(|range| range[0] as f32).collect(),
            high: f.range.iter().map(|range| range[1] as f32).collect(),
            scale: f.step.iter().map(|&step| step as f32).collect(),
            integral: f.integral,
            categories: f.categories.clone(),
            velocities: Vec::new(),
            actions: self.actions.names.clone(),
            best_return: None,
            threshold: self.threshold,
            goal_bonus: 0.0,
            defines_success: self.success,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_spread_over_what_varies_and_is_a_number() {
        let mut features = Features {
            names: ["a", "b", "c"].map(String::from).to_vec(),
            places: vec![0, 1, 2],
            bounds: vec![[None; 2]; 3],
            range: vec![[-9.0, 9.0], [-1.0, 1.0], [0.0, 4.0]],
            step: vec![1.0; 3],
            categories: vec![2],
            integral: false,
            element: Element::F32,
            shape: vec![3],
        };
        let states = [1.0, 5.0, 0.0, 3.0, 5.0, 1.0, 2.0, 5.0, 2.0];
        features.spread_over(&states);
        let expected = vec![[0.0, 4.0], [-1.0, 1.0], [0.0, 4.0]];
        assert_eq!(features.range, expected);
        features.spread_over(&states);
        assert_eq!(features.range, expected);
        features.spread_over(&[]);
        assert_eq!(features.range, expected);
    }
}
