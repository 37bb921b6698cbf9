//! A trained network for other programs: its input's encoding and its layers, as tensors with names.

mod onnx;
mod protobuf;
mod tensors;

pub(crate) use onnx::model;
pub(crate) use tensors::file;

use trestle_proto::experiment::Experiment;
use trestle_proto::round::Round;
use trestle_qnet::{Conv, Encoding, Layer, Layout};

/// A network as it is exported.
pub(crate) struct Network {
    /// Name of the environment.
    pub(crate) env: String,
    /// The checkpoint's tick.
    pub(crate) tick: Round,
    /// Names of the features of an observation; none where they have no names.
    pub(crate) features: Vec<String>,
    /// Names of the actions, in the order of the values.
    pub(crate) actions: Vec<String>,
    /// Lower and upper bound of each feature.
    pub(crate) low: Vec<f32>,
    pub(crate) high: Vec<f32>,
    /// Number of categories of each feature; 0 for one that is scaled.
    pub(crate) categories: Vec<usize>,
    pub(crate) layers: Vec<Exported>,
}

/// A layer: `y = x W + b`, and a ReLU behind all but the last. A convolution is that at every position.
pub(crate) struct Exported {
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    /// `[inputs][outputs]`, row-major.
    pub(crate) weights: Vec<f32>,
    /// `[outputs]`
    pub(crate) bias: Vec<f32>,
    /// What it is a convolution of.
    pub(crate) conv: Option<Conv>,
}

impl Exported {
    /// Shape and numbers of the weights as PyTorch has them: `[outputs][inputs]`, or `[channels out][channels in][kernel][kernel]`.
    fn outputs_first(&self) -> (Vec<usize>, Vec<f32>) {
        let (inputs, outputs) = (self.inputs, self.outputs);
        let weight = |from: usize, to: usize| self.weights[from * outputs + to];
        let Some(Conv { grid, kernel, .. }) = self.conv else {
            let all = (0..outputs).flat_map(|to| (0..inputs).map(move |from| weight(from, to)));
            return (vec![outputs, inputs], all.collect());
        };
        let (channels, area) = (grid.channels, kernel * kernel);
        // The numbers under the kernel are in the order row, column, channel.
        let of = |to: usize| (0..inputs).map(move |at| weight(at % area * channels + at / area, to));
        (vec![outputs, channels, kernel, kernel], (0..outputs).flat_map(of).collect())
    }
}

impl Network {
    /// The network of `experiment` with the flat parameters `params`.
    pub(crate) fn new(
        experiment: &Experiment,
        tick: Round,
        features: Vec<String>,
        layout: &Layout,
        encoding: Encoding,
        params: &[f32],
    ) -> Self {
        let (low, high, categories) = match encoding {
            Encoding::Scale { low, high } => {
                let none = vec![0; low.len()];
                (low, high, none)
            }
            Encoding::OneHot { low, sizes } => {
                let high = low.iter().zip(&sizes).map(|(low, &size)| low + (size - 1) as f32).collect();
                (low, high, sizes)
            }
            Encoding::Mixed { low, high, sizes } => (low, high, sizes),
            // As it is: from -1..=1 onto itself.
            Encoding::Identity { dim } => (vec![-1.0; dim], vec![1.0; dim], vec![0; dim]),
        };
        let exported = |layer: &Layer| Exported {
            inputs: layer.inputs,
            outputs: layer.outputs,
            weights: params[layer.weights()].to_vec(),
            bias: params[layer.bias()].to_vec(),
            conv: layer.conv,
        };
        Self {
            env: experiment.spec.name.clone(),
            tick,
            features,
            actions: experiment.spec.actions.clone(),
            low,
            high,
            categories,
            layers: layout.layers().iter().map(exported).collect(),
        }
    }

    /// What the file says of the network, beside the tensors.
    fn metadata(&self) -> Vec<(String, String)> {
        let list = |names: &[String]| serde_json::Value::from(names.to_vec()).to_string();
        [
            ("program", format!("trestle {}", env!("CARGO_PKG_VERSION"))),
            ("environment", self.env.clone()),
            ("checkpoint", self.tick.to_string()),
            ("features", list(&self.features)),
            ("actions", list(&self.actions)),
        ]
        .map(|(key, value)| (key.to_string(), value))
        .to_vec()
    }
}
