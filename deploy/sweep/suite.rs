//! A sweep over the tasks of a suite: every arm on every task, each with its own map, mentor and budget.

use super::arms::{Arm, OnTask};
use crate::prepare::quoted;
use anyhow::{Context, Result, ensure};
use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use trestle_mentor_server::demo_file;
use trestle_proto::rundir::{Durable, write_atomically};
use trestle_suite::mentor::map_text;
use trestle_suite::set::{Task, TaskSet, matches};

/// What stands for a suite in the place of a configuration.
pub(crate) const SUITE: &str = "suite";
/// The directories of maps and demonstrations, and the file with a command a task, in the sweep's directory.
const MAPS: &str = "maps";
const DEMONSTRATIONS: &str = "demonstrations";
const COMMANDS: &str = "tasks.txt";

/// The tasks of a set that a sweep runs.
pub(crate) struct Suite {
    set: TaskSet,
    tasks: Vec<Task>,
}

impl Suite {
    /// The tasks of the set called `name` whose names one of `patterns` fits; all of them without patterns.
    ///
    /// # Errors
    /// No such set, or a pattern that fits no task.
    pub(crate) fn load(name: &str, patterns: &[String]) -> Result<Self> {
        let set = TaskSet::load(name)?;
        for pattern in patterns {
            ensure!(
                set.tasks().iter().any(|task| matches(pattern, &task.id)),
                "--tasks {pattern} fits no task of the set {name}; accepted: names such as {}, or with * and ?",
                set.tasks()[0].id
            );
        }
        let wanted = |task: &&Task| patterns.is_empty() || patterns.iter().any(|p| matches(p, &task.id));
        let tasks = set.tasks().iter().filter(wanted).cloned().collect();
        Ok(Self { set, tasks })
    }

    /// Each of `arms` on each task, task by task: `<group>/<task>/<arm>`.
    pub(crate) fn arms(&self, arms: &[Arm]) -> Vec<Arm> {
        let on = |task: &Task, arm: &Arm| Arm {
            name: format!("{}/{}", task.id, arm.name),
            sets: arm.sets.clone(),
            task: Some(OnTask {
                preset: task.preset.clone(),
                sets: self.set.settings(task),
                demonstration: task.map.is_some().then(|| demonstration(task)),
            }),
        };
        self.tasks.iter().flat_map(|task| arms.iter().map(move |arm| on(task, arm))).collect()
    }

    /// Writes the maps and demonstrations that the tasks are made of into `out`, and the commands that run each task alone that is
    /// there. What is there already is written again: it is a function of the tasks.
    pub(crate) fn write(&self, out: &Path) -> Result<()> {
        for task in &self.tasks {
            if let Some(name) = &task.map {
                let text = map_text(name).with_context(|| format!("task {}", task.id))?;
                put(&map(out, name), |file| file.write_all(text.as_bytes()))?;
            }
            let Some(states) = self.set.demonstration(task).with_context(|| format!("task {}", task.id))?
            else {
                continue;
            };
            let mentor = out.join(demonstration(task));
            fs::create_dir_all(mentor.parent().unwrap_or(out))
                .with_context(|| format!("cannot make the directory of {}", mentor.display()))?;
            demo_file::write(&mentor, &states)?;
        }
        let is_there = |task: &&Task| match task.map {
            Some(_) => out.join(demonstration(task)).exists(),
            None => self.tasks.contains(task),
        };
        let there = self.set.tasks().iter().filter(is_there);
        let commands: String = there.map(|task| self.command(out, task)).collect();
        put(&out.join(COMMANDS), |file| file.write_all(commands.as_bytes()))
    }

    /// The command that trains on `task` alone, with its files in `out`.
    fn command(&self, out: &Path, task: &Task) -> String {
        let files = task.map.iter().flat_map(|name| {
            [
                format!("env.map={}", map(out, name).display()),
                format!("mentor.demo={}", out.join(demonstration(task)).display()),
            ]
        });
        let own = self.set.settings(task).into_iter().filter(|set| !set.starts_with("env.map="));
        let sets: String = own.chain(files).map(|set| format!(" --set {}", quoted(&set))).collect();
        format!("# {}\ntrestle train {}{sets}\n", task.id, quoted(&task.preset))
    }
}

/// The file of the map called `name` in the sweep's directory `out`.
fn map(out: &Path, name: &str) -> PathBuf {
    out.join(MAPS).join(format!("{}.txt", name.replace([':', '/'], "-")))
}

/// The file of a task's demonstration below the sweep's directory.
fn demonstration(task: &Task) -> PathBuf {
    Path::new(DEMONSTRATIONS).join(format!("{}.csv", task.id))
}

