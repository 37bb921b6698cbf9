//! The online and the target network of Q-learning, each one flat candle tensor.
//!
//! candle is the tensor, autodiff and checkpoint library: the online parameters are a `Var`, so
//! [`crate::autodiff`] differentiates with respect to this very storage and checks the kernels' results.
//! The hot path borrows the storage as a slice and changes it through one candle in-place operation, which
//! copies and allocates nothing.

use std::cell::Cell;

use candle_core::{CpuStorage, Device, InplaceOp1, Storage, Tensor, Var};

use crate::kernels::{Blend, Kernels};
use crate::layout::Layout;
use crate::threads::{Threads, Work, share};

/// Why a network could not be made, loaded or used.
#[derive(Debug, thiserror::Error)]
pub enum NetworkError {
    /// The number of parameters does not fit the layout.
    #[error("the {what} network has {got} parameters, but its layout {sizes:?} needs {expected}")]
    Length {
        /// `online` or `target`.
        what: &'static str,
        /// The number given.
        got: usize,
        /// The number needed.
        expected: usize,
        /// Sizes of the layout.
        sizes: Vec<usize>,
    },
    /// A parameter is NaN or infinite.
    #[error("parameter {index} of the {what} network is {got}; accepted are finite numbers")]
    NotFinite {
        /// `online` or `target`.
        what: &'static str,
        /// Its position in the flat vector.
        index: usize,
        /// The value given.
        got: f32,
    },
    /// candle reported an error.
    #[error("candle failed on the network's parameters: {0}")]
    Candle(#[from] candle_core::Error),
}

/// The parameters of an online and a target network of the same layout.
#[derive(Debug)]
pub struct QNetwork {
    layout: Layout,
    kernels: Kernels,
    online: Var,
    /// A tensor with its own storage: a candle clone would share the online network's and never lag behind
    /// it.
    target: Tensor,
    /// Views of one element on the storage of `online` and `target`, which in-place operations go through:
    /// before each one, candle allocates a list of the tensor's dimensions longer than 1.
    online_handle: Tensor,
    target_handle: Tensor,
}

impl QNetwork {
    /// A network whose online and target parameters are both `params`, in the order of [`Layout`].
    ///
    /// # Errors
    /// Another number of parameters than the layout needs, or one that is not finite.
    pub fn new(layout: Layout, params: &[f32]) -> Result<QNetwork, NetworkError> {
        check(&layout, "online", params)?;
        let online = Var::from_slice(params, params.len(), &Device::Cpu)?;
        let target = Tensor::from_slice(params, params.len(), &Device::Cpu)?;
        let (online_handle, target_handle) =
            (online.narrow(0, 0, 1)?.detach(), target.narrow(0, 0, 1)?.detach());
        Ok(QNetwork { layout, kernels: Kernels::detect(), online, target, online_handle, target_handle })
    }

    /// The same network, computed with `kernels` instead of the fastest ones of this machine.
    pub fn with_kernels(mut self, kernels: Kernels) -> QNetwork {
        self.kernels = kernels;
        self
    }

    /// The layout of both networks.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// The online parameters as a candle variable, `[n_params]`. A clone of it shares the storage.
    pub fn online(&self) -> &Var {
        &self.online
    }

    /// The target parameters as a candle tensor, `[n_params]`. A clone of it shares the storage.
    pub fn target(&self) -> &Tensor {
        &self.target
    }

    /// Hands the online and the target parameters, in this order, to `f`, without a copy.
    ///
    /// # Errors
    /// None in practice: candle's types allow for tensors elsewhere than in memory.
    pub fn with_params<R>(&self, f: impl FnOnce(&[f32], &[f32]) -> R) -> Result<R, NetworkError> {
        let ((online, _), (target, _)) = (self.online.storage_and_layout(), self.target.storage_and_layout());
        Ok(f(flat(&online)?, flat(&target)?))
    }

    /// Lets `f` change the online parameters in place. It must not touch candle handles of this network.
    ///
    /// # Errors
    /// As [`QNetwork::with_params`].
    pub fn update<R>(&mut self, f: impl FnOnce(&mut [f32]) -> R) -> Result<R, NetworkError> {
        in_place(&self.online_handle, f)
    }

    /// Copies the online parameters into the target network.
    ///
    /// # Errors
    /// As [`QNetwork::with_params`].
    pub fn hard_update(&mut self) -> Result<(), NetworkError> {
        let (online, _) = self.online.storage_and_layout();
        let online = flat(&online)?;
        in_place(&self.target_handle, |target| target.copy_from_slice(online))
    }

    /// Moves the target network towards the online one: `target = tau * online + (1 - tau) * target`, `tau`
    /// from 0 to 1. `threads` share the work.
    ///
    /// # Errors
    /// As [`QNetwork::with_params`].
    pub fn polyak_update(&mut self, tau: f32, threads: &Threads) -> Result<(), NetworkError> {
        let (online, _) = self.online.storage_and_layout();
        let online = flat(&online)?;
        let (kernels, whole) = (self.kernels, online.len());
        in_place(&self.target_handle, |target| {
            let blend = Blend { x: target, y: online, share: tau };
            threads.run(whole * AS_MULTIPLY_ADDS, Share { kernels, whole, blend });
        })
    }

    /// Replaces the parameters of both networks, as from a checkpoint. Nothing changes if either is refused.
    ///
    /// # Errors
    /// Another number of parameters than the layout needs, or one that is not finite.
    pub fn load(&mut self, online: &[f32], target: &[f32]) -> Result<(), NetworkError> {
        check(&self.layout, "online", online)?;
        check(&self.layout, "target", target)?;
        in_place(&self.online_handle, |params| params.copy_from_slice(online))?;
        in_place(&self.target_handle, |params| params.copy_from_slice(target))
    }
}

/// What blending one parameter costs, in multiply-adds of a matrix product: it is a matter of memory.
const AS_MULTIPLY_ADDS: usize = 16;

/// The blending of some of the parameters.
struct Share<'a> {
    kernels: Kernels,
    /// Parameters of all parts.
    whole: usize,
    blend: Blend<'a>,
}

