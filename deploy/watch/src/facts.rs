//! What a run says of itself before and after its training: its configuration, its plan, its result, its logs.

use crate::root::{Dir, Stamp};
use crate::tail::last_lines;
use serde::Serialize;
use trestle_learner::record::Goal;
use trestle_proto::config::{self, Config, Mode, Threshold};
use trestle_proto::plan::RunPlan;
use trestle_proto::run_files::{BUILD_FILE, COMMAND_FILE, CONFIG_FILE, PLAN_FILE, RESULT_FILE};
use trestle_proto::run_result::RunResult;

/// Largest config.toml that is read, bytes.
const MAX_CONFIG: u64 = 1 << 20;
/// Largest result.json or build.json that is read, bytes.
const MAX_RESULT: u64 = 1 << 18;
/// Largest plan that is read, bytes.
const MAX_PLAN: u64 = 64 << 20;
/// Longest command line that is shown, characters.
const MAX_COMMAND: usize = 1000;
/// Bytes at the end of a log that are looked at.
const LOG_BYTES: u64 = 6 << 10;
/// Lines of a log that are shown.
const LOG_LINES: usize = 12;
/// Longest line of a log that is shown, characters.
const LOG_WIDTH: usize = 400;
/// Logs that are shown, at most.
const MAX_LOGS: usize = 12;
/// Bytes at the end of the supervisor's log in which events are looked for.
const EVENT_BYTES: u64 = 64 << 10;
/// Events that are shown, at most.
const MAX_EVENTS: usize = 20;
/// The supervisor's last words on a run that it gives up.
const GIVEN_UP: &str = "not started again: ";

/// What a run is.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct Facts {
    /// Algorithm with its extensions.
    pub(crate) arm: String,
    pub(crate) seed: u64,
    /// Name of the environment.
    pub(crate) env: String,
    pub(crate) mode: &'static str,
    pub(crate) actors: u32,
    /// Where the run ends, whichever comes first.
    pub(crate) limit_episodes: Option<u64>,
    pub(crate) limit_env_steps: Option<u64>,
    /// Return that counts as optimal, and how far below it counts as solved.
    pub(crate) threshold: Option<f64>,
    pub(crate) tolerance: f64,
    /// A mentor transition with this e_KL or more is infeasible.
    pub(crate) e_infeas: Option<f64>,
    /// Steps between evaluations, episodes.
    pub(crate) eval_every: u64,
    /// Transitions that the replay holds at most.
    pub(crate) replay: usize,
    /// Names of the actions; empty where the plan cannot be read.
    pub(crate) actions: Vec<String>,
    pub(crate) mentor_transitions: usize,
    pub(crate) restarts: u64,
    /// The newest command line.
    pub(crate) command: String,
    pub(crate) version: String,
    pub(crate) commit: String,
    /// Why the configuration cannot be shown, if it cannot.
    pub(crate) fault: Option<String>,
}

impl Facts {
    /// Reads them from the run's directory. What is missing or damaged stays empty.
    pub(crate) fn read(dir: &Dir) -> Self {
        let mut facts = match configuration(dir) {
            Ok(config) => Self::of(&config),
            Err(fault) => Self { fault: Some(fault), ..Self::default() },
        };
        if let Ok(RunPlan { life, experiment }) =
            dir.read(PLAN_FILE, MAX_PLAN).map_err(drop).and_then(|b| RunPlan::decode(&b).map_err(drop))
        {
            facts.threshold = experiment.threshold();
            facts.mentor_transitions = experiment.mentor_len();
            facts.restarts = life.restarts;
            facts.env = experiment.spec.name;
            facts.actions = experiment.spec.actions;
        } else if let Some(result) = result(dir) {
            // A plan of another version.
            facts.env = result.env;
        }
        let commands = last_lines(dir, COMMAND_FILE, 2 * MAX_COMMAND as u64).unwrap_or_default();
        facts.command = commands.last().map(|line| shown(line, MAX_COMMAND)).unwrap_or_default();
        let build: serde_json::Value = dir
            .read(BUILD_FILE, MAX_RESULT)
            .ok()
            .and_then(|bytes| serde_json::from_slice(&bytes).ok())
            .unwrap_or_default();
        let text = |key: &str| build[key].as_str().map(|text| shown(text, 64)).unwrap_or_default();
        (facts.version, facts.commit) = (text("version"), text("commit"));
        facts
    }

    fn of(config: &Config) -> Self {
        let run = &config.run;
        Self {
            arm: config.arm(),
            seed: run.seed,
            env: config.env.name.clone(),
            mode: match run.mode {
                Mode::Lockstep => "lockstep",
                Mode::Free => "free",
                Mode::Reference => "reference",
            },
            actors: run.actors,
            limit_episodes: run.episodes,
            limit_env_steps: run.env_steps,
            threshold: config.eval.threshold,
            tolerance: config.eval.tolerance,
            e_infeas: match config.mentor.e_infeas {
                Threshold::Kl(kl) => Some(kl),
                Threshold::Auto => None,
            },
            eval_every: config.eval.every,
            replay: config.learner.replay,
            ..Self::default()
        }
    }

