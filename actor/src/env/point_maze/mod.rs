//! The Point Maze: a ball with inertia, pushed through a maze of walls, as in D4RL's maze2d and Gymnasium-Robotics'
//! PointMaze.
//!
//! * [`Geometry`]: which point lies in which cell of the map, in either layout;
//! * [`ActionSet`]: compass directions as forces;
//! * [`Physics`]: one step of the simulation in Rust, the back end `builtin`;
//! * [`mujoco`]: the same step by MuJoCo itself, loaded at run time;
//! * [`PointMaze`]: the environment;
//! * [`plan_states`]: a mentor that follows the shortest path; [`draw`]: paths over the maze, as text.

mod actions;
mod controller;
mod draw;
mod engine;
mod environment;
mod geometry;
pub mod mujoco;
mod physics;

pub use actions::{ActionSet, DIAGONAL, ORTHOGONAL};
pub use controller::plan_states;
pub use draw::draw;
pub use engine::{EngineInfo, engine_info};
pub use environment::{PointMaze, STEP_REWARD, resolve};
pub use geometry::{Geometry, Vector};
pub use physics::{Body, GEAR, MASS, Physics, RADIUS, SPEED_LIMIT, TIMESTEP};
