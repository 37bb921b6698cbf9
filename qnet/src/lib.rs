//! The Q-network as one flat parameter vector: layout, input encoding, forward pass, gradient step and Adam.
//!
//! A network is a [`Layout`] (how many units in which layer) and a `&[f32]` (every weight and bias, in one
//! fixed order). All that a process does with a network is a plain function over these two:
//!
//! * [`encode`]: from an environment's observation to the network's input;
//! * [`forward`], [`forward_train`], [`backward()`], [`backward_outputs`]: values, and the gradient of any weighted sum of
//!   them, or of a loss of whole rows;
//! * [`Loss`], [`Adam`], [`clip_grad_norm`]: from values and targets to the next parameters;
//! * [`Threads`]: several threads that share the work of a step, with the same bits;
//! * [`QNetwork`]: the online and the target parameters, held in candle tensors;
//! * [`network_of`], [`kernels_of`]: the shape and the instruction set that an experiment asks for;
//! * [`autodiff`]: the same loss and gradient through candle's automatic differentiation.
//!
//! The arithmetic lives in [`kernels`], which picks an instruction set at run time and gives the same bits on
//! every one of them. This crate knows nothing of replay buffers, mentors or processes.

pub mod adam;
pub mod autodiff;
pub mod encode;
pub mod kernels;
pub mod layout;
pub mod loss;
pub mod net;
pub mod qnetwork;
pub mod run;
pub mod threads;

mod backward;
mod buffer;

pub use adam::{Adam, AdamConfig, AdamError, clip_grad_norm};
pub use backward::{RowGrad, backward, backward_outputs};
pub use buffer::AlignedBuffer;
pub use encode::{Encoding, EncodingError};
pub use kernels::{Isa, Kernels};
pub use layout::{Conv, Grid, Layer, Layout, LayoutError, init};
pub use loss::{Loss, LossError};
pub use net::{Workspace, argmax, forward, forward_train};
pub use qnetwork::{NetworkError, QNetwork};
pub use run::{PlanError, kernels_of, network_of, threads_of};
pub use threads::{Threads, ThreadsError};
