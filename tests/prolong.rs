//! A finished run that is prolonged equals one that was that long from the start.

use crate::util::{LIMIT, Place, Trace, newest_checkpoint, start, wait_until_gone};
use nix::sys::signal::Signal;
use std::fs;
use trestle_learner::checkpoint;

/// Evaluations, checkpoints and the ends of runs fall on different ticks.
const ARGS: [&str; 7] =
    ["maze-small", "--seed", "5", "--set", "checkpoint.every_env_steps=3000", "--set", "eval.every=3"];

/// Ended by episodes twice, by environment steps within a tick and at the end of one, interrupted and killed in between.
fn equals(more: &[&str]) {
    let place = Place::new();
    let args = [&ARGS[..], more].concat();
    let long = ["--episodes", "100000", "--env-steps", "20003"];
    let straight = place.train("straight", &[&args[..], &long].concat());

    let (dir, root) = (place.run("run"), place.path("run"));
    let resume = |more: &[&str]| start(&[&["resume", &root, "--quiet"], more].concat());
    let first = place.train("run", &[&args[..], &["--episodes", "4"]].concat());
    assert_eq!(first.result.episodes, 4);
    resume(&[]).finish().refused(&["is complete with 4 episodes", "run.episodes = 4", "a higher --episodes"]);
    assert_eq!(Trace::of(&dir), first, "nothing has changed");
    resume(&["--episodes", "7"]).finish().ok();
    let seven = place.train("seven", &[&args[..], &["--episodes", "7"]].concat());
    assert_eq!(Trace::of(&dir), seven);
    for steps in ["6401", "7680"] {
        resume(&["--episodes", "100000", "--env-steps", steps]).finish().ok();
        assert_eq!(Trace::of(&dir).result.env_steps.to_string(), steps);
    }

    let mut run = resume(&long);
    run.wait_for("the run", || !dir.result().exists());
    let before = newest_checkpoint(&dir);
    run.wait_for("a checkpoint", || newest_checkpoint(&dir) > before);
    run.signal(Signal::SIGINT);
    run.finish().code(130);
    let mut run = resume(&[]);
    let before = newest_checkpoint(&dir);
    run.wait_for("a checkpoint", || newest_checkpoint(&dir) > before);
    run.signal(Signal::SIGKILL);
    run.finish();
    wait_until_gone(&dir, LIMIT);
    resume(&[]).finish().ok();
    assert_eq!(Trace::of(&dir), straight);
}

#[test]
fn dqn() {
    equals(&["--algo", "dqn"]);
}

#[test]
fn dqn_with_lag() {
    equals(&["--algo", "dqn", "--set", "run.lag=1"]);
}

/// A run of one process, which goes on in several.
#[test]
fn the_reference() {
    let place = Place::new();
    for (name, more) in [("plain", &["--actors", "2"][..]), ("lag", &["--set", "run.lag=1"])] {
        let args = [&ARGS[..], more, &["--algo", "dqn"]].concat();
        let straight = place.train(&format!("{name}-straight"), &[&args[..], &["--episodes", "7"]].concat());
        place.train(name, &[&args[..], &["--mode", "reference", "--episodes", "4"]].concat());
        start(&["resume", &place.path(name), "--quiet", "--episodes", "7"]).finish().ok();
        assert_eq!(Trace::of(&place.run(name)), straight, "{name}");
    }
}

#[test]
fn two_actors_with_dqn() {
    equals(&["--algo", "dqn", "--actors", "2"]);
}

#[test]
fn two_actors_with_dqn_and_lag() {
    equals(&["--algo", "dqn", "--actors", "2", "--set", "run.lag=1"]);
}

#[test]
fn ha_diiqn() {
    equals(&[]);
}

#[test]
fn ha_diiqn_with_lag() {
    equals(&["--set", "run.lag=1"]);
}

#[test]
fn two_actors() {
    equals(&["--actors", "2"]);
}

#[test]
fn two_actors_with_lag() {
    equals(&["--actors", "2", "--set", "run.lag=1"]);
}

/// The shortest run there is, and one whose last tick is that of a checkpoint.
/// Each actor has a place on the mentor's path of its own, and the guide comes to its end on the way.
#[test]
fn learned_bridges_with_lag() {
    let trestle = ["--algo", "trestle", "--actors", "3", "--set", "run.lag=1"];
    equals(&[&trestle[..], &["--set", "exploration.epsilon_decay_steps=15000"]].concat());
}

