//! `trestle config` and `trestle demo`: what they print and write can be fed back.

use crate::util::{Place, available, newest_checkpoint, start_under, trestle};
use std::fs;
use trestle_actor::env::registry;
use trestle_learner::checkpoint;
use trestle_proto::config::{self, Environments};

const LENGTH: [&str; 4] = ["--env-steps", "5000", "--seed", "3"];

#[test]
fn a_shown_configuration_trains_to_the_same_weights() {
    let place = Place::new();
    let sets = ["--set", "learner.hidden=[24, 16]", "--set", "mentor.k=3", "--set", "env.map=random:5:12x9"];
    let shown = trestle(&[&["config", "show", "maze-small"], &sets[..]].concat()).ok();
    assert_eq!(shown.stderr, "");
    let file = place.write("mine.toml", &shown.stdout);
    let algo = ["--algo", "trestle"];
    let typed = place.train("typed", &[&["maze-small"], &algo[..], &sets, &LENGTH].concat());
    let from_file = place.train("file", &[&[file.as_str()], &algo[..], &LENGTH].concat());
    assert_eq!(from_file, typed);

    // So does what the run itself has kept, without any argument.
    let kept = place.run("typed").config().display().to_string();
    assert_eq!(place.train("kept", &[&[kept.as_str()], &algo[..]].concat()), typed);
    assert_eq!(trestle(&["config", "show", &file]).ok().stdout, shown.stdout);
}

/// A run by one of its files, or by what its own messages name.
#[test]
fn a_run_goes_by_several_names() {
    let place = Place::new();
    place.train("run", &["maze-small", "--env-steps", "1500", "--seed", "3"]);
    let root = place.path("run");
    let figures = |name: &str| trestle(&["eval", name]).ok().stdout;
    let expected = figures(&root);
    for name in ["last", "config.toml", "result.json", "logs"] {
        let name = format!("{root}/{name}");
        assert_eq!(figures(&name), expected, "{name}");
        let out = place.path("network.onnx");
        trestle(&["export", &name, "--format", "onnx", "--overwrite", "--out", &out]).ok();
        trestle(&["demo", "record", &name, "--all", "--overwrite", "--out", &place.path("d.csv")]).ok();
        trestle(&["demo", "inspect", &name]).ok();
    }
    let said = trestle(&["report", &format!("{root}/last")]).ok().stdout;
    assert!(said.contains(&format!("{root}/report/report.html")), "{said}");
    let tick = newest_checkpoint(&place.run("run")).unwrap();
    let checkpoint = checkpoint::directory(place.run("run").root(), tick).display().to_string();
    trestle(&["eval", &checkpoint]).refused(&["is a checkpoint", &root, &format!("--checkpoint {tick}")]);
    // No configuration, but with one.
    for name in [root.clone(), format!("{root}/last")] {
        let judged = ["demo", "inspect", &place.path("d.csv"), "--config", &name];
        for args in [&["config", "show", &name][..], &["config", "check", &name], &judged] {
            let meant = format!("did you mean `{root}/config.toml`");
            trestle(args).refused(&["a directory, not a file", &meant]);
        }
    }
    for name in ["metrics.jsonl", "plan.bin", "command.txt", "last"] {
        let said = trestle(&["train", &format!("{root}/{name}")]);
        said.refused(&["is a run and no configuration", &format!("`trestle resume {root}`")]);
    }
    fs::remove_file(format!("{root}/config.toml")).unwrap();
    trestle(&["resume", &root, "--episodes", "99"]).refused(&["config.toml is missing", "to put it back"]);
}

#[test]
fn a_file_may_build_on_a_preset_and_a_map_file() {
    let place = Place::new();
    let map = place.write("mine.txt", "S....\n..#..\n.....\n....G\n");
    let text = format!("base = \"maze-small\"\n[env]\nmap = {map:?}\n[run]\nepisodes = 20\n");
    let file = place.write("mine.toml", text);
    let trace = place.train("run", &[&file]);
    assert_eq!(trace.result.episodes, 20);
    // The run holds its map: the file may go.
    fs::remove_file(map).unwrap();
    let root = place.path("run");
    let eval = trestle(&["eval", &root]).ok();
    assert!(eval.stdout.contains('S') && eval.stdout.contains('#'), "{eval:?}");
    assert_eq!(place.train("kept", &[&place.run("run").config().display().to_string()]).evals, trace.evals);
}

