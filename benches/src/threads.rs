//! `threads`: one gradient step on the fastest instruction set, shared by several threads; and how far apart the processors are.

use super::Effort;
use super::clock::{Case, Clock, median, samples};
use super::report::Row;
use super::step::{conv, layout};
use anyhow::Result;
use std::hint::spin_loop;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Instant;
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

/// Turns between two threads that make one sample, and samples: as many as figures need, and for a quick look.
const TURNS: usize = 10;
const TRIPS: [usize; 2] = [10_000, 10];

/// The least time in which a cache line goes from one processor to another and back, nanoseconds; none with a single processor.
fn round_trip(effort: Effort) -> Option<f64> {
    if thread::available_parallelism().map_or(1, usize::from) < 2 {
        return None;
    }
    let (turns, turn) = (TURNS * effort.pick(TRIPS[0], TRIPS[1]), AtomicUsize::new(0));
    let wait_for = |wanted: usize| {
        while turn.load(Ordering::Acquire) != wanted {
            spin_loop();
        }
    };
    thread::scope(|scope| {
        scope.spawn(|| {
            for at in 0..turns {
                wait_for(2 * at + 1);
                turn.store(2 * at + 2, Ordering::Release);
            }
        });
        let mut least = f64::INFINITY;
        for first in (0..turns).step_by(TURNS) {
            let start = Instant::now();
            for at in first..first + TURNS {
                turn.store(2 * at + 1, Ordering::Release);
                wait_for(2 * at + 2);
            }
            least = least.min(start.elapsed().as_nanos() as f64 / TURNS as f64);
        }
        Some(least)
    })
}

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
    let before = round_trip(effort);
    let found = samples(&mut cases, effort, Clock::Wall)?;
    let trip = before.zip(round_trip(effort)).map(|(before, after)| before.max(after));
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
                    .measured("gain", middle(&gains))
                    .measured("round_trip_ns", trip),
            );
        }
    }
    Ok(rows)
}
