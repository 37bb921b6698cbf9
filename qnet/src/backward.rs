//! The gradient of a weighted sum of Q-values, or of anything of which the derivatives by all outputs are known.

use crate::buffer::AlignedBuffer;
use crate::kernels::{
    After, ByColumn, ByRow, ColumnSums, Fold, Gathered, Kernels, Left, OutputLayer, Product, Transpose,
    Within,
};
use crate::layout::{Layer, Layout, MAX_LAYERS, PANEL};
use crate::net::{Places, Workspace, split_off};
use crate::threads::{Work, share};

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
    for term in grads_rows {
        assert!((term.row as usize) < ws.trained_rows, "row {} of {}", term.row, ws.trained_rows);
        assert!((term.action as usize) < layout.output(), "action {} of {}", term.action, layout.output());
    }
    ws.rows.clear();
    ws.rows.extend(grads_rows.iter().map(|term| term.row));
    ws.actions.clear();
    ws.actions.extend(grads_rows.iter().map(|term| term.action));
    ws.dq.clear();
    ws.dq.extend(grads_rows.iter().map(|term| term.dq));
    output_layer(layout, params, ws, grad);
    if let Some(top) = (layout.layers().len() - 1).checked_sub(1) {
        layers_from(layout, params, ws, top, None, grad);
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
    layers_from(layout, params, ws, layout.layers().len() - 1, Some(outputs), grad);
}

/// Gradient of the output layer; leaves the gradient of its input in `ws.deltas`.
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
        delta: ws.deltas.last_mut().map(|delta| &mut delta[..]),
    });
    ws.kernels.run(Transpose { x: &ws.grad_t, columns: layer.inputs, out: &mut grad[layer.weights()] });
    let bias = &mut grad[layer.bias()];
    bias.fill(0.0);
    for (&action, &dq) in ws.actions.iter().zip(&ws.dq) {
        bias[action as usize] += dq;
    }
}

/// Gradient of layer `top` and of all below it, from the gradient of its output: `outputs` or else the numbers in `ws.deltas`.
///
/// First the gradients of all layers' outputs, from the top down: threads share the rows. Then those of the weights, which are sums over
/// all rows: threads share the rows of each weight matrix.
fn layers_from(
    layout: &Layout,
    params: &[f32],
    ws: &mut Workspace,
    top: usize,
    outputs: Option<&[f32]>,
    grad: &mut [f32],
) {
    let layers = &layout.layers()[..=top];
    let n = ws.rows.len();
    for (places, layer) in ws.convs.iter_mut().zip(layers) {
        let each = layer.positions();
        places.picked.clear();
        for &row in &ws.rows {
            places.picked.extend_from_slice(&places.bases[row as usize * each..][..each]);
        }
    }
    let pass = Pass { kernels: ws.kernels, layers, inputs: &ws.inputs, convs: &ws.convs };
    if top > 0 {
        let multiply_adds = n * layers[1..].iter().map(Layer::multiply_adds).sum::<usize>();
        let mut deltas: [&mut [f32]; MAX_LAYERS] = Default::default();
        for ((slice, delta), layer) in deltas.iter_mut().zip(&mut ws.deltas).zip(layers) {
            *slice = &mut delta[..n * layer.width_out()];
        }
        let patches = n * most_patches(layers);
        ws.threads.run(
            multiply_adds,
            Deltas {
                pass,
                whole: n,
                rows: &ws.rows,
                params,
                outputs,
                deltas,
                patches: &mut ws.patches[..patches],
                transposed: ws.transposed,
                weights_t: &mut ws.weights_t,
            },
        );
    }
    let mut weights: [&mut [f32]; MAX_LAYERS] = Default::default();
    let mut biases: [&mut [f32]; MAX_LAYERS] = Default::default();
    let mut rest = grad;
    for (layer, (weights, bias)) in layers.iter().zip(weights.iter_mut().zip(&mut biases)) {
        (*weights, rest) = rest.split_at_mut(layer.weights().len());
        (*bias, rest) = rest.split_at_mut(layer.outputs);
    }
    let multiply_adds = n * layers.iter().map(Layer::multiply_adds).sum::<usize>();
    let deltas = &ws.deltas;
    let rows = &ws.rows;
    ws.threads.run(
        multiply_adds,
        Gradients { pass, rows, outputs, deltas, first: [0; MAX_LAYERS], weights, biases },
    );
}

