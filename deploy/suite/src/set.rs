//! Sets of tasks as data.

use crate::mentor::{Mentor, MentorError, Wanted, demonstration};
use serde::Deserialize;
use std::collections::BTreeSet;
use std::path::Path;
use trestle_algorithm::demonstration::Demonstration;
use trestle_proto::names;
use trestle_proto::regular_file::{self, FileError};

/// The sets that are compiled in.
const BUILTIN: [(&str, &str); 2] = [
    ("choosing", include_str!("../sets/choosing.toml")),
    ("reporting", include_str!("../sets/reporting.toml")),
];
/// Version of the form of a set.
const FORMAT: u32 = 1;
/// Tasks of a set, at most.
pub const MAX_TASKS: usize = 1000;
/// Trajectories of a demonstration, at most.
pub const MAX_TRAJECTORIES: u32 = 1000;
/// Letters of a name that becomes a directory, at most.
pub const MAX_NAME: usize = 64;
/// Largest file of a set, bytes.
const MAX_BYTES: u64 = 1 << 20;

/// A set of tasks.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskSet {
    /// Version of the form.
    format: u32,
    /// Settings of every task, `key=value`.
    #[serde(default)]
    set: Vec<String>,
    /// The tasks.
    tasks: Vec<Task>,
}

/// A task: what an agent has to learn, with which mentor, and how long it may take.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Task {
    /// Its name, `<group>/<name>`: the directories of its runs.
    pub id: String,
    /// The preset, which has the hyper-parameters of all arms.
    pub preset: String,
    /// The map, as `env.map` takes it. Not that of a run's seed.
    #[serde(default)]
    pub map: Option<String>,
    /// What the mentor does on the map.
    #[serde(default)]
    pub mentor: Option<Mentor>,
    /// In place of a map and a mentor: a demonstration, as `mentor.demo` takes it.
    #[serde(default)]
    pub demo: Option<String>,
    /// Decides what the mentor leaves to chance.
    #[serde(default)]
    pub seed: u64,
    /// Trajectories of the demonstration.
    #[serde(default = "one")]
    pub trajectories: u32,
    /// Environment steps of a run that is not solved before.
    pub env_steps: u64,
    /// Further settings, `key=value`.
    #[serde(default)]
    pub set: Vec<String>,
}

fn one() -> u32 {
    1
}

/// A set that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SetError {
    /// Neither a set that is compiled in nor a file.
    #[error("task set {name}; accepted: {builtin}, or a file{hint}", builtin = BUILTIN.map(|(name, _)| name).join(", "))]
    Unknown {
        /// What was asked for.
        name: String,
        /// The nearest set, if one is near.
        hint: String,
    },
    /// A file that cannot be read.
    #[error(transparent)]
    Read(#[from] FileError),
    /// A text that is no set.
    #[error("task set {name}: {source}")]
    Parse {
        /// Name or file.
        name: String,
        /// Why.
        source: Box<toml::de::Error>,
    },
    /// A set, or a task of it, that is not accepted.
    #[error("task set {name}: {what}; accepted: {accepted}")]
    Refused {
        /// Name or file.
        name: String,
        /// The thing and its value.
        what: String,
        /// What is.
        accepted: String,
    },
}

impl TaskSet {
    /// The set called `name`: one that is compiled in, or a TOML file.
    ///
    /// # Errors
    /// No such set, or one that cannot be used.
    pub fn load(name: &str) -> Result<Self, SetError> {
        if let Some((_, text)) = BUILTIN.iter().find(|(known, _)| *known == name) {
            return Self::parse(name, text);
        }
        match regular_file::read_to_string(Path::new(name), MAX_BYTES) {
            Ok(text) => Self::parse(name, &text),
            Err(error) if error.is_not_found() => {
                let hint = names::hint(name, BUILTIN.map(|(known, _)| known));
                Err(SetError::Unknown { name: name.into(), hint })
            }
            Err(error) => Err(error.into()),
        }
    }

