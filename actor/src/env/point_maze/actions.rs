//! Forces as discrete actions: each direction of an action set at each magnitude, and no force at all.

use super::Settings;
use super::geometry::{Geometry, Vector};
use crate::env::EnvError;
use crate::env::grid::Direction;

/// The mentor's directions: along the axes.
pub const ORTHOGONAL: &[Direction] = &[Direction::N, Direction::E, Direction::S, Direction::W];
/// The observer's directions: both motors at once. The figure that defines the paper's sets is not available to us;
/// these two share nothing but the action without force.
pub const DIAGONAL: &[Direction] = &[Direction::NE, Direction::SE, Direction::SW, Direction::NW];

/// A discrete action.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Force {
    /// For people: direction and magnitude.
    pub(super) name: String,
    /// Control of the motors, each component -1 to 1. In a diagonal direction both have the magnitude.
    pub(super) control: Vector,
}

/// The actions of the set that the setting `key` calls `name`: all directions at the first magnitude, then at the next,
/// and `none` at the end.
///
/// # Errors
/// An unknown set, or one of the configuration that cannot be used.
pub(super) fn forces(
    settings: &Settings,
    key: &'static str,
    name: &str,
    geometry: &Geometry,
) -> Result<Vec<Force>, EnvError> {
    let set = settings.action_set(key, name)?;
    let mut forces = Vec::new();
    for &magnitude in &settings.magnitudes {
        for direction in &set.directions {
            let (column, row) = direction.delta();
            let change = [f64::from(column) * magnitude, f64::from(row) * magnitude];
            forces.push(Force {
                name: format!("{} {magnitude}", direction.name()),
                control: geometry.turn(change),
            });
        }
    }
    forces.push(Force { name: "none".into(), control: [0.0; 2] });
    Ok(forces)
}
