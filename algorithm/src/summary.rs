//! What `trestle demo inspect` says of a demonstration: how far its states are apart, which thresholds follow from
//! that, and a warning where the thresholds in use are too large or too small for it.
//!
//! `e_th` must be smaller than what the mentor covers in a few steps. Otherwise every observer transition is similar to
//! where the mentor goes next, and any action passes for the mentor's own or for a bridge. `e_infeas` must be smaller
//! than what it covers in one, or an observer that stays where it is does what the mentor did.
//!
//! Where states are not whole numbers, and so hardly ever equal, both must also not be much smaller than that. An observer
//! that has to hit a twentieth of a mentor step hits next to nothing ([`MOST`], our choice). The same holds where the
//! covariance comes from a demonstration in which a feature stays as it is: an observer that differs in it at all is far away.
//!
//! # `auto`
//! Both are a quarter of a KL divergence of the demonstration, which is half of its distance (our choice). `e_th`: the
//! smallest, over 1 to `n` mentor steps, of the median KL of states that many steps apart. Similar states are then no
//! farther from each other than half of what the mentor typically covers, so that the neighbourhoods of its states
//! hardly overlap. `e_infeas`: the median KL of states one step apart. An observer transition counts as the mentor's
//! if it misses it by no more than half a mentor step. Pairs of equal states are left out of the medians: a mentor
//! that waits says nothing of its speed. So are pairs of different categories, which are never near; where there are no others,
//! a change counts as one unit of scale.
//!
//! With inertia a step is mostly the body's own: it goes on as it did, whatever is done. Where changes of states are compared
//! (`mentor.metric = "delta"`) and states have velocities, `e_infeas` is therefore taken from what the mentor's actions did, the
//! changes of its velocities, as a quarter of the KL of its *middle push*. A mentor may coast most of the time, and the median of
//! its changes would be next to nothing. So the middle is that of the sum: changes no smaller add up to half of all change. An
//! observer that misses the mentor's change by no more than half of such a push passes, and one that coasts instead does not.

use crate::demonstration::Demonstration;
use crate::similarity::metric::{DIFFERENT, Metric, kl};
use std::fmt;

/// So many times smaller than `auto` a threshold can be without a warning: a tenth of its distance, a twentieth of a mentor step.
pub const MOST: f64 = 100.0;

/// A part of a feature's scale that an observer does not keep to: where a demonstration varies less in a feature than this, the
/// feature stays as it is.
const STILL: f32 = 1e-3;
/// KL of states one unit of scale apart.
const UNIT: f32 = 0.5;

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
    /// Categories that are compared beside numbers: the mentor steps that change each, by its number. Empty where all that is
    /// compared are categories, whose changes are the mentor's way.
    pub changes: Vec<(usize, usize)>,
    /// Mentor steps that change any of these.
    pub changing: usize,
    /// The KL of the middle push: of the velocities' changes over one mentor step, those no smaller add up to half of the sum
    /// of all, as distances. None if it was not asked for, or no velocity changes.
    pub pushed: Option<f32>,
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
    /// The median over pairs of different states of equal categories, or that of one unit of scale where only categories
    /// change; none if all pairs are equal.
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
/// mentor states are compared over. `velocities`: the features from which `e_infeas` is taken; empty: from all.
pub fn summarise(demo: &Demonstration, metric: &Metric, n: usize, velocities: &[usize]) -> Summary {
    let count = demo.n_trajectories();
    let whitened = metric.whiten_all(demo.states());
    let apart = (1..=n).map_while(|steps| apart(demo, &whitened, steps)).collect();
    let feature = |(axis, name): (usize, &String)| {
        let column = demo.states().iter().skip(axis).step_by(demo.dim());
        let (low, high) = column.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), &x| (l.min(x), h.max(x)));
        (name.clone(), low, high)
    };
    let (changes, changing) = changes(demo, metric);
    Summary {
        changes,
        changing,
        trajectories: count,
        terminal: (0..count).filter(|&i| demo.terminal(i)).count(),
        states: demo.n_states(),
        transitions: demo.n_transitions(),
        lengths: spread((0..count).map(|i| demo.trajectory(i).len() - 1).collect(), usize::cmp)
            .unwrap_or_default(),
        features: demo.names().iter().enumerate().map(feature).collect(),
        apart,
        pushed: pushed(demo, metric, velocities),
    }
}

