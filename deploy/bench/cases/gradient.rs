//! A network with a batch of samples, and one gradient step on it.

use anyhow::Result;
use trestle_proto::rng::{Purpose, mix, stream};
use trestle_qnet::{
    Adam, AdamConfig, Kernels, Layout, Loss, QNetwork, RowGrad, Workspace, argmax, backward, forward,
    forward_train, init,
};

const GAMMA: f32 = 0.99;

/// All that a gradient step of DQN touches.
pub(crate) struct GradientStep {
    layout: Layout,
    kernels: Kernels,
    network: QNetwork,
    rows: usize,
    workspace: Workspace,
    adam: Adam,
    x: Vec<f32>,
    next: Vec<f32>,
    q: Vec<f32>,
    q_target: Vec<f32>,
    terms: Vec<RowGrad>,
    grad: Vec<f32>,
}

impl GradientStep {
    /// A fresh network of `sizes` (input, hidden layers, output), and `rows` samples with features from -1 to 1.
    pub(crate) fn new(sizes: &[usize], rows: usize, kernels: Kernels) -> Result<Self> {
        let layout = Layout::new(sizes)?;
        let params = init(&layout, &mut stream(1, Purpose::Weights, 0));
        let features = |seed: u64| -> Vec<f32> {
            let word = |at: u64| mix(seed << 32 | at) >> 40;
            (0..rows * layout.input()).map(|at| word(at as u64) as f32 / (1 << 23) as f32 - 1.0).collect()
        };
        let values = || vec![0.0; rows * layout.output()];
        let action = |row: usize| row as u32 % layout.output() as u32;
        Ok(Self {
            kernels,
            rows,
            workspace: Workspace::with_kernels(&layout, rows, kernels),
            adam: Adam::new(layout.n_params()),
            x: features(1),
            next: features(2),
            q: values(),
            q_target: values(),
            terms: (0..rows).map(|row| RowGrad { row: row as u32, action: action(row), dq: 0.0 }).collect(),
            grad: vec![0.0; layout.n_params()],
            network: QNetwork::new(layout.clone(), &params)?,
            layout,
        })
    }

    /// One step as the learner takes it: the target network's values, the online network's, Huber's derivative,
    /// the gradient, Adam.
    pub(crate) fn run(&mut self) -> Result<()> {
        let Self { layout, kernels, network, rows, workspace, adam, x, next, q, q_target, terms, grad } =
            self;
        let (loss, scale) = (Loss::Huber { delta: 1.0 }, 1.0 / *rows as f32);
        network.with_params(|_, target| forward(layout, target, next, *rows, workspace, q_target))?;
        network.update(|params| {
            forward_train(layout, params, x, *rows, workspace, q);
            let n = layout.output();
            for (row, term) in terms.iter_mut().enumerate() {
                let of_next = &q_target[row * n..][..n];
                let target = GAMMA * of_next[argmax(of_next)] - 0.04;
                term.dq = scale * loss.derivative(q[row * n + term.action as usize], target);
            }
            backward(layout, params, workspace, terms, grad);
            adam.step(&AdamConfig::default(), *kernels, params, grad);
        })?;
        Ok(())
    }
}
