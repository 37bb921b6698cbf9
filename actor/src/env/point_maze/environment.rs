//! The Point Maze as an environment: actions, episodes and rewards around the simulation.

use super::actions::{Force, forces};
use super::controller::plan_states;
use super::engine::Engine;
use super::geometry::{Geometry, Vector};
use super::physics::{Body, GEAR, MASS, SPEED_LIMIT, TIMESTEP};
use super::{Layout, Reset, Settings};
use crate::env::grid::{ActionSet, REGULAR, mentor_path};
use crate::env::{EnvError, Environment, Impossible, Step, within};
use rand::Rng;
use serde::{Deserialize, Serialize};
use trestle_proto::codec::{self, Kind};
use trestle_proto::rng::Stream;
use trestle_proto::row::Element;
use trestle_proto::space::EnvSpec;

/// Reward of every step. `goal_reward` is added where the goal is reached, for the learner alone.
pub const STEP_REWARD: f32 = -0.001;

/// Steps that a solved episode may take for one of the controller.
const SLACK: f64 = 1.25;

const KIND: Kind = Kind { magic: *b"TRPOINT\0", version: 1 };

/// A ball in a maze. Its state is (x, y, vx, vy): metres, and metres a second.
pub struct PointMaze {
    spec: EnvSpec,
    engine: Engine,
    geometry: Geometry,
    forces: Vec<Force>,
    reset: Reset,
    layout: Layout,
    frame_skip: u32,
    step_limit: u32,
    body: Body,
    steps: u32,
    /// Whether there is an episode to go on with.
    running: bool,
}

/// What a snapshot holds.
#[derive(Serialize, Deserialize)]
struct State {
    position: Vector,
    velocity: Vector,
    steps: u32,
    running: bool,
}

impl Body {
    /// With a velocity as a step of the environment may begin with.
    pub(super) fn limited(self) -> Self {
        Self { velocity: self.velocity.map(|v| v.clamp(-SPEED_LIMIT, SPEED_LIMIT)), ..self }
    }

    /// What an agent sees.
    pub(super) fn observation(&self) -> [f32; 4] {
        let ([x, y], [vx, vy]) = (self.position, self.velocity);
        [x as f32, y as f32, vx as f32, vy as f32]
    }
}

impl PointMaze {
    /// The Point Maze of resolved settings, not yet reset.
    ///
    /// # Errors
    /// No map, a goal that cannot be reached from the start, or an unknown action set.
    pub(super) fn of(settings: &Settings, step_limit: u32) -> Result<Self, EnvError> {
        let geometry = settings.geometry()?;
        mentor_path(&settings.map, geometry.map(), &ActionSet::new("regular", REGULAR))?;
        let forces = forces(settings, "env.actions", &settings.actions, &geometry)?;
        let mut spec = spec(settings, &geometry, &forces);
        spec.threshold = threshold(settings, step_limit);
        Ok(Self {
            engine: Engine::new(settings, &geometry)?,
            reset: settings.reset,
            layout: settings.layout,
            frame_skip: settings.frame_skip,
            step_limit,
            body: Body::default(),
            steps: 0,
            running: false,
            spec,
            geometry,
            forces,
        })
    }

    /// Where an episode begins.
    fn first(&self, rng: &mut Stream) -> Body {
        if self.reset == Reset::Start {
            return Body { position: self.geometry.place(self.geometry.map().start()), velocity: [0.0; 2] };
        }
        // The start is one of them, so there is always a cell to draw.
        let goal = self.geometry.map().goal();
        let cells: Vec<_> = self.geometry.free_cells().filter(|&cell| cell != goal).collect();
        let place = self.geometry.place(cells[rng.random_range(0..cells.len())]);
        let noise = match self.layout {
            Layout::D4rl => 0.1,
            Layout::Gymnasium => 0.25,
        };
        let position = place.map(|x| x + rng.random_range(-noise..=noise));
        let velocity = match self.layout {
            Layout::D4rl => [0; 2].map(|_| 0.1 * normal(rng)),
            Layout::Gymnasium => [0.0; 2],
        };
        Body { position, velocity }
    }
}

/// A draw from the standard normal distribution (Box and Muller 1958), the same on every machine.
fn normal(rng: &mut Stream) -> f64 {
    // Never 0, of which there is no logarithm.
    let radius = (-2.0 * libm::log(1.0 - rng.random::<f64>())).sqrt();
    radius * libm::cos(std::f64::consts::TAU * rng.random::<f64>())
}

/// The return that counts as the goal unless a configuration names another: that of an episode which takes a quarter more
/// steps than the careful controller with the observer's own actions. It lies above the return of an episode that is cut off.
/// None on a map that the controller does not get through.
fn threshold(settings: &Settings, step_limit: u32) -> Option<f64> {
    let states = plan_states(settings, step_limit, &settings.actions).ok()?;
    let steps = (states.len() - 1) as f64;
    Some(-0.001 * f64::midpoint(steps, f64::from(step_limit)).min(SLACK * steps))
}

