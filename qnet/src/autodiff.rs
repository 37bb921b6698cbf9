//! Values, loss and gradient by candle's automatic differentiation.
//!
//! It knows nothing of the kernels, so agreement of the two is evidence for both; it is also a backend of its
//! own for a learner that asks for it. It allocates freely and is an order of magnitude slower. candle asks
//! the environment for its number of threads on every matrix product: set `RAYON_NUM_THREADS=1` before the
//! first one, or small networks spend their time starting threads.

use candle_core::{D, Device, Result, Tensor, Var};
use candle_nn::{Linear, Module};

use crate::layout::{Conv, Grid, Layout};
use crate::loss::Loss;

/// A batch of samples whose targets are known.
#[derive(Clone, Copy, Debug)]
pub struct Samples<'a> {
    /// Network inputs, `[rows][input]`; `rows`, the length of `actions`, is at least 1.
    pub x: &'a [f32],
    /// The taken action of each row.
    pub actions: &'a [u32],
    /// The target of each row's Q-value.
    pub targets: &'a [f32],
    /// The weight of each row's loss.
    pub weights: &'a [f32],
    /// Factor of the whole loss: `1 / rows` for a mean.
    pub scale: f32,
}

/// Q-values `[rows][output]` of the inputs `x`, `[rows][input]`, under the flat parameters `params`,
/// `[n_params]`.
///
/// # Errors
/// Every error that candle reports, above all shapes that do not fit.
pub fn q_values(layout: &Layout, params: &Tensor, x: &Tensor) -> Result<Tensor> {
    let last = layout.layers().len() - 1;
    let mut x = x.clone();
    for (l, layer) in layout.layers().iter().enumerate() {
        let weights = params.narrow(0, layer.offset, layer.weights().len())?;
        let bias = params.narrow(0, layer.bias().start, layer.outputs)?;
        if let Some(conv) = layer.conv {
            x = convolved(&conv, &weights, &bias, &x)?.relu()?;
            continue;
        }
        // candle's `Linear` expects `[outputs][inputs]`: a transposed view of ours.
        let linear = Linear::new(weights.reshape((layer.inputs, layer.outputs))?.t()?, Some(bias));
        x = linear.forward(&x)?;
        if l < last {
            x = x.relu()?;
        }
    }
    Ok(x)
}

/// A convolution of `x`, `[rows][numbers of the grid]`, with flat `weights`, as `[rows][positions * channels]`.
fn convolved(conv: &Conv, weights: &Tensor, bias: &Tensor, x: &Tensor) -> Result<Tensor> {
    let (rows, Grid { height, width, channels, channels_first }) = (x.dim(0)?, conv.grid);
    // candle has the channels first, in the input as in the weights.
    let x = if channels_first {
        x.reshape((rows, channels, height, width))?
    } else {
        x.reshape((rows, height, width, channels))?.permute((0, 3, 1, 2))?.contiguous()?
    };
    // Without the rows and columns at the end that no position covers: candle's gradient cannot pad them in one dimension alone.
    let [down, across] = conv.places().map(|places| (places - 1) * conv.stride + conv.kernel);
    let x = x.narrow(2, 0, down)?.narrow(3, 0, across)?.contiguous()?;
    let outputs = bias.dim(0)?;
    let kernel = weights.reshape((conv.kernel, conv.kernel, channels, outputs))?.permute((3, 2, 0, 1))?;
    let y = x.conv2d(&kernel.contiguous()?, 0, conv.stride, 1, 1)?;
    let y = y.broadcast_add(&bias.reshape((1, outputs, 1, 1))?)?;
    y.permute((0, 2, 3, 1))?.contiguous()?.flatten_from(1)
}

