//! The program as its users have it: one JSON object a benchmark, with the columns that others rely on. What it measures
//! is not looked at beyond being there: `--quick` figures say nothing.

#![allow(clippy::unwrap_used)]

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

const BENCH: &str = env!("CARGO_BIN_EXE_trestle-bench");

/// Runs the program to its end.
fn bench(args: &[&str]) -> Output {
    let mut command = Command::new(BENCH);
    command.args(args);
    // Tests of all members build `trestle` beside it, and other tests use it meanwhile: then it is not built again.
    if Path::new(BENCH).with_file_name("trestle").exists() {
        command.env_remove("CARGO");
    }
    command.output().unwrap()
}

/// The standard output of a benchmark that works.
fn measured(args: &[&str]) -> String {
    let output = bench(args);
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout).unwrap()
}

/// The rows of a benchmark, each of which has all of `numbers` above 0.
fn rows(name: &str, numbers: &[&str]) -> Vec<Value> {
    let report: Value = serde_json::from_str(&measured(&[name, "--json", "--quick"])).unwrap();
    let mut keys: Vec<&String> = report.as_object().unwrap().keys().collect();
    keys.sort();
    assert_eq!(keys, ["machine", "name", "rows"], "{report}");
    assert_eq!(report["name"], name);
    assert!(report["machine"]["cores"].as_u64().unwrap() > 0, "{report}");
    let rows = report["rows"].as_array().unwrap().clone();
    assert!(!rows.is_empty(), "{report}");
    for row in &rows {
        for key in numbers {
            assert!(row[key].as_f64().unwrap() > 0.0, "{key} of {row}");
        }
    }
    rows
}

/// How many different values the rows have under `key`.
fn distinct(rows: &[Value], key: &str) -> usize {
    let mut values: Vec<String> = rows.iter().map(|row| row[key].to_string()).collect();
    values.sort();
    values.dedup();
    values.len()
}

#[test]
fn a_gradient_step_beside_its_limit() {
    let rows = rows("step", &["batch", "us", "limit_us"]);
    let found = |hidden: [u64; 2], batch: u64| {
        rows.iter().any(|row| {
            row["hidden"] == serde_json::json!(hidden) && row["batch"] == batch && row["isa"] == "scalar"
        })
    };
    for (hidden, batch) in [([64, 64], 32), ([128, 128], 64), ([256, 256], 128)] {
        assert!(found(hidden, batch), "{hidden:?} {batch}: {rows:?}");
    }
    let isas = trestle_qnet::Isa::available().count();
    assert_eq!(distinct(&rows, "isa"), isas, "{rows:?}");
}

#[test]
fn threads_beside_one() {
    let rows = rows("threads", &["batch", "us", "gain", "threads"]);
    assert!(rows.iter().all(|row| row["threads"] != 1 || row["gain"] == 1.0), "{rows:?}");
}

#[test]
fn functions() {
    let infer = rows("infer", &["us"]);
    assert!(infer.iter().all(|row| row["hidden"].is_array() && row["isa"].is_string()), "{infer:?}");
    let replay = rows("replay", &["dim", "stored", "ns"]);
    assert_eq!(distinct(&replay, "op"), 2, "{replay:?}");
    let mentor = rows("mentor", &["dim", "mentor", "ns"]);
    for row in &mentor {
        assert!(["similar", "infer", "bridge"].iter().any(|op| row["op"] == *op), "{row}");
        assert!(row["stored"].is_u64(), "{row}");
        let naive = &row["naive_ns"];
        assert!(naive.is_null() || naive.as_f64().unwrap() > 0.0, "{row}");
    }
    assert_eq!(distinct(&mentor, "op"), 3, "{mentor:?}");
}

