//! Learning curves of arms: many runs' evaluations on one axis, as a median and the middle half around it.

use crate::table::Table;
use serde::Serialize;
use std::collections::BTreeMap;

/// Points of a curve.
const POINTS: usize = 80;
/// The axes: names of columns of evaluations, and their places.
const AXES: [(&str, usize); 3] = [("episode", 0), ("env_steps", 1), ("wall_s", 3)];
/// The place of the return.
const RETURN: usize = 4;

/// One run's evaluations, and where it belongs.
pub(crate) struct Curve<'a> {
    pub(crate) task: &'a str,
    pub(crate) arm: &'a str,
    /// Whether it has run its whole length: then its last return stands for what would have followed.
    pub(crate) ended: bool,
    pub(crate) solved: bool,
    pub(crate) threshold: Option<f64>,
    pub(crate) table: &'a Table<7>,
}

/// The curves of a task.
#[derive(Debug, Serialize)]
pub(crate) struct Task {
    pub(crate) task: String,
    /// None where runs differ.
    pub(crate) threshold: Option<f64>,
    pub(crate) arms: Vec<Arm>,
}

/// The curves of an arm.
#[derive(Debug, Serialize)]
pub(crate) struct Arm {
    pub(crate) arm: String,
    pub(crate) runs: usize,
    pub(crate) solved: usize,
    /// By the name of the axis.
    pub(crate) curves: BTreeMap<&'static str, Band>,
}

/// A median with its quartiles, `null` where no run has got.
#[derive(Debug, Default, PartialEq, Serialize)]
pub(crate) struct Band {
    pub(crate) x: Vec<f64>,
    pub(crate) low: Vec<Option<f64>>,
    pub(crate) mid: Vec<Option<f64>>,
    pub(crate) high: Vec<Option<f64>>,
}

/// The curves of all runs by task and arm, `dqn` first, with which the others are compared.
pub(crate) fn arms(runs: &[Curve<'_>]) -> Vec<Task> {
    let mut tasks: BTreeMap<&str, BTreeMap<(bool, &str), Vec<&Curve<'_>>>> = BTreeMap::new();
    for run in runs {
        tasks.entry(run.task).or_default().entry((run.arm != "dqn", run.arm)).or_default().push(run);
    }
    tasks
        .into_iter()
        .map(|(task, arms)| {
            let mut thresholds = arms.values().flatten().map(|run| run.threshold);
            let first = thresholds.next().flatten();
            let threshold = first.filter(|_| thresholds.all(|other| other == first));
            let arms = arms.into_iter().map(|((_, arm), runs)| Arm {
                arm: arm.into(),
                runs: runs.len(),
                solved: runs.iter().filter(|run| run.solved).count(),
                curves: AXES.iter().map(|&(name, axis)| (name, band(&runs, axis))).collect(),
            });
            Task { task: task.into(), threshold, arms: arms.collect() }
        })
        .collect()
}

/// The band of `runs` over the column `axis`.
fn band(runs: &[&Curve<'_>], axis: usize) -> Band {
    let end = runs.iter().filter_map(|run| run.table.last()).map(|row| row[axis]).fold(0.0, f64::max);
    if end <= 0.0 {
        return Band::default();
    }
    let mut band = Band::default();
    for at in 0..POINTS {
        let x = end * at as f64 / (POINTS - 1) as f64;
        let mut values: Vec<f64> = runs.iter().filter_map(|run| value(run, axis, x)).collect();
        values.sort_unstable_by(f64::total_cmp);
        band.x.push(x);
        band.low.push(quantile(&values, 0.25));
        band.mid.push(quantile(&values, 0.5));
        band.high.push(quantile(&values, 0.75));
    }
    band
}

/// The return of a run's newest evaluation at `x`; none before the first one, and after the last one of a run that goes on.
fn value(run: &Curve<'_>, axis: usize, x: f64) -> Option<f64> {
    let over = run.table.last().is_none_or(|last| last[axis] < x);
    if over && !run.ended {
        return None;
    }
    run.table.rows().take_while(|row| row[axis] <= x).last().map(|row| row[RETURN])
}

/// The quantile `q` of ascending `values`, between two of them in proportion.
fn quantile(values: &[f64], q: f64) -> Option<f64> {
    let at = q * (values.len().checked_sub(1)?) as f64;
    let (low, high) = (values[at.floor() as usize], values[at.ceil() as usize]);
    Some(low + (high - low) * at.fract())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn table(returns: &[f64]) -> Table<7> {
        let mut table = Table::new(["episode", "env_steps", "g", "wall_s", "return", "l", "s"], 100);
        for (at, value) in returns.iter().enumerate() {
            table.push([at as f64, 10.0 * at as f64, 0.0, at as f64, *value, 0.0, 0.0]);
        }
        table
    }

    #[test]
    fn a_band_is_the_middle_half_of_what_is_there() {
        let tables = [table(&[0.0, 1.0, 2.0]), table(&[0.0, 3.0]), table(&[0.0, 5.0])];
        let run = |at: usize, arm, ended| Curve {
            task: "t",
            arm,
            ended,
            solved: at == 0,
            threshold: Some(5.0),
            table: &tables[at],
        };
        let tasks = arms(&[
            run(0, "ha-diiqn", true),
            run(1, "ha-diiqn", true),
            run(2, "ha-diiqn", false),
            run(1, "dqn", true),
        ]);
        assert_eq!((tasks.len(), tasks[0].threshold), (1, Some(5.0)));
        assert_eq!(tasks[0].arms[0].arm, "dqn");
        let arm = &tasks[0].arms[1];
        assert_eq!((arm.runs, arm.solved), (3, 1));
        let band = &arm.curves["episode"];
        assert_eq!((band.x.len(), band.x[POINTS - 1]), (POINTS, 2.0));
        // At the end the third run is not there yet, and the second one stays where it was.
        assert_eq!(band.mid[POINTS - 1], Some(2.5));
        assert_eq!((band.low[POINTS - 1], band.high[POINTS - 1]), (Some(2.25), Some(2.75)));
        assert_eq!(band.mid[0], Some(0.0));
        assert_eq!(arm.curves["env_steps"].x[POINTS - 1], 20.0);
    }

    #[test]
    fn without_evaluations_there_is_no_curve() {
        let empty = table(&[]);
        let run = Curve { task: "t", arm: "a", ended: false, solved: false, threshold: None, table: &empty };
        assert_eq!(arms(&[run])[0].arms[0].curves["episode"], Band::default());
    }
}
