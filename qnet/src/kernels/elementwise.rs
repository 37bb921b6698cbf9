//! Kernels that treat every element of a vector alike: Adam, scaling, blending.

use super::vector::{Op, Vector};

/// One Adam step on a whole vector; the scalars are worked out in [`crate::Adam::step`].
pub(crate) struct AdamStep<'a> {
    /// Parameters; updated.
    pub(crate) params: &'a mut [f32],
    /// Mean of the gradient; updated.
    pub(crate) m: &'a mut [f32],
    /// Mean of the squared gradient; updated.
    pub(crate) v: &'a mut [f32],
    /// Gradient.
    pub(crate) grad: &'a [f32],
    /// Share of the gradient in the new `m`: one minus its decay.
    pub(crate) new1: f32,
    /// Decay of `v`.
    pub(crate) beta2: f32,
    /// Share of the squared gradient in the new `v`. Not worked out from `beta2` in `f32`: at a decay of
    /// 0.999 that would be off by 5 parts in 100,000.
    pub(crate) new2: f32,
    /// Learning rate over the bias correction of `m`.
    pub(crate) step_size: f32,
    /// One over the square root of the bias correction of `v`.
    pub(crate) root_scale: f32,
    /// Added to the root.
    pub(crate) eps: f32,
}

/// The scalars of [`AdamStep`] in every lane.
struct AdamLanes<S> {
    new1: S,
    beta2: S,
    new2: S,
    step: S,
    root_scale: S,
    eps: S,
}

impl<S: Vector> AdamLanes<S> {
    /// New parameters and moments `(p, m, v)` from old ones and the gradient.
    #[inline(always)]
    fn update(&self, p: S, m: S, v: S, g: S) -> (S, S, S) {
        // A unit that died leaves moments that shrink for ever. Arithmetic on subnormals is slow, and they
        // could add far less than one rounding error to any parameter.
        let m = g.sub(m).mul_add(self.new1, m).flush_subnormal();
        let v = g.mul(self.new2).mul_add(g, v.mul(self.beta2)).flush_subnormal();
        let p = self.step.mul(m).div(v.sqrt().mul_add(self.root_scale, self.eps)).add(p);
        (p, m, v)
    }
}

impl Op for AdamStep<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Vector>(self) {
        let n = self.params.len();
        assert!(self.m.len() == n && self.v.len() == n && self.grad.len() == n);
        let lanes = AdamLanes {
            new1: S::splat(self.new1),
            beta2: S::splat(self.beta2),
            new2: S::splat(self.new2),
            step: S::splat(-self.step_size),
            root_scale: S::splat(self.root_scale),
            eps: S::splat(self.eps),
        };
        let full = n - n % S::LANES;
        let mut at = 0;
        while at < full {
            let here = at..at + S::LANES;
            let (p, m, v) =
                (&mut self.params[here.clone()], &mut self.m[here.clone()], &mut self.v[here.clone()]);
            let new = lanes.update(S::load(p), S::load(m), S::load(v), S::load(&self.grad[here]));
            new.0.store(p);
            new.1.store(m);
            new.2.store(v);
            at += S::LANES;
        }
        if full < n {
            let (p, m, v) = (&mut self.params[full..], &mut self.m[full..], &mut self.v[full..]);
            let grad = S::load_partial(&self.grad[full..]);
            let new = lanes.update(S::load_partial(p), S::load_partial(m), S::load_partial(v), grad);
            new.0.store_partial(p);
            new.1.store_partial(m);
            new.2.store_partial(v);
        }
    }
}

/// `x *= factor`.
pub(crate) struct Scale<'a> {
    /// Scaled in place.
    pub(crate) x: &'a mut [f32],
    /// The factor.
    pub(crate) factor: f32,
}

impl Op for Scale<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Vector>(self) {
        for x in self.x {
            *x *= self.factor;
        }
    }
}

/// `out = 2 * (x - low) / (high - low) - 1`: `low..=high` onto `-1..=1`.
pub(crate) struct Rescale<'a, T> {
    /// The numbers.
    pub(crate) x: &'a [T],
    /// What becomes -1, for each number.
    pub(crate) low: &'a [f32],
    /// What becomes 1.
    pub(crate) high: &'a [f32],
    /// As long as the others; overwritten.
    pub(crate) out: &'a mut [f32],
}

impl<T: Copy + Into<f32>> Op for Rescale<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<S: Vector>(self) {
        self.each();
    }
}

impl<T: Copy + Into<f32>> Rescale<'_, T> {
    /// One number after the other, or as the compiler makes vectors of them.
    #[inline(always)]
    pub(crate) fn each(self) {
        for (((out, &x), &low), &high) in self.out.iter_mut().zip(self.x).zip(self.low).zip(self.high) {
            *out = rescaled(x.into(), low, high);
        }
    }
}

/// `low..=high` onto `-1..=1`.
#[inline(always)]
pub(crate) fn rescaled(x: f32, low: f32, high: f32) -> f32 {
    2.0 * (x - low) / (high - low) - 1.0
}

/// `x = share * y + (1 - share) * x`.
pub(crate) struct Blend<'a> {
    /// Blended in place.
    pub(crate) x: &'a mut [f32],
    /// Blended into `x`; as long as `x`.
    pub(crate) y: &'a [f32],
    /// Its share, 0 to 1.
    pub(crate) share: f32,
}

impl Op for Blend<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Vector>(self) {
        assert_eq!(self.x.len(), self.y.len());
        let rest = 1.0 - self.share;
        for (x, &y) in self.x.iter_mut().zip(self.y) {
            *x = self.share.mul_add(y, rest * *x);
        }
    }
}
