//! A run that is interrupted and resumed ends as one that was left alone.

use crate::util::{
    LIMIT, Place, Trace, assert_gone, evaluations, newest_checkpoint, process, result, send, start,
    wait_until_gone,
};
use nix::sys::signal::Signal;
use std::fs;
use trestle_learner::checkpoint;

/// Long enough to be interrupted on the way: a second or two.
const ARGS: [&str; 7] =
    ["maze-small", "--env-steps", "60000", "--seed", "5", "--set", "checkpoint.every_env_steps=6000"];

/// An interrupted run as an uninterrupted one would be, but for whether it was interrupted.
fn resumed(place: &Place, name: &str, args: &[&str]) -> Trace {
    let trace = place.train(name, &[args, &["--resume"]].concat());
    assert!(!trace.result.interrupted);
    trace
}

/// Interrupted by Ctrl-C twice, by a kill of the supervisor, and by that of a child.
fn survives(more: &[&str]) {
    let place = Place::new();
    let args = [&ARGS[..], more].concat();
    let undisturbed = place.train("undisturbed", &args);

    let dir = place.run("signal");
    for evaluated in [2, 9] {
        let again: &[&str] = if dir.root().exists() { &["--resume"] } else { &[] };
        let mut run = start(&place.training("signal", &[&args[..], again].concat()));
        run.wait_for("evaluations", || evaluations(&dir) >= evaluated);
        run.signal(Signal::SIGINT);
        run.finish().code(130);
        assert_gone(&dir);
        assert!(result(&dir).interrupted);
    }
    assert_eq!(resumed(&place, "signal", &args), undisturbed);

    let dir = place.run("kill");
    let mut run = start(&place.training("kill", &args));
    run.wait_for("a checkpoint", || dir.last().exists());
    run.signal(Signal::SIGKILL);
    run.finish();
    wait_until_gone(&dir, LIMIT);
    let more = ["--resume", "--set", "supervise.restarts=0"];
    let mut run = start(&place.training("kill", &[&args[..], &more].concat()));
    let before = newest_checkpoint(&dir).unwrap();
    run.wait_for("another checkpoint", || newest_checkpoint(&dir) > Some(before));
    send(process(dir.root(), "mentor-server").unwrap(), Signal::SIGKILL);
    run.finish().refused(&["mentor-server"]);
    assert_gone(&dir);
    assert_eq!(resumed(&place, "kill", &args), undisturbed);
}

/// A run in one process saves nothing on its way, but does when it is interrupted. It goes on in several processes.
#[test]
fn a_run_in_one_process_goes_on_in_several() {
    let place = Place::new();
    for more in [&[][..], &["--actors", "2", "--set", "run.lag=1"]] {
        let args = [&ARGS[..], more].concat();
        let (name, whole) = (format!("run-{}", more.len()), format!("undisturbed-{}", more.len()));
        let mut run = start(&place.training(&name, &[&args[..], &["--mode", "reference"]].concat()));
        let dir = place.run(&name);
        run.wait_for("evaluations", || evaluations(&dir) >= 2);
        run.signal(Signal::SIGINT);
        let ended = run.finish().code(130);
        assert!(
            ended.stderr.contains(&format!("`trestle resume {}` goes on", dir.root().display())),
            "{ended:?}"
        );
        let said = start(&["resume", &place.path(&name)]).finish().ok().stderr;
        assert!(said.contains("goes on in several, with the same weights"), "{said}");
        assert_gone(&dir);
        assert_eq!(Trace::of(&dir), place.train(&whole, &args));
    }
}

#[test]
fn one_actor() {
    survives(&[]);
}

#[test]
fn two_actors() {
    survives(&["--actors", "2"]);
}

#[test]
fn one_actor_with_lag() {
    survives(&["--set", "run.lag=1"]);
}

#[test]
fn two_actors_with_lag() {
    survives(&["--actors", "2", "--set", "run.lag=1"]);
}

/// The replay has gone round before the interruption, so that paths of a restored one cross its seam.
#[test]
fn several_steps_ahead() {
    survives(&["--actors", "2", "--set", "learner.n_step=5", "--set", "learner.replay=3000"]);
}

#[test]
fn a_guide_with_lag() {
    survives(&["--actors", "2", "--set", "run.lag=1", "--set", "exploration.guide_end=0.5"]);
}

#[test]
fn three_actors_on_whole_bridges() {
    survives(&[
        "--actors",
        "3",
        "--set",
        "exploration.guide_end=0.9",
        "--set",
        "exploration.guide_whole=true",
    ]);
}

/// Shaping needs a demonstration, and no mentor-server.
#[test]
fn shaped_rewards() {
    let place = Place::new();
    let args = [&ARGS[..], &["--algo", "dqn", "--set", "shaping.potential=2"]].concat();
    let undisturbed = place.train("undisturbed", &args);
    assert_eq!(undisturbed.result.algo, "dqn+shaped");
    let dir = place.run("signal");
    let mut run = start(&place.training("signal", &args));
    run.wait_for("a checkpoint", || dir.last().exists());
    run.signal(Signal::SIGINT);
    run.finish().code(130);
    assert_eq!(resumed(&place, "signal", &args), undisturbed);
}

