//! A network with a batch of samples, and one gradient step of DQN or DIIQN on it.

use anyhow::Result;
use trestle_algorithm::losses::{Distances, min_distance};
use trestle_proto::rng::{Purpose, mix, stream};
use trestle_qnet::{
    Adam, AdamConfig, AlignedBuffer, Kernels, Layout, Loss, QNetwork, RowGrad, Workspace, argmax, backward,
    forward, forward_train, init,
};

const GAMMA: f32 = 0.99;

/// All that a gradient step of DQN or DIIQN touches.
pub struct GradientStep {
    layout: Layout,
    kernels: Kernels,
    network: QNetwork,
    rows: usize,
    /// Past Q-values of each sample's own action and of its mentor's; none for DQN.
    past: Vec<[f32; 2]>,
    workspace: Workspace,
    adam: Adam,
    x: Vec<f32>,
    next: Vec<f32>,
    q: Vec<f32>,
    q_target: Vec<f32>,
    terms: Vec<RowGrad>,
    grad: AlignedBuffer,
}

impl GradientStep {
    /// A fresh network of `sizes` (input, hidden layers, output), and `rows` samples with features from -1 to 1; with
    /// `mentor`, DIIQN's, each of which has a similar mentor transition.
    pub fn new(sizes: &[usize], rows: usize, mentor: bool, kernels: Kernels) -> Result<Self> {
        let layout = Layout::new(sizes)?;
        let params = init(&layout, &mut stream(1, Purpose::Weights, 0));
        let forward_rows = if mentor { 2 * rows } else { rows };
        let features = |seed: u64, rows: usize| -> Vec<f32> {
            let word = |at: u64| mix(seed << 32 | at) >> 40;
            (0..rows * layout.input()).map(|at| word(at as u64) as f32 / (1 << 23) as f32 - 1.0).collect()
        };
        let values = |rows: usize| vec![0.0; rows * layout.output()];
        let action = |row: usize| row as u32 % layout.output() as u32;
        Ok(Self {
            kernels,
            rows,
            past: vec![[0.0; 2]; forward_rows - rows],
            workspace: Workspace::with_kernels(&layout, forward_rows, kernels),
            adam: Adam::new(layout.n_params()),
            x: features(1, forward_rows),
            next: features(2, rows),
            q: values(forward_rows),
            q_target: values(rows),
            terms: (0..rows).map(|row| RowGrad { row: row as u32, action: action(row), dq: 0.0 }).collect(),
            grad: AlignedBuffer::new(layout.n_params()),
            network: QNetwork::new(layout.clone(), &params)?.with_kernels(kernels),
            layout,
        })
    }

    /// Rows of the online network's forward pass.
    pub fn forward_rows(&self) -> usize {
        self.rows + self.past.len()
    }

    /// One step as the learner takes it: the online network's values (of the mentor's states, too), the choice between
    /// both losses, the target network's values, Huber's derivative, the gradient, Adam.
    pub fn run(&mut self) -> Result<()> {
        let forward_rows = self.forward_rows();
        let Self { layout, kernels, network, rows, past, workspace, adam, x, next, q, q_target, terms, grad } =
            self;
        let (loss, scale, n) = (Loss::Huber { delta: 1.0 }, 1.0 / *rows as f32, layout.output());
        network.with_params(|online, target| {
            forward_train(layout, online, x, forward_rows, workspace, q);
            forward(layout, target, next, *rows, workspace, q_target);
        })?;
        for (row, past) in past.iter_mut().enumerate() {
            let action = terms[row].action as usize;
            let (q_o, q_m) = (q[row * n + action], q[(*rows + row) * n + action]);
            let mentor = min_distance(&Distances { q_o, past_o: past[0], q_m, past_m: past[1] });
            terms[row].row = if mentor { *rows + row } else { row } as u32;
            *past = [q_o, q_m];
        }
        for (of_next, term) in q_target.chunks_exact(n).zip(terms.iter_mut()) {
            let target = GAMMA * of_next[argmax(of_next)] - 0.04;
            term.dq = scale * loss.derivative(q[term.row as usize * n + term.action as usize], target);
        }
        network.update(|params| {
            backward(layout, params, workspace, terms, grad);
            adam.step(&AdamConfig::default(), *kernels, params, grad);
        })?;
        Ok(())
    }
}
