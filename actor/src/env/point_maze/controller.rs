//! The planned mentor: a controller that follows the shortest path from turn to turn.
//!
//! It is careful rather than fast, needs no training, and works on any map: what it drives is a demonstration, not an
//! optimum. Its physics is the built-in one, so that a plan does not depend on what is installed.

use super::actions::{Force, forces};
use super::geometry::{Geometry, Vector};
use super::physics::{Body, GEAR, MASS, Physics, TIMESTEP};
use super::{PlanError, Settings};
use crate::env::EnvError;
use crate::env::grid::{ActionSet, REGULAR, mentor_path};

/// Most metres a second of each component that the controller aims for.
const CRUISE: f64 = 2.0;
/// Speed that it aims for, metres a second, for each metre that is left to the next waypoint.
const APPROACH: f64 = 4.0;
/// Distance in metres at which it turns to the next waypoint.
const CLOSE: f64 = 0.2;

/// States of a mentor that acts with the action set `mentor_actions` from the map's start to its goal, 4 features each;
/// the last one is at the goal.
///
/// # Errors
/// No map, an unknown action set, or a goal that is not reached within `step_limit` steps.
pub(super) fn plan_states(
    settings: &Settings,
    step_limit: u32,
    mentor_actions: &str,
) -> Result<Vec<Vec<f32>>, EnvError> {
    let geometry = settings.geometry()?;
    let forces = forces(settings, "mentor.actions", mentor_actions, &geometry)?;
    let frames = settings.frame_skip;
    let physics = Physics::new(geometry.clone(), settings.contact_margin);
    let mut waypoints = waypoints(settings, &geometry)?.into_iter().peekable();
    let mut body = Body { position: geometry.place(geometry.map().start()), velocity: [0.0; 2] };
    let mut states = vec![body.observation().to_vec()];
    while !geometry.reached(body.position) {
        if states.len() > step_limit as usize {
            return Err(EnvError::own(PlanError { actions: mentor_actions.into(), steps: step_limit }));
        }
        let near = |w: &Vector| (0..2).all(|i| (w[i] - body.position[i]).abs() < CLOSE);
        // The last waypoint is the goal and is never passed.
        if waypoints.peek().is_some_and(near) && waypoints.len() > 1 {
            waypoints.next();
        }
        let target = waypoints.peek().copied().unwrap_or(body.position);
        let control = choose(&forces, &body, target, frames);
        body = body.limited();
        physics.advance(&mut body, control, frames);
        states.push(body.observation().to_vec());
    }
    Ok(states)
}

/// Middles of the cells at which the shortest path turns, and the goal's place.
fn waypoints(settings: &Settings, geometry: &Geometry) -> Result<Vec<Vector>, EnvError> {
    let path = mentor_path(&settings.map, geometry.map(), &ActionSet::new("regular", REGULAR))?;
    let middle = |cell: &[usize; 2]| geometry.centre([cell[0] as isize, cell[1] as isize]);
    let turns = path.windows(3).filter(|w| w[0][0] != w[2][0] && w[0][1] != w[2][1]);
    let mut waypoints: Vec<Vector> = turns.map(|w| middle(&w[1])).collect();
    waypoints.push(geometry.goal());
    Ok(waypoints)
}

/// The control after which, walls aside, the velocity is nearest to the one that leads to `target`.
fn choose(forces: &[Force], body: &Body, target: Vector, frames: u32) -> Vector {
    let wanted = [0, 1].map(|i| (APPROACH * (target[i] - body.position[i])).clamp(-CRUISE, CRUISE));
    let gain = f64::from(frames) * TIMESTEP * GEAR / MASS;
    let miss = |control: Vector| -> f64 {
        (0..2).map(|i| (body.velocity[i] + gain * control[i] - wanted[i]).powi(2)).sum()
    };
    let best = forces.iter().min_by(|a, b| miss(a.control).total_cmp(&miss(b.control)));
    best.map_or([0.0; 2], |force| force.control)
}
