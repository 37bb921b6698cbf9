//! Runs as a report sees them: found below a directory, read one after the other, reduced to tables and curves.
//!
//! A run is a directory with a `config.toml`. Other missing files are missing from the report, and it says so; no
//! single run can spoil the others'. Memory does not grow with a run's length: a series that gets longer than
//! [`MAX_POINTS`](crate::run::MAX_POINTS) is thinned out to every second point, and so on.

use crate::apart;
use crate::run::{Point, Run, Series};
use serde::Deserialize;
use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;
use trestle_proto::config::{self, Config};
use trestle_proto::limits::MAX_TEXT_BYTES;
use trestle_proto::regular_file::{self, FileError};
use trestle_proto::run_result::RunResult;
use trestle_proto::rundir::RunDir;

/// Levels of directories below the one that is named in which runs are looked for.
pub const MAX_DEPTH: usize = 4;
/// Runs of a report, at most.
pub const MAX_RUNS: usize = 10_000;
/// Longest line of a record that is looked at, bytes; longer ones are passed over.
const MAX_LINE: u64 = 1 << 16;
/// Largest result.json that is read, bytes.
const MAX_RESULT: u64 = 1 << 20;
/// Largest record that is read, evals.csv or metrics.jsonl, bytes.
const MAX_RECORD: u64 = 4 << 30;

/// A report without runs, or a directory that cannot be listed.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// Reading a directory.
    #[error("cannot read {path}")]
    Io {
        /// The directory.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Nothing to report on.
    #[error(
        "{path} holds no run; accepted: a run's directory (with a config.toml) or one with runs up to {MAX_DEPTH} levels below it"
    )]
    NoRuns {
        /// The directory.
        path: PathBuf,
    },
    /// Runs, but none that can be read.
    #[error("none of the runs in {path} can be read; {first}")]
    Unreadable {
        /// The directory.
        path: PathBuf,
        /// The fault of the first of them.
        first: String,
    },
    /// Too much to report on.
    #[error("{path} holds more than {MAX_RUNS} runs; accepted: fewer, for example one arm's directory")]
    TooMany {
        /// The directory.
        path: PathBuf,
    },
}

/// The runs below `root`, ordered by task, arm and seed, and notes about everything missing or passed over.
///
/// The arm of a run in `<arm>/seed-<N>` below `root` is `<arm>`; of any other run it is the name of its algorithm. The
/// task is the environment's name, and where runs in several directories above their arms' have the same environment, that
/// of the directory as well. Runs of a suite, in `<group>/<task>/<arm>/seed-<N>`, have the task `<group>/<task>`. Where other
/// settings than seed, length and files differ, the names of tasks and arms say so. `filled` gives the settings of an environment's
/// own table that nobody chooses.
///
/// # Errors
/// A directory that cannot be listed, no run at all, or too many of them.
pub fn read_runs(
    root: &Path,
    filled: impl Fn(&Config) -> &'static [&'static str],
) -> Result<(Vec<Run>, Vec<String>), ReadError> {
    let (mut paths, mut notes) = (Vec::new(), Vec::new());
    find(root, 0, &mut paths, &mut notes)?;
    if paths.len() > MAX_RUNS {
        return Err(ReadError::TooMany { path: root.into() });
    }
    let mut runs = Vec::new();
    for path in paths {
        match read_run(root, &path, &mut notes) {
            Ok(run) => runs.push((place(root, &path).0, run)),
            Err(fault) => notes.push(format!("{} is left out: {fault}", path.display())),
        }
    }
    if runs.is_empty() {
        let path = root.into();
        return Err(match notes.into_iter().next() {
            Some(first) => ReadError::Unreadable { path, first },
            None => ReadError::NoRuns { path },
        });
    }
    let mut runs = name_tasks(runs);
    apart::tell_apart(&mut runs, &mut notes, |run| place(root, &run.path).1.is_none(), filled);
    leave_out_copies(root, &mut runs, &mut notes);
    runs.sort_by(|a, b| {
        let key = |run: &Run| (run.task.clone(), run.arm.clone(), run.config.run.seed, run.path.clone());
        key(a).cmp(&key(b))
    });
    apart::note_repeated_seeds(&runs, &mut notes);
    Ok((runs, notes))
}

/// Adds to the task of each run the directory above its arm's where the environment alone does not tell tasks apart. Two
/// directories are a suite's group and task, and are the task's name.
fn name_tasks(runs: Vec<(String, Run)>) -> Vec<Run> {
    let mut places: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for (above, run) in &runs {
        places.entry(run.task.clone()).or_default().insert(above.clone());
    }
    let name = |(above, mut run): (String, Run)| {
        if let Some((group, task)) = above.split_once('/')
            && !task.contains('/')
        {
            (run.group, run.task) = (group.into(), above);
        } else if places[&run.task].len() > 1 && !above.is_empty() {
            run.task = format!("{}, {above}", run.task);
        }
        run
    };
    runs.into_iter().map(name).collect()
}

