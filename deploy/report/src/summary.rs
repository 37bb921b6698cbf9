//! Runs grouped by task and arm, with the figures of each group and of each pair of groups.

use crate::effect::Effect;
use crate::run::Run;
use crate::stats::{
    Estimate, improvement_interval, iqm_interval, mean, median_interval, ratio_interval, share,
    standard_deviation,
};
use serde::Serialize;
use trestle_proto::run_result::RunResult;

/// The plain algorithms come first, in this order.
const FIRST: [&str; 4] = ["dqn", "diiqn", "ha-diiqn", "trestle"];

/// The runs of one arm on one task.
#[derive(Clone, Debug)]
pub struct Group<'a> {
    /// Name of the arm.
    pub arm: &'a str,
    /// Its runs, by seed.
    pub runs: Vec<&'a Run>,
}

/// The task of a set of runs, with its arms.
#[derive(Clone, Debug)]
pub struct Task<'a> {
    /// Its name: that of the environment, or of a suite's task.
    pub name: &'a str,
    /// The group of a suite's task; empty if there is none.
    pub group: &'a str,
    /// The arms: the plain algorithms, then the others by name.
    pub groups: Vec<Group<'a>>,
}

/// Sorts `runs` by task and arm.
pub fn tasks(runs: &[Run]) -> Vec<Task<'_>> {
    let mut tasks: Vec<Task<'_>> = Vec::new();
    for run in runs {
        let at = tasks.iter().position(|task| task.name == run.task).unwrap_or_else(|| {
            tasks.push(Task { name: &run.task, group: &run.group, groups: Vec::new() });
            tasks.len() - 1
        });
        let groups = &mut tasks[at].groups;
        match groups.iter_mut().find(|group| group.arm == run.arm) {
            Some(group) => group.runs.push(run),
            None => groups.push(Group { arm: &run.arm, runs: vec![run] }),
        }
    }
    for task in &mut tasks {
        task.groups.sort_by_key(|group| order(group.arm));
    }
    tasks
}

/// Sorts the plain algorithms before all others.
pub fn order(arm: &str) -> (usize, &str) {
    (FIRST.iter().position(|first| *first == arm).unwrap_or(FIRST.len()), arm)
}

/// A time that a run takes to get somewhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Time {
    /// Episodes to "solved".
    SolvedEpisode,
    /// Environment steps to "solved".
    SolvedEnvSteps,
    /// Episodes to "optimal".
    OptimalEpisode,
    /// Environment steps to "optimal".
    OptimalEnvSteps,
}

impl Time {
    /// All of them.
    pub const ALL: [Self; 4] =
        [Self::SolvedEpisode, Self::SolvedEnvSteps, Self::OptimalEpisode, Self::OptimalEnvSteps];

    /// The name of the key in `result.json`, also used for files and columns.
    pub fn name(self) -> &'static str {
        match self {
            Self::SolvedEpisode => "solved_episode",
            Self::SolvedEnvSteps => "solved_env_steps",
            Self::OptimalEpisode => "optimal_episode",
            Self::OptimalEnvSteps => "optimal_env_steps",
        }
    }

    /// On pictures.
    pub fn label(self) -> &'static str {
        match self {
            Self::SolvedEpisode => "episodes to solved",
            Self::SolvedEnvSteps => "environment steps to solved",
            Self::OptimalEpisode => "episodes to optimal",
            Self::OptimalEnvSteps => "environment steps to optimal",
        }
    }

    /// That of a complete run; infinite if it never got there.
    pub fn of(self, result: &RunResult) -> f64 {
        let found = match self {
            Self::SolvedEpisode => result.solved_episode,
            Self::SolvedEnvSteps => result.solved_env_steps,
            Self::OptimalEpisode => result.optimal_episode,
            Self::OptimalEnvSteps => result.optimal_env_steps,
        };
        found.map_or(f64::INFINITY, |n| n as f64)
    }

    /// How long the longest complete run of `task` was in the time's unit; 1 without any.
    pub fn longest(self, task: &Task<'_>) -> f64 {
        let of = |result: &RunResult| match self {
            Self::SolvedEpisode | Self::OptimalEpisode => result.episodes as f64,
            Self::SolvedEnvSteps | Self::OptimalEnvSteps => result.env_steps as f64,
        };
        task.groups.iter().flat_map(Group::results).map(of).fold(1.0, f64::max)
    }
}

impl Group<'_> {
    /// The results of its complete runs.
    pub fn results(&self) -> impl Iterator<Item = &RunResult> {
        self.runs.iter().filter_map(|run| run.complete())
    }

    /// `time` of its complete runs.
    pub fn times(&self, time: Time) -> Vec<f64> {
        self.results().map(|result| time.of(result)).collect()
    }
}