/// What both halves of the backward pass need.
#[derive(Clone, Copy)]
struct Pass<'a> {
    kernels: Kernels,
    /// The layers whose gradient is to be found.
    layers: &'a [Layer],
    inputs: &'a [AlignedBuffer],
    convs: &'a [Places],
}

/// The most numbers of one row under the kernels of a convolution that is not the first layer.
fn most_patches(layers: &[Layer]) -> usize {
    let patches = |layer: &Layer| layer.conv.map_or(0, |_| layer.positions() * layer.inputs);
    layers[1..].iter().map(patches).max().unwrap_or(0)
}

/// The gradients of the outputs of all layers but the top one, for some of the terms' rows.
struct Deltas<'a> {
    pass: Pass<'a>,
    /// Rows of all parts.
    whole: usize,
    rows: &'a [u32],
    params: &'a [f32],
    /// Gradient of the top layer's output, if it is not among `deltas`.
    outputs: Option<&'a [f32]>,
    deltas: [&'a mut [f32]; MAX_LAYERS],
    patches: &'a mut [f32],
    /// Room for so many transposed weights for each part.
    transposed: usize,
    weights_t: &'a mut [f32],
}

impl Work for Deltas<'_> {
    fn split(self, part: usize, parts: usize) -> (Self, Self) {
        let Deltas { pass, whole, params, transposed, deltas: mut rests, .. } = self;
        let here = share(whole, part, parts);
        let (rows, rows_rest) = self.rows.split_at(here);
        let top = &pass.layers[pass.layers.len() - 1];
        let outputs = self.outputs.map(|outputs| outputs.split_at(here * top.width_out()));
        // The top layer has none there if it has `outputs`.
        let widths = pass.layers.iter().take(pass.layers.len() - usize::from(outputs.is_some()));
        let deltas = split_off(&mut rests, widths.map(|layer| here * layer.width_out()));
        let (patches, patches_rest) = self.patches.split_at_mut(here * most_patches(pass.layers));
        let (weights_t, weights_t_rest) = self.weights_t.split_at_mut(transposed);
        let first = Deltas {
            pass,
            whole,
            rows,
            params,
            outputs: outputs.map(|both| both.0),
            deltas,
            patches,
            transposed,
            weights_t,
        };
        let rest = Deltas {
            pass,
            whole,
            rows: rows_rest,
            params,
            outputs: outputs.map(|both| both.1),
            deltas: rests,
            patches: patches_rest,
            transposed,
            weights_t: weights_t_rest,
        };
        (first, rest)
    }

    fn run(mut self) {
        let Pass { kernels, layers, inputs, convs } = self.pass;
        let n = self.rows.len();
        for (l, layer) in layers.iter().enumerate().skip(1).rev() {
            let (below, above) = self.deltas.split_at_mut(l);
            let next = &mut *below[l - 1];
            let delta = self.outputs.filter(|_| l + 1 == layers.len()).unwrap_or(&*above[0]);
            let (input, columns) = (&inputs[l], layer.outputs);
            let Some((conv, places)) = layer.conv.zip(convs.get(l)) else {
                let weights = &self.params[layer.weights()];
                let after = After::Gate { activations: input, picked: self.rows };
                // Panel by panel: transposed as a whole, a wide matrix is written all over the memory.
                for first in (0..layer.inputs).step_by(PANEL) {
                    let width = PANEL.min(layer.inputs - first);
                    let panel = &mut self.weights_t[..width * columns];
                    let x = &weights[first * columns..][..width * columns];
                    kernels.run(Transpose { x, columns, out: panel });
                    let whole = product(n, columns, width, ByRow(delta), panel, after, next);
                    kernels.run(Product { within: Within { pitch: layer.inputs, first }, ..whole });
                }
                continue;
            };
            let each = layer.positions();
            let weights_t = transposed(kernels, layer, self.params, self.weights_t);
            let patches = &mut self.patches[..n * each * layer.inputs];
            kernels.run(product(
                n * each,
                columns,
                layer.inputs,
                ByRow(delta),
                weights_t,
                After::Keep,
                patches,
            ));
            kernels.run(Fold {
                patches,
                bases: &places.bases[..n * each],
                run: conv.kernel * conv.grid.channels,
                runs: conv.kernel,
                apart: conv.grid.width * conv.grid.channels,
                width: layer.width_in(),
                activations: input,
                picked: self.rows,
                out: next,
            });
        }
    }
}

