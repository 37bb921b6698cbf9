//! What users met, each of which was once done wrongly: `cases/`, a folder each, and more of the same kinds.

use crate::util::{Place, TRESTLE, trestle};
use std::path::{Path, PathBuf};
use std::process::Command;

fn cases() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cases")
}

#[test]
fn every_case_ends_as_it_should() {
    let place = Place::new();
    let run =
        Command::new(cases().join("run.sh")).env("TRESTLE", TRESTLE).env("TMPDIR", place.root()).output();
    let run = run.unwrap();
    let said = String::from_utf8_lossy(&run.stdout);
    assert!(run.status.success(), "{said}{}", String::from_utf8_lossy(&run.stderr));
    assert!(said.contains("as expected, 0 failed, ") && said.ends_with(" 0 to be read\n"), "{said}");
}

/// A demonstration whose states do not fit is noticed by everything that reads it.
#[test]
fn states_that_the_environment_cannot_have_are_named() {
    let place = Place::new();
    let demo = cases().join("demo-axes-swapped/demo.csv").display().to_string();
    let set = format!("mentor.demo={demo}");
    let words = [
        "are called row, column",
        "1 of 7 states are none that maze maze-small can be in",
        "in row 7, state 5, (2, 3)",
    ];
    let checked = trestle(&["config", "check", "maze-small", "--set", &set]).ok();
    let inspected = trestle(&["demo", "inspect", &demo, "--config", "maze-small"]).ok();
    for word in words {
        assert!(
            checked.stdout.contains(word) && inspected.stdout.contains(word),
            "{checked:?} {inspected:?}"
        );
    }
    // Most of these lie in walls, and none does with the axes swapped.
    let text = "trajectory,terminal,a,b\n0,0,0,0\n0,0,0,3\n0,0,0,4\n0,1,0,5\n";
    let walls = place.write("map.txt", "S.....\n##.##.\n##.##.\n##.##.\n##.##.\n##.##G\n");
    let demo = place.write("swapped.csv", text);
    let sets = [format!("env.map={walls}"), format!("mentor.demo={demo}")];
    let sets = ["--set", &sets[0], "--set", &sets[1], "--set", "env.actions=regular"];
    let words = [
        "3 of 4 states are none",
        "in row 3, state 1, (0, 3): it lies in the wall at column 0, row 3",
        "features 0 and 1 swapped",
    ];
    trestle(&[&["config", "check", "maze-small"], &sets[..]].concat()).refused(&words);
    trestle(&[&["train", "maze-small", "--out", &place.path("run")], &sets[..]].concat()).refused(&words);
    let sets = [&sets[..2], &sets[4..]].concat();
    trestle(&[&["demo", "inspect", &demo, "--config", "maze-small"], &sets[..]].concat()).refused(&words);
    assert!(!Path::new(&place.path("run")).exists());
    // In another unit.
    let demo = place.write("scaled.csv", "trajectory,terminal,a,b\n0,0,0,0\n0,0,0.25,0\n");
    let set = format!("mentor.demo={demo}");
    let words = ["1 of 2 states", "in row 3, state 1, (0.25, 0)", "accepted: whole numbers from 0 to 11"];
    trestle(&["config", "check", "maze-small", "--set", &set]).refused(&words);
}
