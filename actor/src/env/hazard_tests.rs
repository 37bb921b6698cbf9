//! Until a hazard strikes nothing is different; then it is what was asked for.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::env::registry;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Instant;
use trestle_proto::config;
use trestle_proto::rng::{Purpose, stream};

/// Longer than anything takes here.
const LIMIT: Duration = Duration::from_secs(30);

fn bare() -> Box<dyn Environment> {
    let mut env = config::load(registry(), "maze-small", &["env.step_limit=30".into()]).unwrap().env;
    registry().resolve(&mut env, 0).unwrap();
    registry().build(&env).unwrap()
}

fn hazards(kind: HazardKind, after: u64, during: HazardScope) -> Hazards {
    Hazards::new(Hazard { kind, after, during })
}

/// What a walk of `steps` steps sees, resets included, and the snapshots on the way.
fn walk(env: &mut dyn Environment, steps: u64, rng: &mut Stream) -> Vec<(Step, Vec<f32>, Vec<u8>)> {
    let mut obs = vec![0.0; env.spec().obs_dim()];
    env.reset(rng, &mut obs).unwrap();
    let mut seen = Vec::new();
    for n in 0..steps {
        let step = env.step((n % 3) as u32, &mut obs).unwrap();
        if step.terminated || step.truncated {
            env.reset(rng, &mut obs).unwrap();
        }
        seen.push((step, obs.clone(), env.snapshot().unwrap()));
    }
    seen
}

/// An environment for training that has taken `after` steps, and where it is.
fn about_to_fail(kind: HazardKind, after: u64) -> (Box<dyn Environment>, Vec<f32>) {
    let mut env = hazards(kind, after, HazardScope::Both).around(bare(), HazardScope::Training);
    let walked = walk(env.as_mut(), after, &mut stream(3, Purpose::Environment, 0));
    let (_, obs, _) = walked.last().unwrap();
    (env, obs.clone())
}

#[test]
fn before_it_strikes_it_is_the_environment_itself() {
    use HazardKind::{Abort, Error, NanReward, NanState, Panic, Stall};
    let expected = walk(bare().as_mut(), 100, &mut stream(3, Purpose::Environment, 0));
    for kind in [Abort, Panic, Error, Stall, NanReward, NanState] {
        let mut env = hazards(kind, 100, HazardScope::Both).around(bare(), HazardScope::Training);
        assert_eq!(env.spec(), bare().spec());
        assert!(walk(env.as_mut(), 100, &mut stream(3, Purpose::Environment, 0)) == expected, "{kind:?}");
    }
    // Without one there is nothing around it that could be noticed, however far it goes.
    let mut env = hazards(HazardKind::None, 1, HazardScope::Both).around(bare(), HazardScope::Training);
    assert!(walk(env.as_mut(), 100, &mut stream(3, Purpose::Environment, 0)) == expected);
}

#[test]
fn a_slow_environment_is_the_environment_itself_but_for_the_time() {
    let expected = walk(bare().as_mut(), 100, &mut stream(3, Purpose::Environment, 0));
    let mut env = hazards(HazardKind::Slow, 60, HazardScope::Both).around(bare(), HazardScope::Training);
    let start = Instant::now();
    assert!(walk(env.as_mut(), 100, &mut stream(3, Purpose::Environment, 0)) == expected);
    assert!(start.elapsed() >= 40 * SLOW);
}

#[test]
fn an_error_is_one_from_then_on_and_changes_nothing() {
    let (mut env, obs) = about_to_fail(HazardKind::Error, 7);
    let before = env.snapshot().unwrap();
    for _ in 0..2 {
        let mut seen = obs.clone();
        let error = env.step(0, &mut seen).unwrap_err().to_string();
        assert_eq!(error, "env.hazard: the error that was asked for, after 7 steps of the process");
        assert_eq!((&seen, env.snapshot().unwrap()), (&obs, before.clone()));
    }
}

#[test]
fn nan_takes_the_place_of_a_reward_or_a_feature_and_of_nothing_else() {
    // What the next step would have been.
    let mut plain = bare();
    walk(plain.as_mut(), 8, &mut stream(3, Purpose::Environment, 0));
    let mut expected_obs = vec![0.0; 2];
    let expected = plain.step(1, &mut expected_obs).unwrap();

    let (mut env, mut obs) = about_to_fail(HazardKind::NanReward, 8);
    let step = env.step(1, &mut obs).unwrap();
    assert!(step.reward.is_nan() && obs == expected_obs);
    assert_eq!((step.terminated, step.truncated), (expected.terminated, expected.truncated));

    let (mut env, mut obs) = about_to_fail(HazardKind::NanState, 8);
    assert_eq!(env.step(1, &mut obs).unwrap(), expected);
    assert!(obs[0] == expected_obs[0] && obs[1].is_nan(), "{obs:?}");
}

