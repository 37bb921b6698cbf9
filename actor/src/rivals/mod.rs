//! What rivals change about the environment of an actor (`rival.kind`; docs/rivals.md): where episodes begin, and what is
//! observed. Either is an environment around another one, so that whatever steps environments knows nothing of it.

mod goals;
mod resets;

use crate::env::{EnvError, Environment};
use goals::Goals;
use resets::Resets;
use trestle_proto::config::RivalKind;
use trestle_proto::experiment::Experiment;

/// `env` as the rival of `experiment` has it: to train in, or to be evaluated in. Evaluations always begin where the environment
/// itself begins.
///
/// # Errors
/// An environment that cannot be put into a state, where episodes are to begin in states of the mentor's.
pub fn around(
    env: Box<dyn Environment>,
    experiment: &Experiment,
    training: bool,
) -> Result<Box<dyn Environment>, EnvError> {
    let Some(waypoints) = &experiment.waypoints else { return Ok(env) };
    Ok(match experiment.config.rival.kind {
        RivalKind::Resets if training => {
            Box::new(Resets::new(env, &experiment.config.rival.resets, waypoints)?)
        }
        RivalKind::DShape => Box::new(Goals::new(env, waypoints)),
        _ => env,
    })
}
