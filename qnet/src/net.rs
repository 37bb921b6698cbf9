//! Values of a network: the forward pass, for acting and for training.

use crate::buffer::AlignedBuffer;
use crate::kernels::{After, ByRow, Gathered, Kernels, NarrowProduct, Product, Within};
use crate::layout::{Layer, Layout, MAX_LAYERS, PANEL};
use crate::threads::{Threads, Work, share};

/// Scratch memory for networks of one layout and batches up to a fixed number of rows.
///
/// All of it is allocated on construction; no function of this crate that takes a workspace allocates, unless several threads share its
/// work. Its size, in `f32`, is the sum of three parts. For each of `max_rows` rows: the input, twice all hidden widths, twice the widest
/// of them, and all numbers under the kernels of convolutions that are not the first layer. For each thread: the largest of the
/// transposed weights behind the first layer, whole for the output layer or a convolution, 64 rows for another layer. Once: the
/// output layer's weights.
#[derive(Clone, Debug)]
pub struct Workspace {
    pub(crate) kernels: Kernels,
    pub(crate) layout: Layout,
    pub(crate) max_rows: usize,
    /// Input of each layer, `[max_rows][inputs]`, as the last [`forward_train`] left them.
    pub(crate) inputs: Vec<AlignedBuffer>,
    /// How many rows of `inputs` the last [`forward_train`] filled.
    pub(crate) trained_rows: usize,
    /// Hidden layers of [`forward`], in turns: apart from `inputs`, so that a forward pass of the target
    /// network may come between [`forward_train`] and [`crate::backward()`].
    hidden: [AlignedBuffer; 2],
    /// Gradient of the output of each layer but the last, a row for each term.
    pub(crate) deltas: Vec<AlignedBuffer>,
    /// Where the numbers under the kernels lie, for each convolution.
    pub(crate) convs: Vec<Places>,
    /// Gradient of the numbers under the kernel, at each position of each row.
    pub(crate) patches: AlignedBuffer,
    /// The threads that share the work.
    pub(crate) threads: Threads,
    /// Weights of a layer, transposed: room for `transposed` of them for each thread.
    pub(crate) weights_t: AlignedBuffer,
    pub(crate) transposed: usize,
    /// Gradient of the output layer's weights, transposed.
    pub(crate) grad_t: AlignedBuffer,
    /// The gradient's rows, field by field.
    pub(crate) rows: Vec<u32>,
    pub(crate) actions: Vec<u32>,
    pub(crate) dq: Vec<f32>,
}

/// Where the numbers under the kernel of a convolution lie in all rows of its input.
#[derive(Clone, Debug)]
pub(crate) struct Places {
    /// For each position of each row the first of them.
    pub(crate) bases: Vec<u32>,
    /// How far the others lie from it.
    pub(crate) offsets: Vec<u32>,
    /// Those of the bases whose rows count in the backward pass.
    pub(crate) picked: Vec<u32>,
}

impl Places {
    fn new(layer: &Layer, max_rows: usize) -> Option<Places> {
        let (conv, width) = (layer.conv?, layer.width_in());
        let bases = (0..max_rows).flat_map(|row| conv.bases().map(move |base| (row * width + base) as u32));
        let picked = Vec::with_capacity(max_rows * layer.positions());
        Some(Places { bases: bases.collect(), offsets: conv.offsets().map(|at| at as u32).collect(), picked })
    }
}

impl Workspace {
    /// Scratch memory for batches of up to `max_rows` rows, on the fastest instruction set of this machine.
    ///
    /// # Panics
    /// If `max_rows` is 0 or above `u32::MAX`.
    pub fn new(layout: &Layout, max_rows: usize) -> Workspace {
        Workspace::with_kernels(layout, max_rows, Kernels::detect())
    }