impl Work for Share<'_> {
    fn split(self, part: usize, parts: usize) -> (Self, Self) {
        let Share { kernels, whole, blend: Blend { x, y, share: tau } } = self;
        let at = share(whole, part, parts);
        let ((x, x_rest), (y, y_rest)) = (x.split_at_mut(at), y.split_at(at));
        let of = |x, y| Share { kernels, whole, blend: Blend { x, y, share: tau } };
        (of(x, y), of(x_rest, y_rest))
    }

    fn run(self) {
        self.kernels.run(self.blend);
    }
}

fn check(layout: &Layout, what: &'static str, params: &[f32]) -> Result<(), NetworkError> {
    let (got, expected) = (params.len(), layout.n_params());
    if got != expected {
        return Err(NetworkError::Length { what, got, expected, sizes: layout.sizes().to_vec() });
    }
    match params.iter().position(|p| !p.is_finite()) {
        Some(index) => Err(NetworkError::NotFinite { what, index, got: params[index] }),
        None => Ok(()),
    }
}

/// The numbers of a flat tensor in memory.
fn flat(storage: &Storage) -> candle_core::Result<&[f32]> {
    match storage {
        Storage::Cpu(storage) => storage.as_slice(),
        _ => Err(candle_core::Error::Msg("the parameters are not in the CPU's memory".into())),
    }
}

/// A closure as a candle in-place operation.
struct InPlace<F, R> {
    f: Cell<Option<F>>,
    result: Cell<Option<R>>,
}

impl<R, F: FnOnce(&mut [f32]) -> R> InplaceOp1 for InPlace<F, R> {
    fn name(&self) -> &'static str {
        "update-parameters"
    }

    fn cpu_fwd(&self, storage: &mut CpuStorage, _: &candle_core::Layout) -> candle_core::Result<()> {
        // The whole storage, even if the handle shows a part of it.
        if let (CpuStorage::F32(params), Some(f)) = (storage, self.f.take()) {
            self.result.set(Some(f(params)));
        }
        Ok(())
    }
}

/// Runs `f` on the whole storage that `handle` is a view on.
fn in_place<R>(handle: &Tensor, f: impl FnOnce(&mut [f32]) -> R) -> Result<R, NetworkError> {
    let op = InPlace { f: Cell::new(Some(f)), result: Cell::new(None) };
    handle.inplace_op1(&op)?;
    let missing = || candle_core::Error::Msg("the parameters are not f32 in the CPU's memory".into());
    Ok(op.result.into_inner().ok_or_else(missing)?)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn network() -> QNetwork {
        QNetwork::new(Layout::new(&[1, 2]).unwrap(), &[1.0, 2.0, 3.0, 4.0]).unwrap()
    }

    #[test]
    fn an_update_happens_in_place_and_the_target_lags() {
        let mut network = network();
        let before = network.with_params(|online, _| online.as_ptr()).unwrap();
        let sum: f32 = network
            .update(|params| {
                params[0] = 10.0;
                params.iter().sum()
            })
            .unwrap();
        assert_eq!(sum, 19.0);
        assert_eq!(network.online().to_vec1::<f32>().unwrap(), [10.0, 2.0, 3.0, 4.0]);
        assert_eq!(network.target().to_vec1::<f32>().unwrap(), [1.0, 2.0, 3.0, 4.0]);
        network
            .with_params(|online, target| {
                assert_eq!(online.as_ptr(), before);
                assert_eq!((online[0], target[0]), (10.0, 1.0));
            })
            .unwrap();
    }

    #[test]
    fn the_target_follows() {
        let mut network = network();
        network.update(|params| params.fill(5.0)).unwrap();
        network.polyak_update(0.25, &Threads::default()).unwrap();
        assert_eq!(network.target().to_vec1::<f32>().unwrap(), [2.0, 2.75, 3.5, 4.25]);
        network.polyak_update(0.0, &Threads::default()).unwrap();
        assert_eq!(network.target().to_vec1::<f32>().unwrap(), [2.0, 2.75, 3.5, 4.25]);
        network.polyak_update(1.0, &Threads::default()).unwrap();
        assert_eq!(network.target().to_vec1::<f32>().unwrap(), [5.0; 4]);
        network.update(|params| params.fill(6.0)).unwrap();
        network.hard_update().unwrap();
        assert_eq!(network.target().to_vec1::<f32>().unwrap(), [6.0; 4]);
    }

    #[test]
    fn loading_is_all_or_nothing() {
        let mut network = network();
        let error = network.load(&[0.0; 4], &[0.0; 3]).unwrap_err();
        assert_eq!(error.to_string(), "the target network has 3 parameters, but its layout [1, 2] needs 4");
        let error = network.load(&[0.0, f32::NAN, 0.0, 0.0], &[0.0; 4]).unwrap_err();
        assert_eq!(
            error.to_string(),
            "parameter 1 of the online network is NaN; accepted are finite numbers"
        );
        assert_eq!(network.online().to_vec1::<f32>().unwrap(), [1.0, 2.0, 3.0, 4.0]);
        network.load(&[7.0; 4], &[8.0; 4]).unwrap();
        network
            .with_params(|online, target| assert_eq!((online, target), (&[7.0; 4][..], &[8.0; 4][..])))
            .unwrap();
        assert!(QNetwork::new(Layout::new(&[1, 2]).unwrap(), &[0.0; 5]).is_err());
    }
}
