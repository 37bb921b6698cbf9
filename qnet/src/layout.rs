//! The shape of a network and where each of its parameters lies in one flat vector.
//!
//! For each layer in order: the weights as `[inputs][outputs]` row-major, then the bias `[outputs]`. Weights
//! are stored input-major because every kernel then reads a whole row of outputs with one vector load.
//!
//! A network may begin with convolutions. To a convolution, `inputs` are the numbers under its kernel, in the order row, column,
//! channel, and `outputs` its channels: it is the same dense layer at every position. What it gives is
//! `[height][width][channels]`, row-major, which the next layer takes as it lies.

use std::ops::Range;

use rand::Rng;

/// The widest input, hidden layer or output that a network may have, in units. Our choice: far above any
/// environment here, and low enough that a layer's parameters always fit in memory.
pub const MAX_WIDTH: usize = 4096;

/// The largest number of layers, hence at most six hidden ones. Our choice.
pub const MAX_LAYERS: usize = 7;

/// The most numbers that a convolution may give for one input: positions times channels. Our choice: four times
/// [`MAX_WIDTH`], since a convolution has few parameters.
pub const MAX_PLANES: usize = 4 * MAX_WIDTH;

/// Columns of a panel of transposed weights: a multiple of every tile's, and few enough for the panel to stay in the
/// second-level cache.
pub(crate) const PANEL: usize = 64;

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
    /// One size of a network with convolutions is zero or too large.
    #[error("layer {index} of the network has {got} numbers (0 is the input); accepted are 1 to {most}")]
    Size {
        /// Position of the size in the list, from 0 (the input).
        index: usize,
        /// The size.
        got: usize,
        /// The largest one.
        most: usize,
    },
    /// A kernel that does not fit.
    #[error(
        "convolution {layer} has kernel {kernel} and stride {stride}; accepted for its {height} x {width} grid: a kernel of 1 to {most}, a stride of 1 or more",
        most = height.min(width)
    )]
    Kernel {
        /// Which convolution, from 0.
        layer: usize,
        /// Its kernel.
        kernel: usize,
        /// Its stride.
        stride: usize,
        /// Rows of its input.
        height: usize,
        /// Columns of its input.
        width: usize,
    },
}

/// An input that is a grid: `[height][width][channels]`, row-major, or `[channels][height][width]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Numbers at each position.
    pub channels: usize,
    /// Whether the channels come first.
    pub channels_first: bool,
}

impl Grid {
    /// Numbers of one input.
    pub fn numbers(&self) -> usize {
        self.height * self.width * self.channels
    }
}

/// What a convolution of a grid is: a square kernel at every position where it fits, `stride` apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Conv {
    /// Its input.
    pub grid: Grid,
    /// Rows and columns of the kernel.
    pub kernel: usize,
    /// Rows and columns from one position to the next.
    pub stride: usize,
}

impl Conv {
    /// Rows and columns of positions.
    pub fn places(&self) -> [usize; 2] {
        [self.grid.height, self.grid.width].map(|side| (side - self.kernel) / self.stride + 1)
    }

    /// For each position, in row-major order, where the first number under the kernel lies in the input.
    pub fn bases(&self) -> impl Iterator<Item = usize> {
        let (conv, [rows, columns]) = (*self, self.places());
        let at = move |row, column| conv.place(row * conv.stride, column * conv.stride, 0);
        (0..rows).flat_map(move |row| (0..columns).map(move |column| at(row, column)))
    }

    /// How far the numbers under the kernel lie from the first, in the order of the weights: row, column, channel.
    pub fn offsets(&self) -> impl Iterator<Item = usize> {
        let (conv, k) = (*self, self.kernel);
        let each = move |row| {
            (0..k)
                .flat_map(move |column| (0..conv.grid.channels).map(move |c| (column, c)))
                .map(move |(column, channel)| conv.place(row, column, channel))
        };
        (0..k).flat_map(each)
    }

    /// Where a number lies in the input.
    fn place(&self, row: usize, column: usize, channel: usize) -> usize {
        let Grid { height, width, channels, channels_first } = self.grid;
        if channels_first {
            (channel * height + row) * width + column
        } else {
            (row * width + column) * channels + channel
        }
    }
}