    /// The set in `text`; `name` names it in errors.
    ///
    /// # Errors
    /// What is not accepted.
    pub fn parse(name: &str, text: &str) -> Result<Self, SetError> {
        let set: Self = toml::from_str(text)
            .map_err(|source| SetError::Parse { name: name.into(), source: Box::new(source) })?;
        set.check().map_err(|(what, accepted)| SetError::Refused {
            name: name.into(),
            what,
            accepted: accepted.into(),
        })?;
        Ok(set)
    }

    /// The first thing that is not accepted, and what is.
    fn check(&self) -> Result<(), (String, &'static str)> {
        if self.format != FORMAT {
            return Err((format!("format = {}", self.format), "1"));
        }
        if !(1..=MAX_TASKS).contains(&self.tasks.len()) {
            return Err((format!("{} tasks", self.tasks.len()), "1 to 1000"));
        }
        let mut known = BTreeSet::new();
        for task in &self.tasks {
            let Task { id, .. } = task;
            let parts: Vec<&str> = id.split('/').collect();
            if parts.len() != 2 || !parts.iter().all(|part| is_name(part)) {
                return Err((
                    format!("task {id:?}"),
                    "<group>/<name>, each 1 to 64 of the letters a-z, A-Z, 0-9 and -_.@+, no dot first, neither called report, \
                     maps or demonstrations",
                ));
            }
            if !known.insert(id) {
                return Err((format!("a second task {id}"), "each name once"));
            }
            let sets = self.set.iter().chain(&task.set);
            if let Some(set) = sets.into_iter().find(|set| !set.contains('=')) {
                return Err((format!("task {id}: the setting {set:?}"), "key=value"));
            }
            if task.map.is_some() != task.mentor.is_some() || task.map.is_some() == task.demo.is_some() {
                let given = [
                    ("map", task.map.is_some()),
                    ("mentor", task.mentor.is_some()),
                    ("demo", task.demo.is_some()),
                ];
                let given: Vec<&str> =
                    given.into_iter().filter(|(_, given)| *given).map(|(key, _)| key).collect();
                return Err((format!("task {id} with [{}]", given.join(", ")), "map and mentor, or demo"));
            }
            if let Some(map) = task.map.as_ref().filter(|map| map.contains(":run:")) {
                return Err((
                    format!("task {id}: map = {map}"),
                    "a map that does not depend on a run's seed",
                ));
            }
            if !(1..=MAX_TRAJECTORIES).contains(&task.trajectories) {
                return Err((format!("task {id}: trajectories = {}", task.trajectories), "1 to 1000"));
            }
        }
        Ok(())
    }

    /// All tasks, in their order.
    pub fn tasks(&self) -> &[Task] {
        &self.tasks
    }

    /// Every setting of `task` but a demonstration that is made for it: those of all tasks, its map or its recorded
    /// demonstration, its own, its budget. Later ones win.
    pub fn settings(&self, task: &Task) -> Vec<String> {
        let map = task.map.as_ref().map(|map| format!("env.map={map}"));
        let demo = task.demo.as_ref().map(|demo| format!("mentor.demo={demo:?}"));
        let budget = format!("run.env_steps={}", task.env_steps);
        let own = map.into_iter().chain(demo).chain(task.set.iter().cloned());
        self.set.iter().cloned().chain(own).chain([budget]).collect()
    }

    /// The demonstration that is made for `task`; none for one that brings its own.
    ///
    /// # Errors
    /// A task that cannot be.
    pub fn demonstration(&self, task: &Task) -> Result<Option<Demonstration>, MentorError> {
        let (Some(map), Some(mentor)) = (&task.map, task.mentor) else { return Ok(None) };
        demonstration(&Wanted {
            source: &task.preset,
            sets: &self.settings(task),
            map,
            mentor,
            seed: task.seed,
            trajectories: task.trajectories,
        })
        .map(Some)
    }
}

