//! The backward pass of the output layer, which only the taken actions' columns take part in.
//!
//! The general product would multiply by a matrix that holds a single number a row. Here each listed sample
//! costs two passes over one row of the hidden layer, however many actions there are.

use super::vector::{Op, Vector};

/// Gradient of `sum over e of dq[e] * Q(x[rows[e]], actions[e])` with respect to the weights of the output
/// layer, transposed, and with respect to the layer's input.
///
/// `grad_t[a][k] += dq[e] * hidden[rows[e]][k]` for `a = actions[e]`, in ascending `e`, and
/// `delta[e][k] = dq[e] * weights_t[actions[e]][k]`, or 0 where `hidden[rows[e]][k]` is not positive.
pub(crate) struct OutputLayer<'a> {
    /// Width of the hidden layer.
    pub(crate) width: usize,
    /// The layer's input, `[..][width]`: outputs of a ReLU, unless `delta` is absent.
    pub(crate) hidden: &'a [f32],
    /// Which row of `hidden` each entry belongs to.
    pub(crate) rows: &'a [u32],
    /// Which action each entry belongs to.
    pub(crate) actions: &'a [u32],
    /// The factor of each entry.
    pub(crate) dq: &'a [f32],
    /// The layer's weights, transposed: `[actions][width]`.
    pub(crate) weights_t: &'a [f32],
    /// Gradient of the weights, transposed: `[actions][width]`; added to.
    pub(crate) grad_t: &'a mut [f32],
    /// Gradient of the layer's input, `[entries][width]`, overwritten; absent if the input is the network's.
    pub(crate) delta: Option<&'a mut [f32]>,
}

impl Op for OutputLayer<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Vector>(mut self) {
        let width = self.width;
        let n = self.rows.len();
        assert!(self.actions.len() == n && self.dq.len() == n);
        let full = width - width % S::LANES;
        for e in 0..n {
            let action = self.actions[e] as usize * width;
            let hidden = &self.hidden[self.rows[e] as usize * width..][..width];
            let grad = &mut self.grad_t[action..][..width];
            let dq = S::splat(self.dq[e]);
            let (rest, grad_rest) = (&hidden[full..], &mut grad[full..]);
            if !rest.is_empty() {
                dq.mul_add(S::load_partial(rest), S::load_partial(grad_rest)).store_partial(grad_rest);
            }
            let Some(delta) = &mut self.delta else {
                for at in (0..full).step_by(S::LANES) {
                    let grad = &mut grad[at..][..S::LANES];
                    dq.mul_add(S::load(&hidden[at..]), S::load(grad)).store(grad);
                }
                continue;
            };
            let weights = &self.weights_t[action..][..width];
            let delta = &mut delta[e * width..][..width];
            if !rest.is_empty() {
                let product = dq.mul(S::load_partial(&weights[full..]));
                product.gate(S::load_partial(rest)).store_partial(&mut delta[full..]);
            }
            for (((hidden, weights), grad), delta) in hidden
                .chunks_exact(S::LANES)
                .zip(weights.chunks_exact(S::LANES))
                .zip(grad.chunks_exact_mut(S::LANES))
                .zip(delta.chunks_exact_mut(S::LANES))
            {
                let hidden = S::load(hidden);
                dq.mul_add(hidden, S::load(grad)).store(grad);
                dq.mul(S::load(weights)).gate(hidden).store(delta);
            }
        }
    }
}
