//! Observations that are grids, and networks that begin with convolutions.

use super::Agent;
use crate::testing::{N_ACTIONS, experiment, spec};
use rand::{Rng, SeedableRng};
use trestle_proto::batch::{Batch, BatchHeader, Checked, FIRST, TERMINATED, Transition};
use trestle_proto::experiment::Experiment;
use trestle_proto::rng::Stream;
use trestle_proto::row::Element;
use trestle_proto::space::EnvSpec;
use trestle_qnet::Isa;

/// Rows, columns and channels of an observation.
const SHAPE: [usize; 3] = [6, 5, 2];
/// Transitions of a batch.
const COUNT: usize = 8;
/// CRC-32C of the weights that [`learnt`] gives, as recorded. No change of arithmetic, of the random streams or of how states are stored
/// may alter it unless it means to.
const RECORDED: u32 = 0x7481_1de7;

/// An experiment whose observations are grids of whole numbers from 0 to 4, stored as `element`.
fn grid(element: Element, sets: &[&str]) -> Experiment {
    let conv = "learner.conv=[{channels=5,kernel=3},{channels=4,kernel=2,stride=2}]";
    let mut experiment = experiment(&[&["run.algo=dqn", conv], sets].concat());
    let dim = SHAPE.iter().product();
    let (low, high, scale) = (vec![0.0; dim], vec![4.0; dim], vec![1.0; dim]);
    experiment.spec = EnvSpec { element, shape: SHAPE.to_vec(), low, high, scale, ..spec() };
    experiment
}

/// Batches of one actor's random walk from grid to grid.
fn batches(experiment: &Experiment, count: usize) -> Vec<Checked<Batch>> {
    let mut rng = Stream::seed_from_u64(7);
    let state = |rng: &mut Stream| -> Vec<f32> {
        experiment.spec.low.iter().map(|_| rng.random_range(0..=4) as f32).collect()
    };
    let (mut obs, mut first) = (state(&mut rng), FIRST);
    let header = BatchHeader {
        count: COUNT as u32,
        obs_dim: obs.len() as u32,
        element: experiment.spec.element.code(),
        ..BatchHeader::default()
    };
    let mut all = Vec::new();
    for _ in 0..count {
        let mut batch = Batch::default();
        batch.prepare(header);
        for at in 0..COUNT {
            let next = state(&mut rng);
            let ends = if rng.random_range(0..10) == 0 { TERMINATED } else { 0 };
            let (action, reward) = (rng.random_range(0..N_ACTIONS), rng.random_range(-2..=2) as f32);
            batch.set(at, &Transition { obs: &obs, next_obs: &next, action, reward, flags: first | ends });
            (obs, first) = if ends == 0 { (next, 0) } else { (state(&mut rng), FIRST) };
        }
        all.push(batch.check(&experiment.spaces()).unwrap());
    }
    all
}

/// The weights after 12 batches.
fn learnt(element: Element, sets: &[&str]) -> Vec<f32> {
    let experiment = grid(element, sets);
    let mut agent = Agent::new(&experiment, None).unwrap();
    for batch in batches(&experiment, 12) {
        agent.ingest(&batch, None).unwrap();
        agent.train(|| ()).unwrap();
    }
    assert!(agent.counters().grad_steps > 20);
    agent.weights().to_vec()
}

#[test]
fn bytes_and_instruction_sets_leave_no_trace_in_what_is_learnt() {
    for (element, threads) in [(Element::F32, 1), (Element::U8, 1), (Element::U8, 3)] {
        for isa in Isa::available() {
            let sets = [format!("run.isa={isa}"), format!("learner.threads={threads}")];
            let weights = learnt(element, &[&sets[0], &sets[1]]);
            let crc = crc32c::crc32c(bytemuck::cast_slice(&weights));
            assert_eq!(crc, RECORDED, "{element:?}, {isa}: {crc:#010x}");
        }
    }
}

#[test]
fn candle_learns_the_same_but_for_rounding() {
    let (ours, candles) = (learnt(Element::U8, &[]), learnt(Element::U8, &["learner.backend=candle"]));
    assert_ne!(ours, candles);
    for (at, (ours, candles)) in ours.iter().zip(&candles).enumerate() {
        assert!((ours - candles).abs() < 1e-3, "{at}: {ours} {candles}");
    }
}
