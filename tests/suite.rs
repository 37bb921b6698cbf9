//! The suite: arms on the tasks of a set, each with its own map and mentor, through an interruption to a report.

use crate::util::{LIMIT, Place, start, wait_until};
use nix::sys::signal::Signal;
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Two tasks of a few thousand steps.
const SET: &str = r#"
format = 1
set = ["run.episodes=1000000", "run.stop_when_solved=true", "checkpoint.every_env_steps=1000"]
tasks = [
    { id = "small/rooms", preset = "maze-small", map = "rooms:1:9x8", mentor = "free", env_steps = 6_000 },
    { id = "bad/cave", preset = "maze-small", map = "cave:2:10x10", mentor = "backwards", env_steps = 7_000, set = ["env.encoding=one-hot"] },
]
"#;

fn result(dir: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(dir.join("result.json")).unwrap()).unwrap()
}

#[test]
fn a_suite_is_run_interrupted_resumed_and_reported() {
    let place = Place::new();
    let (set, out) = (place.path("set.toml"), place.path("s"));
    fs::write(&set, SET).unwrap();
    let arms = ["--algos", "dqn,ha-diiqn", "--seeds", "3..5", "--jobs", "2", "--out", &out];
    let sweep = |more: &[&str]| {
        let own = ["sweep", "suite", "--task-set", &set];
        let args = own.iter().chain(&arms).chain(more);
        start(&args.collect::<Vec<_>>())
    };
    let process = sweep(&["--quiet"]);
    let began = |run: &str| place.run(run).last().exists();
    assert!(wait_until(LIMIT, || began("s/small/rooms/dqn/seed-3")));
    process.signal(Signal::SIGINT);
    let ended = process.finish();
    assert_eq!(ended.status.code(), Some(130), "{}", ended.stderr);
    // Without the set again.
    fs::remove_file(&set).unwrap();
    let ended = start(&["sweep", "--resume", "--out", &out]).finish().ok();
    assert!(ended.stdout.contains("small") && ended.stdout.contains("2/2"), "{}", ended.stdout);
    fs::write(&set, SET).unwrap();
    let again = sweep(&["--resume", "--quiet", "--tasks", "bad/*"]).finish().ok();
    assert!(again.stderr.is_empty() && !again.stdout.contains("small"), "{} {}", again.stdout, again.stderr);

    // A task alone, with map and demonstration as files, ends with the same weights.
    let root = Path::new(&out);
    let commands = fs::read_to_string(root.join("tasks.txt")).unwrap();
    assert!(commands.contains("# small/rooms\ntrestle train maze-small"), "{commands}");
    let map = format!("env.map={}", root.join("maps/cave-2-10x10.txt").display());
    let demo = format!("mentor.demo={}", root.join("demonstrations/bad/cave.csv").display());
    let sets = ["run.stop_when_solved=true", "env.encoding=one-hot", &map, &demo];
    let alone = place.path("alone");
    let mut args =
        vec!["train", "maze-small", "--algo", "ha-diiqn", "--seed", "4", "--out", &alone, "--quiet"];
    args.extend(["--env-steps", "7000", "--episodes", "1000000"]);
    sets.iter().for_each(|set| args.extend(["--set", set]));
    start(&args).finish().ok();
    let weights = |dir: &Path| result(dir)["weights_sha256"].clone();
    assert_eq!(weights(Path::new(&alone)), weights(&root.join("bad/cave/ha-diiqn/seed-4")));

    let report = start(&["report", &out]).finish().ok();
    assert!(
        report.stdout.contains("all") && report.stdout.contains("to dqn's on the same task"),
        "{}",
        report.stdout
    );
    let text = fs::read_to_string(root.join("report/report.json")).unwrap();
    let json: Value = serde_json::from_str(&text).unwrap();
    let ratios = json["over_tasks"]["ratios"].as_array().unwrap();
    let tasks: Vec<&str> = ratios.iter().map(|ratio| ratio["task"].as_str().unwrap()).collect();
    assert_eq!(tasks, ["bad/cave", "small/rooms"]);
    assert_eq!((&ratios[0]["group"], &ratios[0]["budget"]), (&Value::from("bad"), &Value::from(7000.0)));
    let totals = json["over_tasks"]["totals"].as_array().unwrap();
    assert_eq!(
        totals.iter().map(|total| total["group"].as_str()).collect::<Vec<_>>(),
        [Some("bad"), Some("small"), None]
    );
    let page = fs::read_to_string(root.join("report/report.html")).unwrap();
    assert!(page.contains("<h3>Losses</h3>") && page.contains("Performance profiles over all tasks"));
    let rows = fs::read_to_string(root.join("report/data/over-tasks-ratios.csv")).unwrap();
    assert_eq!(rows.lines().count(), 3, "{rows}");
}

#[test]
fn what_is_no_suite_is_refused_before_anything_is_written() {
    let place = Place::new();
    let out = place.path("s");
    for (args, says) in [
        (
            &["suite", "--algos", "dqn"][..],
            "--task-set is not given; accepted: choosing, reporting, or a file",
        ),
        (&["suite", "--algos", "dqn", "--task-set", "choosin"], "did you mean `choosing`?"),
        (&["suite", "--task-set", "choosing"], "suite without arms; accepted: --algos"),
        (&["suite", "--algos", "dqn", "--task-set", "choosing", "--tasks", "x*"], "--tasks x* fits no task"),
        (
            &["suite", "--algos", "dqn", "--task-set", "choosing", "--over", "env.map=maze30"],
            "--over with suite",
        ),
        (&["suite", "--algos", "dqn", "--task-set", "choosing", "--set", "learner.batch=0"], "learner.batch"),
        (&["maze30", "--algos", "dqn", "--task-set", "choosing"], "--task-set with maze30"),
    ] {
        let args = [&["sweep"], args, &["--seeds", "0..1", "--out", &out]].concat();
        let ended = start(&args).finish();
        assert_ne!(ended.status.code(), Some(0), "{says}");
        assert!(ended.stderr.contains(says), "{says}: {}", ended.stderr);
        assert!(!Path::new(&out).exists(), "{says}");
    }
}
