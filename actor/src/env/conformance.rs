//! What every environment must fulfil, written once and run over all of them.
#![allow(clippy::unwrap_used)]

use super::{EnvError, Environment, Step, build, point_maze, resolve};
use rand::Rng;
use trestle_proto::config::{self, EnvKind, PhysicsBackend, PointLayout, PointReset};
use trestle_proto::rng::{Purpose, Stream, stream};

/// Every environment in a few configurations, with step limits that make episodes end both ways.
fn all() -> Vec<config::Env> {
    let king = ["N", "NE", "E", "SE", "S", "SW", "W", "NW"].map(String::from).to_vec();
    let maze = |map: &str, actions: &str, step_limit| config::Env {
        map: map.into(),
        actions: actions.into(),
        action_sets: [("king".to_string(), king.clone())].into(),
        step_limit,
        ..config::Env::default()
    };
    let mut all = vec![
        maze("maze30", "regular", 300),
        maze("maze30", "irregular", 4000),
        maze("maze-small", "irregular", 200),
        maze("random:5:4x4", "irregular", 60),
        maze("random:5:5x9", "king", 40),
    ];
    let point = |map: &str, actions: &str, step_limit, point_maze: config::PointMaze| config::Env {
        kind: EnvKind::PointMaze,
        point_maze: config::PointMaze { backend: PhysicsBackend::Builtin, ..point_maze },
        ..maze(map, actions, step_limit)
    };
    let gymnasium = config::PointMaze {
        layout: PointLayout::Gymnasium,
        reset: PointReset::Random,
        frame_skip: 5,
        ..config::PointMaze::default()
    };
    let random = config::PointMaze { reset: PointReset::Random, ..config::PointMaze::default() };
    all.push(point("medium", "orthogonal", 300, config::PointMaze::default()));
    all.push(point("umaze", "diagonal", 400, random));
    all.push(point("large", "king", 200, gymnasium));
    if point_maze::mujoco::library().is_ok() {
        let mut by_mujoco = point("umaze", "diagonal", 200, config::PointMaze::default());
        by_mujoco.point_maze.backend = PhysicsBackend::Mujoco;
        all.push(by_mujoco);
    }
    for env in &mut all {
        resolve(env, 0).unwrap();
    }
    all
}

/// One step of a random walk that resets where an episode ends: what a collector sees.
fn walk(env: &mut dyn Environment, rng: &mut Stream, obs: &mut [f32]) -> (u32, Step, Vec<f32>) {
    let action = rng.random_range(0..env.spec().n_actions() as u32);
    let step = env.step(action, obs).unwrap();
    let reached = obs.to_vec();
    if step.terminated || step.truncated {
        env.reset(rng, obs);
    }
    (action, step, reached)
}

fn started(config: &config::Env, seed: u64) -> (Box<dyn Environment>, Stream, Vec<f32>) {
    let mut env = build(config).unwrap();
    let mut rng = stream(seed, Purpose::Environment, 0);
    let mut obs = vec![f32::NAN; env.spec().obs_dim()];
    env.reset(&mut rng, &mut obs);
    (env, rng, obs)
}

#[test]
fn spaces_are_respected() {
    for config in all() {
        let (mut env, mut rng, mut obs) = started(&config, 1);
        let spec = env.spec().clone();
        spec.validate().unwrap();
        let inside = |obs: &[f32]| {
            let bounds = spec.low.iter().zip(&spec.high);
            obs.iter().zip(bounds).all(|(x, (low, high))| (low..=high).contains(&x))
                && (!spec.integral || obs.iter().all(|x| x.fract() == 0.0))
        };
        assert!(inside(&obs));
        let mut ends = 0;
        for _ in 0..5000 {
            let (_, step, reached) = walk(env.as_mut(), &mut rng, &mut obs);
            assert!(inside(&reached) && inside(&obs) && step.reward.is_finite());
            assert!(!(step.terminated && step.truncated));
            ends += u32::from(step.terminated || step.truncated);
        }
        assert!(ends >= 1, "{}", spec.name);
    }
}

#[test]
fn equal_seeds_and_actions_give_equal_steps() {
    for config in all() {
        let run = |seed| {
            let (mut env, mut rng, mut obs) = started(&config, seed);
            (0..500).map(|_| walk(env.as_mut(), &mut rng, &mut obs)).collect::<Vec<_>>()
        };
        assert_eq!(run(3), run(3));
        assert_ne!(run(3), run(4));
    }
}

#[test]
fn a_restored_environment_goes_on_as_if_nothing_had_happened() {
    for config in all() {
        let (mut env, mut rng, mut obs) = started(&config, 5);
        for length in [0, 1, 17, 100, 433] {
            for _ in 0..length {
                walk(env.as_mut(), &mut rng, &mut obs);
            }
            let bytes = env.snapshot().unwrap();
            // Into one that has a history of its own.
            let (mut other, mut other_rng, mut other_obs) = started(&config, 6);
            for _ in 0..50 {
                walk(other.as_mut(), &mut other_rng, &mut other_obs);
            }
            other.restore(&bytes).unwrap();
            assert_eq!(other.snapshot().unwrap(), bytes);
            let (mut copy_rng, mut copy_obs) = (rng.clone(), obs.clone());
            for _ in 0..300 {
                let expected = walk(env.as_mut(), &mut rng, &mut obs);
                assert_eq!(walk(other.as_mut(), &mut copy_rng, &mut copy_obs), expected);
            }
        }
    }
}

#[test]
fn steps_without_an_episode_or_an_action_are_refused() {
    for config in all() {
        let mut env = build(&config).unwrap();
        let n = env.spec().n_actions() as u32;
        let mut obs = vec![0.5; env.spec().obs_dim()];
        assert!(matches!(env.step(0, &mut obs), Err(EnvError::Ended)));
        let mut rng = stream(7, Purpose::Environment, 0);
        env.reset(&mut rng, &mut obs);
        let (before, seen) = (env.snapshot().unwrap(), obs.clone());
        let refused = env.step(n, &mut obs);
        assert!(
            matches!(refused, Err(EnvError::Action { action, last }) if action == n && last == n as usize - 1)
        );
        assert_eq!((env.snapshot().unwrap(), &obs), (before, &seen));
        loop {
            let step = env.step(rng.random_range(0..n), &mut obs).unwrap();
            if step.terminated || step.truncated {
                break;
            }
        }
        let seen = obs.clone();
        assert!(matches!(env.step(0, &mut obs), Err(EnvError::Ended)));
        assert_eq!(obs, seen);
        // An ended episode is saved as such.
        let bytes = env.snapshot().unwrap();
        env.reset(&mut rng, &mut obs);
        env.restore(&bytes).unwrap();
        assert!(matches!(env.step(0, &mut obs), Err(EnvError::Ended)));
    }
}
