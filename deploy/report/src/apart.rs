//! Tells apart runs that a name alone would put together: those outside of a sweep are called after their environment and their
//! algorithm, and may have other settings all the same.
//!
//! Settings of the environment, and what counts as solved, make another task. All others make another arm, but for those that say
//! how long and where a run is trained ([`ASIDE`]). A sweep has named its arms itself: there differences are only noted.

use crate::run::Run;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use trestle_proto::config::{Config, PLAN, Table, Value};
use trestle_proto::regular_file;
use trestle_proto::rng::mix;
use trestle_proto::rundir::RunDir;

/// Settings, and tables of settings, that never make another arm: seed, length, files, upkeep, and numbers that are filled in for
/// what is `auto`, which may depend on the seed.
const ASIDE: [&str; 17] = [
    "env.name",
    "env.hazard",
    "run.algo",
    "run.seed",
    "run.episodes",
    "run.env_steps",
    "run.stop_when_solved",
    "learner.threads",
    "mentor.demo",
    "mentor.e_th",
    "mentor.e_infeas",
    "mentor.learned.radius",
    "mentor.learned.window",
    "mentor.learned.lookahead",
    "eval",
    "checkpoint",
    "supervise",
];
/// Settings beside the environment's that make another task.
const OF_TASK: [&str; 2] = ["eval.threshold", "eval.tolerance"];
/// A setting of every environment that makes another arm: what the network sees of a state.
const ENCODING: &str = "env.encoding";
/// Longest value that is part of a name, characters.
const MAX_VALUE: usize = 40;
/// Settings that are part of a name, at most.
const MAX_KEYS: usize = 3;
/// Largest demonstration that is compared with others, bytes.
const MAX_DEMONSTRATION: u64 = 1 << 28;

/// Settings by their dotted keys.
type Settings = BTreeMap<String, String>;

/// All settings by their dotted keys.
pub(crate) fn settings(config: &Config) -> Settings {
    let mut found = BTreeMap::new();
    // Every configuration has a form as TOML.
    let mut open = vec![(String::new(), Table::try_from(config).unwrap_or_default())];
    while let Some((above, table)) = open.pop() {
        for (key, value) in table {
            let key = if above.is_empty() { key } else { format!("{above}.{key}") };
            match value {
                Value::Table(table) => open.push((key, table)),
                value => _ = found.insert(key, value.to_string()),
            }
        }
    }
    found
}

