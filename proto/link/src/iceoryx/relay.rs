//! The ends of a relay, which stands for processes of other hosts: for actors at the learner's, and for the learner at actors'.
//!
//! A relay waits for the network as well. So each end can also sleep by itself, and be woken by another thread of its process.

use super::bell::{Bells, Consumer, bit};
use super::services::Services;
use super::{Domain, IceoryxActor, IceoryxLearner};
use crate::LinkError;
use std::ops::Range;
use std::rc::Rc;
use trestle_proto::plan::RunPlan;

/// Which end of a relay is woken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Whom {
    /// The places of these actors.
    Actors(Range<u32>),
    /// The learner's place.
    Learner,
}

/// Opens the places of `actors` in `plan`'s run, all in this process. Each is an actor of its own to the learner. All of them wake
/// when one of them has something to do.
pub fn seats(plan: &RunPlan, actors: Range<u32>) -> Result<Vec<IceoryxActor>, LinkError> {
    let services = Rc::new(Services::open(plan)?);
    let whom = bits(&actors);
    actors.map(|index| IceoryxActor::within(services.clone(), index, whom)).collect()
}

/// Opens the learner's place in `plan`'s run on a host that has only some of the actors, and no mentor-server. Messages to
/// actors may miss the actors of other hosts.
pub fn learner(plan: &RunPlan) -> Result<IceoryxLearner, LinkError> {
    IceoryxLearner::of_some(Services::open(plan)?, plan.life.generation)
}

/// A waker of `whom` in run `run`, for any thread of this process.
pub fn waker(run: u64, whom: Whom) -> Result<Box<dyn Fn() + Send>, LinkError> {
    let bells = Bells::new(&Domain::of(run), false)?;
    Ok(Box::new(move || {
        let rung = match &whom {
            Whom::Actors(actors) => bells.ring_actors(bits(actors)),
            Whom::Learner => bells.ring(Consumer::Learner),
        };
        if let Err(error) = rung {
            tracing::warn!("{error}");
        }
    }))
}

fn bits(actors: &Range<u32>) -> u32 {
    actors.clone().fold(0, |bits, actor| bits | bit(actor as usize))
}
