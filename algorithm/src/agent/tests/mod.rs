//! Tests of the agent: what it counts and stores, what it trains, and against naive oracles.

#![allow(clippy::unwrap_used)]

mod allocations;
mod counts;
mod gradient;
mod grids;
mod options;

use super::Agent;
use crate::testing::{N_ACTIONS, World, demonstration, experiment};
use trestle_proto::batch::Spaces;
use trestle_proto::row::{Element, RowKind};

/// Those of the test's plans, with room for more actors.
const SPACES: Spaces =
    Spaces { actors: 8, row: RowKind { dim: 2, element: Element::F32 }, n_actions: N_ACTIONS as usize };

/// A new agent and its world.
fn agent(sets: &[&str], seed: u64) -> (Agent, World) {
    let experiment = experiment(sets);
    let agent = Agent::new(&experiment, demonstration(&experiment)).unwrap();
    (agent, World::new(&experiment, seed))
}

/// Lets `agent` live through `ticks` ticks of all its actors.
fn live(agent: &mut Agent, world: &mut World, ticks: usize) {
    for _ in 0..ticks {
        for actor in 0..world.walked.len() as u32 {
            let (batch, observed) = world.batch(actor, 8);
            agent.ingest(&batch, observed.as_ref()).unwrap();
        }
        agent.train(|| ()).unwrap();
    }
}