/// See [`Summary::changes`] and [`Summary::changing`].
fn changes(demo: &Demonstration, metric: &Metric) -> (Vec<(usize, usize)>, usize) {
    let categories = if metric.numbers() > 0 { metric.categories() } else { &[] };
    let steps = || {
        let all = (0..demo.n_trajectories()).map(move |i| demo.trajectory(i));
        all.flat_map(|states| states.clone().zip(states.skip(1)))
    };
    let changed = |feature: usize, [m, next]: [usize; 2]| demo.state(m)[feature] != demo.state(next)[feature];
    let count =
        |&feature: &usize| (feature, steps().filter(|&(m, next)| changed(feature, [m, next])).count());
    let any = |&(m, next): &(usize, usize)| categories.iter().any(|&feature| changed(feature, [m, next]));
    (categories.iter().map(count).collect(), steps().filter(any).count())
}

/// See [`Summary::pushed`].
fn pushed(demo: &Demonstration, metric: &Metric, velocities: &[usize]) -> Option<f32> {
    if velocities.is_empty() {
        return None;
    }
    // Whitening is linear: with all else 0, differences are those of the velocities alone.
    let mut states = vec![0.0; demo.states().len()];
    for (masked, state) in states.chunks_exact_mut(demo.dim()).zip(demo.states().chunks_exact(demo.dim())) {
        velocities.iter().for_each(|&feature| masked[feature] = state[feature]);
    }
    let changes = steps_apart(demo, &metric.whiten_all(&states), 1);
    // The square root of the KL is a distance, up to a factor.
    let mut rest = 0.5 * changes.iter().map(|&kl| f64::from(kl).sqrt()).sum::<f64>();
    let middle = changes.into_iter().find(|&kl| {
        rest -= f64::from(kl).sqrt();
        rest <= 0.0
    });
    middle.filter(|&kl| kl > 0.0)
}

/// The KL of all states that are `steps` apart, ascending.
fn steps_apart(demo: &Demonstration, whitened: &[f32], steps: usize) -> Vec<f32> {
    let state = |m: usize| &whitened[m * demo.dim()..][..demo.dim()];
    let pairs = (0..demo.n_trajectories()).flat_map(|i| {
        let states = demo.trajectory(i);
        (states.start..states.end.saturating_sub(steps)).map(|m| kl(state(m), state(m + steps)))
    });
    let mut values: Vec<f32> = pairs.collect();
    values.sort_unstable_by(f32::total_cmp);
    values
}