    /// Scratch memory for batches of up to `max_rows` rows, on a given instruction set.
    ///
    /// # Panics
    /// If `max_rows` is 0, or its inputs have more than `u32::MAX` numbers.
    pub fn with_kernels(layout: &Layout, max_rows: usize, kernels: Kernels) -> Workspace {
        let widest = layout.sizes().iter().copied().max().unwrap_or(1);
        assert!(max_rows > 0 && u32::try_from(max_rows * widest).is_ok(), "max_rows is {max_rows}");
        let rows_of = |width: usize| AlignedBuffer::new(max_rows * width);
        let hidden = layout.max_hidden();
        let patches = |layer: &Layer| layer.conv.map_or(0, |_| layer.positions() * layer.inputs);
        let layers = layout.layers();
        let last = layers.len() - 1;
        let transposed = |(l, layer): (usize, &Layer)| match layer.conv {
            None if l < last => PANEL.min(layer.inputs) * layer.outputs,
            _ => layer.weights().len(),
        };
        // Each thread's share begins at a cache line.
        let transposed =
            layers.iter().enumerate().skip(1).map(transposed).max().unwrap_or(0).next_multiple_of(16);
        Workspace {
            kernels,
            layout: layout.clone(),
            max_rows,
            inputs: layers.iter().map(|layer| rows_of(layer.width_in())).collect(),
            trained_rows: 0,
            hidden: [rows_of(hidden), rows_of(hidden)],
            deltas: layers[..last].iter().map(|layer| rows_of(layer.width_out())).collect(),
            convs: layers.iter().map_while(|layer| Places::new(layer, max_rows)).collect(),
            patches: rows_of(layers[1..].iter().map(patches).max().unwrap_or(0)),
            threads: Threads::default(),
            weights_t: AlignedBuffer::new(transposed),
            transposed,
            grad_t: AlignedBuffer::new(layers.last().map_or(0, |layer| layer.weights().len())),
            rows: Vec::with_capacity(max_rows),
            actions: Vec::with_capacity(max_rows),
            dq: Vec::with_capacity(max_rows),
        }
    }

    /// The same, with `threads` that share the work of passes in which each has enough to do. The bits are those of one thread.
    pub fn with_threads(mut self, threads: Threads) -> Workspace {
        self.weights_t = AlignedBuffer::new(threads.count() * self.transposed);
        self.threads = threads;
        self
    }

    /// The threads that share the work.
    pub fn threads(&self) -> &Threads {
        &self.threads
    }

    /// The largest number of rows.
    pub fn max_rows(&self) -> usize {
        self.max_rows
    }

    /// The kernels that run on it.
    pub fn kernels(&self) -> Kernels {
        self.kernels
    }

    /// Panics unless the arguments of a forward pass fit together.
    fn check(&self, layout: &Layout, params: &[f32], x: &[f32], rows: usize, out: &[f32]) {
        assert!(self.layout == *layout, "the workspace belongs to another layout");
        assert_eq!(params.len(), layout.n_params(), "number of parameters");
        assert!(rows > 0 && rows <= self.max_rows, "{rows} rows in a workspace for {}", self.max_rows);
        assert_eq!(x.len(), rows * layout.input(), "length of the input");
        assert_eq!(out.len(), rows * layout.output(), "length of the output");
    }
}

/// Q-values of `rows` inputs: `x` is `[rows][input]`, `out` is `[rows][output]` and is overwritten.
///
/// The bits of a row's result do not depend on the other rows, nor on the instruction set. The layers' inputs that
/// [`forward_train`] kept stay untouched.
///
/// # Panics
/// If a slice has another length, `rows` is 0 or above the workspace's, or the workspace has another layout.
pub fn forward(layout: &Layout, params: &[f32], x: &[f32], rows: usize, ws: &mut Workspace, out: &mut [f32]) {
    ws.check(layout, params, x, rows, out);
    let width = layout.max_hidden();
    let [from, to] = &mut ws.hidden;
    let hidden = [&mut from[..rows * width], &mut to[..rows * width]];
    let net = Net { kernels: ws.kernels, layout, params, convs: &ws.convs };
    ws.threads.run(net.multiply_adds(rows), Values { net, whole: rows, rows, x, hidden, out });
}

/// A network, as the threads that share its work see it.
#[derive(Clone, Copy)]
struct Net<'a> {
    kernels: Kernels,
    layout: &'a Layout,
    params: &'a [f32],
    convs: &'a [Places],
}

impl Net<'_> {
    /// Multiply-adds of a forward pass of `rows` rows.
    fn multiply_adds(&self, rows: usize) -> usize {
        rows * self.layout.layers().iter().map(Layer::multiply_adds).sum::<usize>()
    }
}

/// A forward pass of some rows that keeps nothing.
struct Values<'a> {
    net: Net<'a>,
    /// Rows of all parts.
    whole: usize,
    rows: usize,
    x: &'a [f32],
    hidden: [&'a mut [f32]; 2],
    out: &'a mut [f32],
}

impl Work for Values<'_> {
    fn split(self, part: usize, parts: usize) -> (Self, Self) {
        let Values { net, whole, rows, x, hidden: [from, to], out } = self;
        let (layout, here) = (net.layout, share(whole, part, parts));
        let (x, x_rest) = x.split_at(here * layout.input());
        let (from, from_rest) = from.split_at_mut(here * layout.max_hidden());
        let (to, to_rest) = to.split_at_mut(here * layout.max_hidden());
        let (out, out_rest) = out.split_at_mut(here * layout.output());
        let first = Values { net, whole, rows: here, x, hidden: [from, to], out };
        let hidden = [from_rest, to_rest];
        (first, Values { net, whole, rows: rows - here, x: x_rest, hidden, out: out_rest })
    }

    fn run(self) {
        let Values { net, rows, x, hidden: [mut from, mut to], out, .. } = self;
        let last = net.layout.layers().len() - 1;
        for (l, layer) in net.layout.layers().iter().enumerate() {
            let input = if l == 0 { x } else { &from[..rows * layer.width_in()] };
            let output = if l == last { &mut *out } else { &mut to[..rows * layer.width_out()] };
            apply(net, l, input, rows, output);
            std::mem::swap(&mut from, &mut to);
        }
    }
}

