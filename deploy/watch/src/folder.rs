//! A folder of runs or a sweep, as its page shows it: a row a run, a curve with a band an arm.
//!
//! A look takes a bounded time. Where there are more runs than it can see to, the next look goes on with them.

use crate::arms::{Curve, arms};
use crate::facts::{self, Facts};
use crate::locks::Locks;
use crate::records::Records;
use crate::root::{Below, Dir, Root, Stamp};
use crate::run::{State, is_fresh, is_run, now_s, state};
use crate::tail::last_lines;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::time::{Duration, Instant};
use trestle_proto::run_files::{EVALS_FILE, LOGS_DIR, METRICS_FILE, RESULT_FILE};
use trestle_proto::run_result::RunResult;

/// Levels of directories in which runs are looked for.
const MAX_DEPTH: usize = 4;
/// Runs that are seen to, at most.
const MAX_RUNS: usize = 10_000;
/// Directories that are looked into for runs, at most.
const MAX_DIRS: usize = 100_000;
/// Rows of the table that a page gets, at most.
const MAX_ROWS: usize = 1_000;
/// Evaluations that are kept of a run.
const POINTS: usize = 48;
/// Bytes of evals.csv that are read of a run in one look.
const BUDGET: usize = 1 << 20;
/// Bytes at the end of metrics.jsonl in which the newest counts are looked for.
const METRICS_END: u64 = 4 << 10;
/// Time that a look takes, about.
const LOOK: Duration = Duration::from_millis(300);
/// Least time between two searches for new runs, and how many times as long as the last search took.
const SEARCH_EVERY: Duration = Duration::from_secs(2);
const SEARCH_SHARE: u32 = 20;
/// Largest sweep.json that is read, bytes.
const MAX_SWEEP: u64 = 4 << 20;

/// What is known of one run.
#[derive(Debug)]
struct Summary {
    facts: Facts,
    records: Records,
    state: State,
    result: Option<RunResult>,
    reason: Option<String>,
    /// Episodes, environment steps, seconds.
    counts: [f64; 3],
    /// The last look at it: what its files were like then.
    seen: Option<Seen>,
}

/// The files by whose change a run is known to have changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Seen {
    config: Option<Stamp>,
    result: Option<Stamp>,
    evals: Option<Stamp>,
    locked: bool,
}

/// What is known of a folder, and kept up to date.
#[derive(Debug)]
pub(crate) struct FolderPage {
    below: Below,
    runs: BTreeMap<Below, Summary>,
    /// More runs or directories than are looked at.
    more: bool,
    searched: Option<Instant>,
    search_took: Duration,
    /// Where the next look goes on.
    next: Option<Below>,
    /// Whether every run has been seen to once.
    whole: bool,
}

/// A row of the table.
#[derive(Serialize)]
struct Row<'a> {
    below: String,
    name: String,
    arm: &'a str,
    seed: u64,
    env: &'a str,
    state: State,
    reason: Option<&'a str>,
    share: f64,
    episodes: f64,
    env_steps: f64,
    wall_s: f64,
    best_return: Option<f64>,
    last_return: Option<f64>,
    solved_episode: Option<u64>,
    solved_env_steps: Option<u64>,
}

/// What sweep.json says of the runs that are to come.
#[derive(Deserialize)]
struct Manifest {
    source: String,
    arms: Vec<serde::de::IgnoredAny>,
    seeds: Vec<serde::de::IgnoredAny>,
}

impl FolderPage {
    pub(crate) fn new(below: Below) -> Self {
        Self {
            below,
            runs: BTreeMap::new(),
            more: false,
            searched: None,
            search_took: Duration::ZERO,
            next: None,
            whole: false,
        }
    }