#[test]
fn slopes() {
    let rows = rows("slopes", &["size", "us"]);
    assert_eq!((distinct(&rows, "quantity"), distinct(&rows, "cost")), (6, 5), "{rows:?}");
    for row in &rows {
        assert_eq!(row["slope"].is_null(), row["expected"].is_null(), "{row}");
    }
    // The first of each has none before it.
    assert_eq!(rows.iter().filter(|row| row["slope"].is_null()).count(), 7, "{rows:?}");
}

#[test]
fn messages() {
    let tick = rows("tick", &["actors", "rollout", "us", "socket_us", "sleeps", "socket_sleeps"]);
    assert!(distinct(&tick, "actors") > 1 && distinct(&tick, "rollout") > 1, "{tick:?}");
    // Each number of actors and each rollout in both placements.
    assert_eq!(tick.len(), 2 * distinct(&tick, "actors") * distinct(&tick, "rollout"), "{tick:?}");
    for placement in ["one processor", "scheduler"] {
        let rows = tick.iter().filter(|row| row["placement"] == placement).count();
        assert_eq!(2 * rows, tick.len(), "{placement}: {tick:?}");
    }
    let free = rows("free", &["actors", "rollout", "us_a_batch", "batches_a_round", "sleeps_a_batch"]);
    assert_eq!(distinct(&free, "actors"), 5, "{free:?}");
    rows("message", &["batch", "ns", "socket_ns"]);
    // The difference of two medians of few samples may well be negative.
    let weights = rows("weights", &["subscribers", "tick_us", "socket_tick_us"]);
    assert!(weights.iter().all(|row| row["us"].is_f64() && row["socket_us"].is_f64()), "{weights:?}");
}

#[test]
fn what_processes_take() {
    let idle = rows("idle", &[]);
    assert!(idle.iter().all(|row| row["cpu_percent"].as_f64().unwrap() >= 0.0), "{idle:?}");
    assert_eq!(distinct(&idle, "role"), 2, "{idle:?}");
    // Supervisor, learner and actor; with a mentor one more.
    let memory = rows("memory", &["replay", "peak_mb", "replay_bytes_each"]);
    let processes: Vec<_> = memory.iter().map(|row| row["processes"].as_u64().unwrap()).collect();
    assert_eq!(processes, [3, 4], "{memory:?}");
}

#[test]
fn whole_runs() {
    let rows = rows("loop", &["env_steps", "steps_per_s"]);
    for algo in ["dqn", "ha-diiqn"] {
        for mode in ["reference", "lockstep", "free"] {
            assert!(rows.iter().any(|row| row["algo"] == algo && row["mode"] == mode), "{rows:?}");
        }
    }
    let rows = self::rows("demonstration", &["mentor", "env_steps", "steps_per_cpu_s", "relative"]);
    assert_eq!((distinct(&rows, "mentor"), &rows[0]["relative"]), (2, &Value::from(1.0)), "{rows:?}");
}

#[test]
fn a_table_for_people() {
    let table = measured(&["replay", "--quick"]);
    let lines: Vec<&str> = table.lines().collect();
    assert!(lines[0].starts_with("replay  ("), "{table}");
    assert!(lines[1].contains("stored") && lines.len() > 3, "{table}");
}

#[test]
fn a_wrong_name_gets_the_accepted_ones() {
    let output = bench(&["nothing"]);
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    let text = String::from_utf8(output.stderr).unwrap();
    for word in [
        "nothing",
        "step",
        "infer",
        "replay",
        "mentor",
        "tick",
        "free",
        "message",
        "weights",
        "idle",
        "memory",
        "loop",
        "demonstration",
    ] {
        assert!(text.contains(word), "`{word}` is missing: {text}");
    }
}

#[test]
fn without_trestle_its_place_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let alone = dir.path().join("trestle-bench");
    std::fs::copy(BENCH, &alone).unwrap();
    let output = Command::new(&alone).args(["loop", "--quick"]).env_remove("CARGO").output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(text.contains(dir.path().join("trestle").to_str().unwrap()), "{text}");
    assert!(text.contains("cargo build --release"), "{text}");
}