/// The same as [`forward`], and keeps every layer's input in the workspace for [`crate::backward()`].
///
/// # Panics
/// As [`forward`].
pub fn forward_train(
    layout: &Layout,
    params: &[f32],
    x: &[f32],
    rows: usize,
    ws: &mut Workspace,
    out: &mut [f32],
) {
    ws.check(layout, params, x, rows, out);
    ws.inputs[0][..x.len()].copy_from_slice(x);
    ws.trained_rows = rows;
    let mut inputs: [&mut [f32]; MAX_LAYERS] = Default::default();
    for ((slice, input), layer) in inputs.iter_mut().zip(&mut ws.inputs).zip(layout.layers()) {
        *slice = &mut input[..rows * layer.width_in()];
    }
    let net = Net { kernels: ws.kernels, layout, params, convs: &ws.convs };
    ws.threads.run(net.multiply_adds(rows), KeptValues { net, whole: rows, rows, inputs, out });
}

/// A forward pass of some rows that keeps the input of every layer.
struct KeptValues<'a> {
    net: Net<'a>,
    /// Rows of all parts.
    whole: usize,
    rows: usize,
    inputs: [&'a mut [f32]; MAX_LAYERS],
    out: &'a mut [f32],
}

impl Work for KeptValues<'_> {
    fn split(self, part: usize, parts: usize) -> (Self, Self) {
        let KeptValues { net, whole, rows, inputs: mut rests, out } = self;
        let here = share(whole, part, parts);
        let inputs = split_off(&mut rests, net.layout.layers().iter().map(|layer| here * layer.width_in()));
        let (out, out_rest) = out.split_at_mut(here * net.layout.output());
        let first = KeptValues { net, whole, rows: here, inputs, out };
        (first, KeptValues { net, whole, rows: rows - here, inputs: rests, out: out_rest })
    }

    fn run(self) {
        let KeptValues { net, rows, mut inputs, out, .. } = self;
        let last = net.layout.layers().len() - 1;
        for l in 0..=last {
            let (done, ahead) = inputs.split_at_mut(l + 1);
            let output = if l == last { &mut *out } else { &mut *ahead[0] };
            apply(net, l, &*done[l], rows, output);
        }
    }
}

