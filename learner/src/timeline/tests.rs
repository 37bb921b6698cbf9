#![allow(clippy::unwrap_used)]

use super::*;
use crate::testing::{World, demonstration, experiment};
use serde_json::Value;

/// A run of `ha-diiqn` on a map of 9 x 9 cells in a directory of its own, and a walk through it.
struct Walk {
    place: tempfile::TempDir,
    experiment: Experiment,
    agent: Agent,
    world: World,
}

fn walk() -> Walk {
    let place = tempfile::tempdir().unwrap();
    let experiment = experiment(&["run.algo=ha-diiqn"]);
    let mut rows = vec![".".repeat(9); 9];
    rows[4] = "....##...".into();
    let map = MapFile {
        rows,
        ends: [[0.0, 0.0], [8.0, 8.0]],
        features: [0, 1],
        origin: [-4.0, -4.0],
        scale: [1.0, 1.0],
        squares: 1,
    };
    std::fs::write(place.path().join("map.json"), serde_json::to_string(&map).unwrap()).unwrap();
    let agent = Agent::new(&experiment, demonstration(&experiment)).unwrap();
    let world = World::new(&experiment, 3);
    Walk { place, experiment, agent, world }
}

impl Walk {
    fn dir(&self) -> RunDir {
        RunDir::new(self.place.path())
    }

    fn create(&self) -> Timeline {
        Timeline::create(&self.experiment, &self.dir(), demonstration(&self.experiment).as_ref())
    }

    fn on(&mut self, timeline: &mut Timeline, moments: usize) {
        for _ in 0..moments {
            let (batch, observed) = self.world.batch(0, 4);
            self.agent.ingest(&batch, observed.as_ref()).unwrap();
            self.agent.train(|| ()).unwrap();
            timeline.add(&self.agent, self.agent.counters().env_steps as f64);
        }
    }

    fn written(&self) -> Vec<Value> {
        lines(&self.dir().timeline())
            .unwrap()
            .iter()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect()
    }
}

#[test]
fn a_moment_tells_of_each_transition_and_each_free_square() {
    let mut walk = walk();
    let mut timeline = walk.create();
    timeline.evaluation(&[-4.0, -4.0, -3.0, -4.0]);
    walk.on(&mut timeline, 40);
    let written = walk.written();
    let (head, last) = (&written[0], &written[40]);
    assert_eq!((&head["version"], &head["dims"], &head["squares"]), (&1.into(), &2.into(), &1.into()));
    assert_eq!(head["mentor"]["transitions"], 6);
    // State -3, -1.5 of the demonstration is column 1, row 2.5.
    assert_eq!(head["mentor"]["from"].as_array().unwrap()[..2], [1.0, 2.5]);
    assert_eq!(last["path"], serde_json::json!([0.0, 0.0, 1.0, 0.0]));
    let counts = |key: &str| last[key].as_array().unwrap().len();
    for key in ["e_kl", "action", "visited", "used", "bridge", "ahead", "found"] {
        assert_eq!(counts(key), 6, "{key}");
    }
    let squares = &last["squares"];
    for key in ["visits", "values", "policy"] {
        assert_eq!(squares[key].as_array().unwrap().len(), 79, "{key}");
    }
    assert!(squares["visits"].as_array().unwrap().contains(&255.into()));
    // Against the table itself.
    for (j, row) in walk.agent.mentor_rows().unwrap().enumerate() {
        let kind = last["kind"].as_str().unwrap().as_bytes()[j];
        let expected = match (row.feasible, row.bridge.is_some(), row.estimate.is_some()) {
            (true, ..) => b'f',
            (_, true, _) => b'b',
            (_, _, true) => b'g',
            _ => b'u',
        };
        assert_eq!(kind, expected, "{j}");
        assert_eq!(last["bridge"][j], row.bridge.map_or(0, |bridge| bridge.length));
        assert_eq!(last["used"][j], row.used);
    }
}

