//! Ten gradient steps of DQN against values that PyTorch computed; see `tests/golden/dqn_step.py` and, for convolutions,
//! `tests/golden/conv_step.py`.
//!
//! Not a hundred steps: under Adam the direction of a tiny gradient decides as much as that of a large one,
//! and differences of one rounding error grow.
#![allow(clippy::unwrap_used)]

use serde_json::Value;
use trestle_qnet::{
    Adam, AdamConfig, Encoding, Grid, Isa, Kernels, Layout, Loss, QNetwork, RowGrad, Threads, Workspace,
    argmax, autodiff, backward, clip_grad_norm, forward, forward_train,
};

const GOLDEN: &str = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/dqn_step.json"));

fn floats(value: &Value) -> Vec<f32> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap() as f32).collect()
}

struct Batch {
    obs: Vec<f32>,
    actions: Vec<u32>,
    rewards: Vec<f32>,
    next_obs: Vec<f32>,
    terminals: Vec<bool>,
}

impl Batch {
    fn new(value: &Value) -> Batch {
        let array = |name: &str| value[name].as_array().unwrap();
        Batch {
            obs: floats(&value["obs"]),
            actions: array("action").iter().map(|x| x.as_u64().unwrap() as u32).collect(),
            rewards: floats(&value["reward"]),
            next_obs: floats(&value["next_obs"]),
            terminals: array("terminal").iter().map(|x| x.as_bool().unwrap()).collect(),
        }
    }
}

/// The targets of a batch: plain or Double DQN.
fn targets(network: &QNetwork, batch: &Batch, gamma: f32, double: bool, ws: &mut Workspace) -> Vec<f32> {
    let layout = network.layout();
    let (rows, n) = (batch.actions.len(), layout.output());
    let (mut online_q, mut target_q) = (vec![0.0; rows * n], vec![0.0; rows * n]);
    network
        .with_params(|online, target| {
            forward(layout, online, &batch.next_obs, rows, ws, &mut online_q);
            forward(layout, target, &batch.next_obs, rows, ws, &mut target_q);
        })
        .unwrap();
    let target = |r: usize| {
        let of_row = r * n..(r + 1) * n;
        let chosen = argmax(if double { &online_q[of_row.clone()] } else { &target_q[of_row.clone()] });
        let bootstrap = if batch.terminals[r] { 0.0 } else { target_q[of_row.start + chosen] };
        batch.rewards[r] + gamma * bootstrap
    };
    (0..rows).map(target).collect()
}

#[track_caller]
fn assert_close(got: &[f32], expected: &[f32], tolerance: f32, what: &str) {
    assert_eq!(got.len(), expected.len(), "{what}");
    for (at, (got, expected)) in got.iter().zip(expected).enumerate() {
        let bound = tolerance * expected.abs().max(1.0);
        assert!((got - expected).abs() <= bound, "{what}, number {at}: {got} instead of {expected}");
    }
}

/// Runs one case; `candle` says which side takes the gradients.
fn check(case: &Value, golden: &Value, kernels: Kernels, candle: bool) {
    let sizes: Vec<usize> =
        golden["sizes"].as_array().unwrap().iter().map(|x| x.as_u64().unwrap() as usize).collect();
    let layout = Layout::new(&sizes).unwrap();
    let gamma = golden["gamma"].as_f64().unwrap() as f32;
    let config = AdamConfig { lr: golden["lr"].as_f64().unwrap(), ..AdamConfig::default() };
    let loss = if case["loss"] == "huber" { Loss::Huber { delta: 1.0 } } else { Loss::Squared };
    let double = case["double"].as_bool().unwrap();
    let max_norm = case["max_norm"].as_f64();
    let name = format!("{} on {} (candle: {candle})", case["name"], kernels.isa());

    let rows = golden["rows"].as_u64().unwrap() as usize;
    let mut network = QNetwork::new(layout.clone(), &floats(&golden["online"])).unwrap();
    network.load(&floats(&golden["online"]), &floats(&golden["target"])).unwrap();
    let mut ws = Workspace::with_kernels(&layout, rows, kernels);
    let mut adam = Adam::new(layout.n_params());
    let mut grad = vec![0.0; layout.n_params()];
    let mut q = vec![0.0; rows * layout.output()];
    let (mut losses, mut norms) = (Vec::new(), Vec::new());
    for (step, batch) in golden["batches"].as_array().unwrap().iter().map(Batch::new).enumerate() {
        let y = targets(&network, &batch, gamma, double, &mut ws);
        let scale = 1.0 / rows as f32;
        if candle {
            let weights = vec![1.0; rows];
            let samples = autodiff::Samples {
                x: &batch.obs,
                actions: &batch.actions,
                targets: &y,
                weights: &weights,
                scale,
            };
            let (total, gradient) =
                autodiff::loss_and_gradient(&layout, network.online(), &samples, loss).unwrap();
            losses.push(total);
            grad = gradient;
        }
        network
            .update(|params| {
                if !candle {
                    forward_train(&layout, params, &batch.obs, rows, &mut ws, &mut q);
                    let mut total = 0.0;
                    let mut term = |r: usize| {
                        let action = batch.actions[r];
                        let q = q[r * layout.output() + action as usize];
                        total += scale * loss.value(q, y[r]);
                        RowGrad { row: r as u32, action, dq: scale * loss.derivative(q, y[r]) }
                    };
                    let terms: Vec<RowGrad> = (0..rows).map(&mut term).collect();
                    losses.push(total);
                    backward(&layout, params, &mut ws, &terms, &mut grad);
                }
                if let Some(max_norm) = max_norm {
                    norms.push(clip_grad_norm(kernels, &mut grad, max_norm as f32));
                }
                adam.step(&config, kernels, &Threads::default(), params, &grad);
            })
            .unwrap();
        let params = network.online().to_vec1::<f32>().unwrap();
        match step + 1 {
            1 => assert_close(&params, &floats(&case["params_after_1"]), 1e-6, &name),
            10 => assert_close(&params, &floats(&case["params_after_10"]), 1e-5, &name),
            _ => {}
        }
    }
    assert_eq!(adam.step, 10, "{name}");
    assert_close(&losses, &floats(&case["losses"]), 1e-5, &name);
    assert_close(&norms, &floats(&case["norms"]), 1e-5, &name);
}