/// Takes out runs that repeat another one, and notes each: a copy of its directory, or the same task, arm and seed with the
/// same weights. Of several copies the one in the directory of its seed stays. It also notes directories whose name has another
/// seed than their run.
fn leave_out_copies(root: &Path, runs: &mut Vec<Run>, notes: &mut Vec<String>) {
    let seed_of = |path: &Path| path.file_name()?.to_str()?.strip_prefix("seed-")?.parse::<u64>().ok();
    runs.sort_by_key(|run| (seed_of(&run.path) != Some(run.config.run.seed), run.path.clone()));
    let mut by_start: BTreeMap<u64, PathBuf> = BTreeMap::new();
    let mut by_weights: BTreeMap<(String, String, u64, String), PathBuf> = BTreeMap::new();
    runs.retain(|run| {
        let seed = run.config.run.seed;
        let weights = run.result.as_ref().map(|result| result.weights_sha256.clone());
        let weights = weights.map(|weights| (run.task.clone(), run.arm.clone(), seed, weights));
        let same_start = run.start.and_then(|start| by_start.get(&start));
        let same_weights = weights.as_ref().and_then(|weights| by_weights.get(weights));
        if let Some(original) = same_start.or(same_weights) {
            notes.push(format!(
                "{} is not counted: it is a copy of {} (arm {}, seed {seed})",
                run.path.display(),
                original.display(),
                run.arm
            ));
            return false;
        }
        if let Some(named) = seed_of(&run.path).filter(|&named| named != seed && run.path != root) {
            notes.push(format!(
                "{} is called after seed {named}; its run is of seed {seed}",
                run.path.display()
            ));
        }
        by_start.extend(run.start.map(|start| (start, run.path.clone())));
        by_weights.extend(weights.map(|weights| (weights, run.path.clone())));
        true
    });
}

/// The name before the mark of a run that waits beside its directory while an `--overwrite` takes its place.
fn replaced(name: &str) -> Option<&str> {
    let (name, process) = name.rsplit_once(".replaced-")?;
    (!process.is_empty() && process.bytes().all(|byte| byte.is_ascii_digit())).then_some(name)
}

/// Directories with a `config.toml`, themselves not searched any deeper.
fn find(
    dir: &Path,
    depth: usize,
    found: &mut Vec<PathBuf>,
    notes: &mut Vec<String>,
) -> Result<(), ReadError> {
    if RunDir::new(dir).config().is_file() {
        found.push(dir.into());
        return Ok(());
    }
    if depth == MAX_DEPTH || found.len() > MAX_RUNS {
        return Ok(());
    }
    let fault = |source| ReadError::Io { path: dir.into(), source };
    let mut below = Vec::new();
    for entry in fs::read_dir(dir).map_err(fault)? {
        let entry = entry.map_err(fault)?;
        // A link is not followed: it may lead back.
        // A hidden directory is a program's scratch space.
        let name = entry.file_name();
        let hidden = name.as_encoded_bytes().starts_with(b".");
        if let Some(name) = name.to_str().and_then(replaced) {
            let path = entry.path();
            notes.push(format!(
                "{} is not counted: it is {name} as it was before an --overwrite that was killed, or that is only just \
                 starting; the next start in {name} puts it back",
                path.display()
            ));
        } else if !hidden && entry.file_type().map_err(fault)?.is_dir() {
            below.push(entry.path());
        }
    }
    below.sort();
    below.iter().try_for_each(|path| find(path, depth + 1, found, notes))
}

