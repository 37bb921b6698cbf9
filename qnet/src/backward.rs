//! The gradient of a weighted sum of Q-values, or of anything of which the derivatives by all outputs are known.

use crate::kernels::{
    After, ByColumn, ByRow, ColumnSums, Fold, Gathered, Kernels, Left, OutputLayer, Product, Transpose,
    Within,
};
use crate::layout::{Layer, Layout};
use crate::net::Workspace;

/// Columns of a panel of transposed weights: a multiple of every tile's, and few enough for the panel to stay in the
/// second-level cache.
const PANEL: usize = 64;

/// One term `dq * Q(x_row, action)` of the sum whose gradient [`backward`] takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowGrad {
    /// Row of the last [`crate::forward_train`], from 0.
    pub row: u32,
    /// The taken action, from 0.
    pub action: u32,
    /// Derivative of the loss by this Q-value.
    pub dq: f32,
}

/// Gradient of `sum over terms of dq * Q(x_row, action)` with respect to the parameters, where `x` are the
/// rows of the last [`crate::forward_train`] on this workspace; `params` must be the parameters of that call.
///
/// `grad` is overwritten. Rows that no term names contribute nothing and cost nothing; a row may be named
/// more than once; without terms the gradient is 0. The terms are added up in the order given, on which the
/// last bits may depend. A unit whose ReLU was exactly at 0 passes no gradient on, as in PyTorch.
///
/// # Panics
/// If a slice has another length, there are more terms than the workspace has rows, a term names a row that
/// was not computed or an action that does not exist, or the workspace has another layout.
pub fn backward(
    layout: &Layout,
    params: &[f32],
    ws: &mut Workspace,
    grads_rows: &[RowGrad],
    grad: &mut [f32],
) {
    assert!(ws.layout == *layout, "the workspace belongs to another layout");
    assert_eq!(params.len(), layout.n_params(), "number of parameters");
    assert_eq!(grad.len(), layout.n_params(), "length of the gradient");
    let n = grads_rows.len();
    assert!(n <= ws.max_rows, "{n} terms in a workspace for {}", ws.max_rows);
    if n == 0 {
        grad.fill(0.0);
        return;
    }
    ws.rows.clear();
    ws.actions.clear();
    ws.dq.clear();
    for term in grads_rows {
        assert!((term.row as usize) < ws.trained_rows, "row {} of {}", term.row, ws.trained_rows);
        assert!((term.action as usize) < layout.output(), "action {} of {}", term.action, layout.output());
        ws.rows.push(term.row);
        ws.actions.push(term.action);
        ws.dq.push(term.dq);
    }
    output_layer(layout, params, ws, grad);
    for l in (0..layout.layers().len() - 1).rev() {
        hidden_layer(layout, params, ws, l, None, grad);
    }
}

/// The gradient with respect to the parameters of a loss whose derivatives by the outputs of the last
/// [`crate::forward_train`] on this workspace are `outputs`, `[rows][output]`; `params` must be the parameters of that call.
/// For losses of whole rows, such as a cross-entropy.
///
/// `grad` is overwritten. A unit whose ReLU was exactly at 0 passes no gradient on, as in PyTorch.
///
/// # Panics
/// If a slice has another length, there are not as many rows as were computed, or the workspace has another layout.
pub fn backward_outputs(
    layout: &Layout,
    params: &[f32],
    ws: &mut Workspace,
    outputs: &[f32],
    grad: &mut [f32],
) {
    assert!(ws.layout == *layout, "the workspace belongs to another layout");
    assert_eq!(params.len(), layout.n_params(), "number of parameters");
    assert_eq!(grad.len(), layout.n_params(), "length of the gradient");
    assert_eq!(outputs.len(), ws.trained_rows * layout.output(), "derivatives by the outputs");
    ws.rows.clear();
    ws.rows.extend(0..ws.trained_rows as u32);
    let last = layout.layers().len() - 1;
    hidden_layer(layout, params, ws, last, Some(outputs), grad);
    for l in (0..last).rev() {
        hidden_layer(layout, params, ws, l, None, grad);
    }
}

