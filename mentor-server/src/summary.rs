//! What `trestle demo inspect` says of a demonstration, and the warning when `e_th` is too large for it.
//!
//! `e_th` must be smaller than what the mentor covers in a few steps. Otherwise every observer transition is similar to
//! where the mentor goes next, and any action passes for the mentor's own or for a bridge.

use crate::demonstration::Demonstration;
use crate::metric::{Metric, kl};
use std::fmt;

/// Counts and ranges of a demonstration.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Number of trajectories.
    pub trajectories: usize,
    /// Trajectories that ended in a terminal state.
    pub terminal: usize,
    /// Number of states.
    pub states: usize,
    /// Number of transitions.
    pub transitions: usize,
    /// Transitions of a trajectory.
    pub lengths: Spread<usize>,
    /// Name, smallest and largest value of each feature.
    pub features: Vec<(String, f32, f32)>,
    /// KL between mentor states 1, 2, ... mentor steps apart, as far as any trajectory has such pairs.
    pub apart: Vec<Apart>,
}

/// Smallest, middle and largest of some values; of an even number of them the lower middle one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread<T> {
    /// The smallest.
    pub min: T,
    /// The middle one.
    pub median: T,
    /// The largest.
    pub max: T,
}

/// KL between mentor states that are some steps apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Apart {
    /// Mentor steps between them.
    pub steps: usize,
    /// Pairs.
    pub pairs: usize,
    /// Their KL divergences.
    pub kl: Spread<f32>,
}

/// Looks a demonstration over. `metric` must be for its number of features; `n` is the largest number of steps that
/// mentor states are compared over.
pub fn summarise(demo: &Demonstration, metric: &Metric, n: usize) -> Summary {
    let count = demo.n_trajectories();
    let whitened = metric.whiten_all(demo.states());
    let apart = (1..=n).map_while(|steps| apart(demo, &whitened, steps)).collect();
    let feature = |(axis, name): (usize, &String)| {
        let column = demo.states().iter().skip(axis).step_by(demo.dim());
        let (low, high) = column.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), &x| (l.min(x), h.max(x)));
        (name.clone(), low, high)
    };
    Summary {
        trajectories: count,
        terminal: (0..count).filter(|&i| demo.terminal(i)).count(),
        states: demo.n_states(),
        transitions: demo.n_transitions(),
        lengths: spread((0..count).map(|i| demo.trajectory(i).len() - 1).collect(), usize::cmp)
            .unwrap_or_default(),
        features: demo.names().iter().enumerate().map(feature).collect(),
        apart,
    }
}

fn apart(demo: &Demonstration, whitened: &[f32], steps: usize) -> Option<Apart> {
    let state = |m: usize| &whitened[m * demo.dim()..][..demo.dim()];
    let pairs = (0..demo.n_trajectories()).flat_map(|i| {
        let states = demo.trajectory(i);
        (states.start..states.end.saturating_sub(steps)).map(|m| kl(state(m), state(m + steps)))
    });
    let values: Vec<f32> = pairs.collect();
    Some(Apart { steps, pairs: values.len(), kl: spread(values, f32::total_cmp)? })
}

fn spread<T: Copy>(mut values: Vec<T>, order: fn(&T, &T) -> std::cmp::Ordering) -> Option<Spread<T>> {
    values.sort_unstable_by(order);
    let (&min, &max) = (values.first()?, values.last()?);
    Some(Spread { min, median: values[(values.len() - 1) / 2], max })
}

impl Summary {
    /// A warning with its figures, if half of the mentor's states are similar (KL up to `e_th`) to a later one: an
    /// observer that stays where it is has then already arrived.
    pub fn warning(&self, e_th: f64) -> Option<String> {
        let swallowed = self.apart.iter().rfind(|a| f64::from(a.kl.median) <= e_th)?;
        let one = self.apart[0].kl.median;
        Some(format!(
            "mentor.e_th = {e_th} swallows {steps} mentor steps: states {steps} apart have a median KL of {far}, states \
             one step apart {one}; almost any action will look like the mentor's. Accepted without this warning: less \
             than {one}",
            steps = swallowed.steps,
            far = swallowed.kl.median,
        ))
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "trajectories  {} ({} ended in a terminal state)", self.trajectories, self.terminal)?;
        writeln!(f, "states        {}", self.states)?;
        let Spread { min, median, max } = self.lengths;
        writeln!(f, "transitions   {} (a trajectory: {min} to {max}, median {median})", self.transitions)?;
        for (name, low, high) in &self.features {
            writeln!(f, "feature       {name}: {low} to {high}")?;
        }
        for Apart { steps, pairs, kl: Spread { min, median, max } } in &self.apart {
            writeln!(f, "KL, {steps:>2} apart  min {min}, median {median}, max {max} ({pairs} pairs)")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn line() -> Summary {
        let mut demo = Demonstration::new(vec!["x".into()]).unwrap();
        demo.push_trajectory(&[0.0, 1.0, 2.0, 3.0], true).unwrap();
        demo.push_trajectory(&[10.0, 12.0], false).unwrap();
        summarise(&demo, &Metric::diagonal(&[1.0]).unwrap(), 8)
    }

    #[test]
    fn figures_of_a_line() {
        let s = line();
        assert_eq!((s.trajectories, s.terminal, s.states, s.transitions), (2, 1, 6, 4));
        assert_eq!(s.lengths, Spread { min: 1, median: 1, max: 3 });
        assert_eq!(s.features, [("x".to_string(), 0.0, 12.0)]);
        let apart: Vec<_> =
            s.apart.iter().map(|a| (a.steps, a.pairs, a.kl.min, a.kl.median, a.kl.max)).collect();
        assert_eq!(apart, [(1, 4, 0.5, 0.5, 2.0), (2, 2, 2.0, 2.0, 2.0), (3, 1, 4.5, 4.5, 4.5)]);
        let text = s.to_string();
        assert!(text.contains("transitions   4 (a trajectory: 1 to 3, median 1)"), "{text}");
        assert!(text.contains("KL,  1 apart  min 0.5, median 0.5, max 2 (4 pairs)"), "{text}");
    }

    #[test]
    fn a_threshold_that_swallows_steps_is_warned_of() {
        let s = line();
        assert_eq!(s.warning(0.1), None);
        assert!(s.warning(0.5).unwrap().contains("swallows 1 mentor steps"));
        let text = s.warning(2.0).unwrap();
        assert!(text.contains("swallows 2 mentor steps"), "{text}");
        assert!(text.contains("median KL of 2, states one step apart 0.5"), "{text}");
    }
}
