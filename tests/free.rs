//! Free mode: what is counted, and processes that are replaced while the others go on.

use crate::schedule::{self, KINDS, Kind, SHORTAGES};
use crate::util::{
    Counted, Place, Process, assert_gone, counted, evaluations, metrics, newest_checkpoint, process, result,
    send, start,
};
use nix::sys::signal::Signal;
use std::fs;
use trestle_proto::config::Mode;
use trestle_proto::rundir::RunDir;

/// A run that ends only when it is told to.
const ENDLESS: [&str; 11] = [
    "maze-small",
    "--mode",
    "free",
    "--env-steps",
    "1000000000",
    "--episodes",
    "1000000000",
    "--set",
    "checkpoint.every_env_steps=5000",
    "--set",
    "supervise.restarts=100",
];
const ROLES: [&str; 5] = ["learner", "mentor-server", "actor-0", "actor-1", "actor-2"];

/// Without a batch ahead, a single actor and the learner take turns: that is lockstep.
#[test]
fn one_actor_that_is_never_ahead_learns_what_lockstep_learns() {
    for algo in ["dqn", "ha-diiqn", "trestle"] {
        let place = Place::new();
        let args = ["maze-small", "--algo", algo, "--env-steps", "9000", "--seed", "4"];
        let lockstep = place.train("lockstep", &args);
        let free = place.train("free", &[&args[..], &["--mode", "free", "--set", "run.ahead=32"]].concat());
        assert_eq!(free.weights_sha256, lockstep.weights_sha256, "{algo}");
        assert_eq!(free.episodes, lockstep.episodes, "{algo}");
        assert_eq!(free.mentor, lockstep.mentor, "{algo}");
    }
}

#[test]
fn every_step_is_counted_once_and_learnt_from_in_proportion() {
    let place = Place::new();
    let dir = place.run("run");
    let args = ["maze-small", "--mode", "free", "--actors", "3", "--env-steps", "20000"];
    let more = ["--set", "run.ahead=288", "--set", "exploration.epsilon_spread=7"];
    let trace = place.train("run", &[&args[..], &more].concat());
    let rows = counted(&dir);
    let mut actors: Vec<_> = rows.iter().map(|row| (row.actor, row.incarnation)).collect();
    actors.sort_unstable();
    assert_eq!(actors, [(0, 0), (1, 0), (2, 0)]);
    assert_eq!(rows.iter().map(|row| row.env_steps).sum::<u64>(), 20_000);
    assert!(rows.iter().all(|row| row.env_steps > 0 && row.batches > 0), "{rows:?}");
    let config = fs::read_to_string(dir.config()).unwrap();
    let warmup: u64 =
        config.lines().find_map(|line| line.strip_prefix("warmup = ")).unwrap().parse().unwrap();
    assert_eq!(trace.result.grad_steps, 20_000 - warmup, "a gradient step a step, as `train_every` has it");
    assert!(evaluations(&dir) > 0);
    let keys = ["free/staleness_mean", "free/staleness_max", "free/samples_per_insert"];
    let last = metrics(&dir).into_iter().rfind(|row| row.get("free/samples_per_insert").is_some());
    assert!(last.as_ref().is_some_and(|row| keys.iter().all(|key| row.get(key).is_some())), "{last:?}");
    assert_eq!((trace.result.restarts, trace.result.env_steps), (0, 20_000));
}

/// Starts an endless run of three actors and waits until it is under way.
fn under_way(place: &Place, more: &[&str]) -> (Process, RunDir) {
    let args = [&ENDLESS[..], &["--actors", "3"], more].concat();
    let mut run = start(&place.training("run", &args));
    let dir = place.run("run");
    run.wait_for("three evaluations", || evaluations(&dir) >= 3);
    (run, dir)
}

/// The ids of the run's processes, in the order of [`ROLES`].
fn ids(dir: &RunDir) -> [Option<u32>; 5] {
    ROLES.map(|role| process(dir.root(), role))
}

/// What is counted of the newest incarnation of the actor that is `role`; nothing of another process.
fn newest(dir: &RunDir, role: &str) -> Option<Counted> {
    let actor = role.strip_prefix("actor-")?.parse::<u32>().unwrap();
    counted(dir).into_iter().rfind(|row| row.actor == actor)
}

/// Does `what` to `role` and waits until another process has its place, and the run goes on; with steps of its own
/// where it is an actor, since a run can go on for long with those of the others. The others must still be those that
/// they were.
fn replaced(run: &mut Process, dir: &RunDir, role: &str, what: Signal) {
    let (before, former) = (ids(dir), newest(dir, role).map(|row| row.incarnation));
    let at = ROLES.iter().position(|of| *of == role).unwrap();
    send(before[at].unwrap(), what);
    run.wait_for("another process", || ids(dir)[at].is_some_and(|pid| Some(pid) != before[at]));
    let (rows, checkpoint) = (evaluations(dir), newest_checkpoint(dir));
    run.wait_for("the run to go on", || evaluations(dir) > rows && newest_checkpoint(dir) > checkpoint);
    run.wait_for("steps of the new actor", || {
        newest(dir, role).is_none_or(|row| Some(row.incarnation) > former && row.env_steps > 0)
    });
    let after = ids(dir);
    assert!((0..5).all(|i| (before[i] == after[i]) != (i == at)), "{role}: {before:?}, then {after:?}");
}

/// Ends the run, in which so many processes have been replaced.
fn ends(run: Process, dir: &RunDir, replacements: u64) {
    run.signal(Signal::SIGINT);
    run.finish().code(130);
    assert_gone(dir);
    let result = result(dir);
    assert_eq!(result.restarts, replacements);
    assert_eq!(counted(dir).iter().map(|row| row.env_steps).sum::<u64>(), result.env_steps);
}