    /// What evaluations are held against.
    pub(crate) fn goal(&self) -> Option<Goal> {
        self.threshold.map(|threshold| Goal { threshold, tolerance: self.tolerance })
    }

    /// How much of a run with these counts is done, 0 to 1.
    pub(crate) fn share(&self, episodes: f64, env_steps: f64) -> f64 {
        let share = |done: f64, limit: Option<u64>| limit.map_or(0.0, |limit| done / limit.max(1) as f64);
        let share = share(episodes, self.limit_episodes).max(share(env_steps, self.limit_env_steps));
        if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 }
    }
}

fn configuration(dir: &Dir) -> Result<Config, String> {
    let bytes = dir.read(CONFIG_FILE, MAX_CONFIG).map_err(|error| format!("{CONFIG_FILE}: {error}"))?;
    let text = String::from_utf8(bytes).map_err(|_| format!("{CONFIG_FILE} is not text"))?;
    config::parse_toml(CONFIG_FILE, &text).map_err(|error| shown(&error.to_string(), LOG_WIDTH))
}

/// The text of the configuration, if it is there.
pub(crate) fn configuration_text(dir: &Dir) -> Option<String> {
    let bytes = dir.read(CONFIG_FILE, MAX_CONFIG).ok()?;
    Some(String::from_utf8_lossy(&bytes).into_owned())
}

/// The outcome, if there is one.
pub(crate) fn result(dir: &Dir) -> Option<RunResult> {
    dir.read(RESULT_FILE, MAX_RESULT).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok())
}

/// A line of the supervisor's log.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Event {
    /// Seconds since 1970.
    pub(crate) at: u64,
    /// What happened.
    pub(crate) text: String,
}

/// What the supervisor has noted: starts, deaths, restarts; the newest last.
pub(crate) fn events(logs: &Dir) -> Vec<Event> {
    let lines = last_lines(logs, "supervisor.log", EVENT_BYTES).unwrap_or_default();
    let event = |line: &String| {
        let (at, text) = line.split_once(' ')?;
        Some(Event { at: at.parse().ok()?, text: shown(text, LOG_WIDTH) })
    };
    let mut events: Vec<Event> = lines.iter().filter_map(event).collect();
    events.drain(..events.len().saturating_sub(MAX_EVENTS));
    events
}

/// Why the run was given up, if that was the last that happened.
pub(crate) fn given_up(events: &[Event]) -> Option<&str> {
    events.last().map(|event| event.text.as_str()).filter(|text| text.contains(GIVEN_UP))
}

/// The end of one process's log.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Log {
    /// The process, such as `actor-0`.
    pub(crate) process: String,
    /// Its last lines.
    pub(crate) lines: Vec<String>,
}

/// The ends of the logs, and when the newest was written, seconds since 1970.
pub(crate) fn logs(logs: &Dir) -> (Vec<Log>, i64) {
    let mut names: Vec<String> = match logs.entries() {
        Ok((entries, _)) => entries
            .into_iter()
            .filter_map(|(name, directory)| {
                (!directory).then(|| name.strip_suffix(".log").map(Into::into))?
            })
            .collect(),
        Err(_) => Vec::new(),
    };
    let rank = |name: &str| match name {
        "supervisor" => 0,
        "learner" => 1,
        "mentor-server" => 2,
        _ => 3,
    };
    // By length, so that actor-10 comes after actor-9.
    names.sort_by_key(|name| (rank(name), name.len(), name.clone()));
    names.truncate(MAX_LOGS);
    let mut newest = 0;
    let mut found = Vec::new();
    for process in names {
        let file = format!("{process}.log");
        if let Ok((_, stamp)) = logs.open(&file) {
            newest = newest.max(stamp.changed.0);
        }
        let mut lines = last_lines(logs, &file, LOG_BYTES).unwrap_or_default();
        lines.drain(..lines.len().saturating_sub(LOG_LINES));
        let lines = lines.iter().map(|line| shown(line, LOG_WIDTH)).collect();
        found.push(Log { process: shown(&process, 40), lines });
    }
    (found, newest)
}

/// `text` without control characters, and no longer than `most` characters.
pub(crate) fn shown(text: &str, most: usize) -> String {
    let plain = |c: char| if c.is_control() { ' ' } else { c };
    let mut shown: String = text.chars().take(most).map(plain).collect();
    if text.chars().nth(most).is_some() {
        shown.push('…');
    }
    shown
}

/// When and whether a file changed: to be compared, nothing else. None: it is not there.
pub(crate) fn stamp(dir: &Dir, name: &str) -> Option<Stamp> {
    dir.open(name).ok().map(|(_, stamp)| stamp)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_shown_is_short_and_has_no_control_characters() {
        assert_eq!(shown("a\u{1b}[31mb\tc", 20), "a [31mb c");
        assert_eq!(shown("abcdef", 3), "abc…");
    }

    #[test]
    fn a_run_is_given_up_only_if_nothing_came_after() {
        let event = |text: &str| Event { at: 1, text: text.into() };
        let end = event("learner was killed; not started again: no restarts are left");
        assert!(given_up(std::slice::from_ref(&end)).is_some());
        assert_eq!(given_up(&[end, event("going on from episode 3")]), None);
        assert_eq!(given_up(&[]), None);
    }
}
