//! Tests of the maze's dynamics, rewards and snapshots.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::env::grid::tests::any_map;
use crate::env::{Kind, grid};
use proptest::prelude::*;
use trestle_proto::config;
use trestle_proto::rng::{Purpose, stream};

const N: u32 = 0;
const E: u32 = 1;
const S: u32 = 2;
const W: u32 = 3;

/// Settings and a step limit.
type Config = (Settings, u32);

fn config(map: &str, actions: &str) -> Config {
    let mut settings = Settings { map: map.into(), actions: actions.into(), ..Settings::default() };
    grid::resolve(map, &mut settings.map_text, 0).unwrap();
    (settings, 4000)
}

fn of_text(text: &str, actions: &str, step_limit: u32) -> Config {
    let (map, map_text) = ("text".into(), Some(text.into()));
    (Settings { map, map_text, actions: actions.into(), ..Settings::default() }, step_limit)
}

fn build((settings, step_limit): &Config) -> Result<Maze, EnvError> {
    let maze = Maze::of(settings, *step_limit)?;
    maze.spec.validate().unwrap();
    Ok(maze)
}

fn plan_states((settings, _): &Config, actions: &str) -> Result<Vec<Vec<f32>>, EnvError> {
    Maze::plan(settings, &config::Env::default(), actions).map(Option::unwrap)
}

/// Plays `actions` from the start: the steps and the cells reached.
fn play(env: &Config, actions: &[u32]) -> Vec<(Step, [f32; 2])> {
    let mut maze = build(env).unwrap();
    let mut obs = [0.0; 2];
    maze.reset(&mut stream(0, Purpose::Environment, 0), &mut obs).unwrap();
    actions.iter().map(|&action| (maze.step(action, &mut obs).unwrap(), obs)).collect()
}

fn step(reward: f32) -> Step {
    Step { reward, terminated: false, truncated: false, success: false }
}

#[test]
fn each_reward_applies_where_it_should() {
    let played = play(&of_text("S.#\n..G\n", "regular", 100), &[N, E, E, W, E, S, E]);
    let expected = [
        (step(BLOCKED_REWARD), [0.0, 0.0]),
        (step(MOVE_REWARD), [1.0, 0.0]),
        (step(BLOCKED_REWARD), [1.0, 0.0]),
        (step(REVISIT_REWARD), [0.0, 0.0]),
        (step(REVISIT_REWARD), [1.0, 0.0]),
        (step(MOVE_REWARD), [1.0, 1.0]),
        (Step { reward: GOAL_REWARD, terminated: true, truncated: false, success: true }, [2.0, 1.0]),
    ];
    assert_eq!(played, expected);
}

#[test]
fn a_new_episode_has_visited_nothing_but_the_start() {
    let mut maze = build(&of_text("S.G\n", "regular", 2)).unwrap();
    let (mut rng, mut obs) = (stream(0, Purpose::Environment, 0), [0.0; 2]);
    for _ in 0..3 {
        maze.reset(&mut rng, &mut obs).unwrap();
        assert_eq!(obs, [0.0, 0.0]);
        assert_eq!(maze.step(E, &mut obs).unwrap().reward, MOVE_REWARD);
        let last = maze.step(W, &mut obs).unwrap();
        assert_eq!(last, Step { reward: REVISIT_REWARD, terminated: false, truncated: true, success: false });
    }
}

#[test]
fn visited_cells_survive_the_wrap_of_the_epoch() {
    let mut visited = Visited::new(3);
    visited.epoch = u32::MAX;
    assert!(visited.insert(1) && !visited.insert(1));
    visited.clear();
    assert!(!visited.contains(0) && !visited.contains(1));
    assert!(visited.insert(1));
}

#[test]
fn the_goal_at_the_step_limit_is_an_end_and_no_truncation() {
    let played = play(&of_text("S.G\n", "regular", 2), &[E, E]);
    assert_eq!(played[1].0, Step { reward: GOAL_REWARD, terminated: true, truncated: false, success: true });
}

#[test]
fn maze30_has_the_known_best_returns() {
    let best = |actions| build(&config("maze30", actions)).unwrap().spec().best_return;
    assert_eq!(best("regular"), Some(-2.8));
    assert_eq!(best("irregular"), Some(-3.4));
}

