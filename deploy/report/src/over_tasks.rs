//! Figures over many tasks: what an arm needs compared with a baseline, task by task and on the whole.
//!
//! The time is environment steps until "solved". Times on different tasks have no common scale, so each is compared with the
//! baseline's on the same task.
//!
//! A run that was not solved is later than all others. For a median, that is enough; for a ratio, it is not. So times are cut off
//! at the task's budget before medians are divided: a run that was not solved counts as if it had been with its last step. Then
//! the ratio of an arm whose baseline was not solved is too high, and that of an arm that was not solved itself is too low.
//! [`Bound`] says so, and the second is a loss however low it is.

use crate::stats::{
    Estimate, bootstrap, improvement_interval, iqm_interval, mean, median, ratio_interval, share,
};
use crate::summary::{Group, Task, Time, order};
use serde::Serialize;

/// A ratio above this is a loss.
pub const LOSS: f64 = 1.1;
/// Where the interval of a ratio reaches above this without a loss, the task is in doubt.
pub const DOUBT: f64 = 1.25;
/// Multiples of the baseline's median at which a profile has points, as powers of two: from and to.
const PROFILE: [f64; 2] = [-6.0, 3.0];
/// Points of a profile for each power of two.
const FINENESS: usize = 4;

/// Everything about more than one task.
#[derive(Clone, Debug, Serialize)]
pub struct Overview {
    /// Name of the arm with which all others are compared.
    pub baseline: String,
    /// Each other arm on each task that has both.
    pub ratios: Vec<Ratio>,
    /// Each other arm over the tasks of each group, and over all of them.
    pub totals: Vec<Total>,
    /// Each arm, that of the baseline first, over all tasks.
    pub profiles: Vec<Profile>,
}

/// An arm compared with the baseline on one task.
#[derive(Clone, Debug, Serialize)]
pub struct Ratio {
    /// Group of the task; empty if it has none.
    pub group: String,
    /// Name of the task.
    pub task: String,
    /// Name of the arm.
    pub arm: String,
    /// Environment steps that a run could take.
    pub budget: f64,
    /// Complete runs, and how many of them were solved.
    pub runs: usize,
    /// See `runs`.
    pub solved: usize,
    /// The same of the baseline.
    pub baseline_runs: usize,
    /// See `baseline_runs`.
    pub baseline_solved: usize,
    /// Median environment steps until solved; null if half of the runs or more were not.
    pub median: f64,
    /// That of the baseline.
    pub baseline_median: f64,
    /// Ratio of the medians of times cut off at the budget, with its bootstrap interval.
    pub ratio: Estimate,
    /// What the ratio says.
    pub bound: Bound,
    /// Whether the arm loses: the ratio is above [`LOSS`], or the baseline's median run was solved and the arm's was not.
    pub loss: bool,
}

/// What a ratio of medians says where one of them lies beyond the budget.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Bound {
    /// Both were solved.
    Exact,
    /// The baseline was not: the true ratio is lower.
    AtMost,
    /// The arm was not: the true ratio is higher.
    AtLeast,
    /// Neither was: nothing is known.
    Unknown,
}

impl Bound {
    /// What stands before the ratio.
    pub fn sign(self) -> &'static str {
        match self {
            Self::Exact => "",
            Self::AtMost => "\u{2264} ",
            Self::AtLeast => "\u{2265} ",
            Self::Unknown => "? ",
        }
    }
}

/// An arm over several tasks.
#[derive(Clone, Debug, Serialize)]
pub struct Total {
    /// Group of the tasks; null for all of them.
    pub group: Option<String>,
    /// Name of the arm.
    pub arm: String,
    /// Number of tasks.
    pub tasks: usize,
    /// Geometric mean of the tasks' ratios.
    pub geometric_mean: Estimate,
    /// Interquartile mean over all runs of their time, cut off at the budget, over the baseline's median on their task.
    pub iqm: Estimate,
    /// Probability that a run is solved before one of the baseline on the same task, ties half.
    pub improvement: Estimate,
    /// Share of all runs that were solved.
    pub solved_share: Estimate,
    /// That of the baseline.
    pub baseline_solved_share: Estimate,
    /// Tasks whose ratio is below 1.
    pub faster: usize,
    /// Tasks on which the arm loses.
    pub losses: usize,
    /// Tasks without a loss whose interval reaches above [`DOUBT`]: too few runs to tell.
    pub doubtful: usize,
    /// The largest ratio of a task.
    pub worst: f64,
}