    /// Reads what is new, and gives the whole as JSON.
    ///
    /// # Errors
    /// The folder cannot be opened.
    pub(crate) fn look(&mut self, root: &Root, locks: &Locks) -> io::Result<String> {
        let dir = root.dir(&self.below)?;
        let pause = SEARCH_EVERY.max(self.search_took * SEARCH_SHARE);
        if self.searched.is_none_or(|at| at.elapsed() >= pause) {
            self.search(&dir)?;
        }
        self.see_to_runs(root, locks);
        Ok(self.page(root, &dir))
    }

    /// Finds the runs that are there now.
    fn search(&mut self, dir: &Dir) -> io::Result<()> {
        let start = Instant::now();
        let mut found = Found::default();
        find(dir, &self.below, 0, &mut found)?;
        found.runs.sort_unstable();
        self.more = found.more;
        let before = self.runs.len();
        self.runs.retain(|below, _| found.runs.binary_search(below).is_ok());
        for below in found.runs {
            self.runs.entry(below).or_insert_with(|| Summary {
                facts: Facts::default(),
                records: Records::new(POINTS),
                state: State::Nothing,
                result: None,
                reason: None,
                counts: [0.0; 3],
                seen: None,
            });
        }
        if self.runs.len() > before {
            self.whole = false;
        }
        (self.searched, self.search_took) = (Some(Instant::now()), start.elapsed());
        Ok(())
    }

    /// Brings the runs up to date, from where the last look stopped.
    fn see_to_runs(&mut self, root: &Root, locks: &Locks) {
        let start = Instant::now();
        let now = now_s();
        let from = self.next.take();
        let order: Vec<Below> = match &from {
            Some(from) => {
                self.runs.range(from..).chain(self.runs.range(..from)).map(|(b, _)| b.clone()).collect()
            }
            None => self.runs.keys().cloned().collect(),
        };
        for below in order {
            if start.elapsed() > LOOK {
                self.next = Some(below);
                break;
            }
            if let (Some(summary), Ok(dir)) = (self.runs.get_mut(&below), root.dir(&below)) {
                summary.look(&dir, locks, now);
            }
        }
        self.whole |= self.runs.values().all(|summary| summary.seen.is_some());
    }

    fn page(&self, root: &Root, dir: &Dir) -> String {
        let mut counts: BTreeMap<State, usize> = BTreeMap::new();
        for summary in self.runs.values() {
            *counts.entry(summary.state).or_default() += 1;
        }
        let solved = self.runs.values().filter(|summary| summary.solved().is_some()).count();
        let manifest = dir
            .read("sweep.json", MAX_SWEEP)
            .ok()
            .and_then(|bytes| serde_json::from_slice::<Manifest>(&bytes).ok());
        let planned = manifest.as_ref().map(|sweep| sweep.arms.len().saturating_mul(sweep.seeds.len()));
        let mut rows: Vec<(&Below, &Summary)> = self.runs.iter().collect();
        if rows.len() > MAX_ROWS {
            // Runs that go on or went wrong are looked for first.
            rows.sort_by_key(|(below, summary)| (rank(summary.state), *below));
            rows.truncate(MAX_ROWS);
            rows.sort_by_key(|(below, _)| *below);
        }
        let rows: Vec<Row<'_>> = rows.into_iter().map(|(below, summary)| self.row(below, summary)).collect();
        let tasks = self.tasks();
        let runs = self.runs.iter().zip(&tasks);
        let curves: Vec<Curve<'_>> =
            runs.map(|((below, summary), task)| self.curve(below, summary, task)).collect();
        json!({
            "kind": "folder",
            "below": self.below.to_string(),
            "path": root.path_of(&self.below),
            "sweep": manifest.as_ref().map(|sweep| facts::shown(&sweep.source, 200)),
            "planned": planned,
            "runs": self.runs.len(),
            "counts": counts,
            "solved": solved,
            "more": self.more,
            "whole": self.whole,
            "left_s": self.left(planned),
            "rows": rows,
            "arms": arms(&curves),
        })
        .to_string()
    }