fn spec(settings: &Settings, geometry: &Geometry, forces: &[Force]) -> EnvSpec {
    let frames = f64::from(settings.frame_skip);
    let strongest = settings.magnitudes.iter().copied().fold(0.0, f64::max);
    // What one step of the environment changes at most: the velocity at full force, the position at full speed.
    let change = frames * TIMESTEP * GEAR * strongest / MASS;
    let top = SPEED_LIMIT + change;
    let stride = frames * TIMESTEP * SPEED_LIMIT;
    let [low, high] = geometry.bounds();
    let narrow = |values: [f64; 4]| values.map(|value| value as f32).to_vec();
    EnvSpec {
        name: format!("point-maze {}", settings.map),
        element: Element::F32,
        shape: Vec::new(),
        low: narrow([low[0], low[1], -top, -top]),
        high: narrow([high[0], high[1], top, top]),
        scale: narrow([stride, stride, change, change]),
        integral: false,
        categories: Vec::new(),
        velocities: vec![2, 3],
        actions: forces.iter().map(|force| force.name.clone()).collect(),
        best_return: None,
        threshold: None,
        goal_bonus: settings.goal_reward as f32,
        defines_success: true,
    }
}

impl Environment for PointMaze {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, rng: &mut Stream, obs: &mut [f32]) -> Result<(), EnvError> {
        self.body = self.first(rng);
        self.steps = 0;
        self.running = true;
        obs.copy_from_slice(&self.body.observation());
        Ok(())
    }

    fn can_be_put(&self) -> bool {
        true
    }

    fn put(&mut self, state: &[f32], obs: &mut [f32]) -> Result<bool, EnvError> {
        let number = |feature: usize| f64::from(state[feature]);
        let position = [number(0), number(1)];
        let begins = self.can_be_in(state).is_ok() && !self.geometry.reached(position);
        if begins {
            self.body = Body { position, velocity: [number(2), number(3)] }.limited();
            self.steps = 0;
            self.running = true;
            obs.copy_from_slice(&self.body.observation());
        }
        Ok(begins)
    }

    fn step(&mut self, action: u32, obs: &mut [f32]) -> Result<Step, EnvError> {
        if !self.running {
            return Err(EnvError::Ended);
        }
        let Some(force) = self.forces.get(action as usize) else {
            return Err(EnvError::Action { action, last: self.forces.len() - 1 });
        };
        self.engine.advance(&mut self.body, force.control, self.frame_skip)?;
        self.steps += 1;
        let terminated = self.geometry.reached(self.body.position);
        let truncated = !terminated && self.steps >= self.step_limit;
        self.running = !(terminated || truncated);
        obs.copy_from_slice(&self.body.observation());
        let reward = if terminated { STEP_REWARD + self.spec.goal_bonus } else { STEP_REWARD };
        Ok(Step { reward, terminated, truncated, success: terminated })
    }

    fn snapshot(&self) -> Result<Vec<u8>, EnvError> {
        let Body { position, velocity } = self.body;
        let state = State { position, velocity, steps: self.steps, running: self.running };
        Ok(codec::encode(KIND, &state)?)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), EnvError> {
        let State { position, velocity, steps, running } = codec::decode(KIND, bytes)?;
        let body = Body { position, velocity };
        let foreign = |what| Err(EnvError::Foreign { name: self.spec.name.clone(), what });
        // Comparisons with what is not a number are false.
        let bounds = self.spec.low.iter().zip(&self.spec.high);
        if !body.observation().iter().zip(bounds).all(|(x, (low, high))| (low..=high).contains(&x)) {
            return foreign("the ball's state");
        }
        if running && (self.geometry.is_wall(self.geometry.cell(position)) || self.geometry.reached(position))
        {
            return foreign("the ball's position");
        }
        if steps > self.step_limit || (running && steps == self.step_limit) {
            return foreign("the number of steps");
        }
        self.body = body;
        self.steps = steps;
        self.running = running;
        Ok(())
    }

    fn features(&self) -> Vec<&str> {
        vec!["x", "y", "vx", "vy"]
    }

    fn can_be_in(&self, state: &[f32]) -> Result<(), Impossible> {
        within(&self.spec, state)?;
        // Walls push softly, but never let the ball's middle in.
        let cell = self.geometry.cell([state[0], state[1]].map(f64::from));
        let [column, row] = cell;
        if self.geometry.is_wall(cell) { Err(Impossible::Wall { column, row }) } else { Ok(()) }
    }
}

#[cfg(test)]
#[path = "environment_tests.rs"]
mod tests;
