//! The promises of docs/versions.md: runs that this minor version and earlier ones have made are read, and files of newer
//! versions are refused by name. tests/golden/runs has such runs, and make.sh beside them makes that of this version anew.

use crate::util::{Place, copy, newest_checkpoint, result, start, tree, trestle};
use serde_json::Value;
use std::fs;
use std::path::Path;
use trestle_learner::checkpoint;
use trestle_proto::plan::PLAN_KIND;
use trestle_proto::rundir::RunDir;

/// The stored runs, by the minor version that made them; beside each a text with what `eval` printed then.
const RUNS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/runs");
/// The minor version under test.
const OWN: &str = concat!(env!("CARGO_PKG_VERSION_MAJOR"), ".", env!("CARGO_PKG_VERSION_MINOR"));
const EARLIER: [&str; 1] = ["0.1"];

/// The stored run of `version`, copied to the directory `name`, where it may be written.
fn stored(place: &Place, version: &str, name: &str) -> RunDir {
    let dir = place.run(name);
    copy(&Path::new(RUNS).join(version), dir.root());
    dir
}

/// `train` with the configuration of the run in `dir`, on to `env_steps`.
fn onwards(place: &Place, dir: &RunDir, env_steps: u32, more: &[&str]) -> Vec<String> {
    let config = dir.config().to_str().unwrap().to_string();
    let name = dir.root().file_name().unwrap().to_str().unwrap();
    place.training(name, &[&[config.as_str(), "--env-steps", &env_steps.to_string()], more].concat())
}

#[test]
fn every_stored_run_is_evaluated_as_by_the_version_that_made_it() {
    let place = Place::new();
    for version in EARLIER.iter().chain(&[OWN]) {
        let dir = stored(&place, version, version);
        let printed = trestle(&["eval", dir.root().to_str().unwrap()]).ok();
        let recorded = fs::read_to_string(Path::new(RUNS).join(format!("{version}.txt"))).unwrap();
        let (found, expected): (Vec<&str>, Vec<&str>) =
            (printed.stdout.lines().collect(), recorded.lines().collect());
        assert_eq!(found[1..], expected[1..], "{version}: {printed:?}");
        assert!(found[0].starts_with("maze random:1:5x5, checkpoint "), "{printed:?}");
        assert_eq!(printed.stderr, "", "{version}");
    }
}

#[test]
fn a_report_takes_stored_runs_in() {
    let place = Place::new();
    let mut outcomes = Vec::new();
    for version in EARLIER.iter().chain(&[OWN]) {
        // As arms of a sweep: runs of one arm and seed are not counted twice.
        let dir = stored(&place, version, &format!("{version}/seed-7"));
        outcomes.push(serde_json::from_slice::<Value>(&fs::read(dir.result()).unwrap()).unwrap());
    }
    let printed = trestle(&["report", place.root().to_str().unwrap(), "--out", &place.path("report")]).ok();
    let text = fs::read(place.root().join("report/report.json")).unwrap();
    let report: Value = serde_json::from_slice(&text).unwrap();
    let arms = report["arms"].as_array().unwrap();
    assert_eq!(arms.len(), outcomes.len(), "{printed:?}");
    for (arm, outcome) in arms.iter().zip(&outcomes) {
        assert_eq!((&arm["runs"], &arm["complete"]), (&1.into(), &1.into()), "{arm}");
        for key in ["env_steps", "wall_s"] {
            assert_eq!(arm[key].as_f64(), outcome[key].as_f64(), "{arm}");
        }
        assert_eq!(arm["final_return_mean"].as_f64(), outcome["final_return"].as_f64(), "{arm}");
        for time in arm["times"].as_array().unwrap() {
            assert_eq!(time["mid"].as_f64(), outcome[time["time"].as_str().unwrap()].as_f64(), "{arm}");
        }
    }
    // Nothing is missing but the picture of the older run's map.
    let notes: Vec<&str> = printed.stderr.lines().collect();
    assert_eq!(notes.len(), EARLIER.len(), "{printed:?}");
    assert!(notes.iter().all(|note| note.starts_with("note: no maze of ")), "{printed:?}");
}