fn put(path: &Path, write: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<()> {
    if let Some(parent) = path.parent() {
        fs::create_dir_all(parent).with_context(|| format!("cannot make {}", parent.display()))?;
    }
    write_atomically(path, Durable::Later, |file| write(file))
        .with_context(|| format!("cannot write {}", path.display()))
}

/// For each of `arms` the number of its kind. On the tasks of a suite runs with one preset and one algorithm are of one kind;
/// otherwise each arm is of its own.
pub(crate) fn kinds(arms: &[Arm]) -> Vec<usize> {
    let mut known: BTreeMap<(&str, &str), usize> = BTreeMap::new();
    let mut kinds = Vec::with_capacity(arms.len());
    for (at, arm) in arms.iter().enumerate() {
        kinds.push(match &arm.task {
            Some(task) => *known.entry((&task.preset, label(&arm.name))).or_insert(at),
            None => at,
        });
    }
    kinds
}

/// The name of an arm without its task.
fn label(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or(name)
}

/// The group of tasks that an arm of a suite belongs to, and its name without its task.
pub(crate) fn place(name: &str) -> (&str, &str) {
    (name.split('/').next().unwrap_or(name), label(name))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::configuration;
    use super::*;
    use crate::flags::Limits;
    use crate::prepare::resolve;
    use trestle_proto::config::Algo;

    #[test]
    fn every_arm_meets_every_task() {
        let suite = Suite::load(
            "choosing",
            &["point-maze/labyrinth-9x9-2102-*".into(), "mazes-one-hot/halls-16x16-*".into()],
        )
        .unwrap();
        let arms = suite.arms(&[Arm::plain(Algo::Dqn), "x:learner.lr=0.5".parse().unwrap()]);
        let names: Vec<&str> = arms.iter().map(|arm| arm.name.as_str()).collect();
        assert_eq!(names.len(), 6);
        assert_eq!(names[..2], ["mazes-one-hot/halls-16x16-2001/dqn", "mazes-one-hot/halls-16x16-2001/x"]);
        assert_eq!(kinds(&arms), [0, 1, 2, 3, 2, 3]);
        assert_eq!(place(names[1]), ("mazes-one-hot", "x"));
        let error = Suite::load("choosing", &["nothing*".into()]).err().unwrap().to_string();
        assert!(error.contains("--tasks nothing* fits no task of the set choosing"), "{error}");
    }

    /// As a sweep does before it begins.
    #[test]
    fn every_task_of_every_set_could_be_run() {
        for name in ["choosing", "reporting"] {
            let dir = tempfile::tempdir().unwrap();
            let suite = Suite::load(name, &[]).unwrap();
            suite.write(dir.path()).unwrap();
            for arm in suite.arms(&[Arm::plain(Algo::HaDiiqn)]) {
                let config = configuration(SUITE, &[], Limits::default(), &arm, 0, dir.path()).unwrap();
                resolve(config).unwrap_or_else(|error| panic!("{}: {error:#}", arm.name));
            }
        }
    }

    #[test]
    fn maps_demonstrations_and_commands_are_written() {
        let dir = tempfile::tempdir().unwrap();
        let suite = Suite::load("choosing", &["mazes-coordinates/corridors-2-20x20-*".into()]).unwrap();
        suite.write(dir.path()).unwrap();
        let map = fs::read_to_string(dir.path().join("maps/corridors-2-2004-20x20.txt")).unwrap();
        assert_eq!((map.lines().count(), map.matches('G').count()), (20, 1));
        let file = dir.path().join("demonstrations/mazes-coordinates/corridors-2-20x20-2004.csv");
        assert!(demo_file::read(&file).unwrap().n_transitions() > 10);
        let commands = fs::read_to_string(dir.path().join("tasks.txt")).unwrap();
        let demo = format!("--set mentor.demo={}", file.display());
        assert!(commands.contains(&demo) && commands.contains("--set run.env_steps=200000"), "{commands}");
    }

    #[test]
    fn a_recorded_demonstration_stays_where_it_is() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("set.toml");
        let task = "{ id = 'a/b', preset = 'maze-small', demo = 'mine.csv', env_steps = 9 }";
        fs::write(&file, format!("format = 1\ntasks = [{task}]")).unwrap();
        let suite = Suite::load(&file.display().to_string(), &[]).unwrap();
        suite.write(dir.path()).unwrap();
        let commands = fs::read_to_string(dir.path().join("tasks.txt")).unwrap();
        assert!(commands.contains("trestle train maze-small --set 'mentor.demo=\"mine.csv\"'"), "{commands}");
        assert!(!dir.path().join("maps").exists() && !dir.path().join("demonstrations").exists());
        let arm = &suite.arms(&[Arm::plain(Algo::HaDiiqn)])[0];
        let config = configuration(SUITE, &[], Limits::default(), arm, 0, dir.path()).unwrap();
        assert_eq!(config.mentor.demo.iter().collect::<Vec<_>>(), [("mentor", "mine.csv")]);
    }
}