/// Which share of an arm's runs is solved within a multiple of the baseline's median.
#[derive(Clone, Debug, Serialize)]
pub struct Profile {
    /// Name of the arm.
    pub arm: String,
    /// Binary logarithm of the multiple, the mean over tasks of the share of runs, and the ends of its interval.
    pub points: Vec<(f64, f64, f64, f64)>,
}

/// An arm and the baseline on one task.
struct Pair<'a> {
    group: &'a str,
    task: &'a str,
    budget: f64,
    /// Times of the complete runs, infinite where they were not solved.
    arm: Vec<f64>,
    baseline: Vec<f64>,
}

impl Pair<'_> {
    fn cut(&self, times: &[f64]) -> Vec<f64> {
        times.iter().map(|time| time.clamp(1.0, self.budget)).collect()
    }

    /// The baseline's median, cut off at the budget.
    fn unit(&self) -> f64 {
        median(&mut self.cut(&self.baseline))
    }
}

/// The figures over `tasks`; none unless two tasks or more have complete runs of a baseline (`dqn`, or else the first arm) and of
/// another arm.
pub fn overview(tasks: &[Task<'_>]) -> Option<Overview> {
    let complete = |group: &&Group<'_>| group.results().next().is_some();
    let mut names: Vec<&str> =
        tasks.iter().flat_map(|task| task.groups.iter().filter(complete).map(|group| group.arm)).collect();
    names.sort_by_key(|arm| order(arm));
    names.dedup();
    let (&baseline, others) = names.split_first()?;
    let mut found = Overview {
        baseline: baseline.into(),
        ratios: Vec::new(),
        totals: Vec::new(),
        profiles: vec![profile(baseline, &pairs(tasks, baseline, baseline))],
    };
    let mut most = 0;
    for arm in others {
        let pairs = pairs(tasks, arm, baseline);
        most = most.max(pairs.len());
        let ratios: Vec<Ratio> = pairs.iter().map(|pair| ratio(arm, pair)).collect();
        let mut groups: Vec<&str> = pairs.iter().map(|pair| pair.group).collect();
        groups.dedup();
        let named = groups.iter().filter(|group| !group.is_empty() && groups.len() > 1);
        for group in named.map(|group| Some(*group)).chain([None]) {
            let within = |of: &str| group.is_none_or(|group| group == of);
            let pairs: Vec<&Pair<'_>> = pairs.iter().filter(|pair| within(pair.group)).collect();
            let ratios: Vec<&Ratio> = ratios.iter().filter(|ratio| within(&ratio.group)).collect();
            if !pairs.is_empty() {
                found.totals.push(total(group, arm, &pairs, &ratios));
            }
        }
        found.ratios.extend(ratios);
        found.profiles.push(profile(arm, &pairs));
    }
    (most > 1).then_some(found)
}

/// `arm` and `baseline` on each task that has complete runs of both.
fn pairs<'a>(tasks: &[Task<'a>], arm: &str, baseline: &str) -> Vec<Pair<'a>> {
    let of = |task: &Task<'a>| {
        let times = |name: &str| {
            let group = task.groups.iter().find(|group| group.arm == name)?;
            Some(group.times(Time::SolvedEnvSteps)).filter(|times| !times.is_empty())
        };
        Some(Pair {
            group: task.group,
            task: task.name,
            budget: budget(task),
            arm: times(arm)?,
            baseline: times(baseline)?,
        })
    };
    tasks.iter().filter_map(of).collect()
}

/// Environment steps that a run of `task` can take: the least limit of its runs, or where they have none the length of the longest.
fn budget(task: &Task<'_>) -> f64 {
    let runs = task.groups.iter().flat_map(|group| &group.runs);
    let limits = runs.filter(|run| run.complete().is_some()).filter_map(|run| run.config.run.env_steps);
    limits.min().map_or_else(|| Time::SolvedEnvSteps.longest(task), |steps| steps as f64)
}

