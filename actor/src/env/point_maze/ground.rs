//! Where the ball lies on the map.

use super::Geometry;
use crate::env::Ground;
use crate::env::grid::Cell;

/// Squares along the side of a cell.
const SQUARES: usize = 4;

/// States are a point in metres and its velocity.
pub(super) struct Plane(pub(super) Geometry);

impl Plane {
    /// Where the environment puts what is in a cell.
    fn place(&self, cell: Cell) -> [f64; 2] {
        self.0.grid(self.0.place(cell))
    }
}

impl Ground for Plane {
    fn size(&self) -> [usize; 2] {
        [self.0.map().columns(), self.0.map().rows()]
    }

    fn is_free(&self, cell: [usize; 2]) -> bool {
        self.0.map().is_free(cell)
    }

    fn ends(&self) -> [[f64; 2]; 2] {
        [self.0.map().start(), self.0.map().goal()].map(|cell| self.place(cell))
    }

    fn places(&self, states: &[f32]) -> Vec<[f64; 2]> {
        states.chunks_exact(4).map(|state| self.0.grid([f64::from(state[0]), f64::from(state[1])])).collect()
    }

    fn state(&self, place: [f64; 2]) -> Vec<f32> {
        let [x, y] = self.0.point(place);
        vec![x as f32, y as f32, 0.0, 0.0]
    }

    fn squares(&self) -> usize {
        SQUARES
    }
}
