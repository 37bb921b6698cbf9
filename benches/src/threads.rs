//! `threads`: one gradient step on the fastest instruction set, shared by several threads.

use super::Effort;
use super::clock::{Case, Clock, median, samples};
use super::report::Row;
use super::step::{conv, layout};
use anyhow::Result;
use trestle_bench::gradient::GradientStep;
use trestle_qnet::{Kernels, Threads};

/// Sizes of the network and rows of a batch: from a network that stays with one thread to a wide one; the last is MinAtar's.
const SIZES: [(&[usize], usize); 6] = [
    (&[8, 64, 64, 4], 32),
    (&[8, 128, 128, 4], 64),
    (&[8, 256, 256, 4], 128),
    (&[8, 512, 512, 4], 256),
    (&[8, 1024, 1024, 4], 256),
    (&[400, 128, 6], 32),
];
/// Threads: one, and as many as are compared with it.
const COUNTS: [usize; 2] = [1, 2];

pub(super) fn run(effort: Effort) -> Result<Vec<Row>> {
    let mut cases: Vec<Case<'_>> = Vec::new();
    let mut used = Vec::new();
    for (sizes, rows) in SIZES {
        for count in COUNTS {
            let threads = Threads::new(count)?;
            used.push(threads.count());
            let step = GradientStep::new(layout(sizes)?, rows, false, Kernels::detect())?;
            let mut step = step.with_threads(threads);
            cases.push(Box::new(move || step.run()));
        }
    }
    let found = samples(&mut cases, effort, Clock::Wall)?;
    let mut rows = Vec::new();
    for ((sizes, batch), (found, used)) in
        SIZES.into_iter().zip(found.chunks(COUNTS.len()).zip(used.chunks(COUNTS.len())))
    {
        for (&threads, samples) in used.iter().zip(found) {
            // Each sample beside that of one thread in the same turn.
            let gains: Vec<f64> = found[0].iter().zip(samples).map(|(one, several)| one / several).collect();
            let middle = |samples: &[f64]| (!samples.is_empty()).then(|| median(samples.to_vec()));
            rows.push(
                Row::new()
                    .with("inputs", sizes[0])
                    .with("conv", conv(sizes))
                    .with("hidden", &sizes[1..sizes.len() - 1])
                    .with("batch", batch)
                    .with("threads", threads)
                    .measured("us", middle(samples).map(|ns| ns / 1e3))
                    .measured("gain", middle(&gains)),
            );
        }
    }
    Ok(rows)
}
