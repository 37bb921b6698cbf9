//! The shape of a fully connected network and where each of its parameters lies in one flat vector.
//!
//! For each layer in order: the weights as `[inputs][outputs]` row-major, then the bias `[outputs]`. Weights
//! are stored input-major because every kernel then reads a whole row of outputs with one vector load.

use std::ops::Range;

use rand::Rng;

/// The widest input, hidden layer or output that a network may have, in units. Our choice: far above any
/// environment here, and low enough that a layer's parameters always fit in memory.
pub const MAX_WIDTH: usize = 4096;

/// The largest number of dense layers, hence at most six hidden ones. Our choice.
pub const MAX_LAYERS: usize = 7;

/// Why a list of sizes is no network.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LayoutError {
    /// Too few or too many sizes.
    #[error(
        "a network needs 2 to {max} sizes (input, hidden layers, output), but {got} were given",
        max = MAX_LAYERS + 1
    )]
    Depth {
        /// How many sizes were given.
        got: usize,
    },
    /// One size is zero or above [`MAX_WIDTH`].
    #[error("size {index} of the network is {got}; accepted are 1 to {MAX_WIDTH}")]
    Width {
        /// Position of the size in the list, from 0 (the input).
        index: usize,
        /// The size given.
        got: usize,
    },
}

/// One dense layer: its size and where its parameters lie in the flat vector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layer {
    /// Number of inputs.
    pub inputs: usize,
    /// Number of outputs.
    pub outputs: usize,
    /// Offset of the first weight in the flat vector, in parameters.
    pub offset: usize,
}

impl Layer {
    /// Where the weights lie, `[inputs][outputs]` row-major.
    pub fn weights(&self) -> Range<usize> {
        self.offset..self.offset + self.inputs * self.outputs
    }

    /// Where the bias lies, `[outputs]`; directly behind the weights.
    pub fn bias(&self) -> Range<usize> {
        let start = self.offset + self.inputs * self.outputs;
        start..start + self.outputs
    }
}

/// The sizes of a fully connected network with ReLU between its layers and a linear output.
///
/// Two layouts are equal exactly if their sizes are, and then their flat vectors mean the same.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layout {
    sizes: Vec<usize>,
    layers: Vec<Layer>,
}

impl Layout {
    /// A layout from input size, hidden sizes and output size (the number of actions), in this order.
    ///
    /// # Errors
    /// Fewer than two sizes, more than [`MAX_LAYERS`] layers, or a size outside 1..=[`MAX_WIDTH`].
    pub fn new(sizes: &[usize]) -> Result<Layout, LayoutError> {
        if sizes.len() < 2 || sizes.len() > MAX_LAYERS + 1 {
            return Err(LayoutError::Depth { got: sizes.len() });
        }
        for (index, &got) in sizes.iter().enumerate() {
            if got == 0 || got > MAX_WIDTH {
                return Err(LayoutError::Width { index, got });
            }
        }
        let mut layers = Vec::with_capacity(sizes.len() - 1);
        let mut offset = 0;
        for pair in sizes.windows(2) {
            let layer = Layer { inputs: pair[0], outputs: pair[1], offset };
            offset = layer.bias().end;
            layers.push(layer);
        }
        Ok(Layout { sizes: sizes.to_vec(), layers })
    }

    /// The sizes as given to [`Layout::new`].
    pub fn sizes(&self) -> &[usize] {
        &self.sizes
    }

    /// The dense layers, from the input to the output; at least one.
    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }

    /// Number of input features.
    pub fn input(&self) -> usize {
        self.sizes[0]
    }

    /// Number of outputs: one Q-value an action.
    pub fn output(&self) -> usize {
        self.sizes[self.sizes.len() - 1]
    }

    /// Length of the flat parameter vector.
    pub fn n_params(&self) -> usize {
        self.layers.last().map_or(0, |layer| layer.bias().end)
    }

    /// Width of the widest hidden layer; 0 if there is none.
    pub fn max_hidden(&self) -> usize {
        self.sizes[1..self.sizes.len() - 1].iter().copied().max().unwrap_or(0)
    }
}

/// Fresh parameters as PyTorch's `nn.Linear` draws them by default: weights and biases of a layer uniform in
/// `[-1/sqrt(inputs), 1/sqrt(inputs))`.
///
/// One `f32` is drawn for each parameter in the order of the flat vector, so that the result depends on the
/// layout and the state of `rng` alone.
pub fn init(layout: &Layout, rng: &mut impl Rng) -> Vec<f32> {
    let mut params = Vec::with_capacity(layout.n_params());
    for layer in layout.layers() {
        let bound = 1.0 / (layer.inputs as f32).sqrt();
        let n = (layer.inputs + 1) * layer.outputs;
        params.extend((0..n).map(|_| (2.0 * rng.random::<f32>() - 1.0) * bound));
    }
    params
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn offsets_are_dense_and_in_order() {
        let layout = Layout::new(&[2, 3, 4]).unwrap();
        assert_eq!(layout.layers()[0].weights(), 0..6);
        assert_eq!(layout.layers()[0].bias(), 6..9);
        assert_eq!(layout.layers()[1].weights(), 9..21);
        assert_eq!(layout.layers()[1].bias(), 21..25);
        assert_eq!(layout.n_params(), 25);
        assert_eq!((layout.input(), layout.output(), layout.max_hidden()), (2, 4, 3));
    }

    #[test]
    fn sizes_out_of_range_are_named() {
        assert_eq!(Layout::new(&[3]), Err(LayoutError::Depth { got: 1 }));
        assert_eq!(Layout::new(&[1; 9]), Err(LayoutError::Depth { got: 9 }));
        assert_eq!(Layout::new(&[2, 0, 1]), Err(LayoutError::Width { index: 1, got: 0 }));
        assert_eq!(Layout::new(&[2, 4097]), Err(LayoutError::Width { index: 1, got: 4097 }));
        let message = Layout::new(&[2, 4097]).unwrap_err().to_string();
        assert_eq!(message, "size 1 of the network is 4097; accepted are 1 to 4096");
        assert!(Layout::new(&[1; 8]).is_ok());
        assert_eq!(Layout::new(&[4096, 4096]).unwrap().n_params(), 4096 * 4097);
    }

    #[test]
    fn init_is_bounded_spread_out_and_reproducible() {
        let layout = Layout::new(&[4, 64, 3]).unwrap();
        let params = init(&layout, &mut ChaCha8Rng::seed_from_u64(7));
        assert_eq!(params.len(), layout.n_params());
        assert_eq!(params, init(&layout, &mut ChaCha8Rng::seed_from_u64(7)));
        assert_ne!(params, init(&layout, &mut ChaCha8Rng::seed_from_u64(8)));
        for layer in layout.layers() {
            let bound = 1.0 / (layer.inputs as f32).sqrt();
            let own = &params[layer.weights().start..layer.bias().end];
            assert!(own.iter().all(|p| p.abs() <= bound));
            let mean_square = own.iter().map(|p| p * p).sum::<f32>() / own.len() as f32;
            // The variance of U(-b, b) is b^2 / 3; 195 draws stay well within a fifth of it.
            assert!((mean_square / (bound * bound / 3.0) - 1.0).abs() < 0.2, "{mean_square}");
        }
    }
}
