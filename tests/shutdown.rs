//! Ends that nobody wishes for: Ctrl-C, kills of the supervisor and of its children.

use crate::util::{
    LIMIT, Place, Process, assert_gone, domain, evaluations, newest_checkpoint, process, processes, result,
    send, start, wait_until_gone,
};
use nix::sys::signal::Signal;
use std::fs;
use std::os::unix::process::ExitStatusExt;
use trestle_proto::rundir::RunDir;

/// A run that ends only when it is told to.
const ENDLESS: [&str; 5] = ["maze-small", "--env-steps", "1000000000", "--episodes", "1000000000"];

/// Starts an endless run of two actors and waits until it is well under way.
fn under_way(place: &Place) -> (Process, RunDir) {
    let mut run = start(&place.training("run", &[&ENDLESS[..], &["--actors", "2"]].concat()));
    let dir = place.run("run");
    run.wait_for("three evaluations", || evaluations(&dir) >= 3);
    assert_eq!(processes(dir.root()).len(), 5, "supervisor, learner, mentor-server, two actors");
    (run, dir)
}

#[test]
fn a_signal_saves_and_leaves() {
    let place = Place::new();
    for signal in [Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP] {
        let (run, dir) = under_way(&place);
        run.signal(signal);
        let outcome = run.finish().code(130);
        assert!(outcome.stderr.contains("interrupted"), "{outcome:?}");
        assert!(outcome.stderr.contains("--resume"), "{outcome:?}");
        assert_gone(&dir);
        let result = result(&dir);
        assert!(result.interrupted && result.env_steps > 0, "{result:?}");
        let newest = newest_checkpoint(&dir).unwrap();
        assert_eq!(newest * 2 * 32, result.env_steps, "the checkpoint is of the last tick");
        fs::remove_dir_all(dir.root()).unwrap();
    }
}

#[test]
fn a_second_signal_stops_at_once() {
    let place = Place::new();
    let (mut run, dir) = under_way(&place);
    // The learner cannot finish its tick, so only the second signal can end the run.
    let learner = process(dir.root(), "learner").unwrap();
    send(learner, Signal::SIGSTOP);
    run.signal(Signal::SIGINT);
    let told = run.pid();
    let stderr = |run: &Process| run.stderr_so_far().contains("once more to stop at once");
    assert!(crate::util::wait_until(LIMIT, || stderr(&run)));
    assert!(run.is_running(), "{told} waits for the learner");
    run.signal(Signal::SIGINT);
    run.finish().code(130);
    assert_gone(&dir);
}

#[test]
fn a_signal_before_the_first_tick_leaves_no_directory() {
    let place = Place::new();
    // A place of its own is what a supervisor makes once it handles signals and before it starts anything.
    let mut run = start(&place.training("run", &ENDLESS));
    let dir = place.run("run");
    run.wait_for("the run's place", || dir.read_plan().is_ok() && domain(&dir).root().exists());
    let domain = domain(&dir);
    run.signal(Signal::SIGINT);
    let outcome = run.finish().code(130);
    // It may have begun to train by then; if so, it has saved.
    assert_eq!(dir.root().exists(), outcome.stdout.contains("weights_sha256"), "{outcome:?}");
    assert!(!domain.root().exists() && domain.shared_memory().unwrap().is_empty());
}

#[test]
fn children_do_not_outlive_a_killed_supervisor() {
    let place = Place::new();
    let (run, dir) = under_way(&place);
    run.signal(Signal::SIGKILL);
    let outcome = run.finish();
    assert_eq!(outcome.status.signal(), Some(Signal::SIGKILL as i32));
    wait_until_gone(&dir, LIMIT / 10);
}

#[test]
fn children_do_not_outlive_a_supervisor_killed_at_any_moment_of_the_start() {
    let place = Place::new();
    let moments: [(&str, fn(&RunDir) -> bool); 4] = [
        ("the learner", |dir| process(dir.root(), "learner").is_some()),
        ("the mentor-server", |dir| process(dir.root(), "mentor-server").is_some()),
        ("an actor", |dir| process(dir.root(), "actor-1").is_some()),
        ("the records", |dir| dir.evals().exists()),
    ];
    for (i, (what, reached)) in moments.into_iter().enumerate() {
        let name = i.to_string();
        let mut run = start(&place.training(&name, &[&ENDLESS[..], &["--actors", "2"]].concat()));
        let dir = place.run(&name);
        run.wait_for(what, || reached(&dir));
        run.signal(Signal::SIGKILL);
        run.finish();
        wait_until_gone(&dir, LIMIT / 10);
    }
}

#[test]
fn a_killed_child_ends_the_run() {
    let place = Place::new();
    for role in ["actor-1", "learner", "mentor-server"] {
        let (run, dir) = under_way(&place);
        send(process(dir.root(), role).unwrap(), Signal::SIGKILL);
        let outcome = run.finish().refused(&[role, "signal: 9", "the end of its log"]);
        let log = fs::read_to_string(dir.log(role)).unwrap();
        assert!(outcome.stderr.contains(log.lines().last().unwrap()), "{outcome:?}");
        assert_gone(&dir);
        assert!(!dir.result().exists(), "a run that failed has no result");
        fs::remove_dir_all(dir.root()).unwrap();
    }
}

#[test]
fn a_child_that_fails_at_its_start_is_named_and_the_directory_given_up() {
    let place = Place::new();
    let mut run = start(&place.training("run", &ENDLESS));
    let dir = place.run("run");
    run.wait_for("an actor", || process(dir.root(), "actor-0").is_some());
    let (actor, domain) = (process(dir.root(), "actor-0").unwrap(), domain(&dir));
    send(actor, Signal::SIGKILL);
    run.finish().refused(&["actor-0", "signal: 9"]);
    assert_eq!(processes(dir.root()), []);
    assert!(!domain.root().exists() && domain.shared_memory().unwrap().is_empty());
}