#[test]
fn a_panic_says_that_it_was_asked_for() {
    let (mut env, mut obs) = about_to_fail(HazardKind::Panic, 5);
    let panic = catch_unwind(AssertUnwindSafe(|| env.step(0, &mut obs))).unwrap_err();
    let message = panic.downcast_ref::<String>().unwrap();
    assert_eq!(message, "env.hazard: the panic that was asked for, after 5 steps of the process");
}

/// The state of a thread (proc(5), `stat`, field 3), and its time on a processor so far, in clock ticks (fields 14, 15).
fn thread_state(task: &Path) -> (char, u64) {
    let stat = fs::read_to_string(task.join("stat")).unwrap();
    let fields: Vec<&str> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
    let time = |at: usize| fields[at].parse::<u64>().unwrap();
    (fields[0].chars().next().unwrap(), time(11) + time(12))
}

/// A thread in a step that stalls: its place in `/proc`, and what would tell that the step has returned.
fn stalled() -> (PathBuf, Receiver<()>) {
    let ((tell, place), (returned, end)) = (channel(), channel());
    thread::spawn(move || {
        let (mut env, mut obs) = about_to_fail(HazardKind::Stall, 4);
        tell.send(Path::new("/proc").join(fs::read_link("/proc/thread-self").unwrap())).unwrap();
        env.step(0, &mut obs).unwrap();
        returned.send(()).unwrap();
    });
    (place.recv().unwrap(), end)
}

#[test]
fn a_stalled_thread_sleeps() {
    let (task, end) = stalled();
    let start = Instant::now();
    let mut asleep = 0;
    while asleep < 50 {
        assert!(start.elapsed() < LIMIT, "the thread does not sleep");
        asleep = if thread_state(&task).0 == 'S' { asleep + 1 } else { 0 };
        thread::sleep(Duration::from_millis(2));
    }
    let (_, before) = thread_state(&task);
    assert_eq!(end.recv_timeout(Duration::from_millis(100)), Err(RecvTimeoutError::Timeout));
    assert_eq!(thread_state(&task), ('S', before), "it has had no time on a processor");
}

#[test]
fn training_and_evaluation_are_counted_together_or_apart() {
    let fails_after = |during, uses: &[(HazardScope, u64)]| {
        let hazards = hazards(HazardKind::Error, 10, during);
        let mut rng = stream(1, Purpose::Environment, 0);
        // Both are there from the beginning, as in an actor.
        let mut training = hazards.around(bare(), HazardScope::Training);
        let mut evaluation = hazards.around(bare(), HazardScope::Evaluation);
        let mut obs = vec![0.0; 2];
        uses.iter().all(|(used, steps)| {
            let env = if *used == HazardScope::Training { &mut training } else { &mut evaluation };
            env.reset(&mut rng, &mut obs).unwrap();
            (0..*steps).all(|_| env.step(0, &mut obs).is_ok())
        })
    };
    use HazardScope::{Both, Evaluation, Training};
    assert!(fails_after(Both, &[(Training, 6), (Evaluation, 4)]));
    assert!(!fails_after(Both, &[(Training, 6), (Evaluation, 4), (Training, 1)]));
    assert!(!fails_after(Both, &[(Training, 6), (Evaluation, 5)]));
    assert!(fails_after(Training, &[(Training, 10), (Evaluation, 20)]));
    assert!(!fails_after(Training, &[(Evaluation, 20), (Training, 11)]));
    assert!(fails_after(Evaluation, &[(Training, 20), (Evaluation, 10)]));
    assert!(!fails_after(Evaluation, &[(Training, 20), (Evaluation, 11)]));
}

#[test]
fn a_snapshot_knows_nothing_of_it() {
    let (env, _) = about_to_fail(HazardKind::Error, 9);
    let bytes = env.snapshot().unwrap();
    // Another process goes on from there, for as long again.
    let mut other = hazards(HazardKind::Error, 9, HazardScope::Both).around(bare(), HazardScope::Training);
    other.restore(&bytes).unwrap();
    assert_eq!(other.snapshot().unwrap(), bytes);
    let mut obs = vec![0.0; 2];
    assert!((0..9).all(|_| other.step(0, &mut obs).is_ok()));
    assert!(matches!(other.step(0, &mut obs), Err(EnvError::Hazard { after: 9 })));
    assert!(other.restore(&bytes[1..]).is_err());
}

#[test]
fn refused_steps_are_not_counted() {
    let mut env = hazards(HazardKind::Error, 2, HazardScope::Both).around(bare(), HazardScope::Training);
    let mut obs = vec![0.0; 2];
    for _ in 0..5 {
        assert!(matches!(env.step(0, &mut obs), Err(EnvError::Ended)));
    }
    env.reset(&mut stream(1, Purpose::Environment, 0), &mut obs).unwrap();
    for _ in 0..5 {
        assert!(matches!(env.step(99, &mut obs), Err(EnvError::Action { action: 99, .. })));
    }
    assert!(env.step(0, &mut obs).is_ok() && env.step(0, &mut obs).is_ok());
    assert!(matches!(env.step(0, &mut obs), Err(EnvError::Hazard { after: 2 })));
}
