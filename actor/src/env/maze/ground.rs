//! Where the maze's states lie on its map: they are cells.

use crate::env::Ground;
use crate::env::grid::Map;

/// States are the cells of a map.
pub(super) struct Cells(pub(super) Map);

impl Ground for Cells {
    fn size(&self) -> [usize; 2] {
        [self.0.columns(), self.0.rows()]
    }

    fn is_free(&self, cell: [usize; 2]) -> bool {
        self.0.is_free(cell)
    }

    fn ends(&self) -> [[f64; 2]; 2] {
        [self.0.start(), self.0.goal()].map(|cell| cell.map(|coordinate| coordinate as f64))
    }

    fn places(&self, states: &[f32]) -> Vec<[f64; 2]> {
        states.chunks_exact(2).map(|state| [f64::from(state[0]), f64::from(state[1])]).collect()
    }

    fn state(&self, place: [f64; 2]) -> Vec<f32> {
        place.map(|coordinate| coordinate as f32).to_vec()
    }
}