fn read_run(root: &Path, path: &Path, notes: &mut Vec<String>) -> Result<Run, String> {
    let dir = RunDir::new(path);
    let plan = dir.read_plan();
    if let Err(error) = &plan
        && error.other_version() == Some(Ordering::Greater)
    {
        return Err(error.to_string());
    }
    let file = dir.config();
    let text = regular_file::read_to_string(&file, MAX_TEXT_BYTES).map_err(|e| e.to_string())?;
    let config = config::parse_toml(&file.display().to_string(), &text).map_err(|e| e.to_string())?;
    let result: Option<RunResult> = match regular_file::read(&dir.result(), MAX_RESULT) {
        Ok(bytes) => serde_json::from_slice(&bytes)
            .map_err(|e| notes.push(format!("{} cannot be read: {e}", dir.result().display())))
            .ok(),
        Err(error) if error.is_not_found() => None,
        Err(error) => {
            notes.push(error.to_string());
            None
        }
    };
    let start = plan.as_ref().ok().map(|plan| plan.life.run);
    let task = match &result {
        Some(result) => result.env.clone(),
        None => plan.map(|plan| plan.experiment.spec.name).map_err(|e| e.to_string())?,
    };
    let Build { version, commit } = regular_file::read(&dir.build(), MAX_RESULT)
        .ok()
        .and_then(|bytes| serde_json::from_slice(&bytes).ok())
        .unwrap_or_default();
    let finished = fs::metadata(dir.result()).and_then(|meta| meta.modified()).ok();
    let mut run = Run {
        version: version.unwrap_or_default(),
        commit: commit.unwrap_or_default(),
        finished: finished.and_then(|at| at.duration_since(UNIX_EPOCH).ok()).map(|since| since.as_secs()),
        path: path.into(),
        arm: place(root, path).1.unwrap_or_else(|| config.arm()),
        task,
        group: String::new(),
        start,
        config,
        result,
        evaluations: Series::default(),
        training: Series::default(),
        feasible: Series::default(),
        bridged: Series::default(),
        e_kl: Series::default(),
    };
    if let Err(fault) = read_evaluations(&dir.evals(), &mut run) {
        notes.push(format!("{}: {fault}", dir.evals().display()));
    }
    if let Err(fault) = read_metrics(&dir.metrics(), &mut run) {
        notes.push(format!("{}: {fault}", dir.metrics().display()));
    }
    Ok(run)
}

/// What is read of build.json.
#[derive(Default, Deserialize)]
struct Build {
    version: Option<String>,
    commit: Option<String>,
}

/// The directories above the arm's, and the arm, of a run in `<above>/<arm>/seed-<N>` below `root`.
fn place(root: &Path, path: &Path) -> (String, Option<String>) {
    let find = || {
        let below = path.strip_prefix(root).ok()?;
        below.file_name()?.to_str()?.strip_prefix("seed-")?.parse::<u64>().ok()?;
        let arm = below.parent()?;
        Some((arm.parent()?.to_str()?.to_string(), arm.file_name()?.to_str()?.to_string()))
    };
    find().map_or_else(|| (String::new(), None), |(above, arm)| (above, Some(arm)))
}

/// The fault of a file, for a message that names its path already.
fn kind_of(error: &FileError) -> String {
    match error {
        FileError::Io { error, .. } => error.to_string(),
        FileError::Kind { kind, .. } => format!("{kind}; accepted: a regular file"),
        FileError::Large { bytes, limit, .. } => format!("{bytes} bytes; accepted: up to {limit}"),
        FileError::NotText { .. } => "not text".into(),
    }
}

/// A line of evals.csv.
#[derive(Deserialize)]
struct Evaluation {
    episode: f64,
    env_steps: f64,
    #[serde(rename = "return")]
    value: f64,
}

fn read_evaluations(path: &Path, run: &mut Run) -> Result<(), String> {
    let file = regular_file::open(path, MAX_RECORD).map_err(|e| kind_of(&e))?;
    let mut reader = csv::Reader::from_reader(file.take(MAX_RECORD));
    for row in reader.deserialize() {
        // The last line of a run that is still going on may be half written.
        let Ok(Evaluation { episode, env_steps, value }) = row else { break };
        run.evaluations.push(Point { episode, env_steps, value });
    }
    Ok(())
}

/// A line of metrics.jsonl, as far as it is drawn.
#[derive(Deserialize)]
struct Metrics {
    #[serde(rename = "time/episodes")]
    episode: f64,
    #[serde(rename = "time/total_timesteps")]
    env_steps: f64,
    #[serde(rename = "rollout/ep_rew")]
    episode_return: Option<f64>,
    #[serde(rename = "rollout/ep_rew_mean")]
    mean_return: Option<f64>,
    #[serde(rename = "mentor/feasible_frac")]
    feasible: Option<f64>,
    #[serde(rename = "mentor/bridged_frac")]
    bridged: Option<f64>,
    #[serde(rename = "mentor/e_kl_mean")]
    e_kl: Option<f64>,
}