/// The gradients of weights and biases, for some of the rows of each layer's weights.
struct Gradients<'a> {
    pass: Pass<'a>,
    rows: &'a [u32],
    /// Gradient of the top layer's output, if it is not among `deltas`.
    outputs: Option<&'a [f32]>,
    deltas: &'a [AlignedBuffer],
    /// The first of the rows, of each layer.
    first: [usize; MAX_LAYERS],
    /// Gradient of these rows, `[..][outputs]`.
    weights: [&'a mut [f32]; MAX_LAYERS],
    /// Gradient of the biases, in the last part alone.
    biases: [&'a mut [f32]; MAX_LAYERS],
}

impl Work for Gradients<'_> {
    fn split(self, part: usize, parts: usize) -> (Self, Self) {
        let Gradients { pass, rows, outputs, deltas, first, weights: mut rests, biases } = self;
        let here = |layer: &Layer| share(layer.inputs, part, parts);
        let weights = split_off(&mut rests, pass.layers.iter().map(|layer| here(layer) * layer.outputs));
        let mut behind = first;
        behind.iter_mut().zip(pass.layers).for_each(|(first, layer)| *first += here(layer));
        let this = Gradients { pass, rows, outputs, deltas, first, weights, biases: Default::default() };
        (this, Gradients { pass, rows, outputs, deltas, first: behind, weights: rests, biases })
    }

    fn run(self) {
        let Pass { kernels, layers, inputs, convs } = self.pass;
        let n = self.rows.len();
        let parts = self.first.into_iter().zip(self.weights).zip(self.biases);
        for ((l, layer), ((first, weights), bias)) in layers.iter().enumerate().zip(parts) {
            let delta = match self.outputs {
                Some(outputs) if l + 1 == layers.len() => outputs,
                _ => &self.deltas[l][..n * layer.width_out()],
            };
            if !bias.is_empty() {
                kernels.run(ColumnSums { x: delta, out: bias });
            }
            let (input, columns, rows) = (&inputs[l], layer.outputs, weights.len() / layer.outputs);
            match convs.get(l) {
                None => {
                    let left = ByColumn { x: &input[first..], width: layer.inputs, picked: self.rows };
                    kernels.run(product(rows, n, columns, left, delta, After::Keep, weights));
                }
                Some(places) => {
                    let left = Gathered { x: input, rows: &places.offsets[first..], inner: &places.picked };
                    let inner = n * layer.positions();
                    kernels.run(product(rows, inner, columns, left, delta, After::Keep, weights));
                }
            }
        }
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
    use crate::threads::Threads;

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
        shared_gradient(case, isa, 1)
    }

    fn shared_gradient(case: &Case, isa: Isa, threads: usize) -> Vec<f32> {
        let Case { layout, params, x, terms } = case;
        let rows = x.len() / layout.input();
        let kernels = Kernels::new(isa).unwrap();
        let mut ws = Workspace::with_kernels(layout, rows.max(terms.len()).max(1), kernels)
            .with_threads(Threads::eager(threads));
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
                for threads in 1..4 {
                    let shared = shared_gradient(&case, isa, threads);
                    prop_assert_eq!(bits(&shared), bits(&grad), "{}, {} threads", isa, threads);
                }
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
                let threads = Threads::eager(1 + seed as usize % 3);
                let mut ws = Workspace::with_kernels(&case.layout, rows, Kernels::new(isa).unwrap())
                    .with_threads(threads);
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