#[test]
fn dqn_steps_equal_those_of_pytorch() {
    let golden: Value = serde_json::from_str(GOLDEN).unwrap();
    let cases = golden["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 3);
    for case in cases {
        for isa in Isa::available() {
            check(case, &golden, Kernels::new(isa).unwrap(), false);
        }
        check(case, &golden, Kernels::detect(), true);
    }
}

const CONV: &str = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/conv_step.json"));

fn whole(value: &Value) -> Vec<usize> {
    value.as_array().unwrap().iter().map(|x| x.as_u64().unwrap() as usize).collect()
}

fn conv_layout(case: &Value) -> Layout {
    let [height, width, channels] = whole(&case["grid"])[..] else { panic!("{}", case["grid"]) };
    let grid = Grid { height, width, channels, channels_first: case["channels_first"].as_bool().unwrap() };
    let convs = case["conv"].as_array().unwrap().iter().map(whole);
    let convs: Vec<_> = convs.map(|conv| (conv[0], conv[1], conv[2])).collect();
    Layout::with_conv(grid, &convs, &whole(&case["dense"])).unwrap()
}

/// Runs one case with convolutions; without kernels, candle takes the gradients.
fn check_conv(case: &Value, golden: &Value, kernels: Option<Kernels>) {
    let layout = conv_layout(case);
    let rows = golden["rows"].as_u64().unwrap() as usize;
    let config = AdamConfig { lr: golden["lr"].as_f64().unwrap(), ..AdamConfig::default() };
    let (loss, scale) = (Loss::Huber { delta: 1.0 }, 1.0 / rows as f32);
    let name = format!("{} on {:?}", case["name"], kernels.map(Kernels::isa));
    let encoding = Encoding::Scale { low: vec![0.0; layout.input()], high: vec![255.0; layout.input()] };

    let params = floats(&case["params"]);
    let mut network = QNetwork::new(layout.clone(), &params).unwrap();
    let own = kernels.unwrap_or_default();
    let mut ws = Workspace::with_kernels(&layout, rows, own);
    let mut adam = Adam::new(layout.n_params());
    let (mut grad, mut q) = (vec![0.0; layout.n_params()], vec![0.0; rows * layout.output()]);
    let mut losses = Vec::new();
    for (step, batch) in case["batches"].as_array().unwrap().iter().enumerate() {
        let bytes = floats(&batch["x"]);
        let mut x = vec![0.0; bytes.len()];
        encoding.encode_batch(&bytes, rows, &mut x);
        let actions: Vec<u32> = whole(&batch["action"]).into_iter().map(|action| action as u32).collect();
        let targets = floats(&batch["target"]);
        let weights = vec![1.0; rows];
        if kernels.is_none() {
            let samples =
                autodiff::Samples { x: &x, actions: &actions, targets: &targets, weights: &weights, scale };
            let (total, gradient) =
                autodiff::loss_and_gradient(&layout, network.online(), &samples, loss).unwrap();
            losses.push(total);
            grad = gradient;
        }
        network
            .update(|params| {
                if kernels.is_some() {
                    forward_train(&layout, params, &x, rows, &mut ws, &mut q);
                    let chosen: Vec<f32> =
                        (0..rows).map(|r| q[r * layout.output() + actions[r] as usize]).collect();
                    if step == 0 {
                        assert_close(&chosen, &floats(&case["q"]), 1e-5, &name);
                    }
                    losses.push((0..rows).map(|r| scale * loss.value(chosen[r], targets[r])).sum());
                    let term = |r: usize| {
                        let dq = scale * loss.derivative(chosen[r], targets[r]);
                        RowGrad { row: r as u32, action: actions[r], dq }
                    };
                    let terms: Vec<RowGrad> = (0..rows).map(term).collect();
                    backward(&layout, params, &mut ws, &terms, &mut grad);
                }
                adam.step(&config, own, &Threads::default(), params, &grad);
            })
            .unwrap();
        let params = network.online().to_vec1::<f32>().unwrap();
        match step + 1 {
            1 => assert_close(&params, &floats(&case["params_after_1"]), 1e-6, &name),
            10 => assert_close(&params, &floats(&case["params_after_10"]), 1e-4, &name),
            _ => {}
        }
    }
    assert_close(&losses, &floats(&case["losses"]), 1e-4, &name);
}

#[test]
fn steps_with_convolutions_equal_those_of_pytorch() {
    let golden: Value = serde_json::from_str(CONV).unwrap();
    let cases = golden["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 3);
    for case in cases {
        for isa in Isa::available() {
            check_conv(case, &golden, Some(Kernels::new(isa).unwrap()));
        }
        check_conv(case, &golden, None);
    }
}
