//! A network as an ONNX model: observations in, a value for each action out. The numbers of fields are those of `onnx.proto`.

use super::protobuf::Message;
use super::{Exported, Network};
use trestle_qnet::{Conv, Grid};

/// Version of the format, and of the set of operators: what every runtime since 2021 has.
const IR_VERSION: u64 = 7;
const OPERATORS: u64 = 13;
/// Types of a tensor's elements.
const FLOAT: u64 = 1;
const INT64: u64 = 7;
/// Types of an attribute.
const INT: u64 = 2;
const INTS: u64 = 7;

/// Names of the model's input and output.
const INPUT: &str = "observation";
const OUTPUT: &str = "q_values";

/// The bytes of the model's file.
pub(crate) fn model(network: &Network) -> Vec<u8> {
    let mut graph = Graph::default();
    let encoded = graph.encode(network);
    let last = network.layers.len() - 1;
    let mut x = encoded;
    let mut planes = false;
    for (i, layer) in network.layers.iter().enumerate() {
        if let Some(conv) = layer.conv {
            if !planes {
                x = graph.planes(&x, conv.grid);
                planes = true;
            }
            x = graph.convolution(&x, i, layer, conv);
            continue;
        }
        if std::mem::take(&mut planes) {
            // A row of numbers in the order of a convolution's: height, width, channel.
            let last = graph.node("Transpose", &[&x], &[Attribute::Integers("perm", &[0, 2, 3, 1])]);
            let shape = graph.integers(&format!("layers.{i}.shape"), &[-1, layer.inputs as i64]);
            x = graph.node("Reshape", &[&last, &shape], &[]);
        }
        let weight =
            graph.floats(&format!("layers.{i}.weight"), &[layer.inputs, layer.outputs], &layer.weights);
        let bias = graph.floats(&format!("layers.{i}.bias"), &[layer.outputs], &layer.bias);
        let product = graph.node("MatMul", &[&x, &weight], &[]);
        if i == last {
            graph.node_into("Add", &[&product, &bias], &[], OUTPUT);
        } else {
            let sum = graph.node("Add", &[&product, &bias], &[]);
            x = graph.node("Relu", &[&sum], &[]);
        }
    }
    let input = value(INPUT, network.low.len(), "features of observations, as the environment gives them");
    let output = value(OUTPUT, network.actions.len(), "values of the actions");
    let graph = Message::new()
        .messages(1, graph.nodes)
        .text(2, "q_network")
        .messages(5, graph.tensors)
        .message(11, input)
        .message(12, output);
    let entry = |(key, value): (String, String)| Message::new().text(1, &key).text(2, &value);
    Message::new()
        .number(1, IR_VERSION)
        .text(2, "trestle")
        .text(3, env!("CARGO_PKG_VERSION"))
        .message(7, graph)
        .message(8, Message::new().text(1, "").number(2, OPERATORS))
        .messages(14, network.metadata().into_iter().map(entry))
        .finish()
}

/// A tensor of `f32`, `[rows][width]` with any number of rows.
fn value(name: &str, width: usize, doc: &str) -> Message {
    let rows = Message::new().text(2, "rows");
    let shape = Message::new().message(1, rows).message(1, Message::new().number(1, width as u64));
    let tensor = Message::new().number(1, FLOAT).message(2, shape);
    Message::new().text(1, name).message(2, Message::new().message(1, tensor)).text(3, doc)
}

/// A setting of an operation.
enum Attribute<'a> {
    Integer(&'a str, u64),
    Integers(&'a str, &'a [u64]),
}

impl Attribute<'_> {
    fn message(&self) -> Message {
        match *self {
            Self::Integer(name, value) => Message::new().text(1, name).number(3, value).number(20, INT),
            Self::Integers(name, values) => {
                let named = Message::new().text(1, name);
                values.iter().fold(named, |message, &value| message.number(8, value)).number(20, INTS)
            }
        }
    }
}

/// What the model computes.
#[derive(Default)]
struct Graph {
    nodes: Vec<Message>,
    tensors: Vec<Message>,
}

impl Graph {
    /// A constant tensor; returns its name.
    fn floats(&mut self, name: &str, dims: &[usize], values: &[f32]) -> String {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.tensor(name, FLOAT, dims, &bytes)
    }

    fn integers(&mut self, name: &str, values: &[i64]) -> String {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.tensor(name, INT64, &[values.len()], &bytes)
    }

