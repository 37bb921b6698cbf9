//! Where states lie on a map, for pictures of an environment that has one.

/// A map of cells, and the way from an environment's states to places on it. A place is [column, row] from the top left,
/// whole numbers in the middle of a cell.
pub trait Ground {
    /// Columns and rows.
    fn size(&self) -> [usize; 2];

    /// Whether the cell [column, row] inside the map is no wall.
    fn is_free(&self, cell: [usize; 2]) -> bool;

    /// Places of start and goal.
    fn ends(&self) -> [[f64; 2]; 2];

    /// The places of `states`, which stand one after the other as the environment gives them.
    fn places(&self, states: &[f32]) -> Vec<[f64; 2]>;

    /// The state at a place; at rest, where there is motion.
    fn state(&self, place: [f64; 2]) -> Vec<f32>;

    /// Squares along the side of a cell by which a picture tells states apart: 1, 2 or 4. 1 where states are cells.
    fn squares(&self) -> usize {
        1
    }
}
