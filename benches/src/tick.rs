//! `tick`, `message`, `weights`: what the processes of a run pay for being processes. The peers do no work of their
//! own, so that all of a tick's time is overhead; it is wall time, as it is the waiting that counts.

use super::Effort;
use super::clock::median;
use super::exchange::{Both, Placement, Setup};
use super::report::Row;
use super::sleeps::Sleeps;
use anyhow::Result;
use std::time::Instant;

/// Ticks in a row on one transport before it is the other's turn.
const BLOCK: usize = 50;
/// Turns: as many as figures need, and for a quick look.
const BLOCKS: [usize; 2] = [20, 1];
const WARM_UP: usize = 100;
/// Batches that are sent in one go in `message`: fewer than may wait for the learner.
const BURST: u32 = 32;

/// The medians of a tick's time over shared memory and over sockets, microseconds; and how often all processes together fell asleep in
/// a tick, on average.
fn pair(both: &mut Both, publish: bool, effort: Effort) -> Result<([f64; 2], [f64; 2])> {
    let mut samples = [const { Vec::new() }; 2];
    let mut slept = [0.0; 2];
    for exchange in &mut both.ways {
        (0..WARM_UP).try_for_each(|_| exchange.tick(publish))?;
    }
    for _ in 0..effort.pick(BLOCKS[0], BLOCKS[1]) {
        for ((exchange, samples), slept) in both.ways.iter_mut().zip(&mut samples).zip(&mut slept) {
            let sleeps = Sleeps::of(&exchange.peers())?;
            for _ in 0..BLOCK {
                let start = Instant::now();
                exchange.tick(publish)?;
                samples.push(start.elapsed().as_secs_f64() * 1e6);
            }
            *slept += sleeps.since()?;
        }
    }
    let ticks = samples.each_ref().map(Vec::len);
    Ok((samples.map(median), [0, 1].map(|way| slept[way] / ticks[way] as f64)))
}

/// A whole tick: weights, orders, batches, the mentor-server's answers; with all processes on one processor, and where the scheduler
/// puts them.
pub(super) fn tick(effort: Effort) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for actors in [1, 2, 4, 8, 16] {
        for rollout in [1, 8, 32] {
            for placement in [Placement::OneProcessor, Placement::Scheduler] {
                let setup = Setup { actors, rollout, burst: 1, mentor: true, free: false };
                let mut both = Both::new(setup, placement)?;
                let ([us, socket_us], [sleeps, socket_sleeps]) = pair(&mut both, true, effort)?;
                rows.push(
                    Row::new()
                        .with("actors", actors)
                        .with("rollout", rollout)
                        .with("placement", placement.name())
                        .measured("us", us)
                        .measured("socket_us", socket_us)
                        .measured("ratio", us / socket_us)
                        .measured("sleeps", sleeps)
                        .measured("socket_sleeps", socket_sleeps),
                );
            }
        }
    }
    Ok(rows)
}

/// A learner and one actor take turns, and have one processor; more actors are where the scheduler puts them.
fn usual(actors: u32) -> Placement {
    if actors == 1 { Placement::OneProcessor } else { Placement::Scheduler }
}

/// Microseconds of a whole tick over shared memory, with one transition of each actor.
pub(super) fn tick_us(actors: u32, effort: Effort) -> Result<f64> {
    let setup = Setup { actors, rollout: 1, burst: 1, mentor: true, free: false };
    let mut both = Both::new(setup, usual(actors))?;
    Ok(pair(&mut both, true, effort)?.0[0])
}

/// Batches in bursts from one actor.
pub(super) fn message(effort: Effort) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for batch in [32, 256] {
        let setup = Setup { actors: 1, rollout: batch, burst: BURST, mentor: false, free: false };
        let mut both = Both::new(setup, Placement::Scheduler)?;
        let each = |us: f64| us * 1e3 / f64::from(batch * BURST);
        let [ns, socket_ns] = pair(&mut both, false, effort)?.0.map(each);
        rows.push(
            Row::new()
                .with("batch", batch)
                .measured("ns", ns)
                .measured("socket_ns", socket_ns)
                .measured("ratio", ns / socket_ns),
        );
    }
    Ok(rows)
}

/// What a publication of weights adds to a tick of one transition without a mentor-server, until the last actor has
/// its copy, checked, and has answered.
pub(super) fn weights(effort: Effort) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for subscribers in [1, 4] {
        let setup = Setup { actors: subscribers, rollout: 1, burst: 1, mentor: false, free: false };
        let mut both = Both::new(setup, usual(subscribers))?;
        let (with, _) = pair(&mut both, true, effort)?;
        let (without, _) = pair(&mut both, false, effort)?;
        let [us, socket_us] = [0, 1].map(|way| with[way] - without[way]);
        rows.push(
            Row::new()
                .with("subscribers", subscribers)
                .measured("us", us)
                .measured("socket_us", socket_us)
                .measured("ratio", us / socket_us)
                .measured("tick_us", with[0])
                .measured("socket_tick_us", with[1]),
        );
    }
    Ok(rows)
}
