//! The maze as an environment: dynamics, rewards, and the cells that an episode has visited.

use super::Settings;
use crate::env::grid::{ActionSet, Cell, Index, Map, Move, mentor_path};
use crate::env::{EnvError, Environment, Impossible, Step, within};
use serde::{Deserialize, Serialize};
use trestle_proto::codec::{self, Kind};
use trestle_proto::rng::Stream;
use trestle_proto::row::Element;
use trestle_proto::space::EnvSpec;

// The four rewards are known values. Which of them applies where is partly our choice, because the paper's wording
// leaves room; with it the best return on the paper's maze, 1 - 0.04 x 110 = -3.4, is the paper's threshold exactly.

/// Reward for reaching the goal.
pub const GOAL_REWARD: f32 = 1.0;
/// Reward for a blocked move, which leaves the agent where it is.
pub const BLOCKED_REWARD: f32 = -0.75;
/// Reward for entering a cell that this episode has visited before; the start counts as visited. It depends on the
/// episode's history, so it is not a function of the state that the agent observes.
pub const REVISIT_REWARD: f32 = -0.25;
/// Reward for any other move.
pub const MOVE_REWARD: f32 = -0.04;

const KIND: Kind = Kind { magic: *b"TRMAZE\0\0", version: 1 };

/// A maze with one agent in it. Its state is the agent's (column, row), two whole numbers from 0.
///
/// A state is only a cell: what the episode has visited, on which one reward depends, is not observed.
pub struct Maze {
    spec: EnvSpec,
    map: Map,
    goal: Index,
    moves: Vec<Move>,
    step_limit: u32,
    at: Index,
    steps: u32,
    /// Whether there is an episode to go on with.
    running: bool,
    visited: Visited,
}

/// A set of cells that is emptied in constant time: a cell is in it if it was stamped in the current epoch.
struct Visited {
    stamps: Vec<u32>,
    epoch: u32,
}

impl Visited {
    fn new(indices: usize) -> Self {
        Self { stamps: vec![0; indices], epoch: 1 }
    }

    fn clear(&mut self) {
        match self.epoch.checked_add(1) {
            Some(next) => self.epoch = next,
            None => {
                self.stamps.fill(0);
                self.epoch = 1;
            }
        }
    }

    /// Adds `index`; whether it is new.
    fn insert(&mut self, index: Index) -> bool {
        std::mem::replace(&mut self.stamps[index], self.epoch) != self.epoch
    }

    fn contains(&self, index: Index) -> bool {
        self.stamps[index] == self.epoch
    }
}

/// What a snapshot holds.
#[derive(Serialize, Deserialize)]
struct State {
    columns: u32,
    rows: u32,
    at: [u32; 2],
    steps: u32,
    running: bool,
    /// One bit a cell, row by row, the lowest bit of a word first.
    visited: Vec<u64>,
}

/// The features of a cell.
pub(super) fn observation(cell: Cell) -> [f32; 2] {
    cell.map(|coordinate| coordinate as f32)
}

/// Return of an optimal episode of `moves` moves, 1 or more: every move but the last costs 0.04, no cell is visited
/// twice. Written as a fraction so that it is the nearest number to the decimal one.
fn best_return(moves: usize) -> f64 {
    (25.0 - (moves - 1) as f64) / 25.0
}

impl Maze {
    /// The maze of resolved settings, not yet reset.
    ///
    /// # Errors
    /// No map, an unknown action set, or a goal that `env.actions` does not reach.
    pub(super) fn of(settings: &Settings, step_limit: u32) -> Result<Self, EnvError> {
        let map = settings.map()?;
        let set = settings.action_set("env.actions", &settings.actions)?;
        let optimum = mentor_path(&settings.map, &map, &set)?.len() - 1;
        let spec = spec(&settings.map, step_limit, &map, &set, optimum);
        Ok(Self {
            goal: map.index(map.goal()),
            at: map.index(map.start()),
            moves: map.moves(&set.directions),
            visited: Visited::new(map.indices()),
            step_limit,
            steps: 0,
            running: false,
            spec,
            map,
        })
    }

    fn observe(&self, obs: &mut [f32]) {
        obs.copy_from_slice(&observation(self.map.cell(self.at)));
    }

    /// Begins an episode in the cell with index `at`.
    fn begin(&mut self, at: usize, obs: &mut [f32]) {
        self.at = at;
        self.steps = 0;
        self.running = true;
        self.visited.clear();
        self.visited.insert(self.at);
        self.observe(obs);
    }
}