#[test]
fn from_any_length() {
    let place = Place::new();
    let args = ["maze-small", "--seed", "8", "--set", "checkpoint.every_env_steps=640"];
    let straight = place.train("straight", &[&args[..], &["--env-steps", "1500"]].concat());
    for steps in ["1", "32", "640", "641", "672"] {
        place.train("run", &[&args[..], &["--env-steps", steps, "--overwrite"]].concat());
        let longer = start(&["resume", &place.path("run"), "--env-steps", "1500"]).finish().ok();
        assert!(longer.stderr.contains("going on from episode "), "{}", longer.stderr);
        assert_eq!(Trace::of(&place.run("run")), straight, "from {steps}");
    }
}

#[test]
fn one_that_stopped_because_it_was_solved() {
    let place = Place::new();
    for lag in ["run.lag=0", "run.lag=1"] {
        let args = ["maze-small", "--env-steps", "20000", "--set", "eval.threshold=-4000", "--set", lag];
        let straight = place.train("straight", &[&args[..], &["--overwrite"]].concat());
        let stop = ["--overwrite", "--set", "run.stop_when_solved=true"];
        let stopped = place.train("run", &[&args[..], &stop].concat());
        assert!(stopped.result.env_steps < straight.result.env_steps);
        let on = ["resume", &place.path("run"), "--quiet", "--set", "run.stop_when_solved=false"];
        start(&on).finish().ok();
        assert_eq!(Trace::of(&place.run("run")), straight, "{lag}");
    }
}

#[test]
fn one_of_free_mode_counts_on() {
    let place = Place::new();
    let args = ["maze-small", "--mode", "free", "--actors", "2", "--episodes", "6"];
    let short = place.train("run", &args);
    let root = place.path("run");
    start(&["resume", &root, "--quiet", "--episodes", "12"]).finish().ok();
    let longer = Trace::of(&place.run("run"));
    let (before, after) = (short.result, longer.result);
    assert!(after.episodes == 12 && before.env_steps < after.env_steps, "{after:?}");
    assert!(longer.counted == after.env_steps, "{} of {}", longer.counted, after.env_steps);
    let points: Vec<u64> = longer.evals[1..].iter().map(|row| row[1].parse().unwrap()).collect();
    assert!(points.is_sorted_by(|a, b| a < b), "{points:?}");
}

#[test]
fn a_sweep() {
    let place = Place::new();
    let out = place.path("s");
    let short =
        ["sweep", "maze-small", "--algos", "dqn,ha-diiqn", "--seeds", "3..5", "--quiet", "--out", &out];
    start(&[&short[..], &["--episodes", "3"]].concat()).finish().ok();
    start(&["sweep", "--resume", "--quiet", "--out", &out, "--episodes", "6"]).finish().ok();
    let alone = place.train("alone", &["maze-small", "--algo", "dqn", "--seed", "4", "--episodes", "6"]);
    assert_eq!(Trace::of(&place.run("s/dqn/seed-4")), alone);
    // It knows how long it is by now.
    let whole = start(&["sweep", "--resume", "--quiet", "--out", &out]).finish().ok();
    assert!(whole.stdout.contains("2/2"), "{}", whole.stdout);
}

/// All runs of a sweep are equally long, and those that stopped early can be told to go on.
#[test]
fn a_sweep_that_stopped_because_it_was_solved() {
    let place = Place::new();
    let out = place.path("s");
    let args = ["maze-small", "--algo", "dqn", "--seed", "4", "--set", "eval.threshold=-4000"];
    let alone = place.train("alone", &[&args[..], &["--episodes", "30"]].concat());
    let sweep = ["sweep", "maze-small", "--algos", "dqn", "--seeds", "3..5", "--quiet", "--out", &out];
    let sets = ["--set", "eval.threshold=-4000", "--set", "run.stop_when_solved=true", "--episodes", "25"];
    start(&[&sweep[..], &sets].concat()).finish().ok();
    let stopped = Trace::of(&place.run("s/dqn/seed-4"));
    assert!(stopped.result.episodes < 25);

    let resume =
        |more: &[&str]| start(&[&["sweep", "--resume", "--quiet", "--out", &out], more].concat()).finish();
    let said = resume(&["--episodes", "28", "--seeds", "4"]).ok().stderr;
    assert!(said.contains("1 run is as long as it took to solve it;"), "{said}");
    let said = resume(&["--episodes", "30"]).ok().stderr;
    assert!(said.contains("2 runs are as long as it took to solve them"), "{said}");
    assert_eq!(Trace::of(&place.run("s/dqn/seed-4")), stopped);
    resume(&["--episodes", "29"]).refused(&["--episodes 29; accepted: 30 or more"]);
    resume(&["--set", "learner.lr=0.1"]).refused(&["--set learner.lr=0.1", "run.stop_when_solved"]);
    resume(&["--set", "run.episodes=50"]).refused(&["--set run.episodes=50; accepted", "--episodes"]);
    for more in [["--set", "run.stop_when_solved=false"], ["--episodes", "31"]] {
        resume(&[&more[..], &["--share", "0/2"]].concat()).refused(&["--share 0/2 with --set, --episodes"]);
    }
    resume(&["--set", "run.stop_when_solved=false"]).ok();
    assert_eq!(Trace::of(&place.run("s/dqn/seed-4")), alone);
}