#[test]
fn presets_are_shown_and_checked() {
    for preset in registry().presets().iter().map(|preset| preset.name) {
        let shown = trestle(&["config", "show", preset]).ok();
        let parsed = config::parse_toml(preset, &shown.stdout).unwrap();
        assert_eq!(parsed, config::load(registry(), preset, &[]).unwrap());
        let checked = trestle(&["config", "check", preset]).ok();
        trestle(&["config", "check", preset, "--algo", "dqn", "--seed", "3", "--env-steps", "9"]).ok();
        assert!(checked.stdout.contains("a run could start"), "{checked:?}");
        // What a run counts as solved by: a maze knows its best return, the others name theirs.
        assert!(["best return", "threshold"].iter().any(|goal| checked.stdout.contains(goal)), "{checked:?}");
        assert!(checked.stdout.contains("demonstration"), "{checked:?}");
        assert!(!checked.stdout.contains("warning"), "{checked:?}");
    }
}

#[test]
fn a_planned_demonstration_in_a_file_is_as_good_as_planning() {
    let place = Place::new();
    let demo = place.path("demo.csv");
    let plan = ["demo", "plan", "maze-small", "--out", &demo];
    let planned = trestle(&plan).ok();
    let first = fs::read_to_string(&demo).unwrap();
    let transitions = first.lines().count() - 2;
    assert!(first.starts_with("trajectory,terminal,"), "{first}");
    assert!(planned.stdout.contains(&format!("{} states", transitions + 1)), "{planned:?}");
    assert!(planned.stdout.contains(&format!("{transitions} transitions")), "{planned:?}");
    trestle(&[&plan[..], &["--overwrite"]].concat()).ok();
    assert_eq!(fs::read_to_string(&demo).unwrap(), first);

    let by_plan = place.train("plan", &[&["maze-small"], &LENGTH[..]].concat());
    let set = format!("mentor.demo={demo}");
    let by_file = place.train("file", &[&["maze-small"], &LENGTH[..], &["--set", &set]].concat());
    assert_eq!(by_file, by_plan);
    let kept = fs::read_to_string(place.run("file").demonstration()).unwrap();
    let states = |text: &str| text.lines().skip(1).map(String::from).collect::<Vec<_>>();
    assert_eq!(states(&kept), states(&first));
}

#[test]
fn a_demonstration_is_inspected() {
    let place = Place::new();
    let demo = place.path("demo.csv");
    trestle(&["demo", "plan", "maze-small", "--out", &demo]).ok();
    let transitions = fs::read_to_string(&demo).unwrap().lines().count() - 2;
    let inspected = trestle(&["demo", "inspect", &demo, "--config", "maze-small"]).ok();
    assert!(inspected.stdout.contains(&transitions.to_string()), "{inspected:?}");
    assert!(inspected.stdout.matches('m').count() >= transitions / 2, "the path is drawn: {inspected:?}");
    // A run's own demonstration, under its own settings.
    place.train("run", &[&["maze-small"], &LENGTH[..]].concat());
    let run = trestle(&["demo", "inspect", &place.path("run")]).ok();
    assert!(run.stdout.contains(&transitions.to_string()), "{run:?}");
}

#[test]
fn a_directory_is_chosen_where_none_is_given() {
    let place = Place::new();
    let cd = format!("cd {} && exec \"$@\"", place.root().display());
    if !available(&["sh", "-c", "true"]) {
        return;
    }
    let args = ["train", "maze-small", "--algo", "dqn", "--seed", "3", "--env-steps", "1500", "--quiet"];
    start_under(&["sh", "-c", &cd, "sh"], &args).finish().ok();
    assert!(place.root().join("runs/maze-small-dqn-seed3/result.json").is_file());
    start_under(&["sh", "-c", &cd, "sh"], &args).finish().refused(&["runs/maze-small-dqn-seed3 exists"]);
}

#[test]
fn a_reader_may_have_seen_enough() {
    let printing: [&[&str]; 3] = [&["config", "show", "maze30"], &["config", "check", "maze30"], &["doctor"]];
    for args in printing {
        let outcome = start_under(&["sh", "-c", "\"$@\" | true", "sh"], args).finish().ok();
        assert_eq!(outcome.stderr, "", "{args:?}");
    }
}
