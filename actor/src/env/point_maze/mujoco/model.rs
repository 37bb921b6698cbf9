//! The maze as a model in MuJoCo's XML.

use super::MujocoError;
use super::api::Version;
use crate::env::point_maze::geometry::Geometry;
use crate::env::point_maze::physics::{DAMPING, GEAR, RADIUS, TIMESTEP};
use std::fmt::Write;

/// Most walls of a model.
pub const MAX_WALLS: usize = 10_000;

/// The model of `geometry` for MuJoCo `version`, in which walls push from `margin` metres on.
///
/// The originals leave the solver's tolerance at 1e-8 and start it from the last step's result. Here it has no tolerance
/// and starts anew, so that a step is a function of the state alone, as snapshots need it; walls that the ball cannot
/// touch are left out, and so is the floor.
pub(super) fn xml(geometry: &Geometry, margin: f64, version: Version) -> Result<String, MujocoError> {
    let walls = geometry.walls();
    if walls.len() > MAX_WALLS {
        return Err(MujocoError::Walls { walls: walls.len(), most: MAX_WALLS });
    }
    let margin = if version.adds_margins() { margin / 2.0 } else { margin };
    let mut boxes = String::new();
    for [x, y] in walls {
        // Writing to a string cannot fail.
        let _ = writeln!(
            boxes,
            r#"    <geom type="box" pos="{x} {y} 0" size="0.5 0.5 0.5" contype="1" conaffinity="0"/>"#
        );
    }
    let vertical =
        if version.axes() == 3 { "\n      <joint name=\"z\" type=\"slide\" axis=\"0 0 1\"/>" } else { "" };
    Ok(format!(
        r#"<mujoco model="point maze">
  <option timestep="{TIMESTEP}" gravity="0 0 0" integrator="Euler" solver="Newton" iterations="20" tolerance="0">
    <flag warmstart="disable"/>
  </option>
  <default>
    <geom density="1000" condim="1" margin="{margin}"/>
    <joint damping="{DAMPING}"/>
  </default>
  <worldbody>
{boxes}    <body name="ball">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="y" type="slide" axis="0 1 0"/>{vertical}
      <geom type="sphere" size="{RADIUS}" contype="0" conaffinity="1"/>
    </body>
  </worldbody>
  <actuator>
    <motor joint="x" gear="{GEAR}" ctrllimited="true" ctrlrange="-1 1"/>
    <motor joint="y" gear="{GEAR}" ctrllimited="true" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"#
    ))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::env::grid::{Generator, Map};
    use crate::env::point_maze::Layout;

    #[test]
    fn margins_add_up_to_the_same_in_every_version() {
        let geometry = Geometry::new(Map::parse("m", "SG\n").unwrap(), Layout::D4rl);
        let old = xml(&geometry, 0.002, Version::decode(340)).unwrap();
        let new = xml(&geometry, 0.002, Version::decode(3_005_000)).unwrap();
        assert!(old.contains(r#"margin="0.002""#) && new.contains(r#"margin="0.001""#));
        let joints =
            |version| xml(&geometry, 0.002, Version::decode(version)).unwrap().matches("<joint name").count();
        assert_eq!((joints(237), joints(300)), (3, 2));
        assert_eq!(old.matches("<geom type=\"box\"").count(), 10);
    }

    #[test]
    fn too_many_walls_are_refused() {
        let map = Generator::Random.generate(1, 400, 400);
        let geometry = Geometry::new(map, Layout::D4rl);
        let refused = xml(&geometry, 0.002, Version::decode(340)).map(|text| text.len());
        assert!(matches!(refused, Err(MujocoError::Walls { most: MAX_WALLS, .. })), "{refused:?}");
    }
}
