//! `map.json`: the environment's map for pictures, where it has one.

use anyhow::Result;
use trestle_actor::env::{Ground, registry};
use trestle_proto::config;
use trestle_proto::map_file::MapFile;

/// How far a place may be from what its state says, cells.
const EXACT: f64 = 1e-3;

/// The map of the environment `env`; none where it has no map, or one on which columns and rows are not two features of a
/// state.
pub(super) fn map_file(env: &config::Env) -> Result<Option<MapFile>> {
    Ok(registry().ground(env)?.and_then(|ground| drawn(ground.as_ref())))
}

fn drawn(ground: &dyn Ground) -> Option<MapFile> {
    let [columns, rows] = ground.size();
    let text =
        |row| (0..columns).map(|column| if ground.is_free([column, row]) { '.' } else { '#' }).collect();
    let [zero, right, down] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]].map(|place| ground.state(place));
    let changed = |state: &[f32]| zero.iter().zip(state).position(|(a, b)| a != b);
    let features = [changed(&right)?, changed(&down)?];
    let origin = features.map(|feature| f64::from(zero[feature]));
    let scale = [&right, &down].map(|state| changed(state).map_or(0.0, |at| f64::from(state[at] - zero[at])));
    let map = MapFile {
        rows: (0..rows).map(text).collect(),
        ends: ground.ends(),
        features,
        origin,
        scale,
        squares: ground.squares(),
    };
    let same = |place: [f64; 2]| {
        let mut state = vec![0.0; zero.len()];
        map.state(place, &mut state);
        let there = ground.places(&state);
        there.first().is_some_and(|there| (0..2).all(|axis| (there[axis] - place[axis]).abs() < EXACT))
    };
    let corner = [columns as f64 - 1.0, rows as f64 - 1.0];
    (map.check(zero.len()).is_ok() && same([0.0, 0.0]) && same(corner)).then_some(map)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use trestle_proto::config::load;

    #[test]
    fn maps_of_cells_and_of_metres_are_written_alike() {
        for (preset, rows, squares) in [("maze-small", 12, 1), ("point-umaze", 5, 4)] {
            let mut env = load(registry(), preset, &[]).unwrap().env;
            registry().resolve(&mut env, 0).unwrap();
            let map = map_file(&env).unwrap().unwrap();
            assert_eq!((map.rows.len(), map.squares), (rows, squares), "{preset}");
            let mut state = vec![0.0; if squares == 1 { 2 } else { 4 }];
            map.state(map.ends[1], &mut state);
            let ground = registry().ground(&env).unwrap().unwrap();
            let goal = ground.places(&state)[0];
            assert!((0..2).all(|axis| (goal[axis] - map.ends[1][axis]).abs() < EXACT), "{preset}: {goal:?}");
        }
    }
}
