//! Runs share a host without noticing each other, and never a directory.

use crate::util::{Place, Trace, assert_gone, evaluations, result, start};
use nix::sys::signal::Signal;

fn args(seed: &str) -> Vec<&str> {
    vec!["maze-small", "--env-steps", "6000", "--seed", seed]
}

fn at_once(seeds: &[&str]) {
    let place = Place::new();
    let name = |how: &str, seed: &str| format!("{how}-{seed}");
    let runs: Vec<_> =
        seeds.iter().map(|seed| start(&place.training(&name("together", seed), &args(seed)))).collect();
    for run in runs {
        run.finish().ok();
    }
    for seed in seeds {
        let dir = place.run(&name("together", seed));
        assert_gone(&dir);
        assert_eq!(Trace::of(&dir), place.train(&name("alone", seed), &args(seed)), "seed {seed}");
    }
}

#[test]
fn two_at_once() {
    at_once(&["1", "2"]);
}

#[test]
fn six_at_once() {
    at_once(&["1", "2", "3", "4", "5", "6"]);
}

/// More runs at once than the host has processors by far: all start, and none takes another's slowness for death.
#[test]
fn twenty_four_at_once() {
    let place = Place::new();
    let args = ["maze-small", "--algo", "dqn", "--env-steps", "1000", "--set", "supervise.restarts=0"];
    let runs: Vec<_> = (0..24).map(|i| start(&place.training(&i.to_string(), &args))).collect();
    for run in runs {
        run.finish().ok();
    }
    let hashes: Vec<String> = (0..24).map(|i| result(&place.run(&i.to_string())).weights_sha256).collect();
    assert!(hashes.iter().all(|hash| *hash == hashes[0]));
    (0..24).for_each(|i| assert_gone(&place.run(&i.to_string())));
}

#[test]
fn a_directory_in_use_is_refused() {
    let place = Place::new();
    let endless = ["maze-small", "--episodes", "1000000000", "--set", "checkpoint.every_env_steps=1000"];
    let mut run = start(&place.training("run", &endless));
    let dir = place.run("run");
    run.wait_for("a checkpoint", || dir.last().exists());
    for how in ["--resume", "--overwrite"] {
        let args = place.training("run", &[&endless[..], &[how]].concat());
        start(&args).finish().refused(&["run: a run is in progress", "--out"]);
    }
    let rows = evaluations(&dir);
    run.wait_for("the run to go on", || evaluations(&dir) > rows);
    run.signal(Signal::SIGINT);
    run.finish().code(130);
    assert_gone(&dir);
    assert!(result(&dir).interrupted);
}

#[test]
fn of_two_starts_in_one_directory_one_trains() {
    let place = Place::new();
    let args = place.training("run", &args("1"));
    let both = [start(&args), start(&args)];
    let outcomes = both.map(|run| run.finish());
    let (trained, refused): (Vec<_>, Vec<_>) = outcomes.into_iter().partition(|o| o.status.success());
    assert_eq!((trained.len(), refused.len()), (1, 1), "{trained:?} {refused:?}");
    assert!(refused[0].stderr.contains("accepted: another --out"), "{refused:?}");
    let dir = place.run("run");
    assert_gone(&dir);
    assert!(trained[0].stdout.contains(&result(&dir).weights_sha256));
}