fn ratio(arm: &str, pair: &Pair<'_>) -> Ratio {
    let middle = |times: &[f64]| median(&mut times.to_vec());
    let solved = |times: &[f64]| times.iter().filter(|time| time.is_finite()).count();
    let (median, baseline_median) = (middle(&pair.arm), middle(&pair.baseline));
    let bound = match (median.is_finite(), baseline_median.is_finite()) {
        (true, true) => Bound::Exact,
        (true, false) => Bound::AtMost,
        (false, true) => Bound::AtLeast,
        (false, false) => Bound::Unknown,
    };
    let ratio = ratio_interval(&[pair.cut(&pair.arm)], &[pair.cut(&pair.baseline)]);
    Ratio {
        group: pair.group.into(),
        task: pair.task.into(),
        arm: arm.into(),
        budget: pair.budget,
        runs: pair.arm.len(),
        solved: solved(&pair.arm),
        baseline_runs: pair.baseline.len(),
        baseline_solved: solved(&pair.baseline),
        median,
        baseline_median,
        ratio,
        bound,
        loss: ratio.mid > LOSS || bound == Bound::AtLeast,
    }
}

fn total(group: Option<&str>, arm: &str, pairs: &[&Pair<'_>], ratios: &[&Ratio]) -> Total {
    let (arms, baselines): (Vec<Vec<f64>>, Vec<Vec<f64>>) =
        pairs.iter().map(|pair| (pair.cut(&pair.arm), pair.cut(&pair.baseline))).unzip();
    let scaled = |pair: &&Pair<'_>| {
        let unit = pair.unit();
        pair.cut(&pair.arm).into_iter().map(|time| time / unit).collect::<Vec<f64>>()
    };
    let (own, theirs): (Vec<Vec<f64>>, Vec<Vec<f64>>) =
        pairs.iter().map(|pair| (pair.arm.clone(), pair.baseline.clone())).unzip();
    let all = |times: &[Vec<f64>]| {
        let times = times.iter().flatten();
        share(times.clone().filter(|time| time.is_finite()).count(), times.count())
    };
    Total {
        group: group.map(Into::into),
        arm: arm.into(),
        tasks: pairs.len(),
        geometric_mean: geometric_mean(&arms, &baselines),
        iqm: iqm_interval(&pairs.iter().map(scaled).collect::<Vec<_>>()),
        improvement: improvement_interval(&own, &theirs),
        solved_share: all(&own),
        baseline_solved_share: all(&theirs),
        faster: ratios.iter().filter(|ratio| ratio.ratio.mid < 1.0).count(),
        losses: ratios.iter().filter(|ratio| ratio.loss).count(),
        doubtful: ratios.iter().filter(|ratio| !ratio.loss && ratio.ratio.high > DOUBT).count(),
        worst: ratios.iter().map(|ratio| ratio.ratio.mid).fold(0.0, f64::max),
    }
}

/// Geometric mean over tasks of the ratio of medians, with its stratified bootstrap interval.
fn geometric_mean(arms: &[Vec<f64>], baselines: &[Vec<f64>]) -> Estimate {
    bootstrap(&[arms, baselines], |sample| {
        let [arms, baselines] = sample else { return f64::NAN };
        let logs = arms.iter_mut().zip(baselines).map(|(a, b)| (median(a) / median(b)).ln());
        mean(&logs.collect::<Vec<_>>()).exp()
    })
}

