//! One run as a report sees it: its tables, and curves of bounded length.

use std::path::PathBuf;
use trestle_proto::config::Config;
use trestle_proto::run_result::RunResult;

/// Points that are kept of a series, at most.
pub const MAX_POINTS: usize = 1024;

/// A number that was recorded at some point of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Finished episodes.
    pub episode: f64,
    /// Environment steps.
    pub env_steps: f64,
    /// The number.
    pub value: f64,
}

/// A series of bounded length, in the order of time.
#[derive(Clone, Debug, Default)]
pub struct Series {
    points: Vec<Point>,
    /// The last point, which is always part of the series.
    last: Option<Point>,
    /// One point in 2^`level` is kept.
    level: u32,
    seen: u64,
}

impl Series {
    pub(crate) fn push(&mut self, point: Point) {
        if self.seen.is_multiple_of(1 << self.level) {
            if self.points.len() == MAX_POINTS {
                let mut at = 0;
                self.points.retain(|_| {
                    at += 1;
                    at % 2 == 1
                });
                self.level += 1;
            }
            if self.seen.is_multiple_of(1 << self.level) {
                self.points.push(point);
            }
        }
        self.last = Some(point);
        self.seen += 1;
    }

    /// All points that were kept.
    pub fn points(&self) -> impl Iterator<Item = Point> + '_ {
        let end = self.last.filter(|last| self.points.last() != Some(last));
        self.points.iter().copied().chain(end)
    }

    /// Whether nothing was recorded.
    pub fn is_empty(&self) -> bool {
        self.last.is_none()
    }
}

impl FromIterator<Point> for Series {
    fn from_iter<I: IntoIterator<Item = Point>>(points: I) -> Self {
        let mut series = Self::default();
        points.into_iter().for_each(|point| series.push(point));
        series
    }
}

/// One run.
#[derive(Clone, Debug)]
pub struct Run {
    /// Its directory.
    pub path: PathBuf,
    /// The arm of the comparison that it belongs to.
    pub arm: String,
    /// Its task.
    pub task: String,
    /// The group of its task, where a suite has groups; empty otherwise.
    pub group: String,
    /// The mark of its last start, if that is known: a copy has the same one.
    pub start: Option<u64>,
    /// Its resolved configuration.
    pub config: Config,
    /// Version of the program that made it, and the commit of its sources; empty where the run does not say.
    pub version: String,
    /// See `version`.
    pub commit: String,
    /// When its result was written, seconds since 1970; none without a result.
    pub finished: Option<u64>,
    /// Its result, if it has one.
    pub result: Option<RunResult>,
    /// Return of the greedy evaluations.
    pub evaluations: Series,
    /// Mean return of the last 100 training episodes.
    pub training: Series,
    /// Share of mentor transitions that are feasible.
    pub feasible: Series,
    /// Share of mentor transitions that have a bridge.
    pub bridged: Series,
    /// Mean e_KL of the mentor transitions.
    pub e_kl: Series,
}

impl Run {
    /// A run of nothing.
    #[cfg(test)]
    pub(crate) fn blank(path: &str, arm: &str, task: &str) -> Self {
        Self {
            path: path.into(),
            arm: arm.into(),
            task: task.into(),
            group: String::new(),
            start: None,
            config: Config::default(),
            version: String::new(),
            commit: String::new(),
            finished: None,
            result: None,
            evaluations: Series::default(),
            training: Series::default(),
            feasible: Series::default(),
            bridged: Series::default(),
            e_kl: Series::default(),
        }
    }

    /// Its result, if it has run its whole length.
    pub fn complete(&self) -> Option<&RunResult> {
        self.result.as_ref().filter(|result| !result.interrupted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: u64) -> Point {
        Point { episode: x as f64, env_steps: 2.0 * x as f64, value: -(x as f64) }
    }

    #[test]
    fn a_series_keeps_its_shape_in_bounded_memory() {
        for count in [0, 1, MAX_POINTS as u64, MAX_POINTS as u64 + 1, 100_000] {
            let series: Series = (0..count).map(point).collect();
            let kept: Vec<Point> = series.points().collect();
            assert!(kept.len() <= MAX_POINTS + 1);
            assert_eq!(kept.first().copied(), (count > 0).then(|| point(0)));
            assert_eq!(kept.last().copied(), count.checked_sub(1).map(point));
            let gaps = kept.windows(2).map(|w| w[1].episode - w[0].episode);
            let longest = gaps.fold(0.0, f64::max);
            assert!(longest <= (4 * count) as f64 / MAX_POINTS as f64 + 1.0, "{count}: {longest}");
        }
    }
}