fn apart(demo: &Demonstration, whitened: &[f32], steps: usize) -> Option<Apart> {
    let values = steps_apart(demo, whitened, steps);
    let last = values.len().checked_sub(1)?;
    let tenths = [values[last / 10], values[last - last / 10]];
    let different = &values[values.partition_point(|&kl| kl == 0.0)..];
    let near = different[..different.partition_point(|&kl| kl < DIFFERENT)].to_vec();
    let changes = (!different.is_empty()).then_some(UNIT);
    let moving = spread(near, f32::total_cmp).map(|kl| kl.median).or(changes);
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
        let step = self.pushed.or_else(|| self.apart.first()?.moving).unwrap_or(nearest);
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
        let (step, of, stays) = match self.pushed {
            Some(pushed) => (pushed, "KL of the mentor's middle push", "coasts along"),
            None => (one, "median KL of one mentor step", "stays where it is"),
        };
        let still = (f64::from(step) < e_infeas).then(|| {
            format!(
                "mentor.e_infeas = {e_infeas} is more than the {of}, {step}: an observer that {stays} does \
                 what the mentor did. Accepted without this warning: up to {step}, or auto"
            )
        });
        swallowed.into_iter().chain(still).chain(self.warning_of_categories()).collect()
    }

    /// A warning where most of the mentor's steps change a category: only an observer whose body changes it in the same way comes
    /// near the mentor's states.
    fn warning_of_categories(&self) -> Option<String> {
        (2 * self.changing > self.transitions).then(|| {
            format!(
                "{} of {} mentor steps change a category, and states of different categories are never near each other: {}. \
                 Accepted without this warning: mentor.features without what the observer's body does not share",
                self.changing,
                self.transitions,
                self.changes_in_words()
            )
        })
    }

    /// The categories that change, and how often.
    fn changes_in_words(&self) -> String {
        let changing = self.changes.iter().filter(|(_, count)| *count > 0);
        let words: Vec<String> =
            changing.map(|&(feature, count)| format!("{} in {count}", self.features[feature].0)).collect();
        if words.is_empty() { "none".into() } else { words.join(", ") }
    }
}

/// A KL divergence for people: that of different categories is no number.
fn shown(kl: f32) -> String {
    if kl < DIFFERENT { kl.to_string() } else { "different".into() }
}

