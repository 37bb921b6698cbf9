//! What `trestle demo inspect` says of a demonstration: how far its states are apart, which thresholds follow from
//! that, and a warning where the thresholds in use are too large for it.
//!
//! `e_th` must be smaller than what the mentor covers in a few steps. Otherwise every observer transition is similar to
//! where the mentor goes next, and any action passes for the mentor's own or for a bridge. `e_infeas` must be smaller
//! than what it covers in one, or an observer that stays where it is does what the mentor did.
//!
//! # `auto`
//! Both are a quarter of a KL divergence of the demonstration, which is half of its distance (our choice). `e_th`: the
//! smallest, over 1 to `n` mentor steps, of the median KL of states that many steps apart. Similar states are then no
//! farther from each other than half of what the mentor typically covers, so that the neighbourhoods of its states
//! hardly overlap. `e_infeas`: the median KL of states one step apart. An observer transition counts as the mentor's
//! if it misses it by no more than half a mentor step. Pairs of equal states are left out of the medians: a mentor
//! that waits says nothing of its speed.

use crate::demonstration::Demonstration;
use crate::similarity::metric::{Metric, kl};
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
    /// The tenth part of the pairs is not above, and not below, these.
    pub tenths: [f32; 2],
    /// The median over pairs of different states; none if there is none.
    pub moving: Option<f32>,
}

/// What `auto` stands for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Auto {
    /// `mentor.e_th`.
    pub e_th: f64,
    /// `mentor.e_infeas`.
    pub e_infeas: f64,
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
    let mut values: Vec<f32> = pairs.collect();
    values.sort_unstable_by(f32::total_cmp);
    let last = values.len().checked_sub(1)?;
    let tenths = [values[last / 10], values[last - last / 10]];
    let different = values[values.partition_point(|&kl| kl == 0.0)..].to_vec();
    let moving = spread(different, f32::total_cmp).map(|kl| kl.median);
    Some(Apart { steps, pairs: values.len(), kl: spread(values, f32::total_cmp)?, tenths, moving })
}

fn spread<T: Copy>(mut values: Vec<T>, order: fn(&T, &T) -> std::cmp::Ordering) -> Option<Spread<T>> {
    values.sort_unstable_by(order);
    let (&min, &max) = (values.first()?, values.last()?);
    Some(Spread { min, median: values[(values.len() - 1) / 2], max })
}

impl Summary {
    /// What `auto` stands for here; none where no state differs from the ones after it.
    pub fn auto(&self) -> Option<Auto> {
        let quarter = |kl: f32| f64::from(kl) / 4.0;
        let nearest = self.apart.iter().filter_map(|apart| apart.moving).reduce(f32::min)?;
        let step = self.apart.first().and_then(|apart| apart.moving).unwrap_or(nearest);
        Some(Auto { e_th: quarter(nearest), e_infeas: quarter(step) })
    }

    /// Warnings with their figures. `e_th`: half of the mentor's states are similar to a later one, so an observer that
    /// stays where it is has already arrived. `e_infeas`: half of the mentor's transitions are reproduced by staying.
    pub fn warnings(&self, e_th: f64, e_infeas: f64) -> Vec<String> {
        let Some(one) = self.apart.first().map(|apart| apart.kl.median) else { return Vec::new() };
        let swallowed = self.apart.iter().rfind(|a| f64::from(a.kl.median) <= e_th).map(|swallowed| {
            format!(
                "mentor.e_th = {e_th} swallows {steps} mentor steps: states {steps} apart have a median KL of {far}, \
                 states one step apart {one}; almost any action will look like the mentor's. Accepted without this \
                 warning: less than {one}, or auto",
                steps = swallowed.steps,
                far = swallowed.kl.median,
            )
        });
        let still = (f64::from(one) < e_infeas).then(|| {
            format!(
                "mentor.e_infeas = {e_infeas} is more than the median KL of one mentor step, {one}: an observer that \
                 stays where it is does what the mentor did. Accepted without this warning: up to {one}, or auto"
            )
        });
        swallowed.into_iter().chain(still).collect()
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
        for Apart { steps, pairs, kl: Spread { min, median, max }, tenths: [low, high], .. } in &self.apart {
            writeln!(
                f,
                "KL, {steps:>2} apart  min {min}, 10% {low}, median {median}, 90% {high}, max {max} ({pairs} pairs)"
            )?;
        }
        match self.auto() {
            Some(Auto { e_th, e_infeas }) => {
                writeln!(f, "auto          mentor.e_th {e_th}, mentor.e_infeas {e_infeas}")
            }
            None => writeln!(f, "auto          none: no state differs from those after it"),
        }
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
        let line = "KL,  1 apart  min 0.5, 10% 0.5, median 0.5, 90% 2, max 2 (4 pairs)";
        assert!(text.contains(line), "{text}");
        assert!(text.contains("auto          mentor.e_th 0.125, mentor.e_infeas 0.125"), "{text}");
    }

    /// The summary of a path along one feature.
    fn along(states: &[f32]) -> Summary {
        let mut demo = Demonstration::new(vec!["x".into()]).unwrap();
        demo.push_trajectory(states, false).unwrap();
        summarise(&demo, &Metric::diagonal(&[1.0]).unwrap(), 2)
    }

    #[test]
    fn auto_is_half_of_what_the_mentor_covers() {
        // Steps of 2, and waiting, which does not count.
        let auto = along(&[0.0, 2.0, 2.0, 2.0, 2.0, 4.0]).auto().unwrap();
        assert_eq!(auto, Auto { e_th: 0.5, e_infeas: 0.5 });
        // Forth and nearly back: two steps cover less than one.
        let auto = along(&[0.0, 2.0, 1.0, 3.0, 2.0]).auto().unwrap();
        assert_eq!(auto, Auto { e_th: 0.125, e_infeas: 0.125 });
        let auto = along(&[0.0, 2.0, 0.5, 2.5, 1.0, 3.0, 1.5, 3.5]).auto().unwrap();
        assert_eq!(auto, Auto { e_th: 0.03125, e_infeas: 0.5 });
        assert!(along(&[0.0, 2.0, 4.0]).warnings(auto.e_th, auto.e_infeas).is_empty());
        assert_eq!(along(&[7.0, 7.0, 7.0]).auto(), None);
        assert!(along(&[7.0, 7.0]).to_string().contains("auto          none"));
    }

    #[test]
    fn a_threshold_that_swallows_steps_is_warned_of() {
        let s = line();
        assert_eq!(s.warnings(0.1, 0.5), [] as [String; 0]);
        assert!(s.warnings(0.5, 0.1)[0].contains("swallows 1 mentor steps"));
        let warnings = s.warnings(2.0, 0.6);
        let [text, still] = &warnings[..] else { panic!("{warnings:?}") };
        assert!(text.contains("swallows 2 mentor steps"), "{text}");
        assert!(text.contains("median KL of 2, states one step apart 0.5"), "{text}");
        assert!(
            still.starts_with("mentor.e_infeas = 0.6 is more than the median KL of one mentor step, 0.5")
        );
    }
}
