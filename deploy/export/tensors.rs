//! A network as a safetensors file.

use super::Network;
use anyhow::{Context, Result};
use safetensors::tensor::{Dtype, TensorView, serialize};
use std::collections::HashMap;

/// The bytes of the file.
pub(crate) fn file(network: &Network) -> Result<Vec<u8>> {
    let floats = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let mut tensors: Vec<(String, Dtype, Vec<usize>, Vec<u8>)> = vec![
        ("encoding.low".into(), Dtype::F32, vec![network.low.len()], floats(&network.low)),
        ("encoding.high".into(), Dtype::F32, vec![network.high.len()], floats(&network.high)),
        (
            "encoding.categories".into(),
            Dtype::I64,
            vec![network.categories.len()],
            network.categories.iter().flat_map(|&size| (size as i64).to_le_bytes()).collect(),
        ),
    ];
    for (i, layer) in network.layers.iter().enumerate() {
        // As torch.nn.Linear has them.
        let transposed: Vec<f32> = (0..layer.outputs)
            .flat_map(|to| (0..layer.inputs).map(move |from| layer.weights[from * layer.outputs + to]))
            .collect();
        let shape = vec![layer.outputs, layer.inputs];
        tensors.push((format!("layers.{i}.weight"), Dtype::F32, shape, floats(&transposed)));
        tensors.push((format!("layers.{i}.bias"), Dtype::F32, vec![layer.outputs], floats(&layer.bias)));
    }
    let views = tensors
        .iter()
        .map(|(name, kind, shape, bytes)| Ok((name.as_str(), TensorView::new(*kind, shape.clone(), bytes)?)));
    let views = views.collect::<Result<Vec<_>, safetensors::SafeTensorError>>();
    let metadata: HashMap<String, String> = network.metadata().into_iter().collect();
    serialize(views.context("cannot encode the tensors")?, Some(metadata))
        .context("cannot encode the tensors")
}
