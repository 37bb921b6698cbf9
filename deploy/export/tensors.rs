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
        // As torch.nn.Linear and torch.nn.Conv2d have them.
        let (shape, weights) = layer.outputs_first();
        tensors.push((format!("layers.{i}.weight"), Dtype::F32, shape, floats(&weights)));
        if let Some(conv) = layer.conv {
            tensors.push((
                format!("layers.{i}.stride"),
                Dtype::I64,
                vec![1],
                (conv.stride as i64).to_le_bytes().to_vec(),
            ));
        }
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
