#![allow(clippy::unwrap_used)]
use super::*;
use crate::env::grid;
use crate::env::point_maze::Backend;
use crate::env::point_maze::controller::plan_states;
use trestle_proto::rng::{Purpose, stream};

/// Settings and a step limit.
struct Config {
    settings: Settings,
    step_limit: u32,
}

fn config(map: &str, actions: &str) -> Config {
    let (map, actions) = (map.into(), actions.into());
    let mut settings = Settings { map, actions, backend: Backend::Builtin, ..Settings::default() };
    grid::resolve(&settings.map, &mut settings.map_text, 0).unwrap();
    Config { settings, step_limit: 4000 }
}

fn built(config: &Config) -> Result<PointMaze, EnvError> {
    let point = PointMaze::of(&config.settings, config.step_limit)?;
    point.spec.validate().unwrap();
    Ok(point)
}

fn started(env: &Config) -> (PointMaze, [f32; 4]) {
    let mut point = built(env).unwrap();
    let mut obs = [f32::NAN; 4];
    point.reset(&mut stream(0, Purpose::Environment, 0), &mut obs).unwrap();
    (point, obs)
}

#[test]
fn the_action_sets_share_nothing_but_no_force() {
    let names = |actions| built(&config("medium", actions)).unwrap().spec.actions;
    assert_eq!(names("orthogonal"), ["N 0.5", "E 0.5", "S 0.5", "W 0.5", "N 1", "E 1", "S 1", "W 1", "none"]);
    assert_eq!(
        names("diagonal"),
        ["NE 0.5", "SE 0.5", "SW 0.5", "NW 0.5", "NE 1", "SE 1", "SW 1", "NW 1", "none"]
    );
    let controls = |actions| built(&config("medium", actions)).unwrap().forces;
    assert!(controls("diagonal").iter().all(|force| force.control[0].abs() == force.control[1].abs()));
    // D4RL's x counts rows: south is along x.
    assert_eq!(controls("orthogonal")[2].control, [0.5, 0.0]);
    let mut own = config("medium", "axis");
    own.settings.action_sets = [("axis".to_string(), vec!["N".to_string(), "S".to_string()])].into();
    own.settings.magnitudes = vec![0.25];
    assert_eq!(built(&own).unwrap().spec.actions, ["N 0.25", "S 0.25", "none"]);
    let message = built(&config("medium", "regular")).err().unwrap().to_string();
    assert_eq!(message, "env.actions = regular; action sets: orthogonal, diagonal");
}

#[test]
fn the_benchmark_begins_at_rest_and_falls_freely() {
    let (mut point, obs) = started(&config("medium", "orthogonal"));
    assert_eq!(obs, [1.0, 1.0, 0.0, 0.0]);
    let mut obs = obs;
    let step = point.step(6, &mut obs).unwrap();
    assert_eq!(step, Step { reward: STEP_REWARD, terminated: false, truncated: false, success: false });
    let velocity = 0.01 * 100.0 / (MASS + 0.01);
    assert_eq!(obs, [(1.0 + 0.01 * velocity) as f32, 1.0, velocity as f32, 0.0]);
}

#[test]
fn the_goal_ends_an_episode_and_pays_the_learner_alone() {
    let mut env = config("umaze", "orthogonal");
    env.settings.goal_reward = 2.0;
    let (mut point, mut obs) = started(&env);
    point.body = Body { position: [1.0, 1.52], velocity: [0.0, -5.0] };
    let step = point.step(8, &mut obs).unwrap();
    assert!(step.terminated && step.success && !step.truncated);
    assert_eq!(step.reward, 2.0 + STEP_REWARD);
    let reported = trestle_proto::space::reported(step.reward, true, point.spec.goal_bonus);
    assert!((reported - f64::from(STEP_REWARD)).abs() < 1e-6);
}

#[test]
fn the_velocity_is_cut_off_before_a_step() {
    let (mut point, mut obs) = started(&config("large", "orthogonal"));
    point.body.velocity = [50.0, -50.0];
    point.step(8, &mut obs).unwrap();
    assert!(obs[2] < 5.0 && obs[2] > 4.9 && obs[3] == -obs[2]);
}

#[test]
fn frames_are_skipped_with_the_same_control() {
    let mut skipping = config("medium", "orthogonal");
    skipping.settings.frame_skip = 4;
    let ((mut skipping, mut a), (mut single, mut b)) =
        (started(&skipping), started(&config("medium", "orthogonal")));
    skipping.step(5, &mut a).unwrap();
    for _ in 0..4 {
        single.step(5, &mut b).unwrap();
    }
    assert_eq!(a, b);
    assert_eq!(skipping.spec.scale[0], 4.0 * single.spec.scale[0]);
}

