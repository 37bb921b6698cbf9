//! Sweeps: all runs come to their ends, each as if it were alone, through interruptions and failures.

use crate::util::{LIMIT, Place, Trace, start, wait_until};
use nix::sys::signal::Signal;
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Arguments of a sweep over two algorithms and two seeds into `out`, up to `limit`.
fn sweep(out: &str, limit: [&str; 2], more: &[&str]) -> Vec<String> {
    let own = ["sweep", "maze-small", "--algos", "dqn,ha-diiqn", "--seeds", "3..5", "--out", out];
    own.iter().chain(&limit).chain(more).map(ToString::to_string).collect()
}

/// A few seconds' training at most.
const SHORT: [&str; 2] = ["--episodes", "12"];
/// Less than that.
const QUICK: [&str; 2] = ["--env-steps", "700"];

#[test]
fn every_run_is_as_if_it_were_alone() {
    let place = Place::new();
    let out = place.path("s");
    let text = start(&sweep(&out, SHORT, &["--jobs", "2"])).finish().ok();
    assert!(text.stdout.contains("dqn") && text.stdout.contains("2/2"), "{}", text.stdout);
    assert!(text.stdout.contains(&format!("next: trestle report {out}")), "{}", text.stdout);
    assert!(text.stderr.contains("4 of 4 runs are to do, 2 at once"), "{}", text.stderr);
    assert!(text.stderr.contains("at most "), "{}", text.stderr);
    let alone =
        place.train("alone", &["maze-small", "--algo", "ha-diiqn", "--seed", "4", "--episodes", "12"]);
    assert_eq!(Trace::of(&place.run("s/ha-diiqn/seed-4")), alone);
    assert_eq!(hidden(Path::new(&out)), Vec::<String>::new());

    // A sweep that is complete has nothing left to do, and can grow.
    let again = start(&sweep(&out, SHORT, &["--resume", "--quiet"])).finish().ok();
    assert!(again.stdout.contains("2/2") && again.stderr.is_empty(), "{} {}", again.stdout, again.stderr);
    let wider: Vec<String> =
        sweep(&out, SHORT, &["--resume"]).iter().map(|s| s.replace("3..5", "3..6")).collect();
    let more = start(&wider).finish().ok();
    assert!(
        more.stderr.contains("2 of 6 runs are to do") && more.stderr.contains("about "),
        "{}",
        more.stderr
    );
    start(&sweep(&out, SHORT, &["--resume", "--arm", "slow:algo=dqn,learner.lr=1e-5"])).finish().ok();
    assert!(place.run("s/slow/seed-3").result().is_file());
}

/// What is hidden in `dir`.
fn hidden(dir: &Path) -> Vec<String> {
    let names = fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    names.filter(|name| name.starts_with('.')).collect()
}

#[test]
fn an_interrupted_sweep_goes_on_and_comes_to_the_same() {
    let place = Place::new();
    let limit = ["--env-steps", "10000"];
    let often = ["--set", "checkpoint.every_env_steps=1000"];
    let more = [&often[..], &["--jobs", "2", "--quiet"]].concat();
    let out = place.path("s");
    let process = start(&sweep(&out, limit, &more));
    let began = |run: &str| place.run(run).last().exists();
    assert!(wait_until(LIMIT, || began("s/dqn/seed-3") && began("s/ha-diiqn/seed-3")));
    process.signal(Signal::SIGINT);
    let ended = process.finish();
    assert_eq!(ended.status.code(), Some(130), "{}", ended.stderr);
    assert!(
        ended.stderr.contains(&format!("`trestle sweep --resume --out {out}` goes on")),
        "{}",
        ended.stderr
    );
    // Without its configuration again.
    let again = start(&["sweep", "--resume", "--out", &out]).finish().ok();
    assert!(again.stderr.contains("dqn seed 3  going on from episode "), "{}", again.stderr);
    let train = ["maze-small", "--algo", "dqn", "--seed", "3"];
    let alone = place.train("alone", &[&train[..], &limit, &often].concat());
    assert_eq!(Trace::of(&place.run("s/dqn/seed-3")), alone);
}

#[test]
fn a_run_that_fails_leaves_the_others_alone() {
    let place = Place::new();
    let out = place.path("s");
    start(&sweep(&out, QUICK, &["--arm", "x:algo=dqn", "--quiet"])).finish().ok();
    // A directory that holds something else.
    let run = place.run("s/x/seed-3");
    fs::remove_dir_all(run.root()).unwrap();
    fs::create_dir_all(run.root()).unwrap();
    fs::write(run.root().join("notes.txt"), "mine").unwrap();
    let ended = start(&sweep(&out, QUICK, &["--arm", "x:algo=dqn", "--resume"])).finish();
    assert_eq!(ended.status.code(), Some(1));
    assert!(ended.stderr.contains("1 of 6 runs failed"), "{}", ended.stderr);
    assert_eq!(ended.stderr.matches("x seed 3: failed: ").count(), 1, "{}", ended.stderr);
    assert_eq!(fs::read_to_string(run.root().join("notes.txt")).unwrap(), "mine");
}