#[test]
fn the_specification_describes_the_maze() {
    let maze = build(&config("maze30", "irregular")).unwrap();
    let spec = maze.spec();
    assert_eq!(spec.name, "maze maze30");
    assert_eq!((spec.low.as_slice(), spec.high.as_slice()), (&[0.0; 2][..], &[29.0; 2][..]));
    assert_eq!((spec.scale.as_slice(), spec.integral), (&[1.0; 2][..], true));
    assert_eq!(spec.actions, ["N", "NE", "S", "SW"]);
    let narrow = build(&of_text("SG\n", "regular", 9)).unwrap();
    assert_eq!((narrow.spec().high.as_slice(), narrow.spec().best_return), (&[1.0; 2][..], Some(1.0)));
    let cut = build(&of_text("S.G\n", "regular", 1)).unwrap();
    assert_eq!(cut.spec().best_return, None);
}

#[test]
fn configurations_that_cannot_be_played_are_refused() {
    let refused = |env: &Config| build(env).err().unwrap().to_string();
    assert!(refused(&(Settings::default(), 9)).contains("env.map_text is missing"));
    assert!(
        refused(&of_text("S.G\n", "kings", 9))
            .contains("env.actions = kings; action sets: regular, irregular")
    );
    assert!(
        refused(&of_text("S.G\n", "irregular", 9))
            .contains("line 1, column 3: the goal `G` cannot be reached")
    );
    assert!(refused(&of_text("S.\n", "regular", 9)).contains("map text, line 1, column 2"));
    let message = plan_states(&of_text("S.G\n", "regular", 9), "kings").unwrap_err().to_string();
    assert!(message.starts_with("mentor.actions = kings"));
}

#[test]
fn the_mentor_walks_from_start_to_goal() {
    let states = plan_states(&config("maze30", "irregular"), "regular").unwrap();
    assert_eq!(states.len(), 97);
    assert_eq!((states[0].as_slice(), states[96].as_slice()), (&[0.0, 0.0][..], &[29.0, 29.0][..]));
    let step = |pair: &[Vec<f32>]| (pair[1][0] - pair[0][0]).abs() + (pair[1][1] - pair[0][1]).abs();
    assert!(states.windows(2).all(|pair| step(pair) == 1.0));
}

/// The actions of `env`'s own set that follow its optimal path.
fn optimal_actions(env: &Config) -> Vec<u32> {
    let set = env.0.action_set("env.actions", &env.0.actions).unwrap();
    let states = plan_states(env, &env.0.actions).unwrap();
    let action = |pair: &[Vec<f32>]| {
        let delta = ((pair[1][0] - pair[0][0]) as i32, (pair[1][1] - pair[0][1]) as i32);
        set.directions.iter().position(|d| d.delta() == delta).unwrap() as u32
    };
    states.windows(2).map(action).collect()
}

/// Plays an optimal episode of `env` and compares its return with the specification's.
fn optimum_is_achieved(env: &Config) {
    let played = play(env, &optimal_actions(env));
    assert!(played.last().unwrap().0.terminated);
    let total: f64 = played.iter().map(|(step, _)| f64::from(step.reward)).sum();
    let best = build(env).unwrap().spec().best_return.unwrap();
    // Rewards are `f32`: the relative error of a sum of equal terms is that of one.
    assert!((total - best).abs() <= 1e-7 * played.len() as f64, "{total} {best}");
}

#[test]
fn the_best_return_is_achieved_on_the_built_in_maps() {
    for map in ["maze30", "maze-small"] {
        for actions in ["regular", "irregular"] {
            optimum_is_achieved(&config(map, actions));
        }
    }
}