#[test]
fn other_settings_are_refused_and_more_episodes_are_not() {
    let place = Place::new();
    let base = ["maze-small", "--set", "checkpoint.every_env_steps=1000", "--set", "learner.lr=0.001"];
    let first = place.train("run", &[&base[..], &["--seed", "5", "--episodes", "20"]].concat());
    let refused = |more: &[&str], words: &[&str]| {
        let args = place.training("run", &[&base[..], &["--resume"], more].concat());
        start(&args).finish().refused(words);
        assert_eq!(Trace::of(&place.run("run")), first, "nothing has changed");
    };
    refused(&["--seed", "6"], &["--resume", "seed = 5", "seed = 6"]);
    refused(&["--seed", "5", "--set", "learner.lr=0.5"], &["lr = 0.001", "lr = 0.5"]);
    refused(&["--seed", "5", "--actors", "2"], &["actors = 1", "actors = 2"]);
    refused(&["--seed", "5", "--algo", "dqn"], &["algo = \"ha-diiqn\"", "algo = \"dqn\""]);
    refused(&["--seed", "5", "--episodes", "20"], &["run is complete", "a higher --episodes or --env-steps"]);

    let more = ["--seed", "5", "--episodes", "35"];
    let longer = place.train("run", &[&base[..], &more, &["--resume"]].concat());
    let straight = place.train("straight", &[&base[..], &more].concat());
    assert_eq!(longer, straight, "as if it had been asked for so many at first");
}

#[test]
fn a_run_goes_on_without_its_configuration() {
    let place = Place::new();
    let straight = place.train("straight", &ARGS);
    let dir = place.run("run");
    let mut run = start(&place.training("run", &ARGS));
    run.wait_for("a checkpoint", || dir.last().exists());
    run.signal(Signal::SIGINT);
    run.finish().code(130);
    let root = place.path("run");
    start(&["train", &root]).finish().refused(&["is a run", &format!("trestle resume {root}")]);
    let config = format!("{root}/config.toml");
    let more = start(&["train", &config, "--env-steps", "900", "--quiet", "--out", &place.path("other")]);
    assert!(more.finish().ok().stderr.contains(&format!("`trestle resume {root}` goes on")));
    start(&["resume", &root, "--quiet", "--set", "learner.lr=0.5"]).finish().refused(&["lr = 0.5"]);
    start(&["resume", &format!("{root}/last"), "--quiet"]).finish().ok();
    assert_eq!(Trace::of(&dir), straight);
    let commands = fs::read_to_string(dir.command()).unwrap();
    let lines: Vec<&str> = commands.lines().collect();
    assert!(lines.len() == 2 && lines[0].contains(" train ") && lines[1].contains(" resume "), "{commands}");
}

/// Where nothing is saved, going on is beginning: for a command that says what to begin. The other one says so.
#[test]
fn where_nothing_is_saved_a_run_begins() {
    let place = Place::new();
    let straight = place.train("straight", &ARGS);
    for name in ["empty", "half", "given-up"] {
        fs::create_dir(place.path(name)).unwrap();
    }
    place.write("half/config.toml", "");
    fs::copy(place.run("straight").plan(), place.run("given-up").plan()).unwrap();
    for name in ["absent", "empty", "half", "given-up"] {
        let root = place.path(name);
        let begin = format!("`trestle train CONFIG --resume --out {root}`, which begins one there");
        start(&["resume", &root]).finish().refused(&["holds no run to go on with", &begin]);
        let said = start(&place.training(name, &[&ARGS[..], &["--resume"]].concat())).finish().ok();
        assert!(
            said.stderr.contains(&format!("note: nothing is saved in {root}: the run begins")),
            "{said:?}"
        );
        assert_eq!(Trace::of(&place.run(name)), straight, "{name}");
    }
}

#[test]
fn a_sweep_or_a_torn_configuration_is_named() {
    let place = Place::new();
    fs::create_dir(place.path("sweep")).unwrap();
    place.write("sweep/sweep.json", "{}");
    let root = place.path("sweep");
    let next = format!("`trestle sweep --resume --out {root}`");
    start(&["resume", &root]).finish().refused(&["holds a sweep and not one run", &next]);
    place.train("run", &ARGS);
    let path = place.path("run/config.toml");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.split("[env]").next().unwrap()).unwrap();
    start(&["resume", &place.path("run"), "--episodes", "30"]).finish().refused(&[
        "--resume: a run with the settings in",
        &path,
        "env.map_text is missing",
    ]);
}

#[test]
fn a_run_that_stopped_when_solved_goes_on_only_if_told_to() {
    let place = Place::new();
    let args = [&ARGS[..], &["--set", "eval.threshold=-4000"]].concat();
    let straight = place.train("straight", &args);
    let stopping = [&args[..], &["--set", "run.stop_when_solved=true"]].concat();
    let stopped = place.train("run", &stopping);
    assert!(stopped.result.env_steps < straight.result.env_steps);
    let again = place.training("run", &[&stopping[..], &["--resume"]].concat());
    start(&again).finish().refused(&["is complete", "run.stop_when_solved=false"]);
    assert_eq!(resumed(&place, "run", &args), straight);
}

#[test]
fn a_damaged_checkpoint_is_passed_over() {
    let place = Place::new();
    let undisturbed = place.train("undisturbed", &ARGS);
    let dir = place.run("run");
    let mut run = start(&place.training("run", &ARGS));
    let complete = |tick: u64| checkpoint::directory(dir.root(), tick.into()).join("COMPLETE").exists();
    // The checkpoint of 6000 environment steps and that of 12000, in ticks of 32.
    run.wait_for("two checkpoints", || complete(6_000_u64.div_ceil(32)) && complete(12_000_u64.div_ceil(32)));
    run.signal(Signal::SIGINT);
    run.finish().code(130);
    let newest = newest_checkpoint(&dir).unwrap();
    let model = fs::canonicalize(dir.last()).unwrap().join("model.safetensors");
    let mut bytes = fs::read(&model).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&model, bytes).unwrap();
    assert!(newest_checkpoint(&dir).unwrap() < newest);
    assert_eq!(resumed(&place, "run", &ARGS), undisturbed);
}