fn read_metrics(path: &Path, run: &mut Run) -> Result<(), String> {
    let file = regular_file::open(path, MAX_RECORD).map_err(|e| kind_of(&e))?;
    let mut file = BufReader::new(file.take(MAX_RECORD));
    let mut line = Vec::new();
    loop {
        line.clear();
        if file.by_ref().take(MAX_LINE).read_until(b'\n', &mut line).map_err(|e| e.to_string())? == 0 {
            return Ok(());
        }
        let Ok(row) = serde_json::from_slice::<Metrics>(&line) else { continue };
        let point = |value| Point { episode: row.episode, env_steps: row.env_steps, value };
        if let (Some(_), Some(mean)) = (row.episode_return, row.mean_return) {
            run.training.push(point(mean));
        }
        let gauges =
            [(row.feasible, &mut run.feasible), (row.bridged, &mut run.bridged), (row.e_kl, &mut run.e_kl)];
        for (value, series) in gauges {
            if let Some(value) = value.filter(|v| v.is_finite()) {
                series.push(point(value));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn only_directories_of_seeds_name_an_arm() {
        let root = Path::new("runs");
        let of = |path: &str| place(root, Path::new(path));
        assert_eq!(of("runs/literal/seed-3"), (String::new(), Some("literal".into())));
        assert_eq!(of("runs/a/b/seed-3"), ("a".into(), Some("b".into())));
        for other in ["runs/seed-3", "runs", "runs/a/seed-x", "runs/a/maze30-dqn-seed1"] {
            assert_eq!(of(other), (String::new(), None), "{other}");
        }
    }

    #[test]
    fn a_copy_is_no_other_run() {
        let run = |path: &str, arm: &str, start, weights: Option<&str>, seed| {
            let mut config = Config::default();
            config.run.seed = seed;
            let text = r#"{"algo":"dqn","seed":1,"env":"m","episodes":1,"env_steps":2,"grad_steps":3,"wall_s":4.0,
                "weights_sha256":"","restarts":0,"interrupted":false}"#;
            let mut result: RunResult = serde_json::from_str(text).unwrap();
            result.weights_sha256 = weights.unwrap_or_default().into();
            let result = weights.is_some().then_some(result);
            Run { start, config, result, ..Run::blank(path, arm, "m") }
        };
        let mut runs = vec![
            run("s/dqn/copy", "dqn", Some(1), Some("aa"), 1),
            run("s/dqn/seed-1", "dqn", Some(1), Some("aa"), 1),
            // Gone on with since it was copied, to the same end.
            run("s/dqn/seed-1.bak", "dqn", Some(9), Some("aa"), 1),
            // A copy under another arm's name, and one of a run that is not over.
            run("s/new/seed-1", "new", Some(1), Some("aa"), 1),
            run("s/dqn/seed-2", "dqn", Some(2), None, 2),
            run("s/dqn/seed-2-bak", "dqn", Some(2), None, 2),
            // The same settings under two names are two arms, and equal runs of two seeds are two runs.
            run("s/same/seed-1", "same", Some(3), Some("aa"), 1),
            run("s/dqn/seed-3", "dqn", Some(4), Some("aa"), 3),
            run("s/dqn/seed-7", "dqn", Some(5), Some("bb"), 4),
        ];
        let mut notes = Vec::new();
        leave_out_copies(Path::new("s"), &mut runs, &mut notes);
        let mut left: Vec<&str> = runs.iter().map(|run| run.path.to_str().unwrap()).collect();
        left.sort_unstable();
        let expected = ["s/dqn/seed-1", "s/dqn/seed-2", "s/dqn/seed-3", "s/dqn/seed-7", "s/same/seed-1"];
        assert_eq!(left, expected);
        assert_eq!(notes.iter().filter(|note| note.contains("is not counted: it is a copy of")).count(), 4);
        assert!(
            notes.iter().any(|note| note.contains("seed-7 is called after seed 7; its run is of seed 4"))
        );
        assert_eq!([replaced("best.replaced-45"), replaced("best.replaced-x")], [Some("best"), None]);
    }

    #[test]
    fn directories_tell_tasks_of_one_environment_apart() {
        let run = |task: &str| Run::blank("", "dqn", task);
        let runs = [("hot", "maze"), ("cold", "maze"), ("", "maze"), ("warm", "other"), ("warm", "other")];
        let named = name_tasks(runs.map(|(above, task)| (above.to_string(), run(task))).into());
        let tasks: Vec<&str> = named.iter().map(|run| run.task.as_str()).collect();
        assert_eq!(tasks, ["maze, hot", "maze, cold", "maze", "other", "other"]);
        let of_suite =
            name_tasks([("hot/a", "maze"), ("hot/b", "maze")].map(|(a, t)| (a.into(), run(t))).into());
        assert_eq!((&of_suite[1].task[..], &of_suite[1].group[..]), ("hot/b", "hot"));
    }

    #[test]
    fn a_directory_without_runs_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        assert!(matches!(read_runs(dir.path(), |_| &[]), Err(ReadError::NoRuns { .. })));
        assert!(matches!(read_runs(&dir.path().join("absent"), |_| &[]), Err(ReadError::Io { .. })));
        let run = dir.path().join("arm/seed-0");
        fs::create_dir_all(&run).unwrap();
        fs::write(run.join("config.toml"), "[run]\nepisodes = 0\n").unwrap();
        assert!(matches!(read_runs(dir.path(), |_| &[]), Err(ReadError::Unreadable { .. })));
    }
}