    fn tensor(&mut self, name: &str, kind: u64, dims: &[usize], bytes: &[u8]) -> String {
        let tensor = dims.iter().fold(Message::new(), |tensor, &dim| tensor.number(1, dim as u64));
        self.tensors.push(tensor.number(2, kind).text(8, name).bytes(9, bytes));
        name.into()
    }

    /// An operation; returns the name of its result.
    fn node(&mut self, operator: &str, inputs: &[&str], attributes: &[Attribute<'_>]) -> String {
        let output = format!("t{}", self.nodes.len());
        self.node_into(operator, inputs, attributes, &output);
        output
    }

    fn node_into(&mut self, operator: &str, inputs: &[&str], attributes: &[Attribute<'_>], output: &str) {
        let node = inputs.iter().fold(Message::new(), |node, input| node.text(1, input));
        let attributes = attributes.iter().map(Attribute::message);
        self.nodes.push(node.text(2, output).text(4, operator).messages(5, attributes));
    }

    /// The rows `x` as grids with the channels first; returns their name.
    fn planes(&mut self, x: &str, grid: Grid) -> String {
        let [height, width, channels] = [grid.height, grid.width, grid.channels].map(|side| side as i64);
        let shape =
            if grid.channels_first { [-1, channels, height, width] } else { [-1, height, width, channels] };
        let shape = self.integers("grid", &shape);
        let grids = self.node("Reshape", &[x, &shape], &[]);
        if grid.channels_first {
            return grids;
        }
        self.node("Transpose", &[&grids], &[Attribute::Integers("perm", &[0, 3, 1, 2])])
    }

    /// Layer `i`, a convolution of the grids `x`, with its ReLU; returns the name of the result.
    fn convolution(&mut self, x: &str, i: usize, layer: &Exported, conv: Conv) -> String {
        let (shape, weights) = layer.outputs_first();
        let weight = self.floats(&format!("layers.{i}.weight"), &shape, &weights);
        let bias = self.floats(&format!("layers.{i}.bias"), &[layer.outputs], &layer.bias);
        let [kernel, stride] = [conv.kernel, conv.stride].map(|side| [side as u64; 2]);
        let attributes =
            [Attribute::Integers("kernel_shape", &kernel), Attribute::Integers("strides", &stride)];
        let sum = self.node("Conv", &[x, &weight, &bias], &attributes);
        self.node("Relu", &[&sum], &[])
    }

    /// The encoding of the observations; returns the name of the network's input. Neighbours that are scaled are scaled together.
    fn encode(&mut self, network: &Network) -> String {
        let n = network.low.len();
        let mut parts = Vec::new();
        let mut from = 0;
        while from < n {
            let size = network.categories[from];
            let to =
                if size > 0 { from + 1 } else { (from..n).find(|&i| network.categories[i] > 0).unwrap_or(n) };
            let places = self
                .integers(&format!("encoding.{from}.places"), &(from as i64..to as i64).collect::<Vec<_>>());
            let own = self.node("Gather", &[INPUT, &places], &[Attribute::Integer("axis", 1)]);
            let low = self.floats(&format!("encoding.{from}.low"), &[to - from], &network.low[from..to]);
            let above = self.node("Sub", &[&own, &low], &[]);
            parts.push(if size > 0 {
                let last = self.floats(&format!("encoding.{from}.last"), &[], &[(size - 1) as f32]);
                let first = self.floats(&format!("encoding.{from}.first"), &[], &[0.0]);
                let numbers: Vec<f32> = (0..size).map(|i| i as f32).collect();
                let numbers = self.floats(&format!("encoding.{from}.numbers"), &[1, size], &numbers);
                let whole = self.node("Round", &[&above], &[]);
                let category = self.node("Clip", &[&whole, &first, &last], &[]);
                let is = self.node("Equal", &[&category, &numbers], &[]);
                self.node("Cast", &[&is], &[Attribute::Integer("to", FLOAT)])
            } else {
                let width: Vec<f32> = (from..to).map(|i| network.high[i] - network.low[i]).collect();
                let width = self.floats(&format!("encoding.{from}.width"), &[to - from], &width);
                let two = self.floats(&format!("encoding.{from}.two"), &[], &[2.0]);
                let one = self.floats(&format!("encoding.{from}.one"), &[], &[1.0]);
                let doubled = self.node("Mul", &[&above, &two], &[]);
                let share = self.node("Div", &[&doubled, &width], &[]);
                self.node("Sub", &[&share, &one], &[])
            });
            from = to;
        }
        let parts: Vec<&str> = parts.iter().map(String::as_str).collect();
        self.node("Concat", &parts, &[Attribute::Integer("axis", 1)])
    }
}
