//! `infer`: an actor's forward pass of one observation, straight from the flat weights.

use super::Effort;
use super::clock::{Case, medians};
use super::report::Row;
use anyhow::Result;
use std::hint::black_box;
use trestle_proto::rng::{Purpose, stream};
use trestle_qnet::{Isa, Kernels, Layout, Workspace, forward, init};

const SIZES: [&[usize]; 4] = [&[8, 64, 64, 4], &[8, 128, 128, 4], &[8, 256, 256, 4], &[2, 128, 128, 4]];

pub(super) fn run(effort: Effort) -> Result<Vec<Row>> {
    let all: Vec<Kernels> = Isa::available().filter_map(Kernels::new).collect();
    let pairs: Vec<_> = SIZES.iter().flat_map(|sizes| all.iter().map(move |k| (*sizes, *k))).collect();
    let mut cases = pairs.iter().map(|(sizes, kernels)| case(sizes, *kernels)).collect::<Result<Vec<_>>>()?;
    let found = medians(&mut cases, effort)?;
    let row = |((sizes, kernels), ns): (&(&[usize], Kernels), Option<f64>)| {
        Row::new()
            .with("inputs", sizes[0])
            .with("hidden", &sizes[1..sizes.len() - 1])
            .with("isa", kernels.isa().to_string())
            .measured("us", ns.map(|ns| ns / 1e3))
    };
    Ok(pairs.iter().zip(found).map(row).collect())
}

fn case(sizes: &[usize], kernels: Kernels) -> Result<Case<'static>> {
    let layout = Layout::new(sizes)?;
    let params = init(&layout, &mut stream(1, Purpose::Weights, 0));
    let mut workspace = Workspace::with_kernels(&layout, 1, kernels);
    let x = vec![0.5; layout.input()];
    let mut q = vec![0.0; layout.output()];
    Ok(Box::new(move || {
        forward(&layout, &params, black_box(&x), 1, &mut workspace, &mut q);
        black_box(&q);
        Ok(())
    }))
}
