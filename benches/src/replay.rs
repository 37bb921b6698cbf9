//! `replay`: storing a transition, and drawing one and encoding both of its states for the network.

use super::Effort;
use super::clock::{Case, medians};
use super::report::Row;
use anyhow::Result;
use std::hint::black_box;
use trestle_algorithm::replay::Replay;
use trestle_proto::NONE;
use trestle_proto::batch::{FIRST, Transition};
use trestle_proto::rng::{Purpose, mix, stream};
use trestle_proto::row::{Element, RowKind};
use trestle_qnet::Encoding;

const BATCH: usize = 32;
/// States, and how many transitions are stored; the last are MinAtar's Breakout's.
const CASES: [(RowKind, usize); 4] = [
    (RowKind { dim: 2, element: Element::F32 }, 100_000),
    (RowKind { dim: 4, element: Element::F32 }, 100_000),
    (RowKind { dim: 4, element: Element::F32 }, 1_000_000),
    (RowKind { dim: 400, element: Element::U8 }, 1_000_000),
];
/// States that a walk goes round, and the length of its episodes.
const STATES: usize = 997;
const EPISODE: usize = 200;

pub(super) fn run(effort: Effort) -> Result<Vec<Row>> {
    let mut cases = Vec::new();
    for (row, stored) in CASES {
        let stored = effort.pick(stored, stored / 100);
        cases.extend([storing(row, stored)?, drawing(row, stored)?]);
    }
    let found = medians(&mut cases, effort)?;
    let each = |ns: Option<f64>| ns.map(|ns| ns / BATCH as f64);
    let rows = |((row, stored), found): ((RowKind, usize), &[Option<f64>])| {
        ["push", "sample"].into_iter().zip(found.to_vec()).map(move |(op, ns)| {
            Row::new()
                .with("op", op)
                .with("dim", row.dim)
                .with("bytes", if row.element == Element::U8 { 1 } else { 4 })
                .with("stored", effort.pick(stored, stored / 100))
                .with("batch", BATCH)
                .measured("ns", each(ns))
        })
    };
    Ok(CASES.into_iter().zip(found.chunks(2)).flat_map(rows).collect())
}

/// Whole numbers 0 and 1, for each of the states.
fn states(dim: usize) -> Vec<f32> {
    (0..STATES * dim).map(|at| (mix(at as u64) >> 63) as f32).collect()
}

/// Stores `count` transitions of a walk round `states`.
fn push(replay: &mut Replay, states: &[f32], count: usize) {
    let dim = replay.obs_dim();
    for at in replay.next_index() as usize..replay.next_index() as usize + count {
        let [obs, next_obs] = [at, at + 1].map(|at| &states[at % STATES * dim..][..dim]);
        let flags = if at.is_multiple_of(EPISODE) { FIRST } else { 0 };
        replay.push(&Transition { obs, next_obs, action: 0, reward: 0.0, flags }, 0, NONE);
    }
}

/// A replay of `stored` transitions, full.
fn full(row: RowKind, stored: usize) -> Result<Replay> {
    let mut replay = Replay::new(stored, row)?;
    push(&mut replay, &states(row.dim), stored);
    Ok(replay)
}

/// Storing a batch in a full replay.
fn storing(row: RowKind, stored: usize) -> Result<Case<'static>> {
    let (mut replay, states) = (full(row, stored)?, states(row.dim));
    Ok(Box::new(move || {
        push(&mut replay, &states, BATCH);
        Ok(())
    }))
}

/// Drawing a batch from a full replay.
pub(super) fn drawing(row: RowKind, stored: usize) -> Result<Case<'static>> {
    let (replay, dim) = (full(row, stored)?, row.dim);
    let encoding = Encoding::Scale { low: vec![0.0; dim], high: vec![1.0; dim] };
    let mut rng = stream(1, Purpose::Replay, 0);
    let mut slots = Vec::new();
    let (mut x, mut next) = (vec![0.0; BATCH * dim], vec![0.0; BATCH * dim]);
    Ok(Box::new(move || {
        replay.sample(&mut rng, BATCH, &mut slots);
        for (row, &slot) in slots.iter().enumerate() {
            encoding.encode_row(replay.obs(slot as usize), &mut x[row * dim..][..dim]);
            encoding.encode_row(replay.next_obs(slot as usize), &mut next[row * dim..][..dim]);
        }
        black_box((&x, &next));
        Ok(())
    }))
}
