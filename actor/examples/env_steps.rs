//! Steps a second of the Point Maze with random actions, for `benches/peers/point_maze.py`.
//!
//!     cargo run --release --example env_steps -- builtin 2000000

use rand::Rng;
use std::error::Error;
use std::time::Instant;
use trestle_actor::env::{build, point_maze, resolve};
use trestle_proto::config::{Env, EnvKind, PhysicsBackend, PointMaze};
use trestle_proto::rng::{Purpose, stream};

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let backend = match args.next().as_deref() {
        Some("builtin") => PhysicsBackend::Builtin,
        Some("mujoco") => PhysicsBackend::Mujoco,
        other => return Err(format!("{other:?}; accepted: builtin, mujoco").into()),
    };
    let steps: u64 = args.next().unwrap_or("1000000".into()).parse()?;
    let mut config = Env {
        kind: EnvKind::PointMaze,
        map: "medium".into(),
        actions: "diagonal".into(),
        point_maze: PointMaze { backend, ..PointMaze::default() },
        ..Env::default()
    };
    resolve(&mut config, 0)?;
    let mut env = build(&config)?;
    let mut rng = stream(0, Purpose::Environment, 0);
    let mut obs = vec![0.0; env.spec().obs_dim()];
    env.reset(&mut rng, &mut obs);
    let actions: Vec<u32> = (0..4096).map(|_| rng.random_range(0..env.spec().n_actions() as u32)).collect();
    let started = Instant::now();
    for i in 0..steps {
        let step = env.step(actions[i as usize % actions.len()], &mut obs)?;
        if step.terminated || step.truncated {
            env.reset(&mut rng, &mut obs);
        }
    }
    let seconds = started.elapsed().as_secs_f64();
    let version = point_maze::engine_info(&config).and_then(|info| info.version);
    println!(
        "{{\"backend\": \"{}\", \"version\": {}, \"steps\": {steps}, \"ns\": {:.1}}}",
        backend.name(),
        version.map_or("null".into(), |version| format!("\"{version}\"")),
        seconds * 1e9 / steps as f64
    );
    Ok(())
}
