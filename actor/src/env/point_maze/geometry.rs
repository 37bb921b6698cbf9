//! Between points in metres and cells of the map.

use crate::env::grid::{Cell, Map};
use crate::env::point_maze::Layout;

/// A point, a velocity or a force: x and y.
pub type Vector = [f64; 2];

/// The map laid out in the plane: one cell is a square with sides of one metre. Outside the map everything is wall.
#[derive(Clone, Debug)]
pub struct Geometry {
    map: Map,
    layout: Layout,
}

impl Geometry {
    /// `map` in the coordinates of `layout`.
    pub fn new(map: Map, layout: Layout) -> Self {
        Self { map, layout }
    }

    /// The map.
    pub fn map(&self) -> &Map {
        &self.map
    }

    /// Where the originals put what is "in" a cell: start, goal and random resets. In D4RL this is not the middle of
    /// the cell, because the ball's zero lies 0.2 m beside that of the walls.
    pub fn place(&self, cell: Cell) -> Vector {
        let [column, row] = cell.map(|coordinate| coordinate as f64);
        match self.layout {
            Layout::D4rl => [row, column],
            Layout::Gymnasium => self.centre([cell[0] as isize, cell[1] as isize]),
        }
    }

    /// Middle of the cell [column, row], which may lie outside the map.
    pub fn centre(&self, cell: [isize; 2]) -> Vector {
        self.point(cell.map(|coordinate| coordinate as f64))
    }

    /// The point at [column, row], whole numbers in the middle of a cell.
    pub fn point(&self, [column, row]: Vector) -> Vector {
        match self.layout {
            Layout::D4rl => [row - 0.2, column - 0.2],
            Layout::Gymnasium => {
                [column + 0.5 - self.map.columns() as f64 / 2.0, self.map.rows() as f64 / 2.0 - (row + 0.5)]
            }
        }
    }

    /// `point` as [column, row], whole numbers in the middle of a cell.
    pub fn grid(&self, point: Vector) -> Vector {
        let [x, y] = point;
        match self.layout {
            Layout::D4rl => [y + 0.2, x + 0.2],
            Layout::Gymnasium => {
                [x - 0.5 + self.map.columns() as f64 / 2.0, self.map.rows() as f64 / 2.0 - y - 0.5]
            }
        }
    }

    /// Whether the cell [column, row] is a wall.
    #[inline]
    pub fn is_wall(&self, cell: [isize; 2]) -> bool {
        // What is negative becomes too large.
        !self.map.is_free(cell.map(|coordinate| coordinate as usize))
    }

    /// The cell [column, row] that `point` lies in.
    #[inline]
    pub fn cell(&self, point: Vector) -> [isize; 2] {
        self.grid(point).map(|coordinate| coordinate.round() as isize)
    }

    /// A change of [column, row] as a change of [x, y].
    pub fn turn(&self, change: Vector) -> Vector {
        let [column, row] = change;
        match self.layout {
            Layout::D4rl => [row, column],
            Layout::Gymnasium => [column, -row],
        }
    }

    /// Distance from the goal's place at which an episode ends, metres.
    pub fn goal_radius(&self) -> f64 {
        match self.layout {
            Layout::D4rl => 0.5,
            Layout::Gymnasium => 0.45,
        }
    }

    /// Where the goal is.
    pub fn goal(&self) -> Vector {
        self.place(self.map.goal())
    }

    /// Whether an episode ends at `point`.
    pub fn reached(&self, point: Vector) -> bool {
        let [x, y] = self.goal();
        (point[0] - x).hypot(point[1] - y) <= self.goal_radius()
    }

    /// The free cells, row by row.
    pub fn free_cells(&self) -> impl Iterator<Item = Cell> + '_ {
        let (columns, rows) = (self.map.columns(), self.map.rows());
        (0..rows)
            .flat_map(move |row| (0..columns).map(move |column| [column, row]))
            .filter(|&c| self.map.is_free(c))
    }

    /// Smallest and largest x and y of the free cells.
    pub fn bounds(&self) -> [Vector; 2] {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for cell in self.free_cells() {
            let [x, y] = self.centre([cell[0] as isize, cell[1] as isize]);
            low = [low[0].min(x - 0.5), low[1].min(y - 0.5)];
            high = [high[0].max(x + 0.5), high[1].max(y + 0.5)];
        }
        [low, high]
    }

    /// Middles of the wall cells that touch a free one, those of the border outside the map included: all that the ball
    /// can touch.
    pub fn walls(&self) -> Vec<Vector> {
        let (columns, rows) = (self.map.columns() as isize, self.map.rows() as isize);
        let near =
            |[c, r]: [isize; 2]| (r - 1..=r + 1).flat_map(move |r| (c - 1..=c + 1).map(move |c| [c, r]));
        let all = (-1..=rows).flat_map(|row| (-1..=columns).map(move |column| [column, row]));
        all.filter(|&cell| self.is_wall(cell) && near(cell).any(|cell| !self.is_wall(cell)))
            .map(|cell| self.centre(cell))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::env::grid::Map;

    fn both() -> [Geometry; 2] {
        let map = Map::parse("m", "#####\n#G..#\n###.#\n#S..#\n#####\n").unwrap();
        [Layout::D4rl, Layout::Gymnasium].map(|layout| Geometry::new(map.clone(), layout))
    }

    #[test]
    fn cells_and_points_agree() {
        for geometry in both() {
            for row in -1..=5 {
                for column in -1..=5 {
                    let centre = geometry.centre([column, row]);
                    for offset in [[0.0, 0.0], [0.49, 0.49], [-0.49, 0.49], [0.49, -0.49]] {
                        let point = [centre[0] + offset[0], centre[1] + offset[1]];
                        assert_eq!(geometry.cell(point), [column, row]);
                    }
                }
            }
            let [low, high] = geometry.bounds();
            assert!((high[0] - low[0] - 3.0).abs() < 1e-12 && (high[1] - low[1] - 3.0).abs() < 1e-12);
            assert_eq!(geometry.walls().len(), 25 - geometry.map().free_cells());
        }
    }

    #[test]
    fn the_layouts_are_those_of_the_originals() {
        let [d4rl, gymnasium] = both();
        assert_eq!((d4rl.place([1, 3]), d4rl.goal(), d4rl.goal_radius()), ([3.0, 1.0], [1.0, 1.0], 0.5));
        assert_eq!(d4rl.centre([0, 0]), [-0.2, -0.2]);
        // East is to the right of the picture, north is up.
        assert_eq!((d4rl.turn([1.0, 0.0]), d4rl.turn([0.0, -1.0])), ([0.0, 1.0], [-1.0, 0.0]));
        assert_eq!(gymnasium.place([1, 3]), [-1.0, -1.0]);
        assert_eq!((gymnasium.goal(), gymnasium.goal_radius()), ([-1.0, 1.0], 0.45));
        assert_eq!(gymnasium.turn([1.0, -1.0]), [1.0, 1.0]);
    }

    #[test]
    fn a_map_without_a_border_is_surrounded_by_walls() {
        let geometry = Geometry::new(Map::parse("m", "SG\n").unwrap(), Layout::Gymnasium);
        assert!(geometry.is_wall([-1, 0]) && geometry.is_wall([0, 1]) && !geometry.is_wall([1, 0]));
        assert_eq!(geometry.walls().len(), 10);
    }
}
