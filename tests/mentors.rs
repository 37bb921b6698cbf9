//! Demonstrations and thresholds: several mentors at once, thresholds from the mentor's own steps, and what a run
//! leaves behind about each mentor transition.

use crate::util::{Place, Trace, metrics, trestle};
use std::fs;

/// A whole number of ticks, so that the run can be prolonged.
const ARGS: [&str; 5] = ["maze-small", "--env-steps", "10016", "--seed", "11"];

fn with<'a>(more: &[&'a str]) -> Vec<&'a str> {
    [&ARGS, more].concat()
}

/// The column `name` of `mentor.csv`.
fn column<'a>(trace: &'a Trace, name: &str) -> Vec<&'a str> {
    let mut lines = trace.mentor.lines();
    let at = lines.next().unwrap().split(',').position(|column| column == name).unwrap();
    lines.map(|line| line.split(',').nth(at).unwrap()).collect()
}

fn sum(column: &[&str]) -> u64 {
    column.iter().map(|text| text.parse::<u64>().unwrap()).sum()
}

#[test]
fn thresholds_come_from_the_mentors_own_steps() {
    let place = Place::new();
    // In a maze of whole cells a quarter of a step's KL, 1/8, tells apart what the presets' 0.1 does.
    let fixed = place.train("fixed", &ARGS);
    let auto = ["--set", "mentor.e_th=auto", "--set", "mentor.e_infeas=auto"];
    let by_auto = place.train("auto", &with(&auto));
    assert_eq!(by_auto, fixed);
    let resolved = fs::read_to_string(place.run("auto").config()).unwrap();
    assert!(resolved.contains("e_th = 0.125\ne_infeas = 0.125\n"), "{resolved}");
    // The run stands for itself: its own configuration repeats it, and it can be gone on with as it was begun.
    let own = place.path("auto/config.toml");
    assert_eq!(place.train("again", &[&own]), fixed);
    let longer = [&["maze-small", "--env-steps", "20000", "--seed", "11"], &auto[..], &["--resume"]].concat();
    place.train("auto", &longer);
    let other = [&longer[..], &["--set", "mentor.e_th=0.1"]].concat();
    trestle(&place.training("auto", &other).iter().map(String::as_str).collect::<Vec<_>>())
        .refused(&["e_th"]);
}

#[test]
fn thresholds_too_large_are_warned_of() {
    let place = Place::new();
    let sets =
        ["run.algo=ha-diiqn", "mentor.e_th=0.5", "mentor.e_infeas=0.75"].map(|set| ["--set", set]).concat();
    let args = [&["config", "check", "maze-small"], &sets[..]].concat();
    let checked = trestle(&args).ok();
    assert!(checked.stdout.contains("mentor.e_th = 0.5 swallows 1 mentor steps"), "{checked:?}");
    assert!(checked.stdout.contains("mentor.e_infeas = 0.75 is more than the median KL"), "{checked:?}");
    let args = [&["maze-small", "--env-steps", "600"], &sets[..]].concat();
    let args = place.training("run", &args);
    let trained = trestle(&args.iter().map(String::as_str).collect::<Vec<_>>()).ok();
    assert!(trained.stderr.contains("swallows 1 mentor steps"), "{trained:?}");
}

#[test]
fn several_mentors_have_their_own_names() {
    let place = Place::new();
    // A second mentor that walked the first steps of the planned path twice.
    let demo = place.path("demo.csv");
    trestle(&["demo", "plan", "maze-small", "--out", &demo]).ok();
    let text = fs::read_to_string(&demo).unwrap();
    let mut lines = text.lines();
    let mut novice = format!("{}\n", lines.next().unwrap());
    let states: Vec<String> = lines.take(6).map(|line| line.split_once(',').unwrap().1.to_string()).collect();
    for trajectory in 0..2 {
        states.iter().for_each(|state| novice += &format!("{trajectory},{state}\n"));
    }
    let novice = place.write("novice.csv", novice);

    let set = format!("mentor.demo={{ novice = {novice:?}, expert = \"plan\" }}");
    let two = place.train("two", &with(&["--set", &set]));
    assert_eq!(place.train("one", &with(&["--set", &set, "--mode", "reference"])), two);
    let transitions = text.lines().count() - 2;
    let demos = column(&two, "demo");
    let expected = [vec!["expert"; transitions], vec!["novice"; 10]].concat();
    assert_eq!(demos, expected);
    assert_eq!(column(&two, "trajectory")[transitions..].concat(), "0000011111");
    assert_eq!(column(&two, "step")[transitions..].concat(), "0123401234");
    let rows = metrics(&place.run("two"));
    let last = rows.iter().rfind(|row| row.get("mentor/feasible_frac").is_some()).unwrap();
    for name in ["expert", "novice"] {
        let share = last[format!("mentor/{name}/visited_frac").as_str()].as_f64().unwrap();
        assert!(share > 0.0 && share <= 1.0, "{last}");
        assert!(last.get(format!("mentor/{name}/feasible_frac")).is_some(), "{last}");
    }
    // Where the mentors were in the same place, each of them gets its share of the visits.
    let visited = column(&two, "visited");
    assert!(sum(&visited[..5]) > 0 && sum(&visited[transitions..]) > sum(&visited[..5]), "{visited:?}");

    // The run needs the files no more.
    fs::remove_file(&novice).unwrap();
    assert_eq!(place.train("again", &[&place.path("two/config.toml")]), two);
    let set = format!("mentor.demo={{ novice = {novice:?}, expert = \"plan\" }}");
    let longer = ["maze-small", "--env-steps", "20000", "--seed", "11", "--set", &set, "--resume"];
    assert!(place.train("two", &longer).result.env_steps == 20000);
}

#[test]
fn what_is_known_of_each_mentor_transition_is_written_down() {
    let trace = Place::new().train("run", &with(&["--set", "mentor.e_infeas=0.1"]));
    assert!(sum(&column(&trace, "visited")) > 100 && sum(&column(&trace, "used")) > 100, "{}", trace.mentor);
    let (e_kl, feasible) = (column(&trace, "e_kl"), column(&trace, "feasible"));
    for (e_kl, feasible) in e_kl.iter().zip(&feasible) {
        match e_kl.parse::<f64>() {
            Ok(e_kl) => assert_eq!(*feasible == "1", e_kl < 0.1),
            Err(_) => assert!(e_kl.is_empty() && feasible.is_empty()),
        }
    }
    assert!(feasible.contains(&"1") && feasible.contains(&"0"), "{}", trace.mentor);
    let (lengths, actions) = (column(&trace, "bridge_len"), column(&trace, "a_feas"));
    assert!(lengths.iter().zip(&actions).all(|(l, a)| l.is_empty() == a.is_empty()));
    assert!(lengths.iter().any(|length| length.parse::<u32>().is_ok_and(|l| (1..=4).contains(&l))));
    let states = (column(&trace, "s0"), column(&trace, "s1"));
    assert!(states.0.iter().chain(&states.1).all(|x| x.parse::<f32>().is_ok()));
}