    /// The place of the arm's directory among the names of a run in `<arm>/seed-<N>`.
    fn arm_at(&self, below: &Below) -> Option<usize> {
        let names = below.names();
        let seed = names.last().is_some_and(|name| name.starts_with("seed-"));
        names.len().checked_sub(2).filter(|&at| seed && at >= self.below.names().len())
    }

    /// The arm of a run: in a sweep the directory of its arm, or else its algorithm.
    fn arm<'a>(&self, below: &'a Below, summary: &'a Summary) -> &'a str {
        self.arm_at(below).map_or(&summary.facts.arm, |at| &below.names()[at])
    }

    /// The tasks of the runs, in their order, by the names that reports give them: the environment, with the directory above the
    /// arm's where that has several, or a suite's group and task.
    fn tasks(&self) -> Vec<String> {
        let above = |below: &Below| {
            self.arm_at(below)
                .map_or(String::new(), |at| below.names()[self.below.names().len()..at].join("/"))
        };
        let above: Vec<String> = self.runs.keys().map(above).collect();
        let mut places: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
        for (summary, above) in self.runs.values().zip(&above) {
            places.entry(&summary.facts.env).or_default().insert(above);
        }
        let name = |(summary, above): (&Summary, &String)| {
            let env = summary.facts.env.as_str();
            if above.split('/').count() == 2 {
                above.clone()
            } else if places[env].len() > 1 && !above.is_empty() {
                format!("{env}, {above}")
            } else {
                env.into()
            }
        };
        self.runs.values().zip(&above).map(name).collect()
    }

    fn row<'a>(&self, below: &'a Below, summary: &'a Summary) -> Row<'a> {
        let [episodes, env_steps, wall_s] = summary.counts;
        let standing = &summary.records.evals.standing;
        let solved = summary.solved();
        Row {
            name: below.after(&self.below).join("/"),
            below: below.to_string(),
            arm: self.arm(below, summary),
            seed: summary.facts.seed,
            env: &summary.facts.env,
            state: summary.state,
            reason: summary.reason.as_deref(),
            share: summary.share(),
            episodes,
            env_steps,
            wall_s,
            best_return: standing.best_return(),
            last_return: standing.final_return(),
            solved_episode: solved.map(|at| at.0),
            solved_env_steps: solved.map(|at| at.1),
        }
    }

    fn curve<'a>(&self, below: &'a Below, summary: &'a Summary, task: &'a str) -> Curve<'a> {
        Curve {
            task,
            arm: self.arm(below, summary),
            ended: summary.state == State::Finished,
            solved: summary.solved().is_some(),
            threshold: summary.facts.threshold,
            table: &summary.records.evals.table,
        }
    }

    /// Seconds until all runs are done, at the pace of those that have done something, as many at once as there are now.
    fn left(&self, planned: Option<usize>) -> Option<f64> {
        let running = self.runs.values().filter(|summary| summary.state == State::Running).count();
        let (mut done, mut seconds) = (0.0, 0.0);
        for summary in self.runs.values().filter(|summary| summary.share() > 0.0) {
            done += summary.share();
            seconds += summary.counts[2];
        }
        let given_up = self.runs.values().filter(|summary| summary.state == State::Failed).count() as f64;
        let all = planned.unwrap_or(0).max(self.runs.len()) as f64 - given_up;
        (running > 0 && done > 0.0 && seconds > 0.0)
            .then(|| (all - done).max(0.0) * (seconds / done) / running as f64)
    }
}

fn rank(state: State) -> u8 {
    match state {
        State::Failed => 0,
        State::Running | State::Starting => 1,
        State::Interrupted => 2,
        State::Finished | State::Nothing => 3,
    }
}

#[derive(Default)]
struct Found {
    runs: Vec<Below>,
    dirs: usize,
    more: bool,
}

