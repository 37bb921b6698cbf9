//! `step`: one gradient step on each instruction set, beside the least that it could take.

use super::Effort;
use super::cases::gradient::GradientStep;
use super::clock::{Case, medians};
use super::report::Row;
use anyhow::Result;
use std::hint::black_box;
use trestle_qnet::kernels::peak::{adam_traffic, multiply_adds};
use trestle_qnet::{Isa, Kernels, Layout};

/// Sizes of the network and rows of a batch; the last one is maze30's.
const SIZES: [(&[usize], usize); 4] =
    [(&[8, 64, 64, 4], 32), (&[8, 128, 128, 4], 64), (&[8, 256, 256, 4], 128), (&[2, 128, 128, 4], 32)];
/// Multiply-adds in a sample of the peak.
const ROUNDS: u64 = 10_000;

pub(super) fn run(effort: Effort) -> Result<Vec<Row>> {
    let all: Vec<Kernels> = Isa::available().filter_map(Kernels::new).collect();
    let mut cases: Vec<Case<'_>> = Vec::new();
    for &kernels in &all {
        cases.push(Box::new(move || {
            black_box(multiply_adds(kernels, ROUNDS));
            Ok(())
        }));
        for (sizes, rows) in SIZES {
            let mut step = GradientStep::new(sizes, rows, kernels)?;
            cases.push(Box::new(move || step.run()));
            cases.push(traffic(kernels, Layout::new(sizes)?.n_params()));
        }
    }
    let found = medians(&mut cases, effort)?;
    let mut rows = Vec::new();
    for (&kernels, found) in all.iter().zip(found.chunks(1 + 2 * SIZES.len())) {
        // Floating-point operations in a nanosecond.
        let peak = found[0].map(|ns| multiply_adds(kernels, ROUNDS) as f64 / ns);
        for ((sizes, batch), found) in SIZES.into_iter().zip(found[1..].chunks(2)) {
            let us = found[0].map(|ns| ns / 1e3);
            let flops = operations(&Layout::new(sizes)?, batch);
            let limit = peak.zip(found[1]).map(|(peak, traffic)| (flops as f64 / peak + traffic) / 1e3);
            rows.push(
                Row::new()
                    .with("inputs", sizes[0])
                    .with("hidden", &sizes[1..sizes.len() - 1])
                    .with("batch", batch)
                    .with("isa", kernels.isa().to_string())
                    .measured("us", us)
                    .measured("limit_us", limit)
                    .measured("times_limit", us.zip(limit).map(|(us, limit)| us / limit))
                    .with("flops", flops)
                    .measured("peak_gflops", peak),
            );
        }
    }
    Ok(rows)
}

/// Adam's bytes for `n` parameters, moved and nothing else.
fn traffic(kernels: Kernels, n: usize) -> Case<'static> {
    let (mut params, mut m, mut v, grad) = (vec![1.0; n], vec![1.0; n], vec![1.0; n], vec![0.0; n]);
    Box::new(move || {
        adam_traffic(kernels, &mut params, &mut m, &mut v, &grad);
        Ok(())
    })
}

/// Floating-point operations of a step's matrix products, a multiply-add being two: the forward pass of both networks,
/// the gradient of every weight (of the last layer's for the taken action alone) and of every hidden unit.
fn operations(layout: &Layout, batch: usize) -> usize {
    let last = layout.layers().len() - 1;
    let products = |l: usize| {
        let layer = layout.layers()[l];
        let all = layer.weights().len();
        let backward = if l == last { layer.inputs } else { all };
        // Nobody asks for the gradient of the input.
        2 * all + backward + if l == 0 { 0 } else { backward }
    };
    (0..=last).map(|l| 2 * batch * products(l)).sum()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn operations_are_those_of_the_products() {
        // Two forward passes of 2 * 3 + 3 * 4, gradients of 2 * 3 weights, of 3 weights of the action, of 3 units.
        let layout = Layout::new(&[2, 3, 4]).unwrap();
        assert_eq!(operations(&layout, 1), 2 * (2 * 18 + 6 + 3 + 3));
        assert_eq!(operations(&layout, 5), 5 * operations(&layout, 1));
    }
}
