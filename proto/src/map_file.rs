//! `map.json`: where the states of a run's environment lie on a map, for pictures. Only environments with a map have one.

use serde::{Deserialize, Serialize};

/// Largest `map.json` that is read, bytes.
pub const MAX_MAP_BYTES: u64 = 4 << 20;

/// A map of cells, and the way from states to places on it. A place is [column, row] from the top left, whole numbers in the
/// middle of a cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapFile {
    /// A text a row: `#` is a wall, `.` is none.
    pub rows: Vec<String>,
    /// Places of start and goal.
    pub ends: [[f64; 2]; 2],
    /// The features of a state that say its column and its row.
    pub features: [usize; 2],
    /// Their values at place [0, 0].
    pub origin: [f64; 2],
    /// Their changes from one column, and from one row, to the next; not 0.
    pub scale: [f64; 2],
    /// Squares along the side of a cell by which pictures tell states apart, 1 or more.
    pub squares: usize,
}

/// A map that cannot be drawn.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("map.json: {what} is {found}; accepted: {accepted}")]
pub struct MapFileError {
    what: &'static str,
    found: String,
    accepted: String,
}

impl MapFile {
    /// Checks all that readers rely on, for states with `obs_dim` features.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn check(&self, obs_dim: usize) -> Result<(), MapFileError> {
        let refuse = |what, found: String, accepted: String| Err(MapFileError { what, found, accepted });
        let width = self.rows.first().map_or(0, String::len);
        let plain = |row: &String| row.len() == width && row.bytes().all(|cell| b"#.".contains(&cell));
        if width == 0 || !self.rows.iter().all(plain) {
            return refuse(
                "rows",
                format!("{} of them", self.rows.len()),
                "equally long texts of # and .".into(),
            );
        }
        if self.features[0] == self.features[1] || self.features.iter().any(|&feature| feature >= obs_dim) {
            return refuse("features", format!("{:?}", self.features), format!("two of {obs_dim} features"));
        }
        let numbers = self.ends.iter().chain([&self.origin, &self.scale]).flatten();
        if !numbers.clone().all(|x| x.is_finite()) || self.scale.contains(&0.0) {
            return refuse(
                "a number",
                "not finite, or a scale of 0".into(),
                "finite numbers, scales other than 0".into(),
            );
        }
        if !(1..=16).contains(&self.squares) {
            return refuse("squares", self.squares.to_string(), "1 to 16".into());
        }
        Ok(())
    }

    /// Columns and rows.
    pub fn size(&self) -> [usize; 2] {
        [self.rows.first().map_or(0, String::len), self.rows.len()]
    }

    /// Whether the cell [column, row] inside the map is no wall.
    pub fn is_free(&self, [column, row]: [usize; 2]) -> bool {
        self.rows[row].as_bytes()[column] != b'#'
    }

    /// The place of `state`.
    pub fn place(&self, state: &[f32]) -> [f64; 2] {
        [0, 1].map(|axis| (f64::from(state[self.features[axis]]) - self.origin[axis]) / self.scale[axis])
    }

    /// Writes the state at `place` into `state`; features that say nothing of the place are 0: at rest.
    pub fn state(&self, place: [f64; 2], state: &mut [f32]) {
        state.fill(0.0);
        for axis in 0..2 {
            state[self.features[axis]] = (self.origin[axis] + place[axis] * self.scale[axis]) as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn map() -> MapFile {
        MapFile {
            rows: vec!["..#".into(), "...".into()],
            ends: [[0.0, 0.0], [2.0, 1.0]],
            features: [2, 0],
            origin: [1.0, -3.0],
            scale: [0.5, -2.0],
            squares: 2,
        }
    }

    #[test]
    fn places_and_states_are_each_others_inverse() {
        let map = map();
        let mut state = [9.0; 4];
        map.state([1.5, -0.25], &mut state);
        assert_eq!(state, [-2.5, 0.0, 1.75, 0.0]);
        assert_eq!(map.place(&state), [1.5, -0.25]);
        assert!(map.is_free([1, 0]) && !map.is_free([2, 0]));
        assert_eq!(map.size(), [3, 2]);
    }

    #[test]
    fn what_cannot_be_drawn_is_refused() {
        assert_eq!(map().check(4), Ok(()));
        let wrong = |change: fn(&mut MapFile)| {
            let mut map = map();
            change(&mut map);
            map.check(4).unwrap_err().to_string()
        };
        assert!(wrong(|map| map.rows[1] = "..".into()).contains("rows"));
        assert!(wrong(|map| map.rows.clear()).contains("rows"));
        assert!(wrong(|map| map.rows[0] = "..\u{e9}".into()).contains("rows"));
        assert!(wrong(|map| map.features = [1, 4]).contains("two of 4 features"));
        assert!(wrong(|map| map.scale[1] = 0.0).contains("scale"));
        assert!(wrong(|map| map.ends[0][1] = f64::NAN).contains("finite"));
        assert!(wrong(|map| map.squares = 0).contains("1 to 16"));
    }
}
