//! States as rows of a network's input.

use trestle_proto::row::Row;
use trestle_qnet::Encoding;

/// Rows of network input, in memory that is allocated once.
#[derive(Debug)]
pub(super) struct Rows {
    width: usize,
    len: usize,
    x: Vec<f32>,
}

impl Rows {
    /// Room for `most` rows of `width` numbers.
    pub(super) fn new(width: usize, most: usize) -> Self {
        Self { width, len: 0, x: vec![0.0; width * most] }
    }

    /// Forgets all rows.
    pub(super) fn clear(&mut self) {
        self.len = 0;
    }

    /// Encodes `obs` into a new row and returns its number.
    pub(super) fn push(&mut self, encoding: &Encoding, obs: Row<'_>) -> usize {
        let row = self.len;
        encoding.encode_row(obs, &mut self.x[row * self.width..][..self.width]);
        self.len += 1;
        row
    }

    /// Number of rows.
    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// Row `row`.
    pub(super) fn get(&self, row: usize) -> &[f32] {
        &self.x[row * self.width..][..self.width]
    }

    /// All rows, one after the other.
    pub(super) fn all(&self) -> &[f32] {
        &self.x[..self.len * self.width]
    }
}

/// Q-values of rows, `n_actions` each.
#[derive(Debug)]
pub(super) struct Values {
    n_actions: usize,
    q: Vec<f32>,
}

impl Values {
    /// Room for the values of `most` rows.
    pub(super) fn new(n_actions: usize, most: usize) -> Self {
        Self { n_actions, q: vec![0.0; n_actions * most] }
    }

    /// The values of the first `rows` rows, to be filled in.
    pub(super) fn first(&mut self, rows: usize) -> &mut [f32] {
        &mut self.q[..rows * self.n_actions]
    }

    /// The values of row `row`, one an action.
    pub(super) fn of(&self, row: usize) -> &[f32] {
        &self.q[row * self.n_actions..][..self.n_actions]
    }

    /// The value of `action` in row `row`.
    pub(super) fn at(&self, row: usize, action: u32) -> f32 {
        self.of(row)[action as usize]
    }
}