/// Whether `key` is the setting `of`, or one of the table `of`.
fn is_of(key: &str, of: &str) -> bool {
    key.strip_prefix(of).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

/// What of a run's settings makes another task. `filled` are the settings of its environment's own table that do not.
fn of_task(config: &Config, filled: &[&str]) -> Settings {
    let own = |name: &str| format!("env.{}.{name}", config.env.name);
    let filled: Vec<String> = filled.iter().map(|name| own(name)).collect();
    let aside = |key: &str| {
        ASIDE.iter().any(|of| is_of(key, of)) || key == ENCODING || filled.iter().any(|of| is_of(key, of))
    };
    let mut all = settings(config);
    all.retain(|key, _| OF_TASK.contains(&key.as_str()) || (is_of(key, "env") && !aside(key)));
    all
}

/// What of a run's settings makes another arm. A demonstration counts by what is in it, not by where it is.
fn of_arm(run: &Run) -> Settings {
    let mut all = settings(&run.config);
    all.retain(|key, _| (!is_of(key, "env") || key == ENCODING) && !ASIDE.iter().any(|of| is_of(key, of)));
    // One process computes what several do.
    if let Some(mode) = all.get_mut("run.mode").filter(|mode| *mode == "\"reference\"") {
        *mode = "\"lockstep\"".into();
    }
    let dir = RunDir::new(&run.path);
    let demos = &run.config.mentor.demo;
    for (name, _) in demos.iter().filter(|(_, source)| *source != PLAN) {
        let file = if demos.is_one() { dir.demonstration() } else { dir.demonstration_of(name) };
        if let Ok(bytes) = regular_file::read(&file, MAX_DEMONSTRATION) {
            let key = if demos.is_one() { "mentor.demo".into() } else { format!("mentor.demo.{name}") };
            all.insert(key, format!("file {}", digest(&bytes)));
        }
    }
    all
}

/// A short name for `bytes`.
fn digest(bytes: &[u8]) -> String {
    let hash = bytes.iter().fold(bytes.len() as u64, |hash, &byte| mix(hash ^ u64::from(byte)));
    format!("{:06x}", hash & 0xff_ffff)
}

/// The keys in which `all` are not the same.
fn differing(all: &[&Settings]) -> Vec<String> {
    let keys: BTreeSet<&String> = all.iter().flat_map(|settings| settings.keys()).collect();
    let differs = |key: &&String| all.iter().any(|settings| settings.get(*key) != all[0].get(*key));
    keys.into_iter().filter(differs).cloned().collect()
}

/// `settings` in the `keys` in which they differ from others', as part of a name; nothing where they have none of these.
fn label(settings: &Settings, keys: &[String], env: &str) -> String {
    let own = format!("env.{env}.");
    let given = keys.iter().filter_map(|key| Some((key, settings.get(key)?)));
    let given: Vec<String> = given
        .filter(|(_, value)| !["[]", "{}", "\"\""].contains(&value.as_str()))
        .map(|(key, value)| {
            let plain = value.strip_prefix('"').and_then(|rest| rest.strip_suffix('"')).unwrap_or(value);
            let mut shown: String = plain.chars().take(MAX_VALUE).collect();
            if shown.len() < plain.len() {
                let _ = write!(shown, "... ({})", digest(value.as_bytes()));
            }
            format!("{}={shown}", key.strip_prefix(&own).or(key.strip_prefix("env.")).unwrap_or(key))
        })
        .collect();
    if given.len() <= MAX_KEYS {
        return given.join(", ");
    }
    let all = digest(given.join(", ").as_bytes());
    format!("{}, and {} more ({all})", given[..MAX_KEYS].join(", "), given.len() - MAX_KEYS)
}

/// A run that has one name with others.
struct Member<'a> {
    /// Whether it is outside of a sweep.
    loose: bool,
    settings: &'a Settings,
    /// Its environment.
    env: &'a str,
}

/// What is added to the name of each of `group`, so that equal names mean equal settings, and the keys in which they differ; no key
/// where nothing is added. A sweep's runs keep their name.
fn additions(group: &[Member<'_>]) -> (Vec<String>, Vec<String>) {
    let all: Vec<&Settings> = group.iter().map(|member| member.settings).collect();
    let keys = differing(&all);
    let reference = group.iter().find(|member| !member.loose).map(|member| member.settings);
    let addition = |member: &Member<'_>| {
        let label = label(member.settings, &keys, member.env);
        match reference {
            _ if !member.loose => String::new(),
            Some(reference) if differing(&[reference, member.settings]).is_empty() => String::new(),
            Some(_) if label.is_empty() => format!(", {} unset", keys.join(", ")),
            _ if label.is_empty() => String::new(),
            _ => format!(", {label}"),
        }
    };
    let added: Vec<String> = group.iter().map(addition).collect();
    let any = added.iter().any(|addition| !addition.is_empty());
    (added, if any { keys } else { Vec::new() })
}

