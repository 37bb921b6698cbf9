//! The functions that dominate a run, one by one: `cargo bench -p trestle-bench`. What a whole system reaches, `trestle-bench` says.
#![allow(clippy::unwrap_used)] // All arguments are constants.

use divan::Bencher;
use divan::counter::ItemsCount;
use trestle_algorithm::replay::Replay;
use trestle_bench::gradient::GradientStep;
use trestle_bench::server::{BATCH, DIM, Server};
use trestle_proto::rng::{Purpose, stream};
use trestle_qnet::{Kernels, Layout, Workspace, forward, init};

/// Widths of both hidden layers, and rows of a batch.
const SIZES: [(usize, usize); 3] = [(64, 32), (128, 64), (256, 128)];
const STORED: usize = 100_000;

fn main() {
    divan::main();
}

fn sizes(width: usize) -> [usize; 4] {
    [8, width, width, 4]
}

/// An actor's forward pass.
#[divan::bench(args = SIZES.map(|(width, _)| width))]
fn infer(bencher: Bencher<'_, '_>, width: usize) {
    let layout = Layout::new(&sizes(width)).unwrap();
    let params = init(&layout, &mut stream(1, Purpose::Weights, 0));
    let mut workspace = Workspace::new(&layout, 1);
    let (x, mut q) = (vec![0.5; layout.input()], vec![0.0; layout.output()]);
    bencher.bench_local(|| forward(&layout, &params, divan::black_box(&x), 1, &mut workspace, &mut q));
}

/// A gradient step.
#[divan::bench(args = SIZES)]
fn step(bencher: Bencher<'_, '_>, (width, batch): (usize, usize)) {
    let mut step =
        GradientStep::new(Layout::new(&sizes(width)).unwrap(), batch, false, Kernels::detect()).unwrap();
    bencher.bench_local(|| step.run());
}

/// Drawing a batch from a full replay and reading it.
#[divan::bench]
fn replay_sample(bencher: Bencher<'_, '_>) {
    let mut server = Server::new(STORED).unwrap();
    let mut replay = Replay::new(STORED, DIM).unwrap();
    for _ in 0..STORED / BATCH as usize {
        let (batch, observed) = server.observe().unwrap();
        for at in 0..batch.len() {
            replay.push(&batch.transition(at), 0, observed.mentor[at]);
        }
    }
    let (mut rng, mut slots) = (stream(1, Purpose::Replay, 0), Vec::new());
    bencher.counter(ItemsCount::new(BATCH)).bench_local(|| {
        replay.sample(&mut rng, BATCH as usize, &mut slots);
        slots.iter().map(|&slot| replay.get(slot as usize).reward).sum::<f32>()
    });
}

/// A batch's way through the mentor-server, its history full.
#[divan::bench]
fn mentor_observe(bencher: Bencher<'_, '_>) {
    let mut server = Server::new(STORED).unwrap();
    for _ in 0..2 * STORED / BATCH as usize {
        server.observe().unwrap();
    }
    bencher.counter(ItemsCount::new(BATCH)).bench_local(|| server.observe().map(|(batch, _)| batch.len()));
}
