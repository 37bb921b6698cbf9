//! Where states lie on the map, for pictures of either environment.

use super::EnvError;
use super::maze::{self, Cell, Map};
use super::point_maze::Geometry;
use trestle_proto::config::{self, EnvKind};

/// The map of an environment and the way from its states to places on it: [column, row], whole numbers in the middle of a
/// cell.
#[derive(Clone, Debug)]
pub enum Ground {
    /// States are cells.
    Maze(Map),
    /// States are a point in metres and its velocity.
    PointMaze(Geometry),
}

impl Ground {
    /// That of a resolved configuration (see [`super::resolve`]).
    ///
    /// # Errors
    /// There is no map.
    pub fn of(env: &config::Env) -> Result<Self, EnvError> {
        let map = maze::map_of(env)?;
        Ok(match env.kind {
            EnvKind::Maze => Self::Maze(map),
            EnvKind::PointMaze => Self::PointMaze(Geometry::new(map, env.point_maze.layout)),
        })
    }

    /// The map.
    pub fn map(&self) -> &Map {
        match self {
            Self::Maze(map) => map,
            Self::PointMaze(geometry) => geometry.map(),
        }
    }

    /// The places of `states`, one after the other as the environment gives them.
    pub fn places(&self, states: &[f32]) -> Vec<[f64; 2]> {
        let pair = |state: &[f32]| [f64::from(state[0]), f64::from(state[1])];
        match self {
            Self::Maze(_) => states.chunks_exact(2).map(pair).collect(),
            Self::PointMaze(geometry) => {
                states.chunks_exact(4).map(|state| geometry.grid(pair(state))).collect()
            }
        }
    }

    /// Where the environment puts what is in a cell: start and goal.
    pub fn place(&self, cell: Cell) -> [f64; 2] {
        match self {
            Self::Maze(_) => cell.map(|coordinate| coordinate as f64),
            Self::PointMaze(geometry) => geometry.grid(geometry.place(cell)),
        }
    }

    /// The state at a place, at rest.
    pub fn state(&self, place: [f64; 2]) -> Vec<f32> {
        match self {
            Self::Maze(_) => place.map(|coordinate| coordinate as f32).to_vec(),
            Self::PointMaze(geometry) => {
                let [x, y] = geometry.point(place);
                vec![x as f32, y as f32, 0.0, 0.0]
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use trestle_proto::config::PointLayout;

    #[test]
    fn states_and_places_belong_together() {
        let map = Map::parse("m", "S..\n.#.\n..G\n").unwrap();
        let grounds = [
            Ground::Maze(map.clone()),
            Ground::PointMaze(Geometry::new(map.clone(), PointLayout::D4rl)),
            Ground::PointMaze(Geometry::new(map, PointLayout::Gymnasium)),
        ];
        for ground in grounds {
            for place in [[0.0, 0.0], [2.0, 1.0], [1.0, 2.0]] {
                let found = ground.places(&ground.state(place));
                assert!((0..2).all(|i| (found[0][i] - place[i]).abs() < 1e-6), "{ground:?} {found:?}");
            }
            let [column, row] = ground.place(ground.map().goal()).map(f64::round);
            assert_eq!([column, row], [2.0, 2.0], "{ground:?}");
        }
    }
}