fn spec(name: &str, step_limit: u32, map: &Map, set: &ActionSet, optimum: usize) -> EnvSpec {
    // A map of one column or row still needs a range.
    let last = |side: usize| side.saturating_sub(1).max(1) as f32;
    EnvSpec {
        name: format!("maze {name}"),
        element: Element::F32,
        shape: Vec::new(),
        low: vec![0.0; 2],
        high: vec![last(map.columns()), last(map.rows())],
        scale: vec![1.0; 2],
        integral: true,
        categories: Vec::new(),
        velocities: Vec::new(),
        actions: set.directions.iter().map(|d| d.name().to_string()).collect(),
        // Where every episode is cut off before the goal there is no optimum to reach.
        best_return: (optimum as u64 <= u64::from(step_limit)).then(|| best_return(optimum)),
        threshold: None,
        goal_bonus: 0.0,
        defines_success: true,
    }
}

impl Environment for Maze {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    /// Every episode begins at the start; nothing is drawn.
    fn reset(&mut self, _rng: &mut Stream, obs: &mut [f32]) -> Result<(), EnvError> {
        self.begin(self.map.index(self.map.start()), obs);
        Ok(())
    }

    fn can_be_put(&self) -> bool {
        true
    }

    fn put(&mut self, state: &[f32], obs: &mut [f32]) -> Result<bool, EnvError> {
        if self.can_be_in(state).is_err() {
            return Ok(false);
        }
        let at = self.map.index([state[0], state[1]].map(|coordinate| coordinate as usize));
        let begins = at != self.goal;
        if begins {
            self.begin(at, obs);
        }
        Ok(begins)
    }

    fn step(&mut self, action: u32, obs: &mut [f32]) -> Result<Step, EnvError> {
        if !self.running {
            return Err(EnvError::Ended);
        }
        let Some(&chosen) = self.moves.get(action as usize) else {
            return Err(EnvError::Action { action, last: self.moves.len() - 1 });
        };
        self.steps += 1;
        let reward = match self.map.advance(self.at, chosen) {
            None => BLOCKED_REWARD,
            Some(next) => {
                self.at = next;
                match self.visited.insert(next) {
                    false => REVISIT_REWARD,
                    true if next == self.goal => GOAL_REWARD,
                    true => MOVE_REWARD,
                }
            }
        };
        let terminated = self.at == self.goal;
        let truncated = !terminated && self.steps >= self.step_limit;
        self.running = !(terminated || truncated);
        self.observe(obs);
        Ok(Step { reward, terminated, truncated, success: terminated })
    }

    fn snapshot(&self) -> Result<Vec<u8>, EnvError> {
        let (columns, rows) = (self.map.columns(), self.map.rows());
        let mut visited = vec![0u64; (columns * rows).div_ceil(64)];
        for i in 0..columns * rows {
            if self.visited.contains(self.map.index([i % columns, i / columns])) {
                visited[i / 64] |= 1 << (i % 64);
            }
        }
        let state = State {
            columns: columns as u32,
            rows: rows as u32,
            at: self.map.cell(self.at).map(|coordinate| coordinate as u32),
            steps: self.steps,
            running: self.running,
            visited,
        };
        Ok(codec::encode(KIND, &state)?)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), EnvError> {
        let state: State = codec::decode(KIND, bytes)?;
        let (columns, rows) = (self.map.columns(), self.map.rows());
        let size = columns * rows;
        let foreign = |what| Err(EnvError::Foreign { name: self.spec.name.clone(), what });
        if (state.columns as usize, state.rows as usize) != (columns, rows)
            || state.visited.len() != size.div_ceil(64)
        {
            return foreign("its size");
        }
        let cells: Vec<Cell> = (0..state.visited.len() * 64)
            .filter(|i| state.visited[i / 64] >> (i % 64) & 1 == 1)
            .map(|i| [i % columns, i / columns])
            .collect();
        if !cells.iter().all(|&cell| self.map.is_free(cell)) {
            return foreign("a visited cell");
        }
        let at = state.at.map(|coordinate| coordinate as usize);
        let at_goal = at == self.map.goal();
        if !self.map.is_free(at) || (state.running && (at_goal || !cells.contains(&at))) {
            return foreign("the agent's cell");
        }
        if state.steps > self.step_limit || (state.running && state.steps == self.step_limit) {
            return foreign("the number of steps");
        }
        self.visited.clear();
        for cell in cells {
            self.visited.insert(self.map.index(cell));
        }
        self.at = self.map.index(at);
        self.steps = state.steps;
        self.running = state.running;
        Ok(())
    }

    fn features(&self) -> Vec<&str> {
        vec!["column", "row"]
    }

    fn can_be_in(&self, state: &[f32]) -> Result<(), Impossible> {
        within(&self.spec, state)?;
        let cell = [state[0], state[1]].map(|coordinate| coordinate as usize);
        // A map of one column or row has a range of two.
        if self.map.is_free(cell) {
            return Ok(());
        }
        let [column, row] = cell.map(|coordinate| coordinate as isize);
        Err(Impossible::Wall { column, row })
    }
}

#[cfg(test)]
#[path = "environment_tests.rs"]
mod tests;
