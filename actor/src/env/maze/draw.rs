//! A map with paths on it, as text for a terminal.

use crate::env::grid::{Cell, Map};

/// `map` as text, one line a row, the cells of each of `paths`, one state after the other, with its mark; where two meet, the
/// later one's is seen. Start, goal and walls stay visible, and cells outside the map are left out.
pub(super) fn draw(map: &Map, paths: &[(&[f32], char)]) -> String {
    let mut letters: Vec<Vec<char>> = map.to_string().lines().map(|line| line.chars().collect()).collect();
    for (states, mark) in paths {
        for cell in cells(states).filter(|&cell| map.is_free(cell)) {
            if cell != map.start() && cell != map.goal() {
                letters[cell[1]][cell[0]] = *mark;
            }
        }
    }
    letters.into_iter().flat_map(|line| line.into_iter().chain(['\n'])).collect()
}

/// The cells of a maze's states as they are in demonstrations and evaluations: (column, row) after (column, row).
fn cells(states: &[f32]) -> impl Iterator<Item = Cell> {
    // A cast saturates: what is no cell ends up outside the map, or in column or row 0.
    states.chunks_exact(2).map(|state| [state[0].round() as usize, state[1].round() as usize])
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn paths_are_laid_over_free_cells() {
        let map = Map::parse("m", "S.#\n...\n..G\n").unwrap();
        let path = [0.0, 0.0, 1.0, 0.0, 2.0, 0.0, 1.0, 1.0, 2.0, 2.0, 9.0, 9.0];
        assert_eq!(draw(&map, &[(&path, '*')]), "S*#\n.*.\n..G\n");
        let paths: [(&[f32], char); 2] = [(&[0.0, 1.0, 1.0, 1.0], 'm'), (&[1.0, 1.0, 1.0, 2.0], 'o')];
        assert_eq!(draw(&map, &paths), "S.#\nmo.\n.oG\n");
        assert_eq!(draw(&map, &[]), map.to_string());
    }
}
