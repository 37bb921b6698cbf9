//! A world without walls, a mentor's path through it, and an observer that walks about in it at random.
//!
//! The world is a box of cells with a side that gives the mentor about one state a cell. The mentor moves by one cell
//! along an axis. The observer does so, too, but for the first axis: along it, up or down, it can move only while it
//! moves likewise along the second one, so that those of the mentor's steps are infeasible. As each move has its
//! opposite, the observer comes to be anywhere in the world equally often. With a jitter, states lie beside the middle
//! of their cell, each time anew, and no state is ever seen twice.

use anyhow::Result;
use trestle_algorithm::demonstration::Demonstration;
use trestle_proto::batch::{Batch, BatchHeader, FIRST, TRUNCATED, Transition};
use trestle_proto::rng::mix;
use trestle_proto::row::Element;
use trestle_proto::space::EnvSpec;

/// Steps of an observer's episode.
const EPISODE: u64 = 1000;
/// How often the mentor chooses a new direction: one step in this many.
const TURN: u64 = 3;

/// The world.
#[derive(Clone, Copy)]
pub struct World {
    /// Features of a state.
    pub dim: usize,
    side: i32,
    /// Greatest distance from a cell's middle along each axis, cells.
    jitter: f32,
}

/// Where somebody is, and where the random numbers come from.
struct Walker {
    world: World,
    cell: Vec<i32>,
    seed: u64,
    drawn: u64,
}

/// An observer under way.
pub struct Walk {
    walker: Walker,
    obs: Vec<f32>,
    next: Vec<f32>,
    taken: u64,
}

impl World {
    /// The world of a mentor with this many transitions.
    pub fn new(dim: usize, mentor: usize, jitter: f32) -> Self {
        Self { dim, side: (mentor as f64).powf(1.0 / dim as f64).ceil() as i32, jitter }
    }

    /// Its spaces: an action for each direction along each axis.
    pub fn spec(&self) -> EnvSpec {
        EnvSpec {
            name: "walk".into(),
            element: Element::F32,
            shape: Vec::new(),
            low: vec![-1.0; self.dim],
            high: vec![self.side as f32; self.dim],
            scale: vec![1.0; self.dim],
            integral: self.jitter == 0.0,
            categories: Vec::new(),
            velocities: Vec::new(),
            actions: (0..2 * self.dim).map(|action| action.to_string()).collect(),
            best_return: None,
            threshold: None,
            goal_bonus: 0.0,
            defines_success: true,
        }
    }

    /// A path of the mentor with this many transitions.
    pub fn demonstration(&self, transitions: usize) -> Result<Demonstration> {
        let mut walker = self.walker(1);
        let mut states = Vec::with_capacity((transitions + 1) * self.dim);
        walker.write(&mut states);
        let mut action = 0;
        for _ in 0..transitions {
            if walker.draw(TURN) == 0 {
                action = walker.draw(2 * self.dim as u64) as usize;
            }
            while !walker.shift(&[action]) {
                action = walker.draw(2 * self.dim as u64) as usize;
            }
            walker.write(&mut states);
        }
        let mut demonstration = Demonstration::new((0..self.dim).map(|axis| format!("s{axis}")).collect())?;
        demonstration.push_trajectory(&states, false)?;
        Ok(demonstration)
    }

    /// An observer at its first state.
    pub fn walk(&self) -> Walk {
        let walker = self.walker(2);
        let mut next = Vec::new();
        walker.write(&mut next);
        Walk { walker, obs: next.clone(), next, taken: 0 }
    }

    fn walker(&self, seed: u64) -> Walker {
        Walker { world: *self, cell: vec![self.side / 2; self.dim], seed, drawn: 0 }
    }
}

impl Walker {
    /// A number below `n`.
    fn draw(&mut self, n: u64) -> u64 {
        self.drawn += 1;
        ((mix(self.seed << 56 | self.drawn) >> 32) * n) >> 32
    }

    /// Moves along `directions` (twice the axis, and 1 more for down), if that stays inside. Whether it did.
    fn shift(&mut self, directions: &[usize]) -> bool {
        let step = |direction: usize| (direction / 2, if direction.is_multiple_of(2) { 1 } else { -1 });
        let inside = |&direction: &usize| {
            let (axis, by) = step(direction);
            (0..self.world.side).contains(&(self.cell[axis] + by))
        };
        if !directions.iter().all(inside) {
            return false;
        }
        for &direction in directions {
            let (axis, by) = step(direction);
            self.cell[axis] += by;
        }
        true
    }

    /// Appends the state.
    fn write(&self, out: &mut Vec<f32>) {
        for (axis, &cell) in self.cell.iter().enumerate() {
            let word = mix(mix(self.seed ^ self.drawn) ^ axis as u64) >> 40;
            out.push(cell as f32 + self.world.jitter * (word as f32 / (1 << 23) as f32 - 1.0));
        }
    }
}

impl Walk {
    /// Features of a state.
    pub fn dim(&self) -> usize {
        self.walker.world.dim
    }

    /// Its next transition.
    pub fn step(&mut self) -> Transition<'_> {
        let action = self.walker.draw(2 * self.dim() as u64) as usize;
        let both = [action, action + 2];
        self.walker.shift(if action < 2 { &both } else { &both[..1] });
        std::mem::swap(&mut self.obs, &mut self.next);
        self.next.clear();
        self.walker.write(&mut self.next);
        let first = self.taken.is_multiple_of(EPISODE);
        self.taken += 1;
        let last = self.taken.is_multiple_of(EPISODE);
        let flags = if first { FIRST } else { 0 } | if last { TRUNCATED } else { 0 };
        Transition { obs: &self.obs, next_obs: &self.next, action: action as u32, reward: -0.04, flags }
    }

    /// Replaces the content of `batch` by its next `header.count` transitions, under `header`.
    pub fn fill(&mut self, header: BatchHeader, batch: &mut Batch) {
        batch.prepare(header);
        for at in 0..batch.len() {
            batch.set(at, &self.step());
        }
    }
}