/// A setting of the whole sweep does not reach an arm that has it itself.
#[test]
fn an_arm_that_decides_itself_when_to_stop() {
    let place = Place::new();
    let out = place.path("s");
    let arm = ["sweep", "maze-small", "--arm", "own:run.stop_when_solved=true", "--seeds", "4", "--quiet"];
    start(&[&arm[..], &["--set", "eval.threshold=-4000", "--episodes", "25", "--out", &out]].concat())
        .finish()
        .ok();
    let stopped = Trace::of(&place.run("s/own/seed-4"));
    assert!(stopped.result.episodes < 25);
    let resume =
        |more: &[&str]| start(&[&["sweep", "--resume", "--quiet", "--out", &out], more].concat()).finish();
    let said = resume(&["--episodes", "30"]).ok().stderr;
    assert!(!said.contains("as long as it took"), "{said}");
    resume(&["--set", "run.stop_when_solved=false"]).refused(&["which every arm sets itself"]);
    assert_eq!(Trace::of(&place.run("s/own/seed-4")), stopped);
}

/// Without all of its evaluations a run does not go on. It is refused before anything is started, and stays as it is.
#[test]
fn lost_evaluations_are_named_before_anything_has_changed() {
    let place = Place::new();
    place.train("run", &[&ARGS[..], &["--episodes", "9"]].concat());
    let (dir, root) = (place.run("run"), place.path("run"));
    let whole = fs::read(dir.evals()).unwrap();
    let result = fs::read(dir.result()).unwrap();
    for kept in [whole.len() / 2, 60, 0] {
        fs::write(dir.evals(), &whole[..kept]).unwrap();
        let outcome = start(&["resume", &root, "--episodes", "12"]).finish();
        assert!(!outcome.stderr.contains("learner ended"), "{}", outcome.stderr);
        outcome.refused(&["--resume", "evals.csv"]);
        assert_eq!(fs::read(dir.result()).unwrap(), result);
    }
    fs::remove_file(dir.evals()).unwrap();
    start(&["resume", &root, "--episodes", "12"]).finish().refused(&["--resume", "evals.csv"]);
    fs::write(dir.evals(), &whole).unwrap();
    start(&["resume", &root, "--quiet", "--episodes", "12"]).finish().ok();
    assert_eq!(Trace::of(&dir), place.train("twelve", &[&ARGS[..], &["--episodes", "12"]].concat()));
}

/// The last checkpoint comes on top of those that are kept, and goes when the run has gone on.
#[test]
fn what_it_goes_on_from_is_kept() {
    let place = Place::new();
    let args = ["maze-small", "--seed", "5", "--set", "checkpoint.keep=1"];
    place.train("run", &[&args[..], &["--env-steps", "2000"]].concat());
    let (dir, root) = (place.run("run"), place.path("run"));
    let ticks = || {
        let names = fs::read_dir(dir.checkpoints()).unwrap().map(|entry| entry.unwrap().file_name());
        let mut ticks: Vec<u64> = names.map(|name| name.to_str().unwrap().parse().unwrap()).collect();
        ticks.sort_unstable();
        ticks
    };
    assert_eq!(ticks(), [62, 63]);
    let plan = dir.read_plan().unwrap();
    assert_eq!(checkpoint::newest_resumable(dir.root(), &plan).unwrap().unwrap().0, 62.into());
    let damaged = checkpoint::directory(dir.root(), 62.into()).join("pending.bin");
    let whole = fs::read(&damaged).unwrap();
    fs::write(&damaged, &whole[..whole.len() / 2]).unwrap();
    let refused = start(&["resume", &root, "--env-steps", "3000"]).finish();
    refused.refused(&["pending.bin", "cannot go on from any of the checkpoints"]);
    fs::write(&damaged, &whole).unwrap();
    start(&["resume", &root, "--quiet", "--env-steps", "3000"]).finish().ok();
    assert_eq!(ticks(), [93, 94]);
}
