//! One run, as its page shows it.

use crate::facts::{self, Event, Facts, Log};
use crate::locks::Locks;
use crate::records::Records;
use crate::root::{Below, Dir, Root, Stamp};
use crate::timeline::{Extent, Timeline};
use serde::Serialize;
use serde_json::json;
use std::io;
use std::time::{SystemTime, UNIX_EPOCH};
use trestle_algorithm::agent::Counters;
use trestle_learner::record::{Limits, seconds_left};
use trestle_proto::run_files::{
    ACTORS_FILE, CONFIG_FILE, EVALS_FILE, LOGS_DIR, METRICS_FILE, PLAN_FILE, RESULT_FILE,
};
use trestle_proto::run_result::RunResult;

/// Rows of each table that a page gets, at most.
const MAX_ROWS: usize = 400;
/// Bytes of each record that are read before the page is brought up to date.
const BUDGET: usize = 8 << 20;
/// Seconds without a new line after which a run whose lock cannot be seen does not count as running.
const STALE_S: i64 = 20;
/// Largest actors.csv that is read, bytes.
const MAX_ACTORS_BYTES: u64 = 1 << 20;
/// Incarnations that are shown, at most: the newest.
const MAX_INCARNATIONS: usize = 64;
/// Rows of figures that the pace is taken from.
const PACE_ROWS: usize = 30;

/// How a run stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum State {
    /// There is no run.
    Nothing,
    /// It has not begun to train.
    Starting,
    /// It trains.
    Running,
    /// It has run its whole length.
    Finished,
    /// It was stopped, or its processes are gone without a result.
    Interrupted,
    /// Its supervisor has given it up.
    Failed,
}

/// Whether a run that begins, trains or is over; `alive`: a process has its lock, or its files have just changed.
pub(crate) fn state(alive: bool, begun: bool, result: Option<&RunResult>, given_up: bool) -> State {
    match (alive, result) {
        (true, None) if !begun => State::Starting,
        (true, None) => State::Running,
        (_, Some(result)) if result.interrupted => State::Interrupted,
        (_, Some(_)) => State::Finished,
        (false, None) if given_up => State::Failed,
        (false, None) => State::Interrupted,
    }
}

/// Seconds since 1970.
pub(crate) fn now_s() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs() as i64)
}

/// Whether one of `files` changed within the last seconds.
pub(crate) fn is_fresh(dir: &Dir, files: &[&str], now: i64) -> bool {
    let changed = |name: &&str| dir.open(name).map(|(_, stamp)| stamp.changed.0).ok();
    files.iter().filter_map(changed).max().is_some_and(|changed| (now - changed).abs() < STALE_S)
}

/// What is known of one run, and kept up to date.
#[derive(Debug)]
pub(crate) struct RunPage {
    below: Below,
    stamps: [Option<Stamp>; 2],
    facts: Facts,
    records: Records,
    timeline: Timeline,
    extent: Extent,
}

impl RunPage {
    pub(crate) fn new(below: Below) -> Self {
        Self {
            below,
            stamps: [None; 2],
            facts: Facts::default(),
            records: Records::new(MAX_ROWS),
            timeline: Timeline::default(),
            extent: Extent::default(),
        }
    }

    /// How much of the timeline there was when it was looked at last.
    pub(crate) fn extent(&self) -> &Extent {
        &self.extent
    }

    /// Reads what is new, and gives the whole as JSON.
    ///
    /// # Errors
    /// The directory cannot be opened, or a file that is there cannot be read.
    pub(crate) fn look(&mut self, root: &Root, locks: &Locks) -> io::Result<String> {
        let dir = root.dir(&self.below)?;
        let stamps = [CONFIG_FILE, PLAN_FILE].map(|name| facts::stamp(&dir, name));
        if stamps != self.stamps {
            self.facts = Facts::read(&dir);
            self.stamps = stamps;
        }
        self.records.look(&dir, self.facts.goal(), BUDGET)?;
        self.extent = self.timeline.look(&dir)?;
        let logs = dir.dir(LOGS_DIR);
        let events: Vec<Event> = logs.as_ref().map(facts::events).unwrap_or_default();
        let (logs, logged): (Vec<Log>, i64) = logs.as_ref().map(facts::logs).unwrap_or_default();
        let result = facts::result(&dir);
        let now = now_s();
        let locked = locks.hold(dir.identity()?);
        let fresh = is_fresh(&dir, &[METRICS_FILE, EVALS_FILE], now) || (now - logged).abs() < STALE_S;
        let given_up = facts::given_up(&events);
        let newest = self.records.metrics.newest();
        let state = state(
            locked || fresh && given_up.is_none() && result.is_none(),
            newest.is_some(),
            result.as_ref(),
            given_up.is_some(),
        );
        let [episodes, env_steps, wall_s] = newest.unwrap_or_default();
        let standing = &self.records.evals.standing;
        let at = |moment: Option<trestle_learner::record::Moment>| {
            moment.map(|at| json!({"episode": at.episode, "env_steps": at.env_steps}))
        };
        let page = json!({
            "kind": "run",
            "below": self.below.to_string(),
            "path": root.path_of(&self.below),
            "state": state,
            "reason": given_up,
            "facts": self.facts,
            "episodes": episodes,
            "env_steps": env_steps,
            "wall_s": wall_s,
            "share": if state == State::Finished { 1.0 } else { self.facts.share(episodes, env_steps) },
            "left_s": (state == State::Running).then(|| self.left()).flatten(),
            "best_return": standing.best_return(),
            "last_return": standing.final_return(),
            "solved": at(standing.solved()),
            "optimal": at(standing.optimal()),
            "restarts": result.as_ref().map_or(self.facts.restarts, |result| result.restarts),
            "weights_sha256": result.as_ref().map(|result| &result.weights_sha256),
            "evals": self.records.evals.table,
            "training": self.records.metrics.training,
            "figures": self.records.metrics.figures,
            "timeline": self.extent,
            "actors": actors(&dir),
            "events": events,
            "logs": logs,
            "read": self.records.share(),
        });
        Ok(page.to_string())
    }