/// Adds the runs in `dir`, which is `below` the root, in their order. A run is not searched any deeper.
fn find(dir: &Dir, below: &Below, depth: usize, found: &mut Found) -> io::Result<()> {
    if depth > 0 && is_run(dir) {
        found.runs.push(below.clone());
        return Ok(());
    }
    let (entries, more) = dir.entries()?;
    found.more |= more;
    for (name, directory) in entries {
        if !directory {
            continue;
        }
        if found.runs.len() == MAX_RUNS || found.dirs == MAX_DIRS {
            found.more = true;
            return Ok(());
        }
        found.dirs += 1;
        if let (true, Some(below), Ok(inner)) = (depth < MAX_DEPTH, below.join(&name), dir.dir(&name)) {
            // A directory that cannot be listed has no runs to show.
            let _ = find(&inner, &below, depth + 1, found);
        }
    }
    Ok(())
}

impl Summary {
    fn look(&mut self, dir: &Dir, locks: &Locks, now: i64) {
        let locked = dir.identity().is_ok_and(|identity| locks.hold(identity));
        let stamp = |name| facts::stamp(dir, name);
        let seen = Seen {
            config: stamp(trestle_proto::run_files::CONFIG_FILE),
            result: stamp(RESULT_FILE),
            evals: stamp(EVALS_FILE),
            locked,
        };
        let settled = !matches!(self.state, State::Nothing | State::Starting | State::Running);
        if settled && self.seen == Some(seen) && self.records.share() >= 1.0 {
            return;
        }
        if self.seen.is_none_or(|before| before.config != seen.config || before.result != seen.result) {
            self.facts = Facts::read(dir);
            // There may be thousands of runs.
            (self.facts.actions, self.facts.command) = (Vec::new(), String::new());
        }
        if self.seen.is_none_or(|before| before.result != seen.result) {
            self.result = facts::result(dir);
        }
        // What cannot be read is not shown.
        let _ = self.records.look_at_evals(dir, self.facts.goal(), BUDGET);
        let metrics = last_lines(dir, METRICS_FILE, METRICS_END).unwrap_or_default();
        let newest = metrics.iter().rev().find_map(|line| counts(line));
        self.counts = match (&self.result, newest) {
            (Some(result), _) => [result.episodes as f64, result.env_steps as f64, result.wall_s],
            (None, newest) => newest.unwrap_or_default(),
        };
        let fresh = is_fresh(dir, &[METRICS_FILE, EVALS_FILE], now);
        let alive = locked || fresh && self.result.is_none();
        self.reason = None;
        if self.result.is_none() && !locked {
            let events = dir.dir(LOGS_DIR).map(|logs| facts::events(&logs)).unwrap_or_default();
            self.reason = facts::given_up(&events).map(Into::into);
        }
        let given_up = self.reason.is_some();
        self.state = state(alive && !given_up, newest.is_some(), self.result.as_ref(), given_up);
        self.seen = Some(seen);
    }

    /// Episode and environment steps at which the run was solved.
    fn solved(&self) -> Option<(u64, u64)> {
        let said = self.result.as_ref().and_then(|result| result.solved_episode.zip(result.solved_env_steps));
        said.or_else(|| self.records.evals.standing.solved().map(|at| (at.episode, at.env_steps)))
    }

    fn share(&self) -> f64 {
        match self.state {
            State::Finished => 1.0,
            _ => self.facts.share(self.counts[0], self.counts[1]),
        }
    }
}