/// Gradient of the output layer; leaves the gradient of its input in `ws.delta[0]`.
fn output_layer(layout: &Layout, params: &[f32], ws: &mut Workspace, grad: &mut [f32]) {
    let l = layout.layers().len() - 1;
    let layer = layout.layers()[l];
    let weights_t: &[f32] =
        if l > 0 { transposed(ws.kernels, &layer, params, &mut ws.weights_t) } else { &[] };
    ws.grad_t.fill(0.0);
    ws.kernels.run(OutputLayer {
        width: layer.inputs,
        hidden: &ws.inputs[l],
        rows: &ws.rows,
        actions: &ws.actions,
        dq: &ws.dq,
        weights_t,
        grad_t: &mut ws.grad_t,
        delta: (l > 0).then_some(&mut ws.delta[0][..]),
    });
    ws.kernels.run(Transpose { x: &ws.grad_t, columns: layer.inputs, out: &mut grad[layer.weights()] });
    let bias = &mut grad[layer.bias()];
    bias.fill(0.0);
    for (&action, &dq) in ws.actions.iter().zip(&ws.dq) {
        bias[action as usize] += dq;
    }
}

/// Gradient of layer `l` from the gradient of its output, `outputs` or else what is in `ws.delta[0]`; leaves the gradient
/// of its input there.
fn hidden_layer(
    layout: &Layout,
    params: &[f32],
    ws: &mut Workspace,
    l: usize,
    outputs: Option<&[f32]>,
    grad: &mut [f32],
) {
    let layer = layout.layers()[l];
    let n = ws.rows.len();
    let (weights, bias) = grad[layer.weights().start..layer.bias().end].split_at_mut(layer.weights().len());
    let [delta, next] = &mut ws.delta;
    // An output layer may be wider than what `delta` holds.
    let delta = outputs.unwrap_or_else(|| &delta[..n * layer.width_out()]);
    let (kernels, input, columns) = (ws.kernels, &ws.inputs[l], layer.outputs);
    kernels.run(ColumnSums { x: delta, out: bias });
    let Some(places) = ws.convs.get_mut(l) else {
        let left = ByColumn { x: input, width: layer.inputs, picked: &ws.rows };
        kernels.run(product(layer.inputs, n, columns, left, delta, After::Keep, weights));
        if l > 0 {
            let (weights, after) =
                (&params[layer.weights()], After::Gate { activations: input, picked: &ws.rows });
            let next = &mut next[..n * layer.inputs];
            // Panel by panel: transposed as a whole, a wide matrix is written all over the memory.
            for first in (0..layer.inputs).step_by(PANEL) {
                let width = PANEL.min(layer.inputs - first);
                let panel = &mut ws.weights_t[..width * columns];
                let x = &weights[first * columns..][..width * columns];
                kernels.run(Transpose { x, columns, out: panel });
                let whole = product(n, columns, width, ByRow(delta), panel, after, next);
                kernels.run(Product { within: Within { pitch: layer.inputs, first }, ..whole });
            }
            ws.delta.swap(0, 1);
        }
        return;
    };
    let each = layer.positions();
    places.picked.clear();
    for &row in &ws.rows {
        places.picked.extend_from_slice(&places.bases[row as usize * each..][..each]);
    }
    let left = Gathered { x: input, rows: &places.offsets, inner: &places.picked };
    kernels.run(product(layer.inputs, n * each, columns, left, delta, After::Keep, weights));
    if let Some(conv) = layer.conv.filter(|_| l > 0) {
        let weights_t = transposed(kernels, &layer, params, &mut ws.weights_t);
        let patches = &mut ws.patches[..n * each * layer.inputs];
        kernels.run(product(n * each, columns, layer.inputs, ByRow(delta), weights_t, After::Keep, patches));
        kernels.run(Fold {
            patches,
            bases: &places.bases[..n * each],
            run: conv.kernel * conv.grid.channels,
            runs: conv.kernel,
            apart: conv.grid.width * conv.grid.channels,
            width: layer.width_in(),
            activations: input,
            picked: &ws.rows,
            out: next,
        });
        ws.delta.swap(0, 1);
    }
}