/// Splits tasks and arms whose runs have different settings, and notes it. `is_loose` says of a run whether it is outside of a sweep,
/// `filled` which settings of an environment's own table are none that somebody chooses.
pub(crate) fn tell_apart(
    runs: &mut [Run],
    notes: &mut Vec<String>,
    is_loose: impl Fn(&Run) -> bool,
    filled: impl Fn(&Config) -> &'static [&'static str],
) {
    let loose: Vec<bool> = runs.iter().map(is_loose).collect();
    let tasks: Vec<Settings> = runs.iter().map(|run| of_task(&run.config, filled(&run.config))).collect();
    for of in groups(runs, |run| run.task.clone()) {
        let name = runs[of[0]].task.clone();
        let (added, keys) = additions(&members(runs, &of, &loose, |at| &tasks[at]));
        of.iter().zip(added).for_each(|(&at, addition)| runs[at].task.push_str(&addition));
        if !keys.is_empty() {
            notes.push(format!("runs of {name} are several tasks: they differ in {}", keys.join(", ")));
        }
        let swept: Vec<&Settings> = of.iter().filter(|&&at| !loose[at]).map(|&at| &tasks[at]).collect();
        let keys = differing(&swept);
        if !keys.is_empty() {
            let keys = keys.join(", ");
            notes.push(format!(
                "the arms of {name} are compared as on one task, though they differ in {keys}"
            ));
        }
    }
    for of in groups(runs, |run| (run.task.clone(), run.arm.clone())).into_iter().filter(|of| of.len() > 1) {
        let (task, name) = (runs[of[0]].task.clone(), runs[of[0]].arm.clone());
        let arms: BTreeMap<usize, Settings> = of.iter().map(|&at| (at, of_arm(&runs[at]))).collect();
        let (added, keys) = additions(&members(runs, &of, &loose, |at| &arms[&at]));
        of.iter().zip(added).for_each(|(&at, addition)| runs[at].arm.push_str(&addition));
        if !keys.is_empty() {
            let keys = keys.join(", ");
            notes.push(format!("runs of {name} on {task} are several arms: they differ in {keys}"));
        }
        let swept: Vec<&Settings> = of.iter().filter(|&&at| !loose[at]).map(|at| &arms[at]).collect();
        let keys = differing(&swept);
        if !keys.is_empty() {
            notes.push(format!("runs of the arm {name} on {task} differ in {}", keys.join(", ")));
        }
    }
}

/// Notes every seed that counts more than once in an arm, and in what its runs differ.
pub(crate) fn note_repeated_seeds(runs: &[Run], notes: &mut Vec<String>) {
    for of in groups(runs, |run| (run.task.clone(), run.arm.clone(), run.config.run.seed)) {
        let [first, .., last] = &of[..] else { continue };
        let all: Vec<Settings> = of.iter().map(|&at| settings(&runs[at].config)).collect();
        let mut keys = differing(&all.iter().collect::<Vec<_>>());
        keys.retain(|key| !is_of(key, "mentor.demo") && !key.ends_with(".found"));
        let keys = if keys.is_empty() { "no setting".into() } else { keys.join(", ") };
        let Run { task, arm, config, .. } = &runs[*first];
        notes.push(format!(
            "the arm {arm} on {task} has {} runs of seed {}, and each counts, such as {} and {}; they differ in {keys}",
            of.len(),
            config.run.seed,
            runs[*first].path.display(),
            runs[*last].path.display(),
        ));
    }
}

/// The numbers of the runs with the same `key`.
fn groups<K: Ord>(runs: &[Run], key: impl Fn(&Run) -> K) -> Vec<Vec<usize>> {
    let mut groups: BTreeMap<K, Vec<usize>> = BTreeMap::new();
    runs.iter().enumerate().for_each(|(at, run)| groups.entry(key(run)).or_default().push(at));
    groups.into_values().collect()
}