#[test]
fn snapshots_of_other_mazes_are_refused() {
    let snapshot = |env: &Config, actions: &[u32]| {
        let mut maze = build(env).unwrap();
        let mut obs = [0.0; 2];
        maze.reset(&mut stream(0, Purpose::Environment, 0), &mut obs).unwrap();
        for &action in actions {
            maze.step(action, &mut obs).unwrap();
        }
        maze.snapshot().unwrap()
    };
    let refused = |env: &Config, bytes: &[u8]| {
        let mut maze = build(env).unwrap();
        let before = maze.snapshot().unwrap();
        let message = maze.restore(bytes).unwrap_err().to_string();
        assert_eq!(maze.snapshot().unwrap(), before);
        message
    };
    let here = of_text("S#.\n..G\n", "regular", 5);
    assert!(
        refused(&here, &snapshot(&of_text("S.G\n", "regular", 5), &[])).contains("its size does not fit")
    );
    let other = of_text("S..\n#.G\n", "regular", 9);
    assert!(refused(&here, &snapshot(&other, &[E])).contains("a visited cell does not fit"));
    let longer = of_text("S#.\n..G\n", "regular", 9);
    assert!(
        refused(&here, &snapshot(&longer, &[S, N, S, N, S])).contains("the number of steps does not fit")
    );
    let elsewhere = of_text("S#G\n...\n", "regular", 9);
    assert!(refused(&here, &snapshot(&elsewhere, &[S, E, E])).contains("the agent's cell does not fit"));
    assert!(refused(&here, b"short").contains("bytes"));
    let mut damaged = snapshot(&here, &[S]);
    *damaged.last_mut().unwrap() ^= 1;
    assert!(refused(&here, &damaged).contains("checksum"));
}

proptest! {
    #[test]
    fn optima_of_random_maps_are_achieved(map in any_map(), regular in any::<bool>()) {
        let env = of_text(&map.to_string(), if regular { "regular" } else { "irregular" }, 4000);
        if build(&env).is_ok() {
            optimum_is_achieved(&env);
        }
    }

    /// Against the rules written out: no step leaves the free cells, and each has the reward that history says.
    #[test]
    fn random_walks_follow_the_rules(map in any_map(), regular in any::<bool>(), actions in prop::collection::vec(0u32..4, 1..200)) {
        let env = of_text(&map.to_string(), if regular { "regular" } else { "irregular" }, 150);
        let set = env.0.action_set("env.actions", &env.0.actions).unwrap();
        let Ok(mut maze) = build(&env) else { return Ok(()) };
        let mut obs = [0.0; 2];
        maze.reset(&mut stream(0, Purpose::Environment, 0), &mut obs).unwrap();
        let mut path = vec![map.start()];
        for (i, &action) in actions.iter().enumerate() {
            let from = path[path.len() - 1];
            let taken = maze.step(action, &mut obs).unwrap();
            let to = [obs[0] as usize, obs[1] as usize];
            prop_assert!(map.is_free(to));
            let (dx, dy) = set.directions[action as usize].delta();
            let wanted = [from[0].wrapping_add_signed(dx as isize), from[1].wrapping_add_signed(dy as isize)];
            let expected = if to == from {
                BLOCKED_REWARD
            } else if to == map.goal() {
                GOAL_REWARD
            } else if path.contains(&to) {
                REVISIT_REWARD
            } else {
                MOVE_REWARD
            };
            prop_assert!(to == from || to == wanted);
            prop_assert_eq!(taken.reward, expected);
            prop_assert_eq!((taken.terminated, taken.truncated), (to == map.goal(), to != map.goal() && i == 149));
            if taken.terminated || taken.truncated {
                break;
            }
            path.push(to);
        }
    }
}

#[test]
fn it_can_be_in_free_cells_alone() {
    let maze = build(&of_text("S.#\n..G\n", "regular", 100)).unwrap();
    let wall = Impossible::Wall { column: 2, row: 0 };
    assert_eq!(maze.can_be_in(&[1.0, 1.0]), Ok(()));
    assert_eq!(maze.can_be_in(&[2.0, 0.0]), Err(wall));
    assert_eq!(wall.to_string(), "it lies in the wall at column 2, row 0 of the map");
    for (state, message) in [
        ([0.5, 0.0], "feature 0 is 0.5; accepted: whole numbers from 0 to 2"),
        ([0.0, 2.0], "feature 1 is 2; accepted: whole numbers from 0 to 1"),
        ([f32::NAN, 0.0], "feature 0 is NaN; accepted: whole numbers from 0 to 2"),
    ] {
        assert_eq!(maze.can_be_in(&state).unwrap_err().to_string(), message);
    }
}