/// The figures of one arm on one task.
#[derive(Clone, Debug, Serialize)]
pub struct ArmSummary {
    /// Name of the environment.
    pub task: String,
    /// Name of the arm.
    pub arm: String,
    /// Runs, complete or not.
    pub runs: usize,
    /// Runs that have run their whole length; all that follows is about these.
    pub complete: usize,
    /// How many of them were solved, and optimal.
    pub solved: usize,
    /// See `solved`.
    pub optimal: usize,
    /// Share solved, with Wilson's interval.
    pub solved_share: Estimate,
    /// Share optimal, with Wilson's interval.
    pub optimal_share: Estimate,
    /// Median times with bootstrap intervals, in the order of [`Time::ALL`].
    pub times: Vec<TimeSummary>,
    /// Mean and standard deviation of the last evaluation's return.
    pub final_return_mean: f64,
    /// See `final_return_mean`.
    pub final_return_std: f64,
    /// Interquartile mean of the last evaluation's return.
    pub final_return_iqm: Estimate,
    /// Environment steps of all runs, and the seconds that they took.
    pub env_steps: u64,
    /// See `env_steps`.
    pub wall_s: f64,
    /// How much of the mentor reached the training, on the average; null without a mentor.
    pub mentor: Option<Effect>,
}

/// The median of a time.
#[derive(Clone, Debug, Serialize)]
pub struct TimeSummary {
    /// Which time.
    pub time: Time,
    /// Its median; null where half of the runs or more never got there.
    #[serde(flatten)]
    pub median: Estimate,
}

/// How two arms compare.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    /// Name of the environment, or null for all of them together.
    pub task: Option<String>,
    /// The arm that is compared ...
    pub arm: String,
    /// ... with this one.
    pub with: String,
    /// Which time.
    pub time: Time,
    /// Median of `arm` over median of `with`; null for all tasks together.
    pub ratio: Option<Estimate>,
    /// Probability that a run of `arm` is there before one of `with`, ties counted half.
    pub improvement: Estimate,
}

/// One line for each arm of each task.
pub fn arms(tasks: &[Task<'_>]) -> Vec<ArmSummary> {
    tasks.iter().flat_map(|task| task.groups.iter().map(|group| arm(task.name, group))).collect()
}

fn arm(task: &str, group: &Group<'_>) -> ArmSummary {
    let complete = group.results().count();
    let solved = group.results().filter(|o| o.solved_episode.is_some()).count();
    let optimal = group.results().filter(|o| o.optimal_episode.is_some()).count();
    let returns: Vec<f64> = group.results().filter_map(|o| o.final_return).collect();
    let times = Time::ALL.map(|time| TimeSummary { time, median: median_interval(&[group.times(time)]) });
    ArmSummary {
        task: task.into(),
        arm: group.arm.into(),
        runs: group.runs.len(),
        complete,
        solved,
        optimal,
        solved_share: share(solved, complete),
        optimal_share: share(optimal, complete),
        times: times.into(),
        final_return_mean: mean(&returns),
        final_return_std: standard_deviation(&returns),
        final_return_iqm: iqm_interval(&[returns]),
        env_steps: group.results().map(|o| o.env_steps).sum(),
        wall_s: group.results().map(|o| o.wall_s).sum(),
        mentor: Effect::mean(&group.results().filter_map(Effect::of).collect::<Vec<_>>()),
    }
}

/// Every arm with every one before it, on each task, and on all tasks together where there are several that both have.
pub fn comparisons(tasks: &[Task<'_>]) -> Vec<Comparison> {
    let mut found = Vec::new();
    for task in tasks {
        for (at, group) in task.groups.iter().enumerate() {
            for with in &task.groups[..at] {
                found.extend(Time::ALL.into_iter().filter_map(|time| {
                    compare(Some(task.name), [group.arm, with.arm], time, &[(group, with)])
                }));
            }
        }
    }
    let mut names: Vec<&str> = tasks.iter().flat_map(|t| t.groups.iter().map(|g| g.arm)).collect();
    names.sort_by_key(|arm| order(arm));
    names.dedup();
    for (at, arm) in names.iter().enumerate() {
        for with in &names[..at] {
            let both: Vec<_> = tasks
                .iter()
                .filter_map(|task| {
                    let find =
                        |name| task.groups.iter().find(|g| g.arm == name && g.results().next().is_some());
                    Some((find(*arm)?, find(*with)?))
                })
                .collect();
            if both.len() > 1 {
                found
                    .extend(Time::ALL.into_iter().filter_map(|time| compare(None, [arm, with], time, &both)));
            }
        }
    }
    found
}

fn compare(
    task: Option<&str>,
    [arm, with]: [&str; 2],
    time: Time,
    groups: &[(&Group<'_>, &Group<'_>)],
) -> Option<Comparison> {
    let (a, b): (Vec<_>, Vec<_>) = groups.iter().map(|(a, b)| (a.times(time), b.times(time))).unzip();
    if a.iter().chain(&b).any(Vec::is_empty) {
        return None;
    }
    Some(Comparison {
        task: task.map(Into::into),
        arm: arm.into(),
        with: with.into(),
        time,
        // Times on different tasks have no common scale, and so no common median.
        ratio: task.map(|_| ratio_interval(&a, &b)),
        improvement: improvement_interval(&a, &b),
    })
}