#[test]
fn the_stored_run_of_this_version_goes_on_as_if_it_had_never_ended() {
    let place = Place::new();
    let dir = stored(&place, OWN, "run");
    let before = newest_checkpoint(&dir).unwrap();
    let config = place.write("config.toml", fs::read(dir.config()).unwrap());
    start(&onwards(&place, &dir, 960, &["--resume"])).finish().ok();
    assert!(newest_checkpoint(&dir).unwrap() > before);
    let resumed = result(&dir);
    let straight = place.train("straight", &[&config, "--env-steps", "960"]);
    assert_eq!((resumed.env_steps, resumed.weights_sha256), (960, straight.weights_sha256));
}

#[test]
fn runs_of_other_minor_versions_are_not_gone_on_with() {
    let place = Place::new();
    for version in EARLIER {
        let dir = stored(&place, version, version);
        let before = tree(dir.root());
        let resume = start(&onwards(&place, &dir, 960, &["--resume"])).finish();
        resume.refused(&[
            "--resume",
            &format!("a run of version {version}."),
            &format!("accepted: version {OWN}"),
        ]);
        assert_eq!(tree(dir.root()), before);
        // It is known as a run all the same.
        start(&onwards(&place, &dir, 64, &["--overwrite"])).finish().ok();
    }
}

#[test]
fn a_plan_of_a_newer_version_is_refused_by_name() {
    let place = Place::new();
    let dir = stored(&place, OWN, "run");
    let mut plan = fs::read(dir.plan()).unwrap();
    let newer = PLAN_KIND.version + 1;
    plan[8..12].copy_from_slice(&newer.to_le_bytes());
    fs::write(dir.plan(), plan).unwrap();
    // As a newer version may have it.
    let config = fs::read_to_string(dir.config()).unwrap();
    let typed = place.write("typed.toml", &config);
    fs::write(dir.config(), config + "\n[novelty]\nshare = 0.5\n").unwrap();
    let before = tree(dir.root());
    let root = dir.root().to_str().unwrap();
    let words = ["plan.bin", &format!("v{newer}, of a newer version"), &format!("v{}", PLAN_KIND.version)];
    trestle(&["eval", root]).refused(&words);
    trestle(&["report", root, "--out", &place.path("report")]).refused(&words);
    trestle(&["demo", "record", root, "--out", &place.path("demo.csv")]).refused(&words);
    start(&place.training("run", &[&typed, "--env-steps", "960", "--resume"])).finish().refused(&words);
    assert_eq!(tree(dir.root()), before);
}

#[test]
fn a_checkpoint_of_a_newer_version_is_refused_by_name() {
    let place = Place::new();
    let dir = stored(&place, OWN, "run");
    let newest = checkpoint::directory(dir.root(), newest_checkpoint(&dir).unwrap());
    // An older one would be taken in its place.
    for entry in fs::read_dir(dir.checkpoints()).unwrap().map(Result::unwrap) {
        if entry.path() != newest {
            fs::remove_dir_all(entry.path()).unwrap();
        }
    }
    let text = fs::read(newest.join("MANIFEST")).unwrap();
    let mut manifest: Value = serde_json::from_slice(&text).unwrap();
    let newer = checkpoint::FORMAT + 1;
    (manifest["format"], manifest["version"]) = (newer.into(), "9.4.1".into());
    // A field that only the newer version knows is not what is complained of.
    manifest["novelty"] = true.into();
    let text = manifest.to_string();
    fs::write(newest.join("MANIFEST"), &text).unwrap();
    fs::write(newest.join("COMPLETE"), format!("{:08x}\n", crc32c::crc32c(text.as_bytes()))).unwrap();
    let before = tree(dir.root());
    let root = dir.root().to_str().unwrap();
    let words = ["MANIFEST", &format!("format {newer} of version 9.4.1"), &checkpoint::FORMAT.to_string()];
    trestle(&["eval", root]).refused(&words);
    trestle(&["demo", "record", root, "--out", &place.path("demo.csv")]).refused(&words);
    let resume = start(&onwards(&place, &dir, 960, &["--resume"])).finish();
    resume.refused(&["--resume", "a run of version 9.4.1", &format!("accepted: version {OWN}")]);
    assert_eq!(tree(dir.root()), before);
}
