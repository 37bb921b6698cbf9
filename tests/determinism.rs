//! A run's outcome is a function of its configuration and its seed.

use crate::util::{Place, Trace, assert_gone, available, metrics, start, start_under};
use serde_json::Value;
use std::fs;
use trestle_qnet::Isa;

const ARGS: [&str; 5] = ["maze-small", "--env-steps", "10000", "--seed", "11"];

fn with<'a>(more: &[&'a str]) -> Vec<&'a str> {
    [&ARGS, more].concat()
}

/// The first processor that this process may use.
fn first_processor() -> String {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let list = status.lines().find_map(|line| line.strip_prefix("Cpus_allowed_list:")).unwrap();
    list.trim().split([',', '-']).next().unwrap().into()
}

/// Two runs, a pinned one and the single-process loop agree; returns what they agree on.
fn agree(more: &[&str]) -> Trace {
    let place = Place::new();
    let args = with(more);
    let first = place.train("first", &args);
    assert!(first.result.grad_steps > 1000 && first.evals.len() > 2, "{:?}", first.result);
    assert_eq!(place.train("second", &args), first);
    assert_eq!(place.train("reference", &[&args[..], &["--mode", "reference"]].concat()), first);
    let processor = first_processor();
    if available(&["taskset", "-c", &processor, "true"]) {
        let pinned = place.training("pinned", &args);
        start_under(&["taskset", "-c", &processor], &pinned).finish().ok();
        assert_gone(&place.run("pinned"));
        assert_eq!(Trace::of(&place.run("pinned")), first);
    }
    first
}

#[test]
fn one_actor() {
    let seed_11 = agree(&[]);
    let place = Place::new();
    let seed_12 = place.train("other", &["maze-small", "--env-steps", "10000", "--seed", "12"]);
    assert_ne!(seed_12.weights_sha256, seed_11.weights_sha256);
    assert_ne!(seed_12.episodes, seed_11.episodes);
}

#[test]
fn every_instruction_set() {
    let place = Place::new();
    let args = ["maze-small", "--env-steps", "1500", "--seed", "5"];
    let auto = place.train("auto", &args);
    assert!(auto.result.grad_steps > 500, "{:?}", auto.result);
    for isa in Isa::ALL {
        let (name, set) = (isa.to_string(), format!("run.isa={isa}"));
        let forced = [&args[..], &["--set", &set]].concat();
        if isa.is_available() {
            assert_eq!(place.train(&name, &forced), auto, "{isa}");
        } else {
            start(&place.training(&name, &forced)).finish().refused(&["run.isa", &name, "auto", "scalar"]);
            assert!(!place.root().join(&name).exists());
        }
    }
}

#[test]
fn two_actors() {
    let two = agree(&["--actors", "2"]);
    assert_ne!(two.weights_sha256, Place::new().train("one", &ARGS).weights_sha256);
}

#[test]
fn one_actor_with_lag() {
    let lag = agree(&["--set", "run.lag=1"]);
    assert_ne!(lag.weights_sha256, Place::new().train("none", &ARGS).weights_sha256);
}

#[test]
fn guided_exploration() {
    let guided = ["--set", "exploration.guide_start=0.8", "--actors", "2"];
    let newest = agree(&guided);
    assert_eq!(newest.result.algo, "ha-diiqn+guided");
    assert_ne!(newest.weights_sha256, Place::new().train("none", &with(&guided[2..])).weights_sha256);
    let older = agree(&[&guided[..], &["--set", "run.lag=1"]].concat());
    assert_ne!(newest.weights_sha256, older.weights_sha256);
}

#[test]
fn whole_bridges() {
    let guided = ["--set", "exploration.guide_start=0.8", "--actors", "3", "--set", "run.rollout=7"];
    let whole = [&guided[..], &["--set", "exploration.guide_whole=true"]].concat();
    let newest = agree(&whole);
    assert_eq!(newest.result.algo, "ha-diiqn+guided+whole-bridges");
    assert_ne!(newest.weights_sha256, Place::new().train("first-steps", &with(&guided)).weights_sha256);
    let older = agree(&[&whole[..], &["--set", "run.lag=1"]].concat());
    assert_ne!(newest.weights_sha256, older.weights_sha256);
}

