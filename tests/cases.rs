//! Files that users brought, each of which was once read wrongly or refused for the wrong reason: `golden/cases/`, a folder each.

use crate::util::{Outcome, Place, trestle};
use std::fs;
use std::path::Path;

fn case(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/cases").join(name).display().to_string()
}

/// Imports the case's file with these arguments; what was written, if anything was.
fn import(name: &str, args: &[&str]) -> (Outcome, Option<String>) {
    let place = Place::new();
    let (source, out) = (case(name), place.path("out.csv"));
    let outcome = trestle(&[&["demo", "import", &source, "--out", &out], args].concat());
    (outcome, fs::read_to_string(&out).ok())
}

/// The states of what is imported, a line each, with the trajectories before them.
fn imported(name: &str, args: &[&str]) -> (String, String) {
    let (outcome, written) = import(name, args);
    let outcome = outcome.ok();
    let rows = written.unwrap().lines().skip(1).map(|line| line.to_string() + "\n").collect();
    (rows, outcome.stdout)
}

/// The program refuses the case, says so in a few lines, and writes nothing.
fn refused(name: &str, args: &[&str], words: &[&str]) {
    let (outcome, written) = import(name, args);
    assert!(outcome.refused(words).stderr.len() < 2000);
    assert_eq!(written, None);
}

#[test]
fn tables_are_what_they_look_like() {
    let (rows, said) = imported("csv-without-header/states.csv", &["--columns", "0,1"]);
    assert_eq!(rows, "0,0,0,0\n0,0,1,0\n0,0,2,0\n0,0,2,1\n");
    assert!(said.contains("the table has no header"), "{said}");
    let (rows, _) = imported("csv-numeric-names/frame.csv", &["--columns", "0,1"]);
    assert_eq!(rows, "0,0,5,6\n0,0,6,6\n0,0,7,6\n");
    let (rows, said) = imported("csv-done/log.csv", &["--columns", "x,y"]);
    assert_eq!(rows, "0,0,0,1\n0,0,1,1\n0,0,2,2\n1,0,9,9\n1,0,8,9\n1,0,7,9\n");
    assert!(said.contains("`done` ends episodes, but does not say which last states are terminal"), "{said}");
    let (rows, _) = imported("csv-semicolon/a.csv", &["--columns", "x,y"]);
    assert_eq!(rows, "0,0,0,1\n0,0,1,1\n");
}

#[test]
fn valid_hdf5_is_read_or_named() {
    let two = "0,0,0,1\n0,0,2,3\n0,0,4,5\n1,0,6,7\n1,0,8,9\n1,0,10,11\n";
    for name in ["hdf5-soft-link/a.hdf5", "hdf5-float16/a.hdf5"] {
        assert_eq!(imported(name, &[]).0, two, "{name}");
    }
    refused("hdf5-szip/a.hdf5", &[], &["compressed with SZIP", "h5repack -f GZIP=4"]);
    refused("lfs-pointer/a.hdf5", &[], &["a Git LFS pointer, not the data", "git lfs pull"]);
}

#[test]
fn an_episode_without_its_last_observation_is_imported_as_it_is() {
    let (rows, said) = imported("minari-short-episode/set", &[]);
    assert_eq!(rows.lines().filter(|row| row.starts_with("1,")).count(), 5);
    assert_eq!(rows.lines().filter(|row| row.contains(",1,10,11")).count(), 2, "{rows}");
    assert!(said.contains("1 episodes have as many observations as steps"), "{said}");
    // Or it is left out.
    let (rows, _) = imported("minari-short-episode/set", &["--episodes", "0,2"]);
    assert_eq!(rows.lines().count(), 12);
}

#[test]
fn what_is_no_array_of_numbers_is_named() {
    refused("npy-object/a.npy", &[], &["episodes of unequal length", "CSV with a column `episode`"]);
    let place = Place::new();
    let states: Vec<String> = (0..200_000).map(|i| format!("[{i}.0, 1.0]")).collect();
    let (source, out) = (place.write("a.json", format!("[{}]", states.join(", "))), place.path("o.csv"));
    let outcome = trestle(&["demo", "import", &source, "--out", &out]).refused(&["this is JSON"]);
    assert!(outcome.stderr.lines().count() <= 4 && outcome.stderr.len() < 600, "{}", outcome.stderr);
}

#[test]
fn maps_from_other_editors_are_read() {
    for name in ["map-bom/m.txt", "map-blank-line-first/m.txt"] {
        let set = format!("env.map={}", case(name));
        trestle(&["config", "check", "maze-small", "--set", &set, "--set", "env.actions=regular"]).ok();
    }
}

/// A demonstration whose states do not fit is noticed by everything that reads it.
#[test]
fn states_that_the_environment_cannot_have_are_named() {
    let place = Place::new();
    let demo = case("demo-axes-swapped/demo.csv");
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
