//! Once an agent is under way it allocates nothing, whatever it learns with: neither for a batch that comes in nor for
//! a gradient step.

use super::{SPACES, agent, live};
use allocation_counter::measure;
use trestle_proto::batch::Transition;

/// Allocations of a batch and of the gradient steps after it, tick by tick.
fn allocations(sets: &[&str]) -> Vec<[u64; 2]> {
    let (mut agent, mut world) = agent(sets, 5);
    // The replay is full then.
    live(&mut agent, &mut world, 12);
    let mut counts = Vec::new();
    for _ in 0..8 {
        let (random, observed) = world.batch(0, 8);
        // The end of an episode is reported in a list.
        let mut batch = random.clone().into_inner();
        for at in 0..batch.len() {
            batch.set(at, &Transition { flags: 0, ..random.transition(at) });
        }
        let batch = batch.check(&SPACES).unwrap();
        let before = agent.counters().grad_steps;
        let ingest = measure(|| _ = agent.ingest(&batch, observed.as_ref()).unwrap());
        let train = measure(|| _ = agent.train(|| ()).unwrap());
        assert_eq!(agent.counters().grad_steps, before + 4);
        counts.push([ingest.count_total, train.count_total]);
    }
    counts
}

#[test]
fn there_are_none() {
    for sets in [
        &["run.algo=dqn"] as &[&str],
        &["run.algo=dqn", "learner.loss=squared", "learner.target=hard", "learner.target_every=1"],
        &["run.algo=trestle", "mentor.learned.features=[0]", "learner.n_step=3"],
        &["run.algo=diiqn", "learner.double=true", "learner.max_grad_norm=10"],
        &["run.algo=ha-diiqn", "mentor.selection=min-distance"],
        &["run.algo=ha-diiqn", "mentor.selection=confidence", "learner.hidden=[5, 33, 17]"],
    ] {
        assert_eq!(allocations(sets), [[0, 0]; 8], "{sets:?}");
    }
}

#[test]
fn they_are_counted() {
    // The other path to the gradient makes tensors.
    let counts = allocations(&["run.algo=dqn", "learner.backend=candle"]);
    assert!(counts.iter().all(|[_, train]| *train > 0), "{counts:?}");
}