/// The runs with the numbers `of` as [`additions`] takes them.
fn members<'a>(
    runs: &'a [Run],
    of: &[usize],
    loose: &[bool],
    settings: impl Fn(usize) -> &'a Settings,
) -> Vec<Member<'a>> {
    let member =
        |&at: &usize| Member { loose: loose[at], settings: settings(at), env: &runs[at].config.env.name };
    of.iter().map(member).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::path::Path;

    /// A run of `algo` in `path`, with `text` as its settings.
    fn run(path: &str, seed: u64, text: &str) -> Run {
        let mut config = trestle_proto::config::parse_toml("test", text).unwrap();
        config.run.seed = seed;
        Run { config, ..Run::blank(path, "dqn", "gym drone") }
    }

    const BASE: &str = "[run]\nalgo = \"dqn\"\nenv_steps = 9\n[env]\nname = \"gym\"\n[env.gym]\nid = \"D\"\n";

    fn told(runs: &mut [Run]) -> Vec<String> {
        let mut notes = Vec::new();
        let loose = |run: &Run| !run.path.starts_with("sweep");
        tell_apart(runs, &mut notes, loose, |_| &["found"]);
        note_repeated_seeds(runs, &mut notes);
        notes
    }

    #[test]
    fn another_body_is_another_task() {
        let observer = format!("{BASE}kwargs = {{ body = \"observer\" }}\nfound = \"a\"\n");
        let mentor = format!("{BASE}found = \"b\"\n");
        let again = format!("{BASE}found = \"c\"\n[eval]\nevery = 7\n[checkpoint]\nkeep = 3\n");
        let mut runs = [run("a", 0, &observer), run("b", 0, &mentor), run("c", 1, &again)];
        let notes = told(&mut runs);
        let tasks: Vec<&str> = runs.iter().map(|run| &run.task[..]).collect();
        assert_eq!(tasks, ["gym drone, kwargs.body=observer", "gym drone", "gym drone"]);
        assert!(runs.iter().all(|run| run.arm == "dqn"));
        assert_eq!(notes, ["runs of gym drone are several tasks: they differ in env.gym.kwargs.body"]);
        // What counts as solved belongs to the task as well.
        let mut runs = [run("a", 0, BASE), run("b", 0, &format!("{BASE}[eval]\nthreshold = 0.5\n"))];
        told(&mut runs);
        assert_eq!(runs[1].task, "gym drone, eval.threshold=0.5");
    }

    #[test]
    fn another_learner_is_another_arm_and_a_longer_run_is_not() {
        let text = |more: &str| format!("{BASE}{more}");
        let mut runs = [
            run("a", 0, BASE),
            run("b", 1, &text("[mentor]\nfeatures = [2, 3]\ne_th = 0.5\n")),
            run("c", 1, &text("[mentor]\ne_th = 0.7\n").replace("env_steps = 9", "env_steps = 5")),
            run("d", 1, BASE),
        ];
        let notes = told(&mut runs);
        let arms: Vec<&str> = runs.iter().map(|run| &run.arm[..]).collect();
        assert_eq!(arms, ["dqn", "dqn, mentor.features=[2, 3]", "dqn", "dqn"]);
        assert_eq!(notes[0], "runs of dqn on gym drone are several arms: they differ in mentor.features");
        assert_eq!(
            notes[1],
            "the arm dqn on gym drone has 2 runs of seed 1, and each counts, such as c and d; they differ in mentor.e_th, \
             run.env_steps"
        );
        assert_eq!(notes.len(), 2);
    }

    #[test]
    fn a_sweep_names_its_arms_and_what_differs_is_noted() {
        let other = format!("{BASE}kwargs = {{ force = 2 }}\n");
        let mut runs =
            [run("sweep/a", 0, BASE), run("sweep/b", 0, &other), run("x", 1, &other), run("y", 2, BASE)];
        runs[1].arm = "weak".into();
        let notes = told(&mut runs);
        let tasks: Vec<&str> = runs.iter().map(|run| &run.task[..]).collect();
        assert_eq!(tasks, ["gym drone", "gym drone", "gym drone, kwargs.force=2", "gym drone"]);
        assert!(
            notes
                .iter()
                .any(|note| note.contains("as on one task, though they differ in env.gym.kwargs.force"))
        );
        let mut one = [run("sweep/a", 0, BASE), run("sweep/b", 1, BASE)];
        assert_eq!(told(&mut one), [] as [String; 0]);
        assert_eq!(one[0].path, Path::new("sweep/a"));
    }

    #[test]
    fn demonstrations_count_by_what_is_in_them() {
        let dir = tempfile::tempdir().unwrap();
        let with = |name: &str, seed: u64, states: &str| {
            let path = dir.path().join(name);
            std::fs::create_dir(&path).unwrap();
            std::fs::write(RunDir::new(&path).demonstration(), states).unwrap();
            run(path.to_str().unwrap(), seed, &format!("{BASE}[mentor]\ndemo = \"{name}.csv\"\n"))
        };
        let mut runs = [with("a", 0, "1"), with("b", 1, "1"), with("c", 0, "2")];
        told(&mut runs);
        assert_eq!(runs[0].arm, runs[1].arm);
        assert_ne!(runs[0].arm, runs[2].arm);
        assert!(runs[2].arm.starts_with("dqn, mentor.demo=file "), "{}", runs[2].arm);
    }
}
