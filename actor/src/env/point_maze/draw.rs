//! Paths over the maze, as text for a terminal.

use super::geometry::{Geometry, Vector};

/// Characters that a picture is to be wide, where the map is not larger.
const WIDTH: usize = 96;
/// Most characters for a cell's width. A character is about twice as high as wide.
const CELL: usize = 6;

/// The maze of `geometry` with `paths`: states, 4 features each as the environment gives them, and the mark of each.
/// Where two meet, the later one is seen; start and goal stay visible.
pub(super) fn draw(geometry: &Geometry, paths: &[(&[f32], char)]) -> String {
    let map = geometry.map();
    let wide = (WIDTH / map.columns()).clamp(1, CELL);
    let high = (wide / 2).max(1);
    let (columns, rows) = (wide * map.columns(), high * map.rows());
    let cell = |column: usize, row: usize| [column / wide, row / high];
    let mut letters: Vec<Vec<char>> = (0..rows)
        .map(|row| {
            (0..columns).map(|column| if map.is_free(cell(column, row)) { ' ' } else { '#' }).collect()
        })
        .collect();
    let mut mark = |point: Vector, mark: char| {
        let [column, row] = geometry.grid(point);
        // A cast saturates, so what is left of or above the map would end up on its edge.
        let (column, row) = ((column + 0.5) * wide as f64, (row + 0.5) * high as f64);
        if column >= 0.0
            && row >= 0.0
            && let Some(letter) = letters.get_mut(row as usize).and_then(|line| line.get_mut(column as usize))
        {
            *letter = mark;
        }
    };
    for (states, letter) in paths {
        for state in states.chunks_exact(4) {
            mark([f64::from(state[0]), f64::from(state[1])], *letter);
        }
    }
    mark(geometry.place(map.start()), 'S');
    mark(geometry.goal(), 'G');
    letters.into_iter().flat_map(|line| line.into_iter().chain(['\n'])).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::env::grid::Map;
    use crate::env::point_maze::Layout;

    #[test]
    fn paths_are_laid_over_the_maze() {
        let map = Map::parse("m", "####\n#SG#\n####\n").unwrap();
        let geometry = Geometry::new(map, Layout::Gymnasium);
        let path = [-0.9, 0.4, 0.0, 0.0, -0.9, -0.4, 1.0, 1.0, 99.0, 0.0, 0.0, 0.0, -99.0, 0.0, 0.0, 0.0];
        let wall = format!("{0}\n{0}\n{0}\n", "#".repeat(24));
        let inside = "######o           ######\n######   S     G  ######\n######o           ######\n";
        assert_eq!(draw(&geometry, &[(&path, 'o')]), format!("{wall}{inside}{wall}"));
    }
}