/// `scale * sum over rows of weight * loss(Q(x, action), target)`, and its gradient with respect to `params`,
/// flat in the order of `layout`.
///
/// # Errors
/// Every error that candle reports, above all lengths that do not fit and actions that do not exist.
pub fn loss_and_gradient(
    layout: &Layout,
    params: &Var,
    samples: &Samples<'_>,
    loss: Loss,
) -> Result<(f32, Vec<f32>)> {
    let rows = samples.actions.len();
    let tensor = |values: &[f32]| Tensor::from_slice(values, rows, &Device::Cpu);
    let x = Tensor::from_slice(samples.x, (rows, layout.input()), &Device::Cpu)?;
    let actions = Tensor::from_slice(samples.actions, (rows, 1), &Device::Cpu)?;
    let q = q_values(layout, params, &x)?.gather(&actions, D::Minus1)?.squeeze(D::Minus1)?;
    let each = elementwise(loss, &q, &tensor(samples.targets)?)?;
    let total = ((each * tensor(samples.weights)?)?.sum_all()? * f64::from(samples.scale))?;
    let gradients = total.backward()?;
    let gradient = match gradients.get(params) {
        Some(gradient) => gradient.to_vec1()?,
        None => vec![0.0; layout.n_params()],
    };
    Ok((total.to_scalar()?, gradient))
}

