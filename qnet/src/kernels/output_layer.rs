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
            let mut at = 0;
            while at < full {
                let here = at..at + S::LANES;
                let sum = dq.mul_add(S::load(&hidden[here.clone()]), S::load(&grad[here.clone()]));
                sum.store(&mut grad[here]);
                at += S::LANES;
            }
            if full < width {
                let rest = &mut grad[full..];
                dq.mul_add(S::load_partial(&hidden[full..]), S::load_partial(rest)).store_partial(rest);
            }
            let Some(delta) = &mut self.delta else { continue };
            let delta = &mut delta[e * width..][..width];
            let weights = &self.weights_t[action..][..width];
            let mut at = 0;
            while at < full {
                let here = at..at + S::LANES;
                let product = dq.mul(S::load(&weights[here.clone()]));
                product.gate(S::load(&hidden[here.clone()])).store(&mut delta[here]);
                at += S::LANES;
            }
            if full < width {
                let product = dq.mul(S::load_partial(&weights[full..]));
                product.gate(S::load_partial(&hidden[full..])).store_partial(&mut delta[full..]);
            }
        }
    }
}
