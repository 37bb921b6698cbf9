//! `trestle demo record` and `import`: from what users have to a trained observer.

use crate::util::{Place, trestle};
use std::fs;
use std::path::Path;

/// A file that Minari, h5py or NumPy wrote: see `golden/demonstrations.py`.
fn golden(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/demonstrations").join(name).display().to_string()
}

#[test]
fn a_minari_data_set_is_imported_inspected_and_trained_from() {
    let place = Place::new();
    let out = place.path("minari.csv");
    for format in ["minari-hdf5", "minari-arrow"] {
        let source = golden(format);
        let args =
            ["demo", "import", &source, "--key", "cell", "--episodes", "0..1", "--out", &out, "--overwrite"];
        let imported = trestle(&args).ok();
        let last = "35 states, 34 transitions in 1 trajectories, 1 ending in a terminal state";
        assert!(imported.stdout.contains(last), "{imported:?}");
        let inspected = trestle(&["demo", "inspect", &out, "--config", "maze-small"]).ok();
        assert!(inspected.stdout.contains("trajectories  1 (1 ended in a terminal state)"), "{inspected:?}");
        assert!(inspected.stdout.matches('m').count() > 30, "the path is drawn: {inspected:?}");
        let set = format!("mentor.demo={out}");
        let trace = place.train(format, &["maze-small", "--env-steps", "4000", "--seed", "2", "--set", &set]);
        assert!(trace.result.env_steps >= 4000);
        let kept = fs::read_to_string(place.run(format).demonstration()).unwrap();
        assert_eq!(kept, fs::read_to_string(&out).unwrap());
    }
    let text = fs::read_to_string(place.path("minari.csv")).unwrap();
    assert!(text.starts_with("trajectory,terminal,s0,s1\n0,0,0,0\n0,0,1,0\n"), "{text}");
    assert!(text.ends_with("\n0,1,11,11\n"), "{text}");
}

#[test]
fn a_demonstration_of_any_kind_is_drawn() {
    let place = Place::new();
    let (source, out, svg) = (golden("minari-arrow"), place.path("point.csv"), place.path("point.svg"));
    let args = ["demo", "import", &source, "--key", "observation", "--columns", "0..4", "--out", &out];
    trestle(&args).ok();
    // Four features, of no environment that is at hand.
    let inspected = trestle(&["demo", "inspect", &out, "--picture", &svg]).ok();
    assert!(inspected.stdout.contains("trajectories  2 (1 ended in a terminal state)"), "{inspected:?}");
    assert!(inspected.stdout.contains("right: s0, 0 to 1.1; up: s1, 0 to 1.1"), "{inspected:?}");
    let drawing = fs::read_to_string(&svg).unwrap();
    assert!(drawing.starts_with("<svg ") && drawing.matches("<polyline").count() == 2, "{drawing}");
    let other = trestle(&["demo", "inspect", &out, "--axes", "2,3"]).ok();
    assert!(other.stdout.contains("right: s2, 0 to 1; up: s3, -1 to 1"), "{other:?}");
    trestle(&["demo", "inspect", &out, "--axes", "0,4"]).refused(&["no feature 4", "0 to 3"]);
    trestle(&["demo", "inspect", &out, "--axes", "0"]).refused(&["0,1"]);
    trestle(&["demo", "inspect", &out, "--picture", &svg]).refused(&["point.svg exists"]);
    for (name, begins) in [("point.png", &b"\x89PNG"[..]), ("point.pdf", b"%PDF")] {
        let file = place.path(name);
        trestle(&["demo", "inspect", &out, "--picture", &file]).ok();
        assert!(fs::read(&file).unwrap().starts_with(begins), "{name}");
    }
    trestle(&["demo", "inspect", &out, "--picture", &place.path("point.gif")])
        .refused(&["point.gif", ".svg, .png, .pdf"]);
    trestle(&["demo", "inspect", &out, "--config", "maze-small"]).refused(&["4 features", "accepted: 2"]);
}

#[test]
fn an_import_that_is_refused_leaves_nothing() {
    let place = Place::new();
    let out = place.path("out.csv");
    let source = golden("minari-hdf5");
    let import =
        |source: &str, args: &[&str]| trestle(&[&["demo", "import", source, "--out", &out], args].concat());
    import(&source, &[]).refused(&["main_data.hdf5, episode 0", "--key", "cell, observation"]);
    import(&source, &["--key", "cell", "--columns", "0..9"]).refused(&["--columns is 8", "0 to 1"]);
    import(&source, &["--key", "cell", "--episodes", "3..x"]).refused(&["--episodes", "FROM..TO"]);
    let whole = fs::read(golden("d4rl.hdf5")).unwrap();
    let cut = place.write("cut.hdf5", &whole[..whole.len() / 2]);
    import(&cut, &[]).refused(&["cut.hdf5", "cut off"]);
    assert!(!Path::new(&out).exists());
    let kept = place.write("out.csv", "mine");
    import(&golden("one.npy"), &[]).refused(&["out.csv exists", "--overwrite"]);
    // What is to be imported is no demonstration yet.
    trestle(&["demo", "inspect", &golden("one.npy")]).refused(&["one.npy", "NPY", "trestle demo import"]);
    assert_eq!(fs::read_to_string(kept).unwrap(), "mine");
}

#[test]
fn a_trained_run_is_recorded() {
    let place = Place::new();
    let map = place.write("small.txt", "S...\n....\n...G\n");
    let map = format!("env.map={map}");
    place
        .train("mentor", &["maze-small", "--algo", "dqn", "--seed", "1", "--episodes", "300", "--set", &map]);
    let (run, out, again) = (place.path("mentor"), place.path("demo.csv"), place.path("again.csv"));
    let recorded = trestle(&["demo", "record", &run, "--out", &out]).ok();
    assert!(recorded.stdout.contains("10 of 10 greedy episodes succeed"), "{recorded:?}");
    assert!(recorded.stdout.contains("9 episodes that repeat an earlier one"), "{recorded:?}");
    let text = fs::read_to_string(&out).unwrap();
    assert!(
        text.starts_with("trajectory,terminal,s0,s1\n0,0,0,0\n") && text.ends_with("\n0,1,3,2\n"),
        "{text}"
    );
    trestle(&["demo", "record", &run, "--out", &again, "--episodes", "1"]).ok();
    assert_eq!(fs::read_to_string(&again).unwrap(), text);
    trestle(&["demo", "record", &run, "--out", &out]).refused(&["demo.csv exists", "--overwrite"]);
    let set = format!("mentor.demo={out}");
    place.train("observer", &["maze-small", "--env-steps", "2000", "--set", &map, "--set", &set]);

    // One that has hardly begun goes nowhere.
    place.train(
        "young",
        &["maze-small", "--algo", "dqn", "--env-steps", "1200", "--set", "env.step_limit=60"],
    );
    let (young, none) = (place.path("young"), place.path("none.csv"));
    let args = ["demo", "record", &young, "--out", &none, "--episodes", "2"];
    trestle(&args).refused(&["0 of 2 greedy episodes succeed", "mean return", "--all"]);
    assert!(!Path::new(&none).exists());
    trestle(&[&args[..], &["--all"]].concat()).ok();
    let text = fs::read_to_string(&none).unwrap();
    assert_eq!(text.lines().count(), 1 + 61);
    assert!(text.lines().skip(1).all(|line| line.starts_with("0,0,")), "{text}");
}
