//! Steps a second of the Point Maze with random actions, for `benches/peers/point_maze.py`.
//!
//!     cargo run --release --example env_steps -- builtin 2000000

use rand::Rng;
use std::error::Error;
use std::time::Instant;
use trestle_actor::env::registry;
use trestle_proto::config;
use trestle_proto::rng::{Purpose, stream};

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let backend = args.next().ok_or("accepted: builtin or mujoco, and a number of steps")?;
    let steps: u64 = args.next().unwrap_or("1000000".into()).parse()?;
    let sets = [format!("env.backend={backend}"), "env.frame_skip=1".into()];
    let mut config = config::load(registry(), "point-maze", &sets)?.env;
    registry().resolve(&mut config, 0)?;
    let mut env = registry().build(&config)?;
    let mut rng = stream(0, Purpose::Environment, 0);
    let mut obs = vec![0.0; env.spec().obs_dim()];
    env.reset(&mut rng, &mut obs)?;
    let actions: Vec<u32> = (0..4096).map(|_| rng.random_range(0..env.spec().n_actions() as u32)).collect();
    let started = Instant::now();
    for i in 0..steps {
        let step = env.step(actions[i as usize % actions.len()], &mut obs)?;
        if step.terminated || step.truncated {
            env.reset(&mut rng, &mut obs)?;
        }
    }
    let seconds = started.elapsed().as_secs_f64();
    let engine = registry().engine(&config)?.unwrap_or_default();
    let version = engine.get("version").map_or("null".into(), |version| version.to_string());
    println!(
        "{{\"backend\": \"{backend}\", \"version\": {version}, \"steps\": {steps}, \"ns\": {:.1}}}",
        seconds * 1e9 / steps as f64
    );
    Ok(())
}
