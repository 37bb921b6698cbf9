//! Many runs' series on one axis.
//!
//! At a point of the axis a run has the value that it recorded last. Before its first record it has none and is not
//! counted; after its end it keeps its last one.

use crate::run::{Point, Series};
use crate::stats::{Estimate, iqm_interval, mean, standard_deviation};

/// Points of a curve, at most.
pub const GRID: usize = 120;

/// The horizontal axis of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// Finished episodes.
    Episodes,
    /// Environment steps.
    EnvSteps,
}

impl Axis {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Episodes, Self::EnvSteps];

    /// In names of files and columns.
    pub fn name(self) -> &'static str {
        match self {
            Self::Episodes => "episodes",
            Self::EnvSteps => "env_steps",
        }
    }

    /// On pictures.
    pub fn label(self) -> &'static str {
        match self {
            Self::Episodes => "training episodes",
            Self::EnvSteps => "environment steps",
        }
    }

    fn of(self, point: &Point) -> f64 {
        match self {
            Self::Episodes => point.episode,
            Self::EnvSteps => point.env_steps,
        }
    }
}

/// The values at one point of the axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Position on the axis.
    pub x: f64,
    /// Runs that have a value.
    pub runs: usize,
    /// Their mean and standard deviation.
    pub mean: f64,
    /// See `mean`.
    pub std: f64,
    /// Their interquartile mean with its bootstrap interval.
    pub iqm: Estimate,
}

/// The curve of `series` over `axis`, from its beginning to the end of the longest run, in at most [`GRID`] equal steps.
pub fn curve(series: &[&Series], axis: Axis) -> Vec<Row> {
    let runs: Vec<Vec<(f64, f64)>> =
        series.iter().map(|s| s.points().map(|p| (axis.of(&p), p.value)).collect()).collect();
    let end = runs.iter().filter_map(|run| run.last()).map(|last| last.0).fold(0.0, f64::max);
    let longest = runs.iter().map(Vec::len).max().unwrap_or(0);
    let steps = longest.min(GRID);
    let mut rows = Vec::with_capacity(steps);
    for step in 1..=steps {
        let x = end * step as f64 / steps as f64;
        let values: Vec<f64> = runs
            .iter()
            .filter_map(|run| run[..run.partition_point(|&(at, _)| at <= x)].last())
            .map(|&(_, value)| value)
            .collect();
        if !values.is_empty() {
            rows.push(Row {
                x,
                runs: values.len(),
                mean: mean(&values),
                std: standard_deviation(&values),
                iqm: iqm_interval(std::slice::from_ref(&values)),
            });
        }
    }
    rows
}

/// Share of runs that got there, as steps: after each time in `times` (infinite: never) up to `end`.
pub fn share_over_time(times: &[f64], end: f64) -> Vec<(f64, f64)> {
    let mut sorted: Vec<f64> = times.iter().copied().filter(|t| t.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let share = |hits: usize| hits as f64 / times.len() as f64;
    let mut steps = vec![(0.0, 0.0)];
    for (hits, &at) in sorted.iter().enumerate() {
        steps.extend([(at, share(hits)), (at, share(hits + 1))]);
    }
    steps.push((end, share(sorted.len())));
    steps
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(points: &[(f64, f64)]) -> Series {
        points.iter().map(|&(x, value)| Point { episode: x, env_steps: 10.0 * x, value }).collect()
    }

    #[test]
    fn a_run_has_the_value_that_it_recorded_last() {
        let (long, short) =
            (series(&[(5.0, 1.0), (10.0, 2.0), (15.0, 9.0), (20.0, 4.0)]), series(&[(10.0, 0.0)]));
        let rows = curve(&[&long, &short], Axis::EnvSteps);
        let seen: Vec<_> = rows.iter().map(|r| (r.x, r.runs, r.mean, r.std)).collect();
        assert_eq!(
            seen,
            [(50.0, 1, 1.0, 0.0), (100.0, 2, 1.0, 1.0), (150.0, 2, 4.5, 4.5), (200.0, 2, 2.0, 2.0)]
        );
        assert!(rows.iter().all(|r| r.iqm.low <= r.iqm.mid && r.iqm.mid <= r.iqm.high));
        assert_eq!(curve(&[&Series::default()], Axis::Episodes), []);
    }

    #[test]
    fn shares_rise_where_runs_get_there() {
        let steps = share_over_time(&[30.0, f64::INFINITY, 10.0, 30.0], 50.0);
        let expected = [
            (0.0, 0.0),
            (10.0, 0.0),
            (10.0, 0.25),
            (30.0, 0.25),
            (30.0, 0.5),
            (30.0, 0.5),
            (30.0, 0.75),
            (50.0, 0.75),
        ];
        assert_eq!(steps, expected);
    }
}