/// Takes as many numbers as `lengths` say off the front of each of `slices`, and returns them.
pub(crate) fn split_off<'a>(
    slices: &mut [&'a mut [f32]; MAX_LAYERS],
    lengths: impl Iterator<Item = usize>,
) -> [&'a mut [f32]; MAX_LAYERS] {
    let mut firsts: [&'a mut [f32]; MAX_LAYERS] = Default::default();
    for ((first, slice), length) in firsts.iter_mut().zip(slices).zip(lengths) {
        (*first, *slice) = std::mem::take(slice).split_at_mut(length);
    }
    firsts
}

/// Layer `l` on `rows` rows; a convolution at its places.
fn apply(net: Net<'_>, l: usize, input: &[f32], rows: usize, output: &mut [f32]) {
    let Net { kernels, layout, params, convs } = net;
    let (layer, relu) = (&layout.layers()[l], l + 1 < layout.layers().len());
    // Whether the layer is the last one, not how many rows there are: a row's bits must not depend on the others.
    if !relu && layer.outputs <= NarrowProduct::COLUMNS {
        return kernels.run(NarrowProduct {
            inner: layer.inputs,
            x: input,
            weights: &params[layer.weights()],
            bias: &params[layer.bias()],
            out: output,
        });
    }
    let (right, bias) = (&params[layer.weights()], Some(&params[layer.bias()]));
    let after = if relu { After::Relu } else { After::Keep };
    let (inner, columns, out) = (layer.inputs, layer.outputs, output);
    let within = Within::all(columns);
    match convs.get(l) {
        None => {
            kernels.run(Product { rows, inner, columns, left: ByRow(input), right, bias, after, out, within })
        }
        Some(places) => {
            let rows = rows * layer.positions();
            let left = Gathered { x: input, rows: &places.bases[..rows], inner: &places.offsets };
            kernels.run(Product { rows, inner, columns, left, right, bias, after, out, within });
        }
    }
}

/// Index of the largest number; of equal ones the lowest index. NaN counts as smaller than everything, and a
/// slice of nothing but NaN, or an empty one, gives 0.
#[inline]
pub fn argmax(values: &[f32]) -> usize {
    let mut best = 0;
    for (i, &value) in values.iter().enumerate() {
        if value > values[best] || (values[best].is_nan() && !value.is_nan()) {
            best = i;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use proptest::prelude::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::kernels::{Isa, by_definition};
    use crate::layout::init;
    use crate::layout::testing::{layouts, places};

    /// A forward pass of one row, element by element.
    fn naive(layout: &Layout, params: &[f32], x: &[f32]) -> Vec<f32> {
        let mut x = x.to_vec();
        for (l, layer) in layout.layers().iter().enumerate() {
            let (w, b) = (&params[layer.weights()], &params[layer.bias()]);
            let (bases, offsets) = places(layer);
            let unit = |base: usize, j: usize| {
                if l + 1 == layout.layers().len() && layer.outputs <= NarrowProduct::COLUMNS {
                    let column: Vec<f32> = w.iter().skip(j).step_by(layer.outputs).copied().collect();
                    return by_definition(&x, &column, b[j], layer.outputs);
                }
                let x = |i: usize| x[base + offsets[i]];
                let sum = (0..layer.inputs).fold(b[j], |sum, i| x(i).mul_add(w[i * layer.outputs + j], sum));
                if l + 1 < layout.layers().len() { sum.max(0.0) } else { sum }
            };
            x = bases
                .iter()
                .flat_map(|&base| (0..layer.outputs).map(move |j| (base, j)))
                .map(|(base, j)| unit(base, j))
                .collect();
        }
        x
    }

    proptest! {
        #[test]
        fn both_passes_equal_naive_on_every_instruction_set(
            layout in layouts(90), rows in 1usize..15, seed: u64,
        ) {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let params = init(&layout, &mut rng);
            let x: Vec<f32> = (0..rows * layout.input()).map(|_| rng.random_range(-2.0..2.0)).collect();
            let expected: Vec<f32> =
                x.chunks(layout.input()).flat_map(|row| naive(&layout, &params, row)).collect();
            for isa in Isa::available() {
                let mut ws = Workspace::with_kernels(&layout, rows + 1, Kernels::new(isa).unwrap());
                let mut out = vec![f32::NAN; rows * layout.output()];
                forward(&layout, &params, &x, rows, &mut ws, &mut out);
                prop_assert_eq!(&out, &expected, "{}", isa);
                out.fill(f32::NAN);
                forward_train(&layout, &params, &x, rows, &mut ws, &mut out);
                prop_assert_eq!(&out, &expected, "{}", isa);
                let single = &mut out[..layout.output()];
                forward(&layout, &params, &x[..layout.input()], 1, &mut ws, single);
                prop_assert_eq!(&*single, &expected[..layout.output()], "{}", isa);
                for threads in [2, 3] {
                    let mut ws = ws.clone().with_threads(Threads::eager(threads));
                    out.fill(f32::NAN);
                    forward(&layout, &params, &x, rows, &mut ws, &mut out);
                    prop_assert_eq!(&out, &expected, "{}, {} threads", isa, threads);
                    out.fill(f32::NAN);
                    forward_train(&layout, &params, &x, rows, &mut ws, &mut out);
                    prop_assert_eq!(&out, &expected, "{}, {} threads", isa, threads);
                }
            }
        }

        #[test]
        fn argmax_is_the_first_maximum(values in prop::collection::vec(-3i8..3, 1..12)) {
            let floats: Vec<f32> = values.iter().map(|&v| f32::from(v)).collect();
            let max = values.iter().max().unwrap();
            prop_assert_eq!(Some(argmax(&floats)), values.iter().position(|v| v == max));
        }
    }

    #[test]
    fn argmax_skips_nan() {
        assert_eq!(argmax(&[f32::NAN, -1.0, f32::NAN, 2.0, 2.0]), 3);
        assert_eq!(argmax(&[f32::NAN, f32::NEG_INFINITY]), 1);
        assert_eq!(argmax(&[f32::NAN; 3]), 0);
        assert_eq!(argmax(&[-0.0, 0.0]), 0);
        assert_eq!(argmax(&[]), 0);
    }

    #[test]
    fn a_diverged_network_shows() {
        let layout = Layout::new(&[1, 2, 1]).unwrap();
        let mut params = vec![1.0; layout.n_params()];
        params[0] = f32::NAN;
        let mut out = [0.0];
        forward(&layout, &params, &[1.0], 1, &mut Workspace::new(&layout, 1), &mut out);
        assert!(out[0].is_nan());
    }
}