/// The product of two matrices without a bias.
fn product<'a, L: Left>(
    rows: usize,
    inner: usize,
    columns: usize,
    left: L,
    right: &'a [f32],
    after: After<'a>,
    out: &'a mut [f32],
) -> Product<'a, L> {
    Product { rows, inner, columns, left, right, bias: None, after, out, within: Within::all(columns) }
}

/// The weights of `layer`, transposed into `room`.
fn transposed<'a>(kernels: Kernels, layer: &Layer, params: &[f32], room: &'a mut [f32]) -> &'a [f32] {
    let out = &mut room[..layer.weights().len()];
    kernels.run(Transpose { x: &params[layer.weights()], columns: layer.outputs, out });
    out
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use proptest::prelude::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::kernels::{Isa, Kernels};
    use crate::layout::init;
    use crate::layout::testing::{layouts, places};
    use crate::net::{forward, forward_train};

    struct Case {
        layout: Layout,
        params: Vec<f32>,
        x: Vec<f32>,
        terms: Vec<RowGrad>,
    }

    fn case(layout: Layout, rows: usize, terms: usize, seed: u64) -> Case {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let params = init(&layout, &mut rng);
        let x = (0..rows * layout.input()).map(|_| rng.random_range(-2.0..2.0)).collect();
        let mut term = || RowGrad {
            row: rng.random_range(0..rows as u32),
            action: rng.random_range(0..layout.output() as u32),
            dq: rng.random_range(-1.0..1.0),
        };
        let terms = (0..terms).map(|_| term()).collect();
        Case { layout, params, x, terms }
    }

    fn gradient(case: &Case, isa: Isa) -> Vec<f32> {
        let Case { layout, params, x, terms } = case;
        let rows = x.len() / layout.input();
        let kernels = Kernels::new(isa).unwrap();
        let mut ws = Workspace::with_kernels(layout, rows.max(terms.len()).max(1), kernels);
        let mut q = vec![0.0; rows * layout.output()];
        forward_train(layout, params, x, rows, &mut ws, &mut q);
        // Neither another forward pass nor leftovers of an earlier gradient may matter.
        forward(layout, params, &vec![9.0; layout.input()], 1, &mut ws, &mut q[..layout.output()]);
        let mut grad = vec![f32::NAN; layout.n_params()];
        backward(layout, params, &mut ws, &terms[..terms.len() / 2], &mut grad);
        backward(layout, params, &mut ws, terms, &mut grad);
        grad
    }

    /// The textbook backward pass in `f64`.
    fn naive(case: &Case) -> Vec<f64> {
        let Case { layout, params, x, terms } = case;
        let param = |at: usize| f64::from(params[at]);
        let mut grad = vec![0.0; layout.n_params()];
        for term in terms {
            let row = &x[term.row as usize * layout.input()..][..layout.input()];
            let mut inputs = vec![row.iter().map(|&x| f64::from(x)).collect::<Vec<f64>>()];
            for layer in layout.layers() {
                let x = &inputs[inputs.len() - 1];
                let (bases, offsets) = places(layer);
                let mut output = Vec::new();
                for &base in &bases {
                    output.extend((0..layer.outputs).map(|j| {
                        let weight = |i: usize| param(layer.offset + i * layer.outputs + j);
                        (0..layer.inputs)
                            .fold(param(layer.bias().start + j), |sum, i| {
                                sum + x[base + offsets[i]] * weight(i)
                            })
                            .max(0.0)
                    }));
                }
                inputs.push(output);
            }
            let mut delta = vec![0.0; layout.output()];
            delta[term.action as usize] = f64::from(term.dq);
            for (l, layer) in layout.layers().iter().enumerate().rev() {
                let x = &inputs[l];
                let mut below = vec![0.0; layer.width_in()];
                let (bases, offsets) = places(layer);
                for (p, &base) in bases.iter().enumerate() {
                    for j in 0..layer.outputs {
                        let delta = delta[p * layer.outputs + j];
                        grad[layer.bias().start + j] += delta;
                        for (i, offset) in offsets.iter().enumerate() {
                            let (at, from) = (layer.offset + i * layer.outputs + j, base + offset);
                            grad[at] += x[from] * delta;
                            if x[from] > 0.0 {
                                below[from] += param(at) * delta;
                            }
                        }
                    }
                }
                delta = below;
            }
        }
        grad
    }

    proptest! {
        #[test]
        fn equals_the_textbook_and_is_the_same_on_every_instruction_set(
            layout in layouts(50), rows in 1usize..20, terms in 0usize..20, seed: u64,
        ) {
            let case = case(layout, rows, terms, seed);
            let grad = gradient(&case, Isa::Scalar);
            let exact = naive(&case);
            let largest = exact.iter().fold(1e-3, |max: f64, g| max.max(g.abs()));
            for (at, (&got, &exact)) in grad.iter().zip(&exact).enumerate() {
                prop_assert!((f64::from(got) - exact).abs() < 1e-4 * largest, "{}: {} {}", at, got, exact);
            }
            for isa in Isa::available() {
                let bits = |grad: &[f32]| grad.iter().map(|g| g.to_bits()).collect::<Vec<u32>>();
                prop_assert_eq!(bits(&gradient(&case, isa)), bits(&grad), "{}", isa);
            }
        }
    }

    proptest! {
        /// Every output of every row as a term of its own.
        #[test]
        fn derivatives_by_all_outputs_are_the_sum_of_the_terms(
            layout in layouts(40), rows in 1usize..12, seed: u64,
        ) {
            let mut case = case(layout, rows, 0, seed);
            let n_actions = case.layout.output();
            let outputs: Vec<f32> =
                (0..rows * n_actions).map(|at| ((at * 7 + seed as usize % 5) % 11) as f32 / 5.0 - 1.0).collect();
            let term = |(at, &dq): (usize, &f32)| {
                RowGrad { row: (at / n_actions) as u32, action: (at % n_actions) as u32, dq }
            };
            case.terms = outputs.iter().enumerate().map(term).collect();
            let exact = naive(&case);
            let largest = exact.iter().fold(0.1, |max: f64, g| max.max(g.abs()));
            let mut first: Option<Vec<u32>> = None;
            for isa in Isa::available() {
                let mut ws = Workspace::with_kernels(&case.layout, rows, Kernels::new(isa).unwrap());
                let mut q = vec![0.0; rows * n_actions];
                forward_train(&case.layout, &case.params, &case.x, rows, &mut ws, &mut q);
                let mut grad = vec![f32::NAN; case.layout.n_params()];
                backward_outputs(&case.layout, &case.params, &mut ws, &outputs, &mut grad);
                for (at, (&got, &exact)) in grad.iter().zip(&exact).enumerate() {
                    prop_assert!((f64::from(got) - exact).abs() < 1e-4 * largest, "{}: {} {}", at, got, exact);
                }
                let bits: Vec<u32> = grad.iter().map(|g| g.to_bits()).collect();
                prop_assert_eq!(first.get_or_insert_with(|| bits.clone()), &bits, "{}", isa);
            }
        }
    }

    #[test]
    fn rows_that_are_not_listed_do_not_matter() {
        let mut case = case(Layout::new(&[3, 17, 5]).unwrap(), 6, 0, 1);
        case.terms = vec![RowGrad { row: 4, action: 2, dq: 0.5 }, RowGrad { row: 1, action: 0, dq: -1.0 }];
        let expected = gradient(&case, Isa::Scalar);
        for row in [0, 2, 3, 5] {
            case.x[row * 3..][..3].fill(f32::NAN);
        }
        assert_eq!(gradient(&case, Isa::Scalar), expected);
    }
}