    /// Seconds until the nearer limit at the pace of the last rows.
    fn left(&self) -> Option<f64> {
        let rows: Vec<_> = self.records.metrics.figures.rows().collect();
        let now = *rows.last()?;
        let from = rows[rows.len().saturating_sub(PACE_ROWS)..].first().copied().filter(|_| rows.len() > 1);
        let counters = |row: &[f64; 21]| Counters {
            episodes: row[0] as u64,
            env_steps: row[1] as u64,
            ..Counters::default()
        };
        let begin = from.map(counters).unwrap_or_default();
        let elapsed = now[2] - from.map_or(0.0, |row| row[2]);
        let limits = Limits { episodes: self.facts.limit_episodes, env_steps: self.facts.limit_env_steps };
        seconds_left(&limits, &begin, &counters(now), elapsed)
    }
}

/// The rows of `actors.csv`, cells as they stand there; empty where there is none.
fn actors(dir: &Dir) -> Vec<Vec<String>> {
    let bytes = dir.read(ACTORS_FILE, MAX_ACTORS_BYTES).unwrap_or_default();
    let text = String::from_utf8_lossy(&bytes);
    let mut rows: Vec<Vec<String>> = text
        .lines()
        .skip(1)
        .map(|line| line.split(',').map(|cell| facts::shown(cell, 20)).collect())
        // Version 0.1 knew of no hosts.
        .filter(|row: &Vec<String>| matches!(row.len(), 6 | 7))
        .collect();
    rows.drain(..rows.len().saturating_sub(MAX_INCARNATIONS));
    rows
}

/// Whether the directory holds a run.
pub(crate) fn is_run(dir: &Dir) -> bool {
    dir.has(CONFIG_FILE, false)
        && (dir.has(PLAN_FILE, false) || dir.has(LOGS_DIR, true) || dir.has(RESULT_FILE, false))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use serde_json::Value;
    use std::fs;
    use trestle_proto::config::{self, Config};

    fn looked(page: &mut RunPage, root: &Root) -> Value {
        serde_json::from_str(&page.look(root, &Locks::default()).unwrap()).unwrap()
    }

    #[test]
    fn a_page_follows_its_run() {
        let place = tempfile::tempdir().unwrap();
        let run = place.path().join("r");
        let root = Root::new(place.path()).unwrap();
        let mut page = RunPage::new(Below::parse("r").unwrap());
        assert!(page.look(&root, &Locks::default()).is_err());
        fs::create_dir_all(run.join("logs")).unwrap();
        let mut config = Config::default();
        config.run.episodes = Some(10);
        config.eval.threshold = Some(-1.0);
        fs::write(run.join("config.toml"), config::to_toml(&config)).unwrap();
        fs::write(run.join("logs/learner.log"), "one\n<b>two</b>\nthr").unwrap();
        let seen = looked(&mut page, &root);
        assert_eq!(seen["state"], "starting");
        assert_eq!(seen["logs"][0]["lines"], json!(["one", "<b>two</b>"]));
        let row = |episode: u32| {
            format!(
                "{{\"time/episodes\":{episode},\"time/total_timesteps\":{},\"time/time_elapsed\":{episode},\"train/n_updates\":1}}\n",
                10 * episode
            )
        };
        fs::write(run.join("metrics.jsonl"), row(1) + &row(3)).unwrap();
        let seen = looked(&mut page, &root);
        assert_eq!(
            (&seen["state"], &seen["share"], &seen["left_s"]),
            (&json!("running"), &json!(0.3), &json!(7.0))
        );
        fs::write(
            run.join("logs/supervisor.log"),
            "5 learner died; not started again: it does not get ahead\n",
        )
        .unwrap();
        let seen = looked(&mut page, &root);
        assert_eq!(seen["state"], "failed");
        assert!(seen["reason"].as_str().unwrap().contains("does not get ahead"));
    }

    #[test]
    fn what_a_run_came_to_decides_before_what_it_said() {
        let text = |interrupted| {
            format!(
                "{{\"algo\":\"dqn\",\"seed\":0,\"env\":\"m\",\"episodes\":1,\"env_steps\":1,\"grad_steps\":1,\"wall_s\":1.0,\
                 \"weights_sha256\":\"\",\"restarts\":0,\"interrupted\":{interrupted}}}"
            )
        };
        let result = |interrupted| serde_json::from_str::<RunResult>(&text(interrupted)).ok();
        assert_eq!(state(true, true, result(false).as_ref(), false), State::Finished);
        assert_eq!(state(false, true, result(true).as_ref(), true), State::Interrupted);
        assert_eq!(state(false, true, None, true), State::Failed);
        assert_eq!(state(false, true, None, false), State::Interrupted);
        assert_eq!(state(true, false, None, false), State::Starting);
    }
}
