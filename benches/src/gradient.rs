//! A network with a batch of samples, and one gradient step of DQN or DIIQN on it.

use anyhow::Result;
use trestle_algorithm::losses::MentorKind;
use trestle_algorithm::selection::{self, Candidate, Need, Own, Rule};
use trestle_proto::config::Mentor;
use trestle_proto::rng::{Purpose, mix, stream};
use trestle_qnet::{
    Adam, AdamConfig, AlignedBuffer, Kernels, Layout, Loss, QNetwork, RowGrad, Threads, Workspace, argmax,
    backward, forward, forward_train, init,
};

const GAMMA: f32 = 0.99;

/// All that a gradient step of DQN or DIIQN touches.
pub struct GradientStep {
    layout: Layout,
    kernels: Kernels,
    network: QNetwork,
    rows: usize,
    /// Chooses between a sample's own action and its mentor's; none for DQN.
    rule: Option<Box<dyn Rule>>,
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
    /// A fresh network of `layout`, and `rows` samples with features from -1 to 1; with `mentor`, DIIQN's, each of which has
    /// a similar mentor transition.
    pub fn new(layout: Layout, rows: usize, mentor: bool, kernels: Kernels) -> Result<Self> {
        let params = init(&layout, &mut stream(1, Purpose::Weights, 0));
        let forward_rows = if mentor { 2 * rows } else { rows };
        let features = |seed: u64, rows: usize| -> Vec<f32> {
            let word = |at: u64| mix(seed << 32 | at) >> 40;
            (0..rows * layout.input()).map(|at| word(at as u64) as f32 / (1 << 23) as f32 - 1.0).collect()
        };
        let values = |rows: usize| vec![0.0; rows * layout.output()];
        let action = |row: usize| row as u32 % layout.output() as u32;
        let config = Mentor { selection: "min-distance".into(), ..Mentor::default() };
        let need = Need { mentor: &config, mentor_len: rows, replay: rows };
        let mut rule = if mentor { Some(selection::make(&need)?) } else { None };
        (0..rows).for_each(|slot| rule.iter_mut().for_each(|rule| rule.stored(slot)));
        Ok(Self {
            kernels,
            rows,
            rule,
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

    /// The same, with `threads` that share the work.
    pub fn with_threads(mut self, threads: Threads) -> Self {
        self.workspace = self.workspace.with_threads(threads);
        self
    }

    /// Rows of the online network's forward pass.
    pub fn forward_rows(&self) -> usize {
        self.rows * (1 + usize::from(self.rule.is_some()))
    }

    /// One step as the learner takes it: the online network's values (of the mentor's states, too), the choice between
    /// both losses, the target network's values, Huber's derivative, the gradient, Adam.
    pub fn run(&mut self) -> Result<()> {
        let forward_rows = self.forward_rows();
        let Self { layout, kernels, network, rows, rule, workspace, adam, x, next, q, q_target, terms, grad } =
            self;
        let (loss, scale, n) = (Loss::Huber { delta: 1.0 }, 1.0 / *rows as f32, layout.output());
        network.with_params(|online, target| {
            forward_train(layout, online, x, forward_rows, workspace, q);
            forward(layout, target, next, *rows, workspace, q_target);
        })?;
        if let Some(rule) = rule {
            for (row, term) in terms.iter_mut().enumerate() {
                let action = term.action;
                let own = Own { slot: row, action, q: q[row * n + action as usize] };
                let of_s_m = &q[(*rows + row) * n..][..n];
                let mentor = Candidate { j: row, kind: MentorKind::Feasible, action, e_kl: 0.0, q: of_s_m };
                term.row = if rule.weight(&own, &mentor) > 0.0 { *rows + row } else { row } as u32;
                rule.trained(&own, Some(&mentor));
            }
        }
        for (of_next, term) in q_target.chunks_exact(n).zip(terms.iter_mut()) {
            let target = GAMMA * of_next[argmax(of_next)] - 0.04;
            term.dq = scale * loss.derivative(q[term.row as usize * n + term.action as usize], target);
        }
        network.update(|params| {
            backward(layout, params, workspace, terms, grad);
            adam.step(&AdamConfig::default(), *kernels, workspace.threads(), params, grad);
        })?;
        Ok(())
    }
}
