//! Hosts on which no run can start: shared memory that is missing, too small, or cannot be written to. Each test has
//! its own `/dev/shm` in a mount namespace, which takes the right to make one.

use crate::util::{
    Outcome, Place, Trace, assert_gone, available, process, processes, send, start, start_under, tree,
};
use nix::sys::signal::Signal;
use std::fs;

const ARGS: [&str; 5] = ["maze-small", "--env-steps", "3000", "--seed", "4"];

/// Trains in `run`, after `setup` in a namespace of its own; none where that is not allowed.
fn trained_after(place: &Place, setup: &str, more: &[&str]) -> Option<Outcome> {
    if !available(&["unshare", "--mount", "sh", "-c", setup]) {
        return None;
    }
    let script = format!("{setup} && exec \"$@\"");
    let args = place.training("run", &[&ARGS[..], more].concat());
    Some(start_under(&["unshare", "--mount", "sh", "-c", &script, "sh"], &args).finish())
}

fn refused(setup: &str, words: &[&str]) {
    let place = Place::new();
    if let Some(outcome) = trained_after(&place, setup, &[]) {
        outcome.refused(words);
        assert!(tree(place.root()).is_empty(), "nothing is left behind");
    }
}

#[test]
fn no_shared_memory() {
    refused("mount -t tmpfs tmpfs /dev", &["/dev/shm", "MiB of shared memory"]);
}

#[test]
fn too_little_shared_memory() {
    refused("mount -t tmpfs -o size=1m tmpfs /dev/shm", &["/dev/shm", "1 MiB free", "needs", "run.actors"]);
}

#[test]
fn read_only_shared_memory() {
    refused("mount -t tmpfs -o ro tmpfs /dev/shm", &["/dev/shm", "cannot be written"]);
}

/// What a run says it needs is enough, and a start that is refused puts a replaced run back.
#[test]
fn as_much_shared_memory_as_is_asked_for() {
    let place = Place::new();
    let little = "mount -t tmpfs -o size=1m tmpfs /dev/shm";
    let first = place.train("run", &ARGS);
    let before = tree(place.root());
    let more = ["--actors", "3", "--overwrite"];
    let Some(outcome) = trained_after(&place, little, &more) else { return };
    let outcome = outcome.refused(&["needs"]);
    assert!(tree(place.root()) == before);
    assert_eq!(Trace::of(&place.run("run")), first);
    let needs = outcome.stderr.split("needs ").nth(1).unwrap().split(' ').next().unwrap();
    let enough = format!("mount -t tmpfs -o size={needs}m tmpfs /dev/shm");
    trained_after(&place, &enough, &more).unwrap().ok();
    let dir = place.run("run");
    assert_gone(&dir);
    let undisturbed = place.train("again", &[&ARGS[..], &["--actors", "3"]].concat());
    assert_eq!(Trace::of(&dir), undisturbed);
}

/// A child that dies before the first tick: the replaced run comes back.
#[test]
fn a_failed_start_restores_what_it_replaces() {
    let place = Place::new();
    let first = place.train("run", &ARGS);
    let dir = place.run("run");
    let plan = fs::read(dir.plan()).unwrap();
    let args = place.training("run", &["maze-small", "--env-steps", "1000000000", "--overwrite"]);
    let mut run = start(&args);
    run.wait_for("the learner", || process(dir.root(), "learner").is_some());
    let learner = process(dir.root(), "learner").unwrap();
    // Stopped, the learner cannot begin to train; if it was so quick that it has, there is nothing to restore.
    send(learner, Signal::SIGSTOP);
    let began = dir.evals().exists();
    send(learner, Signal::SIGKILL);
    run.finish().refused(&["learner", "signal: 9"]);
    assert_eq!(processes(dir.root()), []);
    if !began {
        assert_eq!(fs::read(dir.plan()).unwrap(), plan);
        assert_eq!(Trace::of(&dir), first);
        assert_eq!(fs::read_dir(place.root()).unwrap().count(), 1);
    }
}