#[test]
fn only_the_dead_process_is_replaced() {
    let place = Place::new();
    let (mut run, dir) = under_way(&place, &[]);
    for role in ["actor-1", "mentor-server", "actor-0", "actor-1", "mentor-server", "learner", "actor-1"] {
        replaced(&mut run, &dir, role, Signal::SIGKILL);
    }
    ends(run, &dir, 7);
    let rows = counted(&dir);
    let found: Vec<_> = rows.iter().map(|row| (row.actor, row.incarnation)).collect();
    assert_eq!(found[3..6], [(1, 1), (0, 1), (1, 2)], "{rows:?}");
    // The next learner knows them anew, and the last of them was replaced once more.
    let mut later = found[6..].to_vec();
    later.sort_unstable();
    assert_eq!(later, [(0, 1 << 16), (1, 1 << 16), (1, (1 << 16) + 1), (2, 1 << 16)], "{rows:?}");
    assert!(rows.iter().all(|row| row.env_steps > 0), "{rows:?}");
    let log = fs::read_to_string(dir.log("supervisor")).unwrap();
    assert_eq!(log.matches("ended with signal: 9 (SIGKILL); replacing it").count(), 7, "{log}");
}

#[test]
fn a_stopped_process_keeps_nobody_waiting_for_long() {
    let place = Place::new();
    let (mut run, dir) = under_way(&place, &["--set", "supervise.silence_s=3"]);
    for role in ["actor-2", "mentor-server", "learner"] {
        replaced(&mut run, &dir, role, Signal::SIGSTOP);
    }
    ends(run, &dir, 3);
    let log = fs::read_to_string(dir.log("supervisor")).unwrap();
    assert!(
        log.contains("actor-2 gave no sign of life for 3 s (supervise.silence_s); replacing it"),
        "{log}"
    );
}

/// One after the other, from the newest checkpoint or, before there is one, from the beginning; the others stay.
#[test]
fn a_learner_goes_on_where_the_former_one_had_saved() {
    let place = Place::new();
    let (mut run, dir) = under_way(&place, &[]);
    for _ in 0..4 {
        replaced(&mut run, &dir, "learner", Signal::SIGKILL);
    }
    ends(run, &dir, 4);
    // And once more, as a user would.
    let mut run = start(&place.training("run", &[&ENDLESS[..], &["--actors", "3", "--resume"]].concat()));
    let rows = evaluations(&dir);
    run.wait_for("the run to go on", || evaluations(&dir) > rows + 3);
    ends(run, &dir, 4);
    let last: Vec<_> = counted(&dir).iter().rev().take(3).map(|row| row.incarnation).collect();
    assert_eq!(last, [5 << 16; 3], "every learner has incarnations of its own");
}

#[test]
fn a_learner_that_dies_before_it_has_saved_anything_begins_anew() {
    let place = Place::new();
    let (mut run, dir) = under_way(&place, &["--set", "checkpoint.every_env_steps=1000000000"]);
    let before = ids(&dir);
    send(before[0].unwrap(), Signal::SIGKILL);
    run.wait_for("another learner", || ids(&dir)[0].is_some_and(|pid| Some(pid) != before[0]));
    let starts = || fs::read_to_string(dir.log("learner")).unwrap().matches("ready to train").count();
    run.wait_for("it to begin", || starts() == 2);
    run.wait_for("its evaluations", || evaluations(&dir) >= 3);
    assert_eq!(ids(&dir)[1..], before[1..]);
    ends(run, &dir, 1);
    assert!(counted(&dir).iter().all(|row| row.incarnation == 1 << 16), "{:?}", counted(&dir));
}

/// A run that has ended can be prolonged, with all that it has recorded, and in its own mode alone.
#[test]
fn a_complete_run_is_prolonged() {
    let place = Place::new();
    let dir = place.run("run");
    let args = |steps| {
        ["maze-small", "--mode", "free", "--actors", "2", "--episodes", "100000", "--env-steps", steps]
    };
    place.train("run", &args("6400"));
    let other = ["maze-small", "--actors", "2", "--episodes", "100000", "--env-steps", "12800", "--resume"];
    start(&place.training("run", &other)).finish().refused(&["--resume"]);
    start(&place.training("run", &[&args("12800")[..], &["--resume"]].concat())).finish().ok();
    let text = fs::read_to_string(dir.evals()).unwrap();
    let points: Vec<u64> =
        text.lines().skip(1).map(|row| row.split(',').nth(1).unwrap().parse().unwrap()).collect();
    assert!(points.is_sorted() && points.last() == Some(&12_800), "one evaluation at the end: {text}");
    let (result, rows) = (result(&dir), counted(&dir));
    assert_eq!((result.env_steps, rows.iter().map(|row| row.env_steps).sum()), (12_800, 12_800));
    assert_eq!(rows.iter().filter(|row| row.incarnation == 1 << 16).count(), 2, "{rows:?}");
}

/// A short piece of what `cargo test --test faults -- --mode free` plays at length.
#[test]
fn a_schedule_of_faults_loses_and_doubles_nothing() {
    let kinds = [Kind::Kill, Kind::Stop, Kind::Pause];
    assert_eq!(schedule::play(Mode::Free, 1, 12, &kinds, |_| {}).faults, 12);
}

#[test]
fn a_schedule_of_shortages_loses_and_doubles_nothing() {
    let summary = schedule::play(Mode::Free, 1, 8, &KINDS[SHORTAGES..], |_| {});
    assert_eq!(summary.faults, 8);
    assert!(summary.clients > 0);
}
