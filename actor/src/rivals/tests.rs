//! Tests of what rivals change about an environment.
#![allow(clippy::unwrap_used)]

use super::super::goals::Goals;
use super::*;
use crate::env::registry;
use proptest::prelude::*;
use trestle_proto::NONE;
use trestle_proto::rng::{Purpose, stream};

/// The corridor "S...G.", five cells from its start to its end, with steps to W and E.
fn corridor() -> Box<dyn Environment> {
    let mut config = crate::worker::tests::experiment(&[]).config.env;
    let own = &mut config.own;
    own.insert("map_text".into(), "S...G.\n".into());
    own.insert("action_sets".into(), toml_sets());
    own.insert("actions".into(), "line".into());
    config.step_limit = 9;
    registry().build(&config).unwrap()
}

fn toml_sets() -> trestle_proto::config::Value {
    let line = ["W", "E"].map(|name| trestle_proto::config::Value::String(name.into())).to_vec();
    trestle_proto::config::Value::Table(trestle_proto::config::Table::from_iter([(
        "line".to_string(),
        line.into(),
    )]))
}

/// A mentor that walks to the goal, and another that goes there from the other side.
fn waypoints() -> Waypoints {
    let places = [0, 1, 2, 3, 4, 5, 4];
    Waypoints {
        states: places.iter().flat_map(|&x| [x as f32, 0.0]).collect(),
        transition_of: vec![0, 1, 2, 3, NONE, 4, NONE],
        progress: vec![0.0, 0.25, 0.5, 0.75, 1.0, 0.0, 1.0],
    }
}

fn curriculum(shift: f64, episodes: u32) -> Resets {
    let settings = Settings { shift, share: 0.5, episodes };
    let mut waypoints = waypoints();
    waypoints.states.truncate(10);
    waypoints.transition_of.truncate(5);
    Resets::new(corridor(), &settings, &waypoints).unwrap()
}

/// Where an episode begins, and one step to the west of each kind of ending: until the limit, or to the goal.
fn episode(env: &mut dyn Environment, succeeds: bool, rng: &mut Stream) -> f32 {
    let mut obs = vec![0.0; env.spec().obs_dim()];
    env.reset(rng, &mut obs).unwrap();
    let began = obs[0];
    loop {
        let step = env.step(u32::from(succeeds), &mut obs).unwrap();
        if step.terminated || step.truncated {
            assert_eq!(step.success, succeeds);
            return began;
        }
    }
}

#[test]
fn episodes_begin_further_back_once_enough_have_succeeded() {
    let mut env = curriculum(0.5, 2);
    let rng = &mut stream(3, Purpose::Environment, 0);
    // Of the states 0 to 3 (4 is the goal) those from half on: cells 1 to 3.
    let began: Vec<f32> = (0..30).map(|_| episode(&mut env, false, rng)).collect();
    assert!(began.iter().all(|x| (1.0..=3.0).contains(x)) && began.contains(&1.0) && began.contains(&3.0));
    assert_eq!(env.progress.from, 0.5);
    // One of the newest two is enough, and from then on the environment's own start is where they begin.
    episode(&mut env, true, rng);
    assert_eq!(env.progress, Progress { from: 0.0, succeeded: VecDeque::new() });
    assert!((0..20).all(|_| episode(&mut env, false, rng) == 0.0));
}

#[test]
fn every_share_is_passed_once() {
    let mut env = curriculum(0.1, 1);
    let rng = &mut stream(3, Purpose::Environment, 0);
    let mut stages = 0;
    while env.progress.from > 0.0 {
        episode(&mut env, true, rng);
        stages += 1;
    }
    assert_eq!(stages, 9);
}

#[test]
fn a_curriculum_goes_on_from_its_snapshot() {
    let (mut env, mut other) = (curriculum(0.3, 4), curriculum(0.3, 4));
    let mut rng = stream(5, Purpose::Environment, 0);
    for succeeds in [true, false, true, true, false] {
        episode(&mut env, succeeds, &mut rng);
    }
    env.reset(&mut rng, &mut [0.0; 2]).unwrap();
    other.restore(&env.snapshot().unwrap()).unwrap();
    let mut again = rng.clone();
    for _ in 0..20 {
        assert_eq!(episode(&mut env, true, &mut rng), episode(&mut other, true, &mut again));
        assert_eq!(env.snapshot().unwrap(), other.snapshot().unwrap());
    }
    let broken = codec::encode(
        KIND,
        &State {
            env: env.env.snapshot().unwrap(),
            progress: Progress { from: 2.0, succeeded: VecDeque::new() },
        },
    );
    assert!(other.restore(&broken.unwrap()).is_err());
}

#[test]
fn states_in_walls_and_at_the_goal_begin_nothing() {
    let mut all = waypoints();
    all.states[2] = 9.0;
    let settings = Settings { shift: 0.5, share: 0.5, episodes: 2 };
    let env = Resets::new(corridor(), &settings, &all).unwrap();
    let cells = |trajectory: &Vec<Vec<f32>>| trajectory.iter().map(|state| state[0]).collect::<Vec<f32>>();
    assert_eq!(env.trajectories.iter().map(cells).collect::<Vec<_>>(), [vec![0.0, 2.0, 3.0], vec![5.0]]);
    // With none at all the environment begins where it always does.
    all.states.fill(9.0);
    let mut env = Resets::new(corridor(), &settings, &all).unwrap();
    assert_eq!(episode(&mut env, true, &mut stream(1, Purpose::Environment, 0)), 0.0);
}

#[test]
fn goals_are_the_mentor_s_states_one_after_the_other() {
    let mut env = Goals::new(corridor(), &waypoints().with_goals(2));
    env.spec().validate().unwrap();
    assert_eq!(env.spec().obs_dim(), 4);
    let rng = &mut stream(1, Purpose::Environment, 0);
    let mut obs = [0.0; 4];
    env.reset(rng, &mut obs).unwrap();
    // The trajectory that begins here.
    assert_eq!(obs, [0.0, 0.0, 1.0, 0.0]);
    let mut seen = Vec::new();
    for action in [0, 1, 1, 0, 0, 0] {
        env.step(action, &mut obs).unwrap();
        seen.push([obs[0], obs[2]]);
    }
    // The goals go on whether the observer follows or not, and end with the mentor's last state.
    assert_eq!(seen, [[0.0, 2.0], [1.0, 3.0], [2.0, 4.0], [1.0, 4.0], [0.0, 4.0], [0.0, 4.0]]);
    let mut other = Goals::new(corridor(), &waypoints().with_goals(2));
    other.restore(&env.snapshot().unwrap()).unwrap();
    let mut again = [0.0; 4];
    env.step(1, &mut obs).unwrap();
    other.step(1, &mut again).unwrap();
    assert_eq!((obs, env.snapshot().unwrap()), (again, other.snapshot().unwrap()));
}

proptest! {
    /// An environment that was put into a state goes on as one that came there by itself, but for what it remembers of the way.
    #[test]
    fn put_is_where_an_episode_could_be(x in 0usize..7) {
        let mut env = corridor();
        let mut obs = [9.0; 2];
        let begins = env.put(&[x as f32, 0.0], &mut obs).unwrap();
        prop_assert_eq!(begins, x != 4 && x < 6);
        if begins {
            prop_assert_eq!(obs, [x as f32, 0.0]);
            let step = env.step(1, &mut obs).unwrap();
            prop_assert_eq!((step.success, obs[0]), (x == 3, if x == 5 { 5.0 } else { x as f32 + 1.0 }));
        } else {
            prop_assert!(env.step(1, &mut obs).is_err());
        }
    }
}