fn profile(arm: &str, pairs: &[Pair<'_>]) -> Profile {
    let [from, to] = PROFILE;
    let count = ((to - from) * FINENESS as f64) as usize;
    let points = (0..=count).map(|at| {
        let power = from + at as f64 / FINENESS as f64;
        let within = |pair: &Pair<'_>| {
            let limit = pair.unit() * power.exp2();
            pair.arm.iter().map(|&time| f64::from(u8::from(time <= limit))).collect::<Vec<f64>>()
        };
        let hits: Vec<Vec<f64>> = pairs.iter().map(within).collect();
        let Estimate { mid, low, high } =
            bootstrap(&[&hits], |sample| mean(&sample[0].iter().map(|task| mean(task)).collect::<Vec<_>>()));
        (power, mid, low, high)
    });
    Profile { arm: arm.into(), points: points.collect() }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const NEVER: f64 = f64::INFINITY;

    fn pair(arm: &[f64], baseline: &[f64]) -> Pair<'static> {
        Pair { group: "g", task: "t", budget: 100.0, arm: arm.into(), baseline: baseline.into() }
    }

    #[test]
    fn ratios_say_what_is_known() {
        for (arm, baseline, mid, bound, loss) in [
            (&[10.0, 20.0, 30.0][..], &[40.0, 50.0, NEVER][..], 0.4, Bound::Exact, false),
            (&[56.0; 3], &[50.0; 3], 1.12, Bound::Exact, true),
            (&[50.0; 3], &[NEVER, NEVER, 1.0], 0.5, Bound::AtMost, false),
            // Too low, and a loss all the same.
            (&[NEVER; 3], &[95.0; 3], 100.0 / 95.0, Bound::AtLeast, true),
            (&[NEVER, NEVER, 3.0], &[NEVER; 3], 1.0, Bound::Unknown, false),
        ] {
            let found = ratio("x", &pair(arm, baseline));
            assert!((found.ratio.mid - mid).abs() < 1e-12, "{found:?}");
            assert_eq!((found.bound, found.loss), (bound, loss), "{found:?}");
            assert!(found.ratio.low <= mid && mid <= found.ratio.high, "{found:?}");
        }
        let two_of_three = ratio("x", &pair(&[NEVER, 2.0, 4.0], &[8.0; 2]));
        assert_eq!((two_of_three.runs, two_of_three.solved, two_of_three.baseline_runs), (3, 2, 2));
        assert_eq!((two_of_three.median, two_of_three.baseline_median), (4.0, 8.0));
    }

    /// Two tasks with ratios 0.25 and 1, by hand.
    #[test]
    fn totals_are_those_of_a_case_by_hand() {
        let pairs = [pair(&[10.0, 10.0], &[40.0, 40.0]), pair(&[80.0, NEVER], &[90.0, NEVER])];
        let ratios: Vec<Ratio> = pairs.iter().map(|pair| ratio("x", pair)).collect();
        // The medians of the second task lie between a time and the budget: 90 of 95.
        assert!((ratios[1].ratio.mid - 90.0 / 95.0).abs() < 1e-12);
        let total = total(Some("g"), "x", &[&pairs[0], &pairs[1]], &[&ratios[0], &ratios[1]]);
        let expected = (0.25f64 * 90.0 / 95.0).sqrt();
        assert!((total.geometric_mean.mid - expected).abs() < 1e-12);
        assert!(total.geometric_mean.low < expected && expected < total.geometric_mean.high);
        // Of 0.25, 0.25, 80 / 95 and 100 / 95 the middle two.
        assert!((total.iqm.mid - (0.25 + 80.0 / 95.0) / 2.0).abs() < 1e-12);
        // Always before on the first task; on the second (80 before both, never against 90, a tie): 2.5 of 4.
        assert!((total.improvement.mid - (1.0 + 2.5 / 4.0) / 2.0).abs() < 1e-12);
        assert_eq!((total.solved_share.mid, total.baseline_solved_share.mid), (0.75, 0.75));
        assert_eq!((total.tasks, total.faster, total.losses, total.doubtful), (2, 2, 0, 0));
        assert!((total.worst - 90.0 / 95.0).abs() < 1e-12);
    }

    #[test]
    fn a_profile_counts_runs_within_multiples_of_the_baselines_median() {
        let pairs = [pair(&[10.0, 45.0], &[40.0, 40.0]), pair(&[NEVER, 80.0], &[80.0, 80.0])];
        let profile = profile("x", &pairs);
        let at = |power: f64| profile.points.iter().find(|point| point.0 == power).unwrap().1;
        assert_eq!(
            [at(-2.25), at(-2.0), at(-0.25), at(0.0), at(0.25), at(3.0)],
            [0.0, 0.25, 0.25, 0.5, 0.75, 0.75]
        );
        assert!(profile.points.iter().all(|&(_, mid, low, high)| low <= mid && mid <= high));
    }
}
