//! Flat parameter vectors as safetensors files, one tensor a layer's weights or bias, and back.

use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use trestle_qnet::{Adam, Layout};

/// Why bytes are not the tensors of a layout.
#[derive(Debug, thiserror::Error)]
pub(super) enum TensorsError {
    #[error(transparent)]
    Format(#[from] safetensors::SafeTensorError),
    #[error("tensor {name} is {found}; accepted: {accepted}")]
    Tensor { name: String, found: String, accepted: String },
    #[error("{found} tensors; accepted: {accepted}")]
    Count { found: usize, accepted: usize },
    #[error("it does not say which evaluation its weights were best in")]
    Evaluation,
}

/// Under which key the text is.
const EVALUATION: &str = "evaluation";

/// A tensor's name, shape and place in the flat vector.
type Piece = (String, Vec<usize>, std::ops::Range<usize>);

fn pieces(layout: &Layout, prefix: &str) -> Vec<Piece> {
    let layers = layout.layers().iter().enumerate();
    layers
        .flat_map(|(l, layer)| {
            let shape = match layer.conv {
                None => vec![layer.inputs, layer.outputs],
                Some(conv) => vec![conv.kernel, conv.kernel, conv.grid.channels, layer.outputs],
            };
            let weight = (format!("{prefix}layers.{l}.weight"), shape, layer.weights());
            [weight, (format!("{prefix}layers.{l}.bias"), vec![layer.outputs], layer.bias())]
        })
        .collect()
}

fn views<'a>(
    layout: &Layout,
    prefix: &str,
    flat: &'a [f32],
) -> Result<Vec<(String, TensorView<'a>)>, TensorsError> {
    let view = |(name, shape, range): Piece| {
        Ok((name, TensorView::new(Dtype::F32, shape, bytemuck::cast_slice(&flat[range]))?))
    };
    pieces(layout, prefix).into_iter().map(view).collect()
}

/// The parameters `params` of a network of `layout` as the bytes of a file.
pub(super) fn encode_params(layout: &Layout, params: &[f32]) -> Result<Vec<u8>, TensorsError> {
    Ok(safetensors::serialize(views(layout, "", params)?, None)?)
}

/// [`encode_params`] with a text beside them, which [`evaluation_of`] gives back.
pub(super) fn encode_best(layout: &Layout, params: &[f32], text: String) -> Result<Vec<u8>, TensorsError> {
    let beside = [(EVALUATION.to_string(), text)].into_iter().collect();
    Ok(safetensors::serialize(views(layout, "", params)?, Some(beside))?)
}

/// The text beside the tensors in `bytes`.
pub(super) fn evaluation_of(bytes: &[u8]) -> Result<String, TensorsError> {
    let (_, header) = SafeTensors::read_metadata(bytes)?;
    let text = header.metadata().as_ref().and_then(|beside| beside.get(EVALUATION).cloned());
    text.ok_or(TensorsError::Evaluation)
}

/// The state of the optimiser as the bytes of a file.
pub(super) fn encode_adam(layout: &Layout, adam: &Adam) -> Result<Vec<u8>, TensorsError> {
    let step = adam.step.to_le_bytes();
    let mut tensors = views(layout, "m.", &adam.m)?;
    tensors.extend(views(layout, "v.", &adam.v)?);
    tensors.push(("step".into(), TensorView::new(Dtype::U64, vec![1], &step)?));
    Ok(safetensors::serialize(tensors, None)?)
}

/// A tensor's bytes, if it has the type and shape that it should have.
fn tensor<'a>(
    file: &SafeTensors<'a>,
    name: &str,
    dtype: Dtype,
    shape: &[usize],
) -> Result<&'a [u8], TensorsError> {
    let view = file.tensor(name)?;
    if view.dtype() != dtype || view.shape() != shape {
        return Err(TensorsError::Tensor {
            name: name.into(),
            found: format!("{:?} {:?}", view.dtype(), view.shape()),
            accepted: format!("{dtype:?} {shape:?}"),
        });
    }
    Ok(view.data())
}

fn flat(file: &SafeTensors<'_>, layout: &Layout, prefix: &str) -> Result<Vec<f32>, TensorsError> {
    let mut params = vec![0.0; layout.n_params()];
    for (name, shape, range) in pieces(layout, prefix) {
        let bytes = tensor(file, &name, Dtype::F32, &shape)?;
        bytemuck::cast_slice_mut(&mut params[range]).copy_from_slice(bytes);
    }
    Ok(params)
}

fn open(bytes: &[u8], accepted: usize) -> Result<SafeTensors<'_>, TensorsError> {
    let file = SafeTensors::deserialize(bytes)?;
    if file.len() == accepted { Ok(file) } else { Err(TensorsError::Count { found: file.len(), accepted }) }
}

/// What [`encode_params`] was given.
pub(super) fn decode_params(layout: &Layout, bytes: &[u8]) -> Result<Vec<f32>, TensorsError> {
    flat(&open(bytes, 2 * layout.layers().len())?, layout, "")
}

/// What [`encode_adam`] was given.
pub(super) fn decode_adam(layout: &Layout, bytes: &[u8]) -> Result<Adam, TensorsError> {
    let file = open(bytes, 4 * layout.layers().len() + 1)?;
    let mut step = [0; 8];
    step.copy_from_slice(tensor(&file, "step", Dtype::U64, &[1])?);
    Ok(Adam { m: flat(&file, layout, "m.")?, v: flat(&file, layout, "v.")?, step: u64::from_le_bytes(step) })
}