/// One layer: its size and where its parameters lie in the flat vector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layer {
    /// Number of inputs: of a convolution, those under its kernel.
    pub inputs: usize,
    /// Number of outputs: of a convolution, its channels.
    pub outputs: usize,
    /// Offset of the first weight in the flat vector, in parameters.
    pub offset: usize,
    /// What it is a convolution of; none for a dense layer.
    pub conv: Option<Conv>,
}

impl Layer {
    /// Where the weights lie, `[inputs][outputs]` row-major.
    pub fn weights(&self) -> Range<usize> {
        self.offset..self.offset + self.inputs * self.outputs
    }

    /// How often it is applied to one input of the network: the positions of a convolution, or 1.
    pub fn positions(&self) -> usize {
        self.conv.map_or(1, |conv| conv.places().iter().product())
    }

    /// Numbers that it takes for one input of the network.
    pub fn width_in(&self) -> usize {
        self.conv.map_or(self.inputs, |conv| conv.grid.numbers())
    }

    /// Numbers that it gives for one input of the network.
    pub fn width_out(&self) -> usize {
        self.positions() * self.outputs
    }

    /// Multiply-adds for one input of the network.
    pub(crate) fn multiply_adds(&self) -> usize {
        self.positions() * self.weights().len()
    }

    /// Where the bias lies, `[outputs]`; directly behind the weights.
    pub fn bias(&self) -> Range<usize> {
        let start = self.offset + self.inputs * self.outputs;
        start..start + self.outputs
    }
}

/// The sizes of a network with ReLU between its layers and a linear output. All its layers are dense but for the first, which
/// may be convolutions.
///
/// Two layouts are equal exactly if their layers are, and then their flat vectors mean the same.
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
        let mut layout = Layout { sizes: vec![sizes[0]], layers: Vec::with_capacity(sizes.len() - 1) };
        sizes[1..].iter().for_each(|&outputs| layout.push(outputs, None));
        Ok(layout)
    }

    /// A layout that begins with convolutions of `grid`: of each `(channels, kernel, stride)`. `dense` are the sizes of the
    /// layers behind them, the last of which is the output.
    ///
    /// # Errors
    /// No layer behind the convolutions, more than [`MAX_LAYERS`] together, a size out of range, or a kernel that does not fit into
    /// what it is to be applied to.
    pub fn with_conv(
        grid: Grid,
        convs: &[(usize, usize, usize)],
        dense: &[usize],
    ) -> Result<Layout, LayoutError> {
        let count = 1 + convs.len() + dense.len();
        if dense.is_empty() || count > MAX_LAYERS + 1 {
            return Err(LayoutError::Depth { got: count });
        }
        let mut layout = Layout { sizes: vec![grid.numbers()], layers: Vec::with_capacity(count - 1) };
        let mut grid = grid;
        for (at, &(channels, kernel, stride)) in convs.iter().enumerate() {
            let side = grid.height.min(grid.width);
            if kernel == 0 || kernel > side || stride == 0 {
                let Grid { height, width, .. } = grid;
                return Err(LayoutError::Kernel { layer: at, kernel, stride, height, width });
            }
            let conv = Conv { grid, kernel, stride };
            let [height, width] = conv.places();
            grid = Grid { height, width, channels, channels_first: false };
            layout.push(channels, Some(conv));
        }
        dense.iter().for_each(|&outputs| layout.push(outputs, None));
        for (index, &got) in layout.sizes.iter().enumerate() {
            let most = if (1..=convs.len()).contains(&index) { MAX_PLANES } else { MAX_WIDTH };
            if got == 0 || got > most {
                return Err(LayoutError::Size { index, got, most });
            }
        }
        Ok(layout)
    }

    /// Appends a layer.
    fn push(&mut self, outputs: usize, conv: Option<Conv>) {
        let width = self.sizes[self.sizes.len() - 1];
        let inputs = conv.map_or(width, |conv| conv.kernel * conv.kernel * conv.grid.channels);
        let layer = Layer { inputs, outputs, offset: self.n_params(), conv };
        self.sizes.push(layer.width_out());
        self.layers.push(layer);
    }

    /// Numbers of the input, of what each hidden layer gives, and of the output.
    pub fn sizes(&self) -> &[usize] {
        &self.sizes
    }

    /// The layers, from the input to the output; at least one.
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

