//! How long a sweep will take, from what is known of its arms, or with a suite of each algorithm with each preset: its kinds.
//!
//! Before the first run of a kind has ended, now or before the sweep was resumed, only a bound is known: the steps that a run can
//! take at the most, at the rate of a short probe. Once runs have ended, the others of the kind are expected to take as long for
//! each step that they may take.

use std::time::Duration;
use trestle_proto::config::Config;

/// What is known of how long runs of one kind take. Runs may take different numbers of steps: a run's time is taken to be in
/// proportion to the most that it may take.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Pace {
    /// Seconds a step that are not exceeded.
    most_s: f64,
    /// Seconds of the runs that have ended, and the steps that they could have taken.
    ended_s: f64,
    ended_steps: f64,
}

/// Runs that are still to end.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Left {
    /// Their number.
    pub(crate) runs: usize,
    /// The steps that they can take at the most, together.
    pub(crate) steps: f64,
}

impl Pace {
    /// Of runs that take `rate` environment steps a second.
    pub(crate) fn new(rate: f64) -> Self {
        Self { most_s: 1.0 / rate.max(1.0), ..Self::default() }
    }

    /// A run that could take up to `steps` has ended after `seconds`.
    pub(crate) fn ended(&mut self, seconds: f64, steps: f64) {
        self.ended_s += seconds;
        self.ended_steps += steps;
    }

    /// Whether a run has ended.
    pub(crate) fn is_measured(&self) -> bool {
        self.ended_steps > 0.0
    }

    /// Seconds for each step that a run can take.
    fn expected_s(&self) -> f64 {
        if self.is_measured() { self.ended_s / self.ended_steps } else { self.most_s }
    }
}

/// Environment steps that a run of `config` can take at the most.
pub(crate) fn most_steps(config: &Config) -> f64 {
    let by_episodes = config.run.episodes.map(|n| n as f64 * f64::from(config.env.step_limit));
    let by_steps = config.run.env_steps.map(|n| n as f64);
    by_episodes.into_iter().chain(by_steps).fold(f64::INFINITY, f64::min)
}

/// Seconds for the runs that are left of each kind, `jobs` at once; a kind without a pace counts as nothing.
pub(crate) fn seconds_left(kinds: &[(Option<Pace>, Left)], jobs: usize) -> f64 {
    let known = kinds.iter().filter_map(|(pace, left)| Some(pace.as_ref()?.expected_s() * left.steps));
    known.sum::<f64>() / jobs as f64
}

/// Whether all kinds with runs left have one that has ended.
pub(crate) fn is_measured(kinds: &[(Option<Pace>, Left)]) -> bool {
    kinds.iter().all(|(pace, left)| left.runs == 0 || pace.is_some_and(|pace| pace.is_measured()))
}

/// `seconds` for people.
pub(crate) fn duration(seconds: f64) -> String {
    let whole = Duration::from_secs_f64(seconds.clamp(0.0, 1e9)).as_secs();
    match whole {
        0..=99 => format!("{whole} s"),
        100..=5999 => format!("{} min", (whole + 30) / 60),
        _ => format!("{} h {} min", whole / 3600, whole % 3600 / 60),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bound_becomes_a_mean() {
        let mut config = Config::default();
        (config.run.episodes, config.run.env_steps, config.env.step_limit) = (Some(100), None, 500);
        assert_eq!(most_steps(&config), 50_000.0);
        config.run.env_steps = Some(20_000);
        assert_eq!(most_steps(&config), 20_000.0);
        let left = |runs: usize| Left { runs, steps: 20_000.0 * runs as f64 };
        let mut pace = Pace::new(1_000.0);
        assert_eq!(seconds_left(&[(Some(pace), left(6)), (None, left(3))], 2), 60.0);
        assert!(!is_measured(&[(Some(pace), left(6))]) && is_measured(&[(Some(pace), left(0))]));
        // The second one could have taken twice as many steps.
        [(2.0, 20_000.0), (4.0, 40_000.0)]
            .into_iter()
            .for_each(|(seconds, steps)| pace.ended(seconds, steps));
        assert_eq!(seconds_left(&[(Some(pace), left(4))], 2), 4.0);
        assert!(
            is_measured(&[(Some(pace), left(4))]) && !is_measured(&[(Some(pace), left(4)), (None, left(1))])
        );
    }

    #[test]
    fn durations_are_said_as_people_say_them() {
        let said = [0.4, 99.9, 100.0, 5400.0, 9000.0].map(duration);
        assert_eq!(said, ["0 s", "99 s", "2 min", "90 min", "2 h 30 min"]);
    }
}
