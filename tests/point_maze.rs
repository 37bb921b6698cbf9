//! The Point Maze through the real program: as deterministic, resumable and documented as the maze.

use crate::util::{Place, Trace, start, trestle};
use serde_json::Value;
use std::fs;

/// A small network, so that a few thousand steps take a second.
const SMALL: [&str; 9] = [
    "point-umaze",
    "--set",
    "learner.hidden=[16]",
    "--set",
    "learner.batch=16",
    "--set",
    "learner.warmup=320",
    "--set",
    "env.step_limit=1600",
];

fn with<'a>(more: &[&'a str]) -> Vec<&'a str> {
    [&SMALL, more].concat()
}

#[test]
fn lockstep_is_the_single_process_loop_and_a_resumed_run_an_undisturbed_one() {
    let place = Place::new();
    let args = with(&["--set", "env.backend=builtin", "--env-steps", "6400"]);
    let whole = place.train("whole", &args);
    assert!(whole.result.grad_steps > 1000, "{:?}", whole.result);
    assert_eq!(place.train("reference", &[&args[..], &["--mode", "reference"]].concat()), whole);

    let part = with(&["--set", "env.backend=builtin", "--env-steps", "3200"]);
    place.train("part", &part);
    start(&place.training("part", &[&args[..], &["--resume"]].concat())).finish().ok();
    assert_eq!(Trace::of(&place.run("part")).weights_sha256, whole.weights_sha256);
}

#[test]
fn what_computes_the_physics_is_decided_once_and_recorded() {
    let place = Place::new();
    let args = with(&["--env-steps", "3200"]);
    place.train("run", &args);
    let dir = place.run("run");
    let build: Value = serde_json::from_slice(&fs::read(dir.build()).unwrap()).unwrap();
    let backend = build["physics"]["backend"].as_str().unwrap();
    assert!(["builtin", "mujoco"].contains(&backend), "{build}");
    assert_eq!(build["physics"]["version"].is_string(), backend == "mujoco");
    assert_eq!(build["physics"]["contact_margin"], 0.002);
    let config = fs::read_to_string(dir.config()).unwrap();
    assert!(config.contains(&format!("backend = \"{backend}\"")), "{config}");
    // `auto` goes on with what the run has.
    start(&place.training("run", &with(&["--env-steps", "4800", "--resume"]))).finish().ok();

    let eval = trestle(&["eval", dir.root().to_str().unwrap()]).ok();
    assert!(
        eval.stdout.contains("point-maze umaze") && eval.stdout.contains("##############################")
    );
}

#[test]
fn a_planned_mentor_reaches_the_goal_below_the_threshold() {
    let place = Place::new();
    for (preset, most) in [("point-umaze", 60), ("point-maze", 110)] {
        let out = place.path(&format!("{preset}.csv"));
        trestle(&["demo", "plan", preset, "--out", &out]).ok();
        let states = fs::read_to_string(&out).unwrap().lines().count();
        assert!((40..most).contains(&states), "{preset}: {states}");
        trestle(&["demo", "inspect", &out, "--config", preset]).ok();
    }
}

#[test]
fn mistakes_are_refused_before_anything_starts() {
    let place = Place::new();
    let refused = |sets: &[&str], words: &[&str]| {
        let sets = sets.iter().flat_map(|set| ["--set", set]).collect::<Vec<_>>();
        start(&place.training("no", &[&["point-umaze"], &sets[..]].concat())).finish().refused(words);
        assert!(!place.run("no").root().exists());
    };
    refused(&["env.step_limit=120", "eval.threshold=-0.12"], &["eval.threshold = -0.12", "above -0.120"]);
    refused(&["env.encoding=one-hot"], &["env.encoding = one-hot", "coordinates"]);
    refused(&["env.actions=irregular"], &["env.actions = irregular", "orthogonal, diagonal"]);
    refused(&["env.frame_skip=0"], &["env.frame_skip = 0", "1 to 100"]);
    refused(&["env.point-maze.frame_skip=0"], &["env.frame_skip = 0", "1 to 100"]);
    refused(&["env.point_maze.frame_skip=2"], &["env.point_maze", "did you mean `env.point-maze`?"]);
}

#[test]
fn the_doctor_says_what_computes_the_physics() {
    let output = trestle(&["doctor"]);
    let line = output.stdout.lines().find(|line| line.contains("Point Maze: ")).unwrap();
    assert!(line.starts_with("ok  "), "{line}");
    assert!(line.contains("MuJoCo") || line.contains("deploy/fetch-mujoco.sh"), "{line}");
}