/// [`Loss::value`] on tensors.
fn elementwise(loss: Loss, q: &Tensor, y: &Tensor) -> Result<Tensor> {
    let error = (q - y)?;
    match loss {
        Loss::Squared => error.sqr(),
        Loss::Huber { delta } => {
            let delta = f64::from(delta);
            let distance = error.abs()?;
            let line = ((&distance - 0.5 * delta)? * delta)?;
            distance.le(delta)?.where_cond(&(error.sqr()? * 0.5)?, &line)
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use proptest::prelude::*;
    use proptest::test_runner::TestCaseResult;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::backward::{RowGrad, backward};
    use crate::kernels::{Isa, Kernels};
    use crate::layout::init;
    use crate::layout::testing::{layouts, places};
    use crate::net::{Workspace, forward_train};

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn kernels_agree_with_autodiff(
            layout in layouts(70),
            rows in prop_oneof![6 => 1usize..40, 1 => 1usize..=1024],
            seed: u64,
            huber: bool,
        ) {
            check(&layout, rows, seed, huber)?;
        }
    }

    #[test]
    fn kernels_agree_with_autodiff_at_the_ends() {
        for (sizes, rows) in [
            (&[1usize, 1] as &[usize], 1),
            (&[2, 1, 1, 1, 1, 1, 1, 3], 7),
            (&[3, 300, 257, 17], 1024),
            (&[9, 1025, 2], 31),
        ] {
            let rejected = |result: &TestCaseResult| matches!(result, Err(TestCaseError::Reject(_)));
            let mut results = (0..20)
                .map(|seed| check(&Layout::new(sizes).unwrap(), rows, seed, true))
                .skip_while(rejected);
            results.next().unwrap().unwrap();
        }
    }

    /// Whether the input of some ReLU is so close to 0 that the last bits decide whether it passes a gradient on.
    fn at_a_kink(layout: &Layout, params: &[f32], x: &[f32]) -> bool {
        let hidden = &layout.layers()[..layout.layers().len() - 1];
        x.chunks_exact(layout.input()).any(|row| {
            let mut x: Vec<f64> = row.iter().map(|&x| f64::from(x)).collect();
            hidden.iter().any(|layer| {
                let (weights, bias) = (&params[layer.weights()], &params[layer.bias()]);
                let (bases, offsets) = places(layer);
                let mut sums = Vec::new();
                for base in bases {
                    let mut own: Vec<f64> = bias.iter().map(|&b| f64::from(b)).collect();
                    for (at, weights) in offsets.iter().zip(weights.chunks_exact(layer.outputs)) {
                        let x = x[base + at];
                        own.iter_mut().zip(weights).for_each(|(sum, &w)| *sum += x * f64::from(w));
                    }
                    sums.extend(own);
                }
                let at_a_kink = sums.iter().any(|sum| sum.abs() < 1e-6);
                x = sums.into_iter().map(|sum| sum.max(0.0)).collect();
                at_a_kink
            })
        })
    }

    /// Loss and gradient on every instruction set against autodiff's, and against each other bit by bit.
    fn check(layout: &Layout, rows: usize, seed: u64, huber: bool) -> TestCaseResult {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let params = init(layout, &mut rng);
        let mut floats = |n: usize| (0..n).map(|_| rng.random_range(-2.0f32..2.0)).collect::<Vec<f32>>();
        let (x, targets, weights) = (floats(rows * layout.input()), floats(rows), floats(rows));
        let actions: Vec<u32> = (0..rows).map(|_| rng.random_range(0..layout.output() as u32)).collect();
        if at_a_kink(layout, &params, &x) {
            return Err(TestCaseError::reject("a ReLU at its kink"));
        }
        let loss = if huber { Loss::Huber { delta: 0.7 } } else { Loss::Squared };
        let scale = 1.0 / rows as f32;

        let var = Var::from_slice(&params, params.len(), &Device::Cpu).unwrap();
        let samples = Samples { x: &x, actions: &actions, targets: &targets, weights: &weights, scale };
        let (expected_loss, expected) = loss_and_gradient(layout, &var, &samples, loss).unwrap();

        let mut found: Option<(f32, Vec<f32>)> = None;
        for isa in Isa::available() {
            let mut ws = Workspace::with_kernels(layout, rows, Kernels::new(isa).unwrap());
            let mut q = vec![0.0; rows * layout.output()];
            forward_train(layout, &params, &x, rows, &mut ws, &mut q);
            let mut total = 0.0;
            let terms: Vec<RowGrad> = (0..rows)
                .map(|r| {
                    let q = q[r * layout.output() + actions[r] as usize];
                    total += scale * weights[r] * loss.value(q, targets[r]);
                    let dq = scale * weights[r] * loss.derivative(q, targets[r]);
                    RowGrad { row: r as u32, action: actions[r], dq }
                })
                .collect();
            let mut grad = vec![f32::NAN; layout.n_params()];
            backward(layout, &params, &mut ws, &terms, &mut grad);

            let close = (total - expected_loss).abs() < 1e-4 * (1.0 + total.abs());
            prop_assert!(close, "{}: {} {}", isa, total, expected_loss);
            let largest = expected.iter().fold(1e-3f32, |max, g| max.max(g.abs()));
            for (at, (got, expected)) in grad.iter().zip(&expected).enumerate() {
                prop_assert!((got - expected).abs() < 1e-4 * largest, "{} {}: {} {}", isa, at, got, expected);
            }
            let first = found.get_or_insert_with(|| (total, grad.clone()));
            let bits = |x: &[f32]| x.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
            prop_assert_eq!(first.0.to_bits(), total.to_bits(), "{}", isa);
            prop_assert_eq!(bits(&first.1), bits(&grad), "{}", isa);
        }
        Ok(())
    }

    #[test]
    fn elementwise_losses_are_those_of_candle_nn() {
        let q = Tensor::new(&[0.0f32, 0.4, -3.0, 1.0], &Device::Cpu).unwrap();
        let y = Tensor::new(&[0.0f32, 1.0, 2.0, -0.1], &Device::Cpu).unwrap();
        let mean =
            |loss: Loss| elementwise(loss, &q, &y).unwrap().mean_all().unwrap().to_scalar::<f32>().unwrap();
        let huber = candle_nn::loss::huber(&q, &y, 0.8).unwrap().to_scalar::<f32>().unwrap();
        let squared = candle_nn::loss::mse(&q, &y).unwrap().to_scalar::<f32>().unwrap();
        assert!((mean(Loss::Huber { delta: 0.8 }) - huber).abs() < 1e-6);
        assert!((mean(Loss::Squared) - squared).abs() < 1e-6);
    }

    #[test]
    fn a_wrong_length_or_action_is_an_error() {
        let layout = Layout::new(&[2, 3]).unwrap();
        let var = Var::zeros(layout.n_params(), candle_core::DType::F32, &Device::Cpu).unwrap();
        let good = Samples { x: &[0.0; 2], actions: &[2], targets: &[1.0], weights: &[1.0], scale: 1.0 };
        assert!(loss_and_gradient(&layout, &var, &good, Loss::Squared).is_ok());
        assert!(loss_and_gradient(&layout, &var, &Samples { actions: &[3], ..good }, Loss::Squared).is_err());
        assert!(loss_and_gradient(&layout, &var, &Samples { x: &[0.0; 3], ..good }, Loss::Squared).is_err());
    }
}