#[test]
fn what_cannot_be_swept_is_refused_before_anything_is_written() {
    let place = Place::new();
    let out = place.path("s");
    for (args, says) in [
        (&["--seeds", "5..5"][..], "holds no seed"),
        (&["--arm", "a"], "NAME:key=value"),
        (&["--arm", "a:algo=dqn,learner.batch=0"], "learner.batch"),
        (&["--arm", "a:learner.nonsense=1"], "learner.nonsense"),
        (&["--arm", "dqn:algo=dqn"], "two arms are called dqn"),
        (&["--set", "run.mode=reference"], "run.mode = reference"),
        (&["--over", "env.map"], "KEY=VALUE,VALUE"),
        (&["--over", "learner.batch=0"], "learner.batch"),
        (&["--jobs", "0"], "0"),
    ] {
        let args = [&["sweep", "maze-small", "--algos", "dqn", "--out", &out][..], args].concat();
        let seeds = if args.contains(&"--seeds") { vec![] } else { vec!["--seeds", "0..1"] };
        let args: Vec<String> = args.iter().chain(&seeds).map(ToString::to_string).collect();
        let ended = start(&args).finish();
        assert_ne!(ended.status.code(), Some(0));
        assert!(ended.stderr.contains(says), "{says}: {}", ended.stderr);
        assert!(!Path::new(&out).exists(), "{says}");
    }
}

#[test]
fn arms_are_compared_within_each_task_and_over_all() {
    let place = Place::new();
    let out = place.path("s");
    let over = ["--over", "env.map=random:1:7x7,random:2:7x7", "--quiet"];
    start(&sweep(&out, QUICK, &over)).finish().ok();
    for run in ["map-random-1-7x7/dqn/seed-3", "map-random-2-7x7/ha-diiqn/seed-4"] {
        assert!(place.run(&format!("s/{run}")).result().is_file(), "{run}");
    }
    start(&["report".to_string(), out.clone()]).finish().ok();
    let text = fs::read(Path::new(&out).join("report/report.json")).unwrap();
    let json: Value = serde_json::from_slice(&text).unwrap();
    let list = |name: &str, key: &str| -> Vec<Value> {
        json[name].as_array().unwrap().iter().map(|entry| entry[key].clone()).collect()
    };
    assert_eq!(list("arms", "task").len(), 4);
    assert_eq!(list("arms", "arm"), ["dqn", "ha-diiqn", "dqn", "ha-diiqn"]);
    // Four times for either task and for both.
    assert_eq!(list("comparisons", "task").len(), 12);
    assert!(list("comparisons", "task").contains(&Value::Null));
}

#[test]
fn a_report_says_what_the_runs_came_to() {
    let place = Place::new();
    let out = place.path("s");
    start(&sweep(&out, SHORT, &["--quiet"])).finish().ok();
    let report = start(&["report".to_string(), out.clone()]).finish().ok();
    assert!(report.stdout.contains("4 runs, 0 notes"), "{}", report.stdout);
    let dir = Path::new(&out).join("report");
    let json: Value = serde_json::from_slice(&fs::read(dir.join("report.json")).unwrap()).unwrap();
    let arms = json["arms"].as_array().unwrap();
    assert_eq!(arms.iter().map(|arm| arm["arm"].as_str().unwrap()).collect::<Vec<_>>(), ["dqn", "ha-diiqn"]);
    assert!(arms.iter().all(|arm| arm["complete"] == 2 && arm["task"] == "maze maze-small"));
    let results = ["3", "4"].map(|seed| place.run(&format!("s/dqn/seed-{seed}")).result());
    let steps = results.map(|path| {
        let result: Value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
        result["env_steps"].as_u64().unwrap()
    });
    assert_eq!(arms[0]["env_steps"], steps.iter().sum::<u64>());
    assert_eq!(json["comparisons"][0]["arm"], "ha-diiqn");
    let page = fs::read_to_string(dir.join("report.html")).unwrap();
    assert!(page.contains("</html>") && !page.contains("http://www.w3.org/1999") && !page.contains("src="));
    for name in ["evaluation-mean-episodes", "training-iqm-env_steps", "solved-share", "maze-ha-diiqn-paths"]
    {
        for file in [
            format!("pictures/01-maze-maze-small-{name}.svg"),
            format!("pictures/01-maze-maze-small-{name}.png"),
        ] {
            assert!(fs::metadata(dir.join(&file)).is_ok_and(|m| m.len() > 1000), "{file}");
        }
    }
    // The same runs give the same report, and one damaged run spoils no other.
    let before = fs::read(dir.join("report.html")).unwrap();
    start(&["report".to_string(), out.clone()]).finish().ok();
    assert!(fs::read(dir.join("report.html")).unwrap() == before);
    fs::write(place.run("s/dqn/seed-3").result(), "{").unwrap();
    let damaged = start(&["report".to_string(), out.clone()]).finish().ok();
    assert!(damaged.stderr.contains("result.json cannot be read"), "{}", damaged.stderr);
    let nothing = start(&["report".to_string(), place.path("absent")]).finish();
    assert_eq!(nothing.status.code(), Some(1));
}

/// A run that was not solved has no picture of when it was.
#[test]
fn a_report_of_an_unsolved_run_has_no_empty_pictures() {
    let place = Place::new();
    place.train("run", &["maze-small", "--env-steps", "600"]);
    let report = start(&["report".to_string(), place.path("run")]).finish().ok();
    assert!(report.stdout.contains("1 runs, 0 notes"), "{report:?}");
    let page = fs::read_to_string(place.run("run").root().join("report/report.html")).unwrap();
    assert!(page.contains("Trestle: 1 run in") && page.contains("Share of runs solved"), "{page}");
    assert!(!page.contains("Runs solved so far") && !page.contains("Median episodes"), "{page}");
}