#[test]
fn without_a_map_moments_tell_of_the_newest_states() {
    let mut walk = walk();
    std::fs::remove_file(walk.dir().map()).unwrap();
    let mut timeline = walk.create();
    walk.on(&mut timeline, 100);
    let written = walk.written();
    let (head, last) = (&written[0], &written[100]);
    let every = head["states_every"].as_u64().unwrap();
    // Of the newest, which the replay still holds.
    let first = walk.agent.replay().first_index();
    let expected: Vec<f64> = (first..400)
        .filter(|index| index % every == 0)
        .flat_map(|index| {
            let replay = walk.agent.replay();
            let obs = replay.obs(replay.slot(index)).wide(&mut Vec::new()).to_vec();
            obs.into_iter().map(|x| (f64::from(x) * 1e4).round() / 1e4)
        })
        .collect();
    let told: Vec<f64> = last["states"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
    assert_eq!(told.len() as u64, 2 * 400u64.div_ceil(every));
    assert!(told.ends_with(&expected) && !expected.is_empty(), "{told:?} {expected:?}");
    // One that goes on tells of the same.
    let mentor = demonstration(&walk.experiment);
    let mut resumed = Timeline::resume(&walk.experiment, &walk.dir(), mentor.as_ref(), walk.agent.counters());
    resumed.evaluation(&[]);
    resumed.add(&walk.agent, 1.0);
    assert_eq!(walk.written().last().unwrap()["states"], serde_json::json!(expected));
}

#[test]
fn however_long_a_run_is_its_moments_are_few_and_even() {
    let mut walk = walk();
    let mut timeline = walk.create();
    walk.on(&mut timeline, 3 * MOST + 5);
    let written = walk.written();
    assert!(written.len() <= MOST + 1 && written.len() > MOST / 2, "{}", written.len());
    assert!(timeline.every > EVERY);
    let steps: Vec<u64> = written[1..].iter().map(|moment| moment["env_steps"].as_u64().unwrap()).collect();
    assert_eq!(steps, timeline.kept.iter().copied().collect::<Vec<_>>());
    assert!(steps.is_sorted() && steps[0] == 4 && *steps.last().unwrap() == walk.agent.counters().env_steps);
}

#[test]
fn a_resumed_run_forgets_what_came_after_its_checkpoint() {
    let mut walk = walk();
    let mut timeline = walk.create();
    walk.on(&mut timeline, 10);
    let counters = walk.agent.counters();
    walk.on(&mut timeline, 5);
    std::fs::write(walk.dir().timeline(), {
        let mut text: String = walk.written().iter().map(|line| format!("{line}\n")).collect();
        text.push_str("{\"torn");
        text
    })
    .unwrap();
    let mentor = demonstration(&walk.experiment);
    let at = Counters { env_steps: counters.env_steps + 8, ..counters };
    let resumed = Timeline::resume(&walk.experiment, &walk.dir(), mentor.as_ref(), at);
    let steps: Vec<u64> =
        walk.written()[1..].iter().map(|moment| moment["env_steps"].as_u64().unwrap()).collect();
    assert_eq!(steps.len(), 12);
    assert_eq!(steps.last(), Some(&at.env_steps));
    assert_eq!(resumed.kept, steps);
    // Bridges are as old as they were.
    assert_eq!(resumed.findings.spans(), timeline_at(&walk.written()[12]));
}

#[test]
fn a_damaged_map_or_a_file_that_cannot_be_written_costs_the_pictures_alone() {
    let mut walk = walk();
    std::fs::write(walk.dir().map(), "{\"rows\":[\"..\",\"...\"]}").unwrap();
    std::fs::create_dir(walk.dir().timeline()).unwrap();
    let mut timeline = walk.create();
    assert!(timeline.broken && timeline.squares.is_none() && !timeline.due());
    walk.on(&mut timeline, 3);
    assert!(walk.dir().timeline().is_dir());
}

/// Length, reach and age of the bridges that `moment` tells of.
fn timeline_at(moment: &Value) -> Vec<[u64; 3]> {
    let list =
        |key: &str| moment[key].as_array().unwrap().iter().map(|x| x.as_u64().unwrap()).collect::<Vec<_>>();
    let (length, ahead, found) = (list("bridge"), list("ahead"), list("found"));
    (0..length.len()).map(|j| [length[j], ahead[j], found[j]]).collect()
}
