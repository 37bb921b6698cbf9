//! `step`: one gradient step on each instruction set, beside the least that it could take.

use super::Effort;
use super::clock::{Case, medians};
use super::report::Row;
use anyhow::Result;
use std::hint::black_box;
use trestle_bench::gradient::GradientStep;
use trestle_qnet::kernels::peak::{adam_traffic, multiply_adds};
use trestle_qnet::{Grid, Isa, Kernels, Layout};

/// Sizes of the network and rows of a batch; the last one but one is maze30's, the last MinAtar's, with its convolution.
const SIZES: [(&[usize], usize); 5] = [
    (&[8, 64, 64, 4], 32),
    (&[8, 128, 128, 4], 64),
    (&[8, 256, 256, 4], 128),
    (&[2, 128, 128, 4], 32),
    (&[400, 128, 6], 32),
];
/// Channels and kernel of MinAtar's convolution of 10 x 10 x 4 numbers.
const CONV: (usize, usize) = (16, 3);
/// DIIQN's step has a second forward pass, of the mentor's states.
const ALGOS: [&str; 2] = ["dqn", "diiqn"];
/// Multiply-adds in a sample of the peak.
const ROUNDS: u64 = 10_000;

/// Whether the network of `sizes` begins with MinAtar's convolution.
fn convolves(sizes: &[usize]) -> bool {
    sizes.len() == 3
}

/// The network of `sizes`; MinAtar's if it has one hidden layer.
pub(super) fn layout(sizes: &[usize]) -> Result<Layout> {
    if !convolves(sizes) {
        return Ok(Layout::new(sizes)?);
    }
    let grid = Grid { height: 10, width: 10, channels: 4, channels_first: false };
    Ok(Layout::with_conv(grid, &[(CONV.0, CONV.1, 1)], &sizes[1..])?)
}

pub(super) fn run(effort: Effort) -> Result<Vec<Row>> {
    let all: Vec<Kernels> = Isa::available().filter_map(Kernels::new).collect();
    let mut cases: Vec<Case<'_>> = Vec::new();
    let mut operations = Vec::new();
    for &kernels in &all {
        cases.push(Box::new(move || {
            black_box(multiply_adds(kernels, ROUNDS));
            Ok(())
        }));
        for (sizes, rows) in SIZES {
            for algo in ALGOS {
                let mut step = GradientStep::new(layout(sizes)?, rows, algo != "dqn", kernels)?;
                operations.push(flops(&layout(sizes)?, rows, step.forward_rows()));
                cases.push(Box::new(move || step.run()));
            }
            cases.push(traffic(kernels, layout(sizes)?.n_params()));
        }
    }
    let found = medians(&mut cases, effort)?;
    let mut rows = Vec::new();
    let mut operations = operations.into_iter();
    for (&kernels, found) in all.iter().zip(found.chunks(1 + SIZES.len() * (ALGOS.len() + 1))) {
        // Floating-point operations in a nanosecond.
        let peak = found[0].map(|ns| multiply_adds(kernels, ROUNDS) as f64 / ns);
        for ((sizes, batch), found) in SIZES.into_iter().zip(found[1..].chunks(ALGOS.len() + 1)) {
            let (steps, traffic) = found.split_at(ALGOS.len());
            for ((algo, ns), flops) in ALGOS.into_iter().zip(steps).zip(&mut operations) {
                let us = ns.map(|ns| ns / 1e3);
                let limit = peak.zip(traffic[0]).map(|(peak, traffic)| (flops as f64 / peak + traffic) / 1e3);
                rows.push(
                    Row::new()
                        .with("algo", algo)
                        .with("inputs", sizes[0])
                        .with("conv", conv(sizes))
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
    }
    Ok(rows)
}

/// The convolution of the network of `sizes`, for people.
pub(super) fn conv(sizes: &[usize]) -> String {
    let (channels, kernel) = CONV;
    if convolves(sizes) { format!("{channels} of {kernel} x {kernel}") } else { "-".into() }
}

/// Adam's bytes for `n` parameters, moved and nothing else.
fn traffic(kernels: Kernels, n: usize) -> Case<'static> {
    let (mut params, mut m, mut v, grad) = (vec![1.0; n], vec![1.0; n], vec![1.0; n], vec![0.0; n]);
    Box::new(move || {
        adam_traffic(kernels, &mut params, &mut m, &mut v, &grad);
        Ok(())
    })
}

/// Floating-point operations of a step's matrix products, a multiply-add being two: the forward pass of `forward_rows`
/// rows in the online network and of `batch` rows in the target network, the gradient of every weight (of the last
/// layer's for the taken action alone) and of every hidden unit for `batch` rows.
pub(super) fn flops(layout: &Layout, batch: usize, forward_rows: usize) -> usize {
    let last = layout.layers().len() - 1;
    let products = |l: usize| {
        let layer = layout.layers()[l];
        // A convolution is applied at every position.
        let all = layer.positions() * layer.weights().len();
        let backward = if l == last { layer.inputs } else { all };
        // Nobody asks for the gradient of the input.
        (batch + forward_rows) * all + batch * (backward + if l == 0 { 0 } else { backward })
    };
    (0..=last).map(|l| 2 * products(l)).sum()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn operations_are_those_of_the_products() {
        // Two forward passes of 2 * 3 + 3 * 4, gradients of 2 * 3 weights, of 3 weights of the action, of 3 units.
        let layout = Layout::new(&[2, 3, 4]).unwrap();
        assert_eq!(flops(&layout, 1, 1), 2 * (2 * 18 + 6 + 3 + 3));
        assert_eq!(flops(&layout, 5, 5), 5 * flops(&layout, 1, 1));
        assert_eq!(flops(&layout, 1, 2), flops(&layout, 1, 1) + 2 * 18);
        // 64 positions of 36 numbers and 16 channels, twice forward and once backward.
        let minatar = super::layout(SIZES[4].0).unwrap();
        let dense = 2 * (4 * 1024 * 128 + 2 * 128 * 6 + 2 * 128);
        assert_eq!(flops(&minatar, 1, 1), 2 * 3 * 64 * 36 * 16 + dense);
    }
}