/// Episodes, environment steps and seconds in a line of `metrics.jsonl`.
fn counts(line: &str) -> Option<[f64; 3]> {
    let row: serde_json::Value = serde_json::from_str(line).ok()?;
    let number = |key: &str| row[key].as_f64();
    Some([number("time/episodes")?, number("time/total_timesteps")?, number("time/time_elapsed")?])
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::fs;
    use std::path::Path;
    use trestle_proto::config::{self, Config};

    fn write_run(at: &Path, seed: u64, evals: &str) {
        fs::create_dir_all(at.join("logs")).unwrap();
        let mut config = Config::default();
        (config.run.seed, config.run.episodes, config.eval.threshold) = (seed, Some(10), Some(-1.0));
        fs::write(at.join("config.toml"), config::to_toml(&config)).unwrap();
        fs::write(
            at.join("evals.csv"),
            format!("episode,env_steps,grad_steps,wall_s,return,length,success\n{evals}"),
        )
        .unwrap();
    }

    fn looked(page: &mut FolderPage, root: &Root) -> serde_json::Value {
        serde_json::from_str(&page.look(root, &Locks::default()).unwrap()).unwrap()
    }

    #[test]
    fn runs_are_found_and_links_are_not_followed() {
        let place = tempfile::tempdir().unwrap();
        let outside = tempfile::tempdir().unwrap();
        write_run(&outside.path().join("secret"), 9, "");
        let evals = "0,0,0,0,-9,9,0\n1,9,1,1,-1,9,1\n2,18,2,2,-1,9,1\n3,27,3,3,-1,9,1\n";
        for (arm, seed) in [("a", 0), ("a", 1), ("<b>", 0)] {
            write_run(&place.path().join(format!("{arm}/seed-{seed}")), seed, evals);
        }
        std::os::unix::fs::symlink(outside.path(), place.path().join("link")).unwrap();
        std::os::unix::fs::symlink(place.path(), place.path().join("a/loop")).unwrap();
        fs::create_dir_all(place.path().join(".probe-1/seed-0/logs")).unwrap();
        fs::write(
            place.path().join("sweep.json"),
            "{\"source\":\"m\",\"arms\":[{},{}],\"seeds\":[0,1],\"x\":1}",
        )
        .unwrap();
        let root = Root::new(place.path()).unwrap();
        let mut page = FolderPage::new(Below::default());
        let seen = looked(&mut page, &root);
        assert_eq!((&seen["runs"], &seen["planned"], &seen["solved"]), (&json!(3), &json!(4), &json!(3)));
        let rows: Vec<_> =
            seen["rows"].as_array().unwrap().iter().map(|row| row["arm"].as_str().unwrap()).collect();
        assert_eq!(rows, ["<b>", "a", "a"]);
        assert_eq!(seen["arms"][0]["arms"][1]["runs"], 2);
        assert!(!seen.to_string().contains("secret"));
        fs::remove_dir_all(place.path().join("a")).unwrap();
        page.searched = None;
        assert_eq!(looked(&mut page, &root)["runs"], 1);
        fs::remove_dir_all(place.path()).unwrap();
        assert!(page.look(&root, &Locks::default()).is_err(), "the folder is gone");
    }

    /// Two tasks of a suite have one environment, and different mentors.
    #[test]
    fn tasks_have_the_names_that_reports_give_them() {
        let names = |runs: &[&str]| {
            let place = tempfile::tempdir().unwrap();
            runs.iter().for_each(|run| write_run(&place.path().join(run), 0, "0,0,0,0,-9,9,0\n"));
            let seen = looked(&mut FolderPage::new(Below::default()), &Root::new(place.path()).unwrap());
            let tasks =
                seen["arms"].as_array().unwrap().iter().map(|task| task["task"].as_str().unwrap().into());
            tasks.collect::<Vec<String>>()
        };
        assert_eq!(names(&["g/a/dqn/seed-0", "g/b/dqn/seed-0", "g/b/dqn/seed-1"]), ["g/a", "g/b"]);
        assert_eq!(names(&["x/dqn/seed-0", "y/dqn/seed-0", "z"]), ["maze", "maze, x", "maze, y"]);
        assert_eq!(names(&["x/dqn/seed-0", "x/ha-diiqn/seed-0"]), ["maze"]);
    }

    #[test]
    fn a_run_is_not_searched_for_runs() {
        let place = tempfile::tempdir().unwrap();
        write_run(&place.path().join("r"), 0, "");
        write_run(&place.path().join("r/inner"), 0, "");
        let root = Root::new(place.path()).unwrap();
        let mut page = FolderPage::new(Below::default());
        assert_eq!(looked(&mut page, &root)["rows"][0]["name"], "r");
        assert_eq!(page.runs.len(), 1);
    }
}
