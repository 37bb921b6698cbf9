//! `replay`: storing a transition, and drawing one and encoding both of its states for the network.

use super::Effort;
use super::clock::{Case, medians};
use super::report::Row;
use anyhow::Result;
use std::hint::black_box;
use trestle_algorithm::replay::Replay;
use trestle_bench::walk::World;
use trestle_proto::NONE;
use trestle_proto::batch::{Batch, BatchHeader};
use trestle_proto::rng::{Purpose, stream};
use trestle_qnet::Encoding;

const CAPACITY: usize = 100_000;
const BATCH: usize = 32;
const DIMS: [usize; 2] = [2, 4];

pub(super) fn run(effort: Effort) -> Result<Vec<Row>> {
    let mut cases = Vec::new();
    for dim in DIMS {
        cases.extend(pair(dim)?);
    }
    let found = medians(&mut cases, effort)?;
    let each = |ns: Option<f64>| ns.map(|ns| ns / BATCH as f64);
    let rows = |(dim, found): (usize, &[Option<f64>])| {
        ["push", "sample"].into_iter().zip(found.to_vec()).map(move |(op, ns)| {
            Row::new()
                .with("op", op)
                .with("dim", dim)
                .with("stored", CAPACITY)
                .with("batch", BATCH)
                .measured("ns", each(ns))
        })
    };
    Ok(DIMS.into_iter().zip(found.chunks(2)).flat_map(rows).collect())
}

/// A full replay that a batch is pushed to, and one that a batch is drawn from.
fn pair(dim: usize) -> Result<[Case<'static>; 2]> {
    let world = World::new(dim, CAPACITY, 0.2);
    let spec = world.spec();
    let mut walk = world.walk();
    let mut replay = Replay::new(CAPACITY, dim)?;
    (0..CAPACITY).for_each(|_| _ = replay.push(&walk.step(), 0, NONE));
    let mut batch = Batch::default();
    let header = BatchHeader { count: BATCH as u32, obs_dim: dim as u32, ..BatchHeader::default() };
    walk.fill(header, &mut batch);

    let mut written = replay.clone();
    let push = move || {
        for at in 0..batch.len() {
            written.push(&batch.transition(at), 0, NONE);
        }
        Ok(())
    };
    let encoding = Encoding::Scale { low: spec.low, high: spec.high };
    let mut rng = stream(1, Purpose::Replay, 0);
    let mut slots = Vec::new();
    let (mut x, mut next) = (vec![0.0; BATCH * dim], vec![0.0; BATCH * dim]);
    let sample = move || {
        replay.sample(&mut rng, BATCH, &mut slots);
        for (row, &slot) in slots.iter().enumerate() {
            encoding.encode_row(replay.obs(slot as usize), &mut x[row * dim..][..dim]);
            encoding.encode_row(replay.next_obs(slot as usize), &mut next[row * dim..][..dim]);
        }
        black_box((&x, &next));
        Ok(())
    };
    Ok([Box::new(push), Box::new(sample)])
}
