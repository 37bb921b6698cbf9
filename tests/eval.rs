//! `trestle eval` and what a run says of its mentor.

use crate::util::{Place, result, trestle};
use serde_json::Value;
use std::fs;
use trestle_learner::checkpoint;

const ARGS: [&str; 9] = [
    "maze-small",
    "--env-steps",
    "4000",
    "--seed",
    "7",
    "--set",
    "checkpoint.every_env_steps=1000",
    "--set",
    "checkpoint.keep=4",
];

fn object(args: &[&str]) -> Value {
    let printed = trestle(&[&["eval"], args, &["--json"]].concat()).ok();
    assert_eq!((printed.stdout.lines().count(), printed.stderr.as_str()), (1, ""));
    serde_json::from_str(&printed.stdout).unwrap()
}

#[test]
fn a_checkpoint_is_played_and_told_of_as_json() {
    let place = Place::new();
    place.train("run", &ARGS);
    let root = place.path("run");
    let newest = object(&[&root]);
    let keys: Vec<&String> = newest.as_object().unwrap().keys().collect();
    let mut documented =
        ["run", "checkpoint", "episodes", "mean_return", "mean_steps", "success_rate", "threshold"];
    documented.sort_unstable();
    assert_eq!(keys, documented);
    let ticks: Vec<u64> =
        checkpoint::complete(place.run("run").root()).unwrap().into_iter().map(u64::from).collect();
    // The one that the run ended with may come on top.
    assert!((4..=5).contains(&ticks.len()), "{ticks:?}");
    let first = ticks[ticks.len() - 1];
    assert_eq!((&newest["run"], &newest["checkpoint"]), (&root.clone().into(), &ticks[0].into()));
    assert_eq!((&newest["episodes"], &newest["threshold"]), (&10.into(), &(-0.36).into()));
    assert!(newest["mean_return"].is_f64() && newest["success_rate"].is_f64(), "{newest}");

    assert_eq!(object(&[&root, "--checkpoint", "last", "--seed", "7"]), newest);
    let oldest = object(&[&root, "--checkpoint", &first.to_string(), "--episodes", "2"]);
    assert_eq!((&oldest["checkpoint"], &oldest["episodes"]), (&first.into(), &2.into()));
    assert_eq!(oldest["success_rate"], 0.0, "after 1000 steps it has learnt little");
    let near = (ticks[2] + 1).to_string();
    let all: Vec<String> = ticks.iter().rev().map(u64::to_string).collect();
    let accepted = format!("accepted: last, best, {}", all.join(", "));
    trestle(&["eval", &root, "--checkpoint", &near]).refused(&["--checkpoint", &near, &accepted]);

    // Fewer checkpoints are kept from a resumption on.
    let longer =
        ["maze-small", "--env-steps", "6400", "--set", "checkpoint.every_env_steps=1000", "--seed", "7"];
    place.train("run", &[&longer[..], &["--set", "checkpoint.keep=1", "--resume"]].concat());
    assert!(checkpoint::complete(place.run("run").root()).unwrap().len() <= 2);
}

#[test]
fn a_seed_makes_other_episodes() {
    let place = Place::new();
    let reset = ["--set", "env.point-maze.reset=random", "--set", "env.point-maze.backend=builtin"];
    let length = ["point-umaze", "--algo", "dqn", "--env-steps", "300"];
    place.train("run", &[&length[..], &reset].concat());
    let root = place.path("run");
    let play = |more: &[&str]| trestle(&[&["eval", root.as_str()], more].concat()).ok().stdout;
    assert_eq!(play(&[]), play(&["--seed", "0"]));
    // The ball begins elsewhere, which the drawing shows.
    assert_ne!(play(&["--seed", "1"]), play(&["--seed", "2"]));
}

/// The states of the mentor's path are whole, but no observer of a ball in a maze comes near them by a millionth.
#[test]
fn a_mentor_without_effect_is_told_of() {
    let place = Place::new();
    let sets = [
        "--set",
        "run.algo=ha-diiqn",
        "--set",
        "mentor.e_th=1e-12",
        "--set",
        "mentor.e_infeas=1e-12",
        "--set",
        "env.point-maze.backend=builtin",
    ];
    let checked = trestle(&[&["config", "check", "point-umaze"], &sets[..]].concat()).ok();
    assert!(checked.stdout.contains("mentor.e_th = 0.000000000001 is next to nothing"), "{checked:?}");
    let out = place.path("runs/none");
    let length = ["--env-steps", "3000", "--out", &out];
    let trained = trestle(&[&["train", "point-umaze", "--quiet"], &sets[..], &length].concat()).ok();
    assert!(trained.stderr.contains("warning: mentor.e_infeas = 0.000000000001 is"), "{trained:?}");
    let said = "the mentor had next to no effect (0.0 % of its transitions feasible, 0.0 % bridged, its loss in 0.0 %";
    assert!(trained.stdout.contains(said), "{trained:?}");
    let written = result(&place.run("runs/none"));
    assert_eq!(
        (written.mentor_feasible_frac, written.mentor_bridged_frac, written.mentor_loss_frac),
        (Some(0.0), Some(0.0), Some(0.0))
    );
    let reported = trestle(&["report", &place.path("runs")]).ok();
    assert!(reported.stderr.contains(said), "{reported:?}");
    assert!(fs::read_to_string(place.path("runs/report/report.html")).unwrap().contains(said));
    let json: Value =
        serde_json::from_slice(&fs::read(place.path("runs/report/report.json")).unwrap()).unwrap();
    assert_eq!(json["arms"][0]["mentor"]["loss_frac"], 0.0);

    // One that has an effect is no reason for a warning, and without one there is nothing to say.
    let trained = trestle(
        &[&["train", "maze-small", "--algo", "ha-diiqn", "--out", &place.path("some")], &ARGS[1..5]].concat(),
    )
    .ok();
    assert!(trained.stdout.contains("  mentor   ") && !trained.stdout.contains("no effect"), "{trained:?}");
    place.train("dqn", &["maze-small", "--algo", "dqn", "--env-steps", "1000"]);
    assert_eq!(result(&place.run("dqn")).mentor_loss_frac, None);
}
