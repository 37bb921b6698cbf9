//! Rivals as arms: each learns something of its own, the same in every mode, and goes on where it was left.

use crate::util::{Place, start};

/// What each is called in results, and its settings.
const ARMS: [(&str, &[&str]); 7] = [
    ("dqn+optimal-transport", &["--algo", "dqn", "--set", "rival.kind=optimal-transport"]),
    ("dqn+resets", &["--algo", "dqn", "--set", "rival.kind=resets", "--set", "rival.resets.episodes=1"]),
    (
        "diiqn+labels",
        &["--algo", "diiqn", "--set", "rival.kind=inverse-dynamics", "--set", "rival.inverse.every=100"],
    ),
    (
        "ha-diiqn+guided+labels",
        &[
            "--algo",
            "ha-diiqn",
            "--set",
            "rival.kind=inverse-dynamics",
            "--set",
            "rival.inverse.every=300",
            "--set",
            "exploration.guide_start=0.5",
        ],
    ),
    ("dqn+d-shape", &["--algo", "dqn", "--set", "rival.kind=d-shape", "--set", "learner.n_step=3"]),
    (
        "dqn+gaifo",
        &[
            "--algo",
            "dqn",
            "--set",
            "rival.kind=gaifo",
            "--set",
            "rival.gaifo.batch=16",
            "--set",
            "learner.n_step=2",
        ],
    ),
    ("trestle+gaifo", &["--algo", "trestle", "--set", "rival.kind=gaifo", "--set", "rival.gaifo.batch=16"]),
];

/// The replay goes round, and several episodes end in either half.
const ARGS: [&str; 5] = ["maze-small", "--seed", "6", "--set", "learner.replay=1500"];

#[test]
fn every_mode_learns_the_same_and_a_run_goes_on_where_it_was_left() {
    for (name, sets) in ARMS {
        let place = Place::new();
        let base = [&ARGS[..], sets].concat();
        let long = [&base[..], &["--env-steps", "4000"]].concat();
        let straight = place.train("straight", &long);
        assert_eq!(straight.result.algo, name);
        assert_eq!(
            place.train("reference", &[&long[..], &["--mode", "reference"]].concat()),
            straight,
            "{name}"
        );

        place.train("halves", &[&base[..], &["--env-steps", "2200"]].concat());
        assert_eq!(place.train("halves", &[&long[..], &["--resume"]].concat()), straight, "{name}");

        let free = ["--mode", "free", "--set", "run.ahead=32"];
        let free = place.train("free", &[&long[..], &free].concat());
        assert_eq!(free.weights_sha256, straight.weights_sha256, "{name}");
    }
}

#[test]
fn several_actors_and_a_lag_are_no_matter() {
    for (name, sets) in ARMS {
        let place = Place::new();
        let more = ["--env-steps", "2500", "--actors", "3", "--set", "run.lag=1", "--set", "run.rollout=7"];
        let args = [&ARGS[..], sets, &more].concat();
        let lockstep = place.train("lockstep", &args);
        let reference = place.train("reference", &[&args[..], &["--mode", "reference"]].concat());
        assert_eq!(lockstep, reference, "{name}");
    }
}

#[test]
fn each_differs_from_what_it_is_added_to() {
    // In a maze a feasible transition's label is the action that a_est is as well.
    for (name, sets) in ARMS.iter().filter(|(name, _)| !name.starts_with("ha-")) {
        let place = Place::new();
        let args = [&ARGS[..], sets, &["--env-steps", "3000"]].concat();
        let plain = [&args[..], &["--set", "rival.kind=none"]].concat();
        let weights =
            [("with", &args), ("without", &plain)].map(|(name, args)| place.train(name, args).weights_sha256);
        assert_ne!(weights[0], weights[1], "{name}");
    }
}

#[test]
fn what_makes_no_sense_is_refused_before_anything_is_written() {
    let place = Place::new();
    let refused = |sets: &[&str], words: &[&str]| {
        start(&place.training("run", &[&["maze-small", "--env-steps", "9"], sets].concat()))
            .finish()
            .refused(words);
        assert!(!place.root().join("run").exists());
    };
    let kind = |kind: &'static str| ["--set", kind];
    let gaifo = kind("rival.kind=gaifo");
    refused(&[&["--algo", "ha-diiqn"][..], &gaifo].concat(), &["run.algo = ha-diiqn", "dqn or trestle"]);
    let labels = kind("rival.kind=inverse-dynamics");
    refused(&[&["--algo", "dqn"][..], &labels].concat(), &["run.algo = dqn", "diiqn or ha-diiqn"]);
    let resets = kind("rival.kind=resets");
    refused(&[&["--algo", "trestle"][..], &resets].concat(), &["run.algo = trestle", "dqn without a guide"]);
    let shaped = ["--algo", "dqn", "--set", "shaping.potential=2"];
    refused(&[&shaped[..], &gaifo].concat(), &["shaping.potential = 2", "0 with rival.kind = gaifo"]);
    let long = ["--algo", "dqn", "--set", "env.step_limit=4000000", "--set", "rival.kind=optimal-transport"];
    refused(&long, &["env.step_limit", "accepted: up to 8388608"]);
}
