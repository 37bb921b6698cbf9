//! What a dead run leaves behind for a moment, or for good: a learner that still lives, and shared memory. The order of
//! events is forced by stopping processes, never hoped for.

use crate::util::{
    LIMIT, Place, Process, Trace, assert_gone, copy, domain, kill_all, newest_checkpoint, process, processes,
    send, start, tree, wait_until,
};
use nix::sys::prctl::set_child_subreaper;
use nix::sys::signal::Signal;
use std::fs;
use trestle_link::Liveness;
use trestle_proto::rundir::RunDir;

/// A run that ends only when it is told to, or killed.
const ENDLESS: [&str; 7] = [
    "maze-small",
    "--env-steps",
    "1000000000",
    "--episodes",
    "1000000000",
    "--set",
    "checkpoint.every_env_steps=4000",
];

/// Starts the run `name` and waits for its first checkpoint.
fn saved_once(place: &Place, name: &str) -> (Process, RunDir) {
    let mut run = start(&place.training(name, &ENDLESS));
    let dir = place.run(name);
    run.wait_for("a checkpoint", || dir.last().exists());
    (run, dir)
}

/// The arguments of a run as above that ends a few checkpoints after the newest one in `dir`.
fn a_little_longer(dir: &RunDir) -> [String; 7] {
    // A tick has 32 steps.
    let steps = u64::from(newest_checkpoint(dir).unwrap()) * 32 + 12_000;
    let mut args = ENDLESS.map(String::from);
    args[2] = steps.to_string();
    args
}

/// Trains in the directory `name` with `args` and `more`.
fn training(place: &Place, name: &str, args: &[String], more: &[&str]) -> Process {
    let args: Vec<&str> = args.iter().map(String::as_str).chain(more.iter().copied()).collect();
    start(&place.training(name, &args))
}

/// What a run of `args` comes to that nobody disturbs.
fn undisturbed(place: &Place, name: &str, args: &[String]) -> Trace {
    training(place, name, args, &[]).finish().ok();
    Trace::of(&place.run(name))
}

/// Kills the supervisor while its learner is stopped; returns the learner, which is all that is left then.
fn bereaved(run: Process, dir: &RunDir) -> u32 {
    // The kernel continues stopped processes whose parent dies, unless they get another one in their session: this one.
    set_child_subreaper(true).unwrap();
    let learner = process(dir.root(), "learner").unwrap();
    stop(learner);
    run.signal(Signal::SIGKILL);
    run.finish();
    let alone = || processes(dir.root()).iter().all(|(pid, _)| *pid == learner);
    assert!(wait_until(LIMIT, alone), "{:?}", processes(dir.root()));
    learner
}

/// Stops a process, all of its threads, and returns when they stand still.
fn stop(pid: u32) {
    send(pid, Signal::SIGSTOP);
    let stands = |stat: String| stat.rsplit_once(") ").is_some_and(|(_, rest)| rest.starts_with('T'));
    let all = || {
        let mut threads = fs::read_dir(format!("/proc/{pid}/task")).unwrap();
        threads.all(|thread| fs::read_to_string(thread.unwrap().path().join("stat")).is_ok_and(stands))
    };
    assert!(wait_until(LIMIT, all));
}

/// The end of a process that others may be waiting for as well.
fn ended(pid: u32) -> bool {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat"));
    stat.map_or(true, |stat| stat.rsplit_once(") ").is_none_or(|(_, rest)| rest.starts_with('Z')))
}

#[test]
fn a_resumed_run_waits_for_the_learner_of_the_dead_one() {
    let place = Place::new();
    let (run, dir) = saved_once(&place, "run");
    let learner = bereaved(run, &dir);
    let (args, plan) = (a_little_longer(&dir), fs::read(dir.plan()).unwrap());
    let mut resumed = training(&place, "run", &args, &["--resume"]);
    let waiting = format!("waiting for the end of the learner (process {learner})");
    assert!(wait_until(LIMIT, || resumed.stderr_so_far().contains(&waiting)), "{}", resumed.stderr_so_far());
    assert!(resumed.is_running() && !ended(learner));
    assert_eq!(fs::read(dir.plan()).unwrap(), plan, "nothing is written meanwhile");
    send(learner, Signal::SIGCONT);
    resumed.finish().ok();
    assert!(ended(learner), "the lock ends with it");
    assert_gone(&dir);
    assert_eq!(Trace::of(&dir), undisturbed(&place, "undisturbed", &args));
}

#[test]
fn a_start_is_refused_while_the_learner_of_the_dead_run_lives() {
    let place = Place::new();
    let (run, dir) = saved_once(&place, "run");
    let learner = bereaved(run, &dir);
    let (args, before) = (a_little_longer(&dir), tree(dir.root()));
    let held = format!("held by the learner (process {learner})");
    let both = ["--resume", "--overwrite"].map(|how| training(&place, "run", &args, &[how]));
    for refused in both {
        refused.finish().refused(&["a run is in progress there", &held, "wait for its end"]);
    }
    assert!(!ended(learner) && tree(dir.root()) == before, "nothing has changed");
    send(learner, Signal::SIGCONT);
    assert!(wait_until(LIMIT, || ended(learner)));
    training(&place, "run", &args, &["--overwrite"]).finish().ok();
    assert_gone(&dir);
}

/// Nobody was left who could have removed anything. The next start in the directory does it, whatever becomes of that start.
#[test]
fn the_next_start_removes_what_a_dead_run_has_left_in_shared_memory() {
    // What `doctor` would say of the leftovers is not for other tests to see.
    let place = Place::alone();
    let starts: [(&[&str], bool); 3] = [(&["--resume"], true), (&["--overwrite"], true), (&[], false)];
    for (i, (more, succeeds)) in starts.into_iter().enumerate() {
        let name = i.to_string();
        let (run, dir) = saved_once(&place, &name);
        let left = domain(&dir);
        kill_all(run, &dir);
        let args = a_little_longer(&dir);
        assert_eq!(left.liveness(), Liveness::Dead);
        assert!(!left.shared_memory().unwrap().is_empty());
        let outcome = training(&place, &name, &args, more).finish();
        assert_eq!(outcome.status.success(), succeeds, "{outcome:?}");
        assert_eq!(left.liveness(), Liveness::Absent, "{more:?}");
        if succeeds {
            assert_gone(&dir);
            assert_eq!(Trace::of(&dir), undisturbed(&place, &format!("undisturbed-{i}"), &args));
        } else {
            outcome.refused(&["exists", "--resume"]);
        }
    }
}

/// A copy of a run's directory names the original's shared memory, which may be in use.
#[test]
fn a_copy_of_a_living_run_leaves_it_alone() {
    let place = Place::new();
    let (run, dir) = saved_once(&place, "run");
    // It stands still while it is copied.
    let all: Vec<u32> = processes(dir.root()).into_iter().map(|(pid, _)| pid).collect();
    all.iter().for_each(|pid| stop(*pid));
    copy(dir.root(), &place.root().join("copy"));
    let (args, shared) = (a_little_longer(&dir), domain(&dir).shared_memory().unwrap());
    training(&place, "copy", &args, &["--resume"]).finish().ok();
    assert_eq!(domain(&dir).shared_memory().unwrap(), shared);
    all.iter().for_each(|pid| send(*pid, Signal::SIGCONT));
    assert_eq!(Trace::of(&place.run("copy")), undisturbed(&place, "undisturbed", &args));
    run.signal(Signal::SIGINT);
    run.finish().code(130);
    assert_gone(&dir);
}
