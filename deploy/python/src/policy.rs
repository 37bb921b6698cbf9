//! A trained policy: the network of a run's checkpoint, and the encoding of its input.

use pyo3::buffer::PyBuffer;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::path::PathBuf;
use trestle_learner::checkpoint;
use trestle_proto::config::Env;
use trestle_proto::round::Round;
use trestle_proto::rundir::RunDir;
use trestle_qnet::{Conv, Encoding, Layout, Workspace, forward, network_of};

/// Rows that are evaluated at a time.
const ROWS: usize = 256;

/// A layer as Python gets it.
type Part = (usize, usize, Vec<f32>, Vec<f32>, Option<(usize, usize, usize, usize, usize, bool)>);

/// The network of a checkpoint.
#[pyclass]
pub(crate) struct Policy {
    env: Env,
    layout: Layout,
    encoding: Encoding,
    weights: Vec<f32>,
    workspace: Workspace,
    tick: Round,
    actions: Vec<String>,
}

fn failed(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

#[pymethods]
impl Policy {
    /// The checkpoint of `tick` of the run in the directory `run`; the newest complete one without a tick.
    #[new]
    fn new(run: PathBuf, tick: Option<u64>) -> PyResult<Self> {
        let dir = RunDir::new(&run);
        let experiment = dir.read_plan().map_err(failed)?.experiment;
        let none = || PyValueError::new_err(format!("{} holds no such complete checkpoint", run.display()));
        let (tick, path) = match tick.map(Round::from) {
            None => checkpoint::newest_complete(dir.root()).map_err(failed)?.ok_or_else(none)?,
            Some(tick) if checkpoint::complete(dir.root()).map_err(failed)?.contains(&tick) => {
                (tick, checkpoint::directory(dir.root(), tick))
            }
            Some(_) => return Err(none()),
        };
        let (layout, encoding) = network_of(&experiment).map_err(failed)?;
        let weights = checkpoint::load_model(&path, &layout).map_err(failed)?;
        let workspace = Workspace::new(&layout, ROWS);
        let actions = experiment.spec.actions.clone();
        Ok(Self { env: experiment.config.env, layout, encoding, weights, workspace, tick, actions })
    }

    /// The checkpoint's tick.
    #[getter]
    fn tick(&self) -> u64 {
        self.tick.into()
    }

    /// Names of the actions, in their order.
    #[getter]
    fn actions(&self) -> Vec<String> {
        self.actions.clone()
    }

    /// Features of an observation.
    #[getter]
    fn features(&self) -> usize {
        self.encoding.observation_dim()
    }

    /// `env.name`.
    #[getter]
    fn env(&self) -> &str {
        &self.env.name
    }

    /// The environment's own settings, as JSON.
    fn settings(&self) -> PyResult<String> {
        serde_json::to_string(&self.env.own).map_err(failed)
    }

    /// How an observation becomes the network's input, as JSON.
    fn encoding(&self) -> PyResult<String> {
        serde_json::to_string(&self.encoding).map_err(failed)
    }

    /// Each layer's inputs, outputs, weights (`[inputs][outputs]`, row-major) and biases; of a convolution also height, width and
    /// channels of its input, kernel, stride, and whether the channels come first.
    fn layers(&self) -> Vec<Part> {
        let layer = |layer: &trestle_qnet::Layer| {
            let part = |range: std::ops::Range<usize>| self.weights[range].to_vec();
            let conv = layer.conv.map(|Conv { grid: g, kernel, stride }| {
                (g.height, g.width, g.channels, kernel, stride, g.channels_first)
            });
            (layer.inputs, layer.outputs, part(layer.weights()), part(layer.bias()), conv)
        };
        self.layout.layers().iter().map(layer).collect()
    }

    /// Values of every action in the observations `obs` (`float32`, `[rows][features]`, row-major), flat: `[rows][actions]`.
    fn q_values(&mut self, py: Python<'_>, obs: &Bound<'_, PyAny>) -> PyResult<Vec<f32>> {
        let obs = PyBuffer::<f32>::get(obs)?.to_vec(py)?;
        let (dim, input, n) =
            (self.encoding.observation_dim(), self.encoding.input_dim(), self.actions.len());
        if obs.len() % dim != 0 {
            return Err(PyValueError::new_err(format!(
                "{} numbers; accepted: {dim} for each row",
                obs.len()
            )));
        }
        let mut values = vec![0.0; obs.len() / dim * n];
        let mut x = vec![0.0; ROWS * input];
        for (obs, out) in obs.chunks(ROWS * dim).zip(values.chunks_mut(ROWS * n)) {
            let rows = obs.len() / dim;
            self.encoding.encode_batch(obs, rows, &mut x[..rows * input]);
            forward(&self.layout, &self.weights, &x[..rows * input], rows, &mut self.workspace, out);
        }
        Ok(values)
    }
}