#[test]
fn random_resets_follow_the_layout() {
    for (layout, noise, speed) in [(Layout::D4rl, 0.1, 1.0), (Layout::Gymnasium, 0.25, 0.0)] {
        let mut env = config("umaze", "orthogonal");
        env.settings.layout = layout;
        env.settings.reset = Reset::Random;
        let mut point = built(&env).unwrap();
        let mut rng = stream(1, Purpose::Environment, 0);
        let mut seen = std::collections::BTreeSet::new();
        let (mut sum, mut squares) = (0.0, 0.0);
        for _ in 0..2000 {
            point.reset(&mut rng, &mut [0.0; 4]).unwrap();
            let cell = point.geometry.cell(point.body.position);
            seen.insert(cell);
            let place = point.geometry.place(cell.map(|c| c as usize));
            assert!((0..2).all(|i| (point.body.position[i] - place[i]).abs() <= noise + 1e-12));
            assert!(point.body.velocity.iter().all(|v| v.abs() <= speed));
            assert!(!point.geometry.reached(point.body.position));
            sum += point.body.velocity[0];
            squares += point.body.velocity[1] * point.body.velocity[1];
        }
        assert_eq!(seen.len(), point.geometry.map().free_cells() - 1);
        if layout == Layout::D4rl {
            // Mean and deviation of 2000 draws of N(0, 0.1), within four standard errors.
            assert!((sum / 2000.0).abs() < 0.009 && ((squares / 2000.0).sqrt() - 0.1).abs() < 0.0064);
        }
    }
}

#[test]
fn snapshots_of_other_states_are_refused() {
    let (mut point, _) = started(&config("umaze", "orthogonal"));
    let good = State { position: [2.0, 3.0], velocity: [1.0, -1.0], steps: 3, running: true };
    let restore = |point: &mut PointMaze, state: &State| point.restore(&codec::encode(KIND, state).unwrap());
    restore(&mut point, &good).unwrap();
    let before = point.snapshot().unwrap();
    for (bad, what) in [
        (State { position: [f64::NAN, 3.0], ..good }, "the ball's state"),
        (State { velocity: [0.0, 99.0], ..good }, "the ball's state"),
        (State { position: [1.9, 1.9], ..good }, "the ball's position"),
        (State { position: [1.0, 1.0], ..good }, "the ball's position"),
        (State { steps: 4000, ..good }, "the number of steps"),
    ] {
        let message = restore(&mut point, &bad).unwrap_err().to_string();
        assert!(message.contains(what), "{message}");
        assert_eq!(point.snapshot().unwrap(), before);
    }
}

#[test]
fn the_controller_reaches_every_goal_with_either_set() {
    for map in ["umaze", "medium", "large", "maze-small"] {
        for actions in ["orthogonal", "diagonal"] {
            for layout in [Layout::D4rl, Layout::Gymnasium] {
                let mut env = config(map, "diagonal");
                env.settings.layout = layout;
                let states = plan_states(&env.settings, env.step_limit, actions).unwrap();
                let spec = built(&env).unwrap().spec.clone();
                for state in &states {
                    assert!(
                        state.iter().zip(spec.low.iter().zip(&spec.high)).all(|(x, (l, h))| l <= x && x <= h)
                    );
                }
                let limit = match map {
                    "umaze" => 300,
                    "medium" => 550,
                    "large" => 800,
                    _ => 2500,
                };
                assert!(states.len() < limit, "{map} {actions} {layout:?}: {}", states.len());
            }
        }
    }
    let mut env = config("medium", "diagonal");
    env.step_limit = 50;
    let message = plan_states(&env.settings, env.step_limit, "orthogonal").unwrap_err().to_string();
    assert!(message.contains("env.step_limit = 50 steps"), "{message}");
}

#[test]
fn a_goal_behind_walls_is_refused() {
    let mut env = config("umaze", "diagonal");
    env.settings.map_text = Some("S#G\n".into());
    let message = built(&env).err().unwrap().to_string();
    assert!(message.contains("cannot be reached"), "{message}");
}

#[test]
fn it_can_be_where_the_ball_fits() {
    let (maze, state) = started(&config("umaze", "orthogonal"));
    assert_eq!(maze.can_be_in(&state), Ok(()));
    let [x, y, vx, vy] = state;
    assert!(matches!(maze.can_be_in(&[x, y, 99.0, vy]), Err(Impossible::Range { feature: 2, .. })));
    // The wall in the middle of the U.
    assert!(matches!(maze.can_be_in(&[1.8, 1.8, vx, vy]), Err(Impossible::Wall { column: 2, row: 2 })));
}
