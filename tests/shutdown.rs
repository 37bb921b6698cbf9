//! Ends that nobody wishes for: Ctrl-C, kills of the supervisor and of its children.

use crate::util::{
    LIMIT, Place, Process, assert_gone, dead_runs, domain, evaluations, newest_checkpoint, process,
    processes, result, send, start, start_under, wait_until, wait_until_gone,
};
use nix::sys::signal::Signal;
use std::fs;
use std::os::unix::process::ExitStatusExt;
use trestle_proto::rundir::RunDir;

/// A run that ends only when it is told to.
const ENDLESS: [&str; 5] = ["maze-small", "--env-steps", "1000000000", "--episodes", "1000000000"];

/// Starts an endless run of two actors and waits until it is well under way.
fn under_way(place: &Place) -> (Process, RunDir) {
    let args = [&ENDLESS[..], &["--actors", "2", "--set", "supervise.restarts=0"]].concat();
    let mut run = start(&place.training("run", &args));
    let dir = place.run("run");
    run.wait_for("three evaluations", || evaluations(&dir) >= 3);
    assert_eq!(processes(dir.root()).len(), 5, "supervisor, learner, mentor-server, two actors");
    (run, dir)
}

#[test]
fn a_signal_saves_and_leaves() {
    let place = Place::new();
    let warnings = [Signal::SIGUSR1, Signal::SIGUSR2, Signal::SIGXCPU, Signal::SIGXFSZ];
    for signal in [Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP].into_iter().chain(warnings) {
        let (run, dir) = under_way(&place);
        run.signal(signal);
        let outcome = run.finish().code(130);
        assert!(outcome.stderr.contains("interrupted"), "{outcome:?}");
        assert!(outcome.stderr.contains("`trestle resume "), "{outcome:?}");
        assert_gone(&dir);
        let result = result(&dir);
        assert!(result.interrupted && result.env_steps > 0, "{result:?}");
        let newest = newest_checkpoint(&dir).unwrap();
        assert_eq!(u64::from(newest) * 2 * 32, result.env_steps, "the checkpoint is of the last tick");
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
    let stderr = |run: &Process| run.stderr_so_far().contains("once more to stop at once");
    assert!(wait_until(LIMIT, || stderr(&run)));
    assert!(run.is_running(), "it waits for the learner");
    // The last one comes later than half a second after the first: those in between are the same request.
    let ended = wait_until(LIMIT, || {
        run.signal(Signal::SIGINT);
        !run.is_running()
    });
    assert!(ended);
    run.finish().code(130);
    assert_gone(&dir);
    assert!(!dir.result().exists(), "nothing was saved");
}

/// systemd sends SIGTERM and then SIGHUP, a batch system warns before it terminates, and a wrapper repeats them all.
#[test]
fn signals_together_are_one_request() {
    let place = Place::new();
    let (mut run, dir) = under_way(&place);
    // What they ask for cannot be done until all of them have come.
    let learner = process(dir.root(), "learner").unwrap();
    send(learner, Signal::SIGSTOP);
    let all =
        [Signal::SIGTERM, Signal::SIGHUP, Signal::SIGUSR1, Signal::SIGINT, Signal::SIGINT, Signal::SIGTERM];
    all.into_iter().for_each(|signal| run.signal(signal));
    let pid = run.pid();
    run.wait_for("all signals to be delivered", || {
        let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
        status.lines().filter(|line| line.contains("Pnd:")).all(|line| line.ends_with("0000000000000000"))
    });
    assert!(wait_until(LIMIT, || run.stderr_so_far().contains("saving")));
    send(learner, Signal::SIGCONT);
    run.finish().code(130);
    assert_gone(&dir);
    let result = result(&dir);
    assert!(result.interrupted);
    assert_eq!(
        u64::from(newest_checkpoint(&dir).unwrap()) * 2 * 32,
        result.env_steps,
        "the last tick is saved"
    );
}

/// Some systems signal every process of a service or a job, and not the supervisor alone.
#[test]
fn a_signal_for_a_process_of_a_run_is_one_for_the_run() {
    let place = Place::new();
    for (role, signal) in [
        (Some("learner"), Signal::SIGUSR1),
        (Some("actor-1"), Signal::SIGTERM),
        (Some("mentor-server"), Signal::SIGXCPU),
        (None, Signal::SIGTERM),
    ] {
        let (run, dir) = under_way(&place);
        match role {
            Some(role) => send(process(dir.root(), role).unwrap(), signal),
            None => processes(dir.root()).iter().for_each(|(pid, _)| send(*pid, signal)),
        }
        run.finish().code(130);
        assert_gone(&dir);
        let result = result(&dir);
        assert!(result.interrupted, "{role:?}");
        assert_eq!(u64::from(newest_checkpoint(&dir).unwrap()) * 2 * 32, result.env_steps, "{role:?}");
        fs::remove_dir_all(dir.root()).unwrap();
    }
}

/// What a run has come to while it starts, and how to see it.
type Moment = (&'static str, fn(&RunDir) -> bool);

/// Moments of a start, in their order.
const START: [Moment; 7] = [
    ("its directory", |dir| dir.root().exists()),
    ("its plan", |dir| dir.plan().exists()),
    ("its place in shared memory", |dir| dir.read_plan().is_ok() && domain(dir).root().exists()),
    ("its learner", |dir| process(dir.root(), "learner").is_some()),
    ("its mentor-server", |dir| process(dir.root(), "mentor-server").is_some()),
    ("its last actor", |dir| process(dir.root(), "actor-1").is_some()),
    ("its records", |dir| dir.evals().exists()),
];

#[test]
fn a_signal_while_a_run_starts_leaves_nothing_or_a_checkpoint() {
    let place = Place::new();
    for (i, (what, reached)) in START.into_iter().enumerate() {
        let name = i.to_string();
        let dead = dead_runs();
        let mut run = start(&place.training(&name, &[&ENDLESS[..], &["--actors", "2"]].concat()));
        let dir = place.run(&name);
        run.wait_for(what, || reached(&dir));
        run.signal(Signal::SIGINT);
        let outcome = run.finish().code(130);
        if dir.root().exists() {
            assert_gone(&dir);
            assert!(result(&dir).interrupted && newest_checkpoint(&dir).is_some(), "at {what}: {outcome:?}");
            assert!(outcome.stdout.contains("weights_sha256"), "at {what}: {outcome:?}");
        } else {
            assert!(outcome.stderr.contains("before anything was saved"), "at {what}: {outcome:?}");
            assert_eq!(processes(dir.root()), []);
        }
        assert!(wait_until(LIMIT, || dead_runs().iter().all(|run| dead.contains(run))), "at {what}");
    }
}

#[test]
fn a_run_outlives_its_terminal_if_told_to() {
    let place = Place::new();
    // As `nohup` starts a program.
    let args = place.training("run", &ENDLESS);
    let mut run = start_under(&["sh", "-c", "trap '' HUP; exec \"$@\"", "sh"], &args);
    let dir = place.run("run");
    run.wait_for("an evaluation", || evaluations(&dir) > 0);
    run.signal(Signal::SIGHUP);
    let before = evaluations(&dir);
    run.wait_for("the run to go on", || evaluations(&dir) > before + 3);
    run.signal(Signal::SIGTERM);
    run.finish().code(130);
    assert_gone(&dir);
}

#[test]
fn a_run_does_not_need_anybody_to_read_what_it_prints() {
    let place = Place::new();
    let status = place.path("status");
    for (i, quiet) in [&["--quiet"][..], &[]].into_iter().enumerate() {
        let out = place.path(&i.to_string());
        let args = [&["train", "maze-small", "--env-steps", "3000", "--out", &out], quiet].concat();
        let script = format!("{{ \"$@\"; echo $? > {status}; }} 2>&1 | true");
        start_under(&["sh", "-c", &script, "sh"], &args).finish().ok();
        assert!(
            wait_until(LIMIT, || fs::read_to_string(&status).is_ok_and(|text| text == "0\n")),
            "{quiet:?}"
        );
        assert_eq!(result(&place.run(&i.to_string())).env_steps, 3000);
        fs::remove_file(&status).unwrap();
    }
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
    // Before that there is nothing that a child could remove.
    for (i, (what, reached)) in START.into_iter().enumerate().skip(3) {
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
fn a_killed_child_ends_a_run_without_restarts() {
    let place = Place::new();
    for role in ["actor-1", "learner", "mentor-server"] {
        let (run, dir) = under_way(&place);
        send(process(dir.root(), role).unwrap(), Signal::SIGKILL);
        let outcome =
            run.finish().refused(&[role, "signal: 9", "supervise.restarts = 0", "the end of its log"]);
        let log = fs::read_to_string(dir.log(role)).unwrap();
        assert!(outcome.stderr.contains(log.lines().last().unwrap()), "{outcome:?}");
        assert_gone(&dir);
        assert!(!dir.result().exists(), "a run that failed has no result");
        fs::remove_dir_all(dir.root()).unwrap();
    }
}

#[test]
fn a_child_that_fails_while_the_run_starts_is_named() {
    let place = Place::new();
    for role in ["learner", "mentor-server", "actor-0"] {
        let args = [&ENDLESS[..], &["--set", "supervise.restarts=0"]].concat();
        let mut run = start(&place.training(role, &args));
        let dir = place.run(role);
        run.wait_for(role, || process(dir.root(), role).is_some());
        let domain = domain(&dir);
        send(process(dir.root(), role).unwrap(), Signal::SIGKILL);
        run.finish().refused(&[role, "signal: 9"]);
        assert_eq!(processes(dir.root()), []);
        assert!(!domain.root().exists() && domain.shared_memory().unwrap().is_empty());
    }
}