/// Fresh parameters as PyTorch's `nn.Linear` and `nn.Conv2d` draw them by default: weights and biases of a layer uniform in
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
pub(crate) mod testing {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    /// Dense networks of layers of up to `most` units, and networks that begin with one or two convolutions.
    pub(crate) fn layouts(most: usize) -> impl Strategy<Value = Layout> {
        let dense = prop::collection::vec(1..most, 2..6).prop_map(|sizes| Layout::new(&sizes).unwrap());
        let grid = (3usize..8, 3usize..8, 1usize..5, any::<bool>());
        let conv = (1usize..20, 1usize..4, 1usize..3);
        let convs = prop::collection::vec(conv, 1..3);
        let conv = (grid, convs, prop::collection::vec(1..most, 1..4)).prop_map(|(grid, convs, dense)| {
            let (height, width, channels, channels_first) = grid;
            let grid = Grid { height, width, channels, channels_first };
            // The second one may not fit.
            let network = |n: usize| Layout::with_conv(grid, &convs[..n], &dense).ok();
            network(convs.len()).or_else(|| network(1)).unwrap()
        });
        prop_oneof![dense, conv]
    }

    /// Where a layer begins to read its input, at each of its positions, and how far from there its inputs lie.
    pub(crate) fn places(layer: &Layer) -> (Vec<usize>, Vec<usize>) {
        match layer.conv {
            Some(conv) => (conv.bases().collect(), conv.offsets().collect()),
            None => (vec![0], (0..layer.inputs).collect()),
        }
    }
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
    fn a_convolution_is_the_same_layer_at_every_position() {
        let grid = Grid { height: 4, width: 5, channels: 2, channels_first: false };
        let layout = Layout::with_conv(grid, &[(3, 2, 2), (7, 1, 1)], &[6, 4]).unwrap();
        assert_eq!(layout.sizes(), [40, 2 * 2 * 3, 2 * 2 * 7, 6, 4]);
        let [first, second, dense, last] = layout.layers() else { panic!("{layout:?}") };
        assert_eq!((first.inputs, first.outputs, first.weights(), first.bias()), (8, 3, 0..24, 24..27));
        assert_eq!((second.inputs, second.width_in(), second.offset), (3, 12, 27));
        assert_eq!((dense.inputs, dense.width_in(), last.bias().end), (28, 28, layout.n_params()));
        let conv = first.conv.unwrap();
        assert_eq!(conv.bases().collect::<Vec<_>>(), [0, 4, 20, 24]);
        assert_eq!(conv.offsets().collect::<Vec<_>>(), [0, 1, 2, 3, 10, 11, 12, 13]);
        let first = Conv { grid: Grid { channels_first: true, ..grid }, ..conv };
        assert_eq!(first.bases().collect::<Vec<_>>(), [0, 2, 10, 12]);
        assert_eq!(first.offsets().collect::<Vec<_>>(), [0, 20, 1, 21, 5, 25, 6, 26]);
    }

    #[test]
    fn convolutions_that_do_not_fit_are_named() {
        let grid = Grid { height: 10, width: 10, channels: 4, channels_first: false };
        let refused = |convs: &[(usize, usize, usize)], dense: &[usize]| {
            Layout::with_conv(grid, convs, dense).unwrap_err().to_string()
        };
        assert!(refused(&[(16, 11, 1)], &[4]).contains("a kernel of 1 to 10"));
        assert!(refused(&[(16, 3, 1), (16, 9, 1)], &[4]).starts_with("convolution 1 has kernel 9"));
        assert!(refused(&[(16, 3, 0)], &[4]).contains("stride 0"));
        assert!(refused(&[(0, 3, 1)], &[4]).contains("layer 1 of the network has 0 numbers"));
        assert!(refused(&[(1000, 3, 1)], &[4]).contains("accepted are 1 to 16384"));
        assert!(refused(&[(16, 3, 1)], &[]).contains("2 to 8 sizes"));
        assert!(refused(&[(1, 1, 1); 7], &[4]).contains("9 were given"));
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