/// Warnings where next to nothing that an observer does can ever match the mentor, with the figures. Only for states that are not
/// whole numbers: those are often equal. `metric` is that of the thresholds, and `scale` has the environment's scale of each
/// feature.
pub fn unreachable(
    summary: &Summary,
    metric: &Metric,
    scale: &[f32],
    e_th: f64,
    e_infeas: f64,
) -> Vec<String> {
    let mut warnings = Vec::new();
    if let Some(auto) = summary.auto() {
        for (key, value, auto, missing) in [
            (
                "mentor.e_th",
                e_th,
                auto.e_th,
                "next to no observer state will be similar to one of the mentor's",
            ),
            (
                "mentor.e_infeas",
                e_infeas,
                auto.e_infeas,
                "next to no mentor transition will count as feasible",
            ),
        ] {
            let least = auto / MOST;
            if value < least {
                warnings.push(format!(
                    "{key} = {value} is next to nothing beside {auto}, which auto stands for: {missing}. Accepted without \
                     this warning: {least} or more, or auto"
                ));
            }
        }
    }
    let numbers =
        summary.features.iter().enumerate().filter(|(index, _)| !metric.categories().contains(index));
    for (index, (name, low, high)) in numbers {
        let still = STILL * scale[index];
        let mut moved = vec![0.0; metric.dim()];
        moved[index] = still;
        let kl = kl(&metric.whiten_all(&moved), &vec![0.0; metric.dim()]);
        if high - low < still && f64::from(kl) > e_th.max(e_infeas) {
            warnings.push(format!(
                "the demonstration's feature {name} hardly varies ({low} to {high}), so that the covariance makes a \
                 difference of {still} in it a KL of {kl}, above mentor.e_th = {e_th} and mentor.e_infeas = {e_infeas}: \
                 next to nothing will match. Accepted without this warning: mentor.covariance = space, or a larger \
                 mentor.sigma_floor"
            ));
        }
    }
    warnings
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
        if !self.changes.is_empty() {
            writeln!(f, "categories    steps that change them: {}", self.changes_in_words())?;
        }
        for Apart { steps, pairs, kl, tenths, .. } in &self.apart {
            let [min, low, median, high, max] = [kl.min, tenths[0], kl.median, tenths[1], kl.max].map(shown);
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
    use trestle_proto::config;
    use trestle_proto::row::Element;
    use trestle_proto::space::EnvSpec;

    fn line() -> Summary {
        let mut demo = Demonstration::new(vec!["x".into()]).unwrap();
        demo.push_trajectory(&[0.0, 1.0, 2.0, 3.0], true).unwrap();
        demo.push_trajectory(&[10.0, 12.0], false).unwrap();
        summarise(&demo, &Metric::diagonal(&[1.0]).unwrap(), 8, &[])
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
        summarise(&demo, &Metric::diagonal(&[1.0]).unwrap(), 2, &[])
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
    fn with_inertia_it_is_half_of_a_push() {
        let mut demo = Demonstration::new(vec!["x".into(), "v".into()]).unwrap();
        // It speeds up by 1, twice, coasts, and slows down by 1: positions change by up to 4 a step.
        demo.push_trajectory(&[0.0, 2.0, 2.0, 3.0, 5.0, 4.0, 9.0, 4.0, 13.0, 3.0], false).unwrap();
        // And then it is slowed down by next to nothing, for long: less than all of its pushes together.
        let braked: Vec<f32> = (0..20).flat_map(|i| [4.0 * i as f32, 4.0 - 0.01 * i as f32]).collect();
        demo.push_trajectory(&braked, false).unwrap();
        let metric = Metric::diagonal(&[1.0, 1.0]).unwrap();
        let whole = summarise(&demo, &metric, 1, &[]).auto().unwrap();
        let summary = summarise(&demo, &metric, 1, &[1]);
        assert_eq!(summary.pushed, Some(0.5));
        assert_eq!(summary.auto().unwrap(), Auto { e_infeas: 0.125, ..whole });
        assert!(whole.e_infeas > 0.5, "coasting would pass: {whole:?}");
        let warnings = summary.warnings(whole.e_th, 0.6);
        let [text] = &warnings[..] else { panic!("{warnings:?}") };
        assert!(
            text.contains("0.6 is more than the KL of the mentor's middle push, 0.5")
                && text.contains("coasts")
        );
        // A mentor that never changes its velocity leaves its steps.
        let mut coasting = Demonstration::new(vec!["x".into(), "v".into()]).unwrap();
        coasting.push_trajectory(&[0.0, 1.0, 1.0, 1.0, 2.0, 1.0], false).unwrap();
        assert_eq!(summarise(&coasting, &metric, 1, &[1]).pushed, None);
    }

    #[test]
    fn a_change_of_categories_says_nothing_of_a_step() {
        let spec = EnvSpec {
            element: Element::F32,
            shape: Vec::new(),
            low: vec![0.0; 2],
            high: vec![20.0; 2],
            integral: false,
            categories: vec![1],
            velocities: Vec::new(),
            ..crate::testing::spec()
        };
        let auto = |states: &[f32], features: Vec<usize>| {
            let mut demo = Demonstration::new(vec!["x".into(), "room".into()]).unwrap();
            demo.push_trajectory(states, true).unwrap();
            let features = config::Features::Numbers(features);
            let mentor = config::Mentor { features, ..config::Mentor::default() };
            let metric = Metric::of(&mentor, &spec, demo.states()).unwrap();
            let summary = summarise(&demo, &metric, 1, &[]);
            let warnings = unreachable(&summary, &metric, &spec.scale, 0.5, 0.5);
            assert_eq!(warnings, [] as [String; 0]);
            summary.auto()
        };
        // Steps of 2, and through more doors than steps.
        let states = [0.0, 1.0, 2.0, 1.0, 2.0, 4.0, 2.0, 7.0, 4.0, 7.0, 4.0, 3.0];
        let steps = Auto { e_th: 0.5, e_infeas: 0.5 };
        assert_eq!(auto(&states, vec![]), Some(steps));
        assert_eq!(auto(&states, vec![0]), Some(steps));
        assert_eq!(auto(&states, vec![1]), Some(Auto { e_th: 0.125, e_infeas: 0.125 }));
        assert_eq!(auto(&[3.0, 1.0, 5.0, 1.0], vec![1]), None);
    }

    #[test]
    fn categories_that_most_steps_change_are_warned_of_by_name() {
        let spec = EnvSpec {
            element: Element::F32,
            shape: Vec::new(),
            low: vec![0.0; 3],
            high: vec![20.0; 3],
            scale: vec![1.0; 3],
            integral: false,
            categories: vec![1, 2],
            velocities: Vec::new(),
            ..crate::testing::spec()
        };
        let summary = |states: &[f32], features: &[usize]| {
            let mut demo = Demonstration::new(["x", "heading", "key"].map(String::from).into()).unwrap();
            demo.push_trajectory(states, true).unwrap();
            let features = config::Features::Numbers(features.to_vec());
            let mentor = config::Mentor { features, ..config::Mentor::default() };
            summarise(&demo, &Metric::of(&mentor, &spec, demo.states()).unwrap(), 1, &[])
        };
        let turning = [0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 2.0, 0.0, 1.0, 3.0, 0.0, 1.0, 4.0, 2.0, 1.0];
        let all = summary(&turning, &[]);
        assert_eq!((all.changing, &all.changes[..]), (3, &[(1, 3), (2, 1)][..]));
        let [warning] = &all.warnings(0.1, 0.1)[..] else { panic!("one") };
        assert!(warning.starts_with("3 of 4 mentor steps change a category"), "{warning}");
        assert!(warning.contains("heading in 3, key in 1. Accepted without this warning: mentor.features"));
        let text = all.to_string();
        assert!(text.contains("categories    steps that change them: heading in 3, key in 1"), "{text}");
        assert!(text.contains("median different, 90% different, max different (4 pairs)"), "{text}");
        // Without the heading, and where there is nothing but categories.
        for features in [&[0, 2][..], &[1, 2], &[0]] {
            assert_eq!(summary(&turning, features).warnings(0.1, 0.1), [] as [String; 0], "{features:?}");
        }
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

    #[test]
    fn thresholds_that_nothing_can_meet_are_warned_of() {
        let (summary, metric) = (along(&[0.0, 2.0, 4.0]), Metric::diagonal(&[1.0]).unwrap());
        let warned = |e_th, e_infeas| unreachable(&summary, &metric, &[1.0], e_th, e_infeas);
        assert_eq!(warned(0.005, 0.005), [] as [String; 0]);
        let both = warned(0.004, 0.001);
        assert_eq!(
            both[0],
            "mentor.e_th = 0.004 is next to nothing beside 0.5, which auto stands for: next to no observer state will be \
             similar to one of the mentor's. Accepted without this warning: 0.005 or more, or auto"
        );
        assert!(both[1].starts_with("mentor.e_infeas = 0.001 is"), "{both:?}");
        // A demonstration that does not move says nothing of steps.
        assert!(unreachable(&along(&[7.0, 7.0]), &metric, &[1.0], 1e-6, 1e-6).is_empty());
    }

    #[test]
    fn a_feature_that_stays_as_it_is_must_not_rule_everything_out() {
        let mut demo = Demonstration::new(vec!["x".into(), "tilt".into()]).unwrap();
        demo.push_trajectory(&[0.0, 3.0, 1.0, 3.0, 2.0, 3.0], true).unwrap();
        let warned = |sigma: &[f64]| {
            let metric = Metric::diagonal(sigma).unwrap();
            unreachable(&summarise(&demo, &metric, 4, &[]), &metric, &[1.0, 1.0], 0.1, 0.1)
        };
        assert_eq!(warned(&[1.0, 1.0]), [] as [String; 0]);
        let [warning] = &warned(&[1.0, 1e-6])[..] else { panic!("one feature") };
        assert!(warning.contains("feature tilt hardly varies (3 to 3)"), "{warning}");
        assert!(warning.contains("mentor.covariance = space, or a larger mentor.sigma_floor"), "{warning}");
    }
}