#[test]
fn learned_bridges() {
    let trestle = ["--algo", "trestle", "--actors", "3", "--set", "run.rollout=7"];
    let newest = agree(&trestle);
    assert_eq!(newest.result.algo, "trestle");
    let plain = [&["--algo", "dqn"], &trestle[2..]].concat();
    assert_ne!(newest.weights_sha256, Place::new().train("dqn", &with(&plain)).weights_sha256);
    let older = agree(&[&trestle[..], &["--set", "run.lag=1"]].concat());
    assert_ne!(newest.weights_sha256, older.weights_sha256);
}

#[test]
fn what_learned_bridges_do_is_recorded() {
    let place = Place::new();
    let rows = |name: &str, algo| {
        place.train(name, &with(&["--algo", algo]));
        metrics(&place.run(name))
    };
    let of = |rows: &[Value], key: &str| -> Vec<f64> {
        rows.iter().filter_map(|row| row.get(key)?.as_f64()).collect()
    };
    let trestle = rows("trestle", "trestle");
    for key in ["guide/steps_frac", "guide/progress_mean"] {
        let values = of(&trestle, key);
        assert!(!values.is_empty() && values.iter().all(|x| (0.0..=1.0).contains(x)), "{key}: {values:?}");
    }
    let [guided, stuck] = ["guided", "stuck"].map(|kind| of(&trestle, &format!("guide/{kind}_episodes")));
    assert!(guided.last() > Some(&0.0) && stuck.last() <= guided.last(), "{guided:?} {stuck:?}");
    // Below that of a policy which knows nothing: that is the logarithm of the number of actions.
    assert!(of(&trestle, "guide/loss").iter().any(|loss| *loss < 4f64.ln()), "{trestle:?}");
    assert!(!of(&trestle, "guide/return").is_empty());
    let plain = rows("dqn", "dqn");
    assert!(plain.iter().all(|row| row.as_object().unwrap().keys().all(|key| !key.starts_with("guide/"))));
}

#[test]
fn three_actors_with_lag() {
    agree(&["--actors", "3", "--set", "run.lag=1", "--set", "run.rollout=7"]);
}

#[test]
fn stopping_when_solved() {
    let place = Place::new();
    for (i, more) in [&[] as &[&str], &["--set", "run.lag=1", "--actors", "2"]].into_iter().enumerate() {
        let easy = ["--set", "run.stop_when_solved=true", "--set", "eval.threshold=-4000"];
        let args = [&ARGS[..], &easy, more].concat();
        let lockstep = place.train(&format!("lockstep-{i}"), &args);
        let reference =
            place.train(&format!("reference-{i}"), &[&args[..], &["--mode", "reference"]].concat());
        assert_eq!(lockstep, reference, "{more:?}");
        assert_eq!(lockstep.evals.len(), 1 + 3, "the header and three evaluations");
        assert!(lockstep.result.env_steps < 10_000 && !lockstep.result.interrupted);
    }
}

#[test]
fn plain_learning_the_paper_variants_and_ours() {
    let place = Place::new();
    let variants: [&[&str]; 11] = [
        &["--algo", "dqn"],
        &["--algo", "diiqn", "--actors", "2"],
        &["--set", "mentor.selection=confidence", "--set", "learner.target=hard"],
        &[
            "--set",
            "env.encoding=one-hot",
            "--set",
            "mentor.reward=observer",
            "--set",
            "learner.backend=candle",
        ],
        &["--set", "mentor.combine=beside", "--set", "mentor.one_sided=true", "--actors", "2"],
        &["--set", "mentor.selection=always", "--set", "mentor.draw=uniform", "--set", "run.lag=1"],
        &["--algo", "dqn", "--set", "shaping.potential=2"],
        &[
            "--actors",
            "3",
            "--set",
            "learner.n_step=5",
            "--set",
            "run.rollout=7",
            "--set",
            "learner.replay=1000",
        ],
        &["--algo", "dqn", "--set", "learner.n_step=3", "--set", "shaping.potential=2"],
        &[
            "--algo",
            "dqn",
            "--set",
            "exploration.guide=learned",
            "--set",
            "exploration.guide_end=0.5",
            "--set",
            "mentor.learned.idle=7",
            "--set",
            "mentor.learned.gate=false",
        ],
        &["--algo", "trestle", "--set", "env.encoding=one-hot", "--set", "learner.n_step=5"],
    ];
    for (i, variant) in variants.iter().enumerate() {
        let args = [&["maze-small", "--env-steps", "4000", "--seed", "2"], *variant].concat();
        let lockstep = place.train(&format!("lockstep-{i}"), &args);
        let reference =
            place.train(&format!("reference-{i}"), &[&args[..], &["--mode", "reference"]].concat());
        assert_eq!(lockstep, reference, "{variant:?}");
    }
}