/// Whether `name` can be that of a directory: 1 to [`MAX_NAME`] of the letters a-z, A-Z, 0-9 and -_.@+, no dot first.
pub fn is_plain(name: &str) -> bool {
    let letter = |c: char| c.is_ascii_alphanumeric() || "-_.@+".contains(c);
    (1..=MAX_NAME).contains(&name.len()) && !name.starts_with('.') && name.chars().all(letter)
}

fn is_name(part: &str) -> bool {
    is_plain(part) && !["report", "maps", "demonstrations"].contains(&part)
}

/// Whether `name` is of the form of `pattern`, in which `*` stands for any letters and `?` for one.
pub fn matches(pattern: &str, name: &str) -> bool {
    let (pattern, name): (Vec<char>, Vec<char>) = (pattern.chars().collect(), name.chars().collect());
    // Which beginnings of the name the pattern so far has the form of.
    let mut fits = vec![false; name.len() + 1];
    fits[0] = true;
    for letter in pattern {
        let mut next = vec![false; name.len() + 1];
        for at in 0..=name.len() {
            next[at] = match letter {
                '*' => fits[at] || at > 0 && next[at - 1],
                '?' => at > 0 && fits[at - 1],
                letter => at > 0 && fits[at - 1] && name[at - 1] == letter,
            };
        }
        fits = next;
    }
    fits[name.len()]
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;
    use trestle_actor::env::registry;
    use trestle_proto::config;

    fn sets() -> [TaskSet; 2] {
        BUILTIN.map(|(name, _)| TaskSet::load(name).unwrap())
    }

    /// Every task has an environment, a goal that the observer reaches, and a demonstration that fits.
    #[test]
    fn every_task_can_be_run() {
        for set in sets() {
            for task in set.tasks() {
                let mut config = config::load(registry(), &task.preset, &set.settings(task)).unwrap();
                registry().resolve(&mut config.env, 0).unwrap();
                let env = registry().build(&config.env).unwrap_or_else(|e| panic!("{}: {e}", task.id));
                let demonstration =
                    set.demonstration(task).unwrap_or_else(|e| panic!("{}: {e}", task.id)).unwrap();
                let n = demonstration.n_states();
                let possible = (0..n).filter(|&m| env.can_be_in(demonstration.state(m)).is_ok()).count();
                if task.mentor == Some(Mentor::OtherMap) {
                    assert!(possible < n && 2 * possible > n, "{}: {possible} of {n}", task.id);
                } else {
                    assert_eq!(possible, n, "{}", task.id);
                }
                assert_eq!(demonstration.n_trajectories(), task.trajectories as usize, "{}", task.id);
                assert_eq!(Some(demonstration), set.demonstration(task).unwrap(), "{}", task.id);
                assert!(config.run.stop_when_solved && config.run.env_steps == Some(task.env_steps));
            }
        }
    }

    /// What is chosen on one set must say nothing about the other.
    #[test]
    fn the_sets_share_no_map_and_some_generators_are_for_the_report_alone() {
        let [choosing, reporting] = sets();
        let maps =
            |set: &TaskSet| set.tasks().iter().filter_map(|task| task.map.clone()).collect::<BTreeSet<_>>();
        assert!(maps(&choosing).is_disjoint(&maps(&reporting)));
        let mazes = |set: &TaskSet, group: &str| {
            let tasks = set.tasks().iter().filter(|task| task.id.starts_with(group));
            tasks.filter_map(|task| task.map.clone()).collect::<BTreeSet<_>>()
        };
        let generators = |maps: &BTreeSet<String>| {
            maps.iter().map(|map| map.split(':').next().unwrap().to_string()).collect::<BTreeSet<_>>()
        };
        let [coordinates, one_hot] =
            ["mazes-coordinates/", "mazes-one-hot/"].map(|group| mazes(&reporting, group));
        assert_eq!(coordinates, one_hot);
        assert!(one_hot.len() >= 40 && generators(&one_hot).len() >= 4, "{}", one_hot.len());
        assert!(generators(&one_hot).difference(&generators(&mazes(&choosing, "mazes-"))).count() >= 2);
    }

    #[test]
    fn what_is_no_set_is_refused_by_name() {
        let head = "format = 1\ntasks = [{ preset = \"maze-small\", mentor = \"short\", env_steps = 9, ";
        let task = |fields: &str| format!("{head}{fields} }}]");
        for (text, says) in [
            ("tasks = []".into(), "missing field `format`"),
            ("format = 1\ntasks = []".into(), "0 tasks; accepted: 1 to 1000"),
            (task("id = \"a\", map = \"maze30\""), "task \"a\"; accepted: <group>/<name>"),
            (task("id = \"a/../b\", map = \"maze30\""), "task \"a/../b\""),
            (task("id = \"report/b\", map = \"maze30\""), "neither called report"),
            (task("id = \"a/b\", map = \"random:run:9x9\""), "does not depend on a run's seed"),
            (task("id = \"a/b\", map = \"maze30\", trajectories = 0"), "trajectories = 0"),
            (task("id = \"a/b\""), "task a/b with [mentor]; accepted: map and mentor, or demo"),
            (
                task("id = \"a/b\", map = \"maze30\", demo = \"a.csv\""),
                "task a/b with [map, mentor, demo]; accepted: map and mentor, or demo",
            ),
            (task("id = \"a/b\", map = \"maze30\", set = [\"x\"]"), "the setting \"x\"; accepted: key=value"),
            (task("id = \"a/b\", map = \"maze30\", sets = []"), "unknown field `sets`"),
        ] {
            let error = TaskSet::parse("mine", &text).unwrap_err().to_string();
            assert!(error.starts_with("task set mine: ") && error.contains(says), "{says}: {error}");
        }
        let unknown = TaskSet::load("chosing").unwrap_err().to_string();
        assert!(
            unknown.contains("accepted: choosing, reporting, or a file; did you mean `choosing`?"),
            "{unknown}"
        );
    }

    #[test]
    fn a_task_can_bring_a_recorded_demonstration() {
        let text = "format = 1\nset = [\"eval.every=9\"]\n\
            tasks = [{ id = \"a/b\", preset = \"mine.toml\", demo = \"a b.csv\", env_steps = 9, set = [\"x=1\"] }]";
        let set = TaskSet::parse("mine", text).unwrap();
        let [task] = set.tasks() else { panic!("one task") };
        let expected = ["eval.every=9", "mentor.demo=\"a b.csv\"", "x=1", "run.env_steps=9"];
        assert_eq!(set.settings(task), expected);
        assert_eq!(set.demonstration(task).unwrap(), None);
    }

    #[test]
    fn patterns_fit_names() {
        for (pattern, name, fits) in [
            ("*", "a/b", true),
            ("", "", true),
            ("", "a", false),
            ("a?c", "abc", true),
            ("a?c", "ac", false),
            ("mazes-*/rooms*", "mazes-one-hot/rooms-14x14", true),
            ("mazes-*/rooms", "mazes-one-hot/rooms-14x14", false),
            ("*-hot*", "mazes-one-hot/x", true),
        ] {
            assert_eq!(matches(pattern, name), fits, "{pattern} {name}");
        }
    }

    proptest! {
        #[test]
        fn a_pattern_of_a_name_with_letters_left_out_fits(name in "[abc/]{0,8}", cut in prop::collection::vec(0u8..3, 8)) {
            let pattern: String = name.chars().zip(cut).map(|(c, cut)| ['*', '?', c][usize::from(cut)]).collect();
            prop_assert!(matches(&pattern, &name));
            let (open, longer) = (pattern + "*", name + "abc");
            prop_assert!(matches(&open, &longer));
        }
    }
}
