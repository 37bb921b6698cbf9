//! How long a sweep will take, from what is known of its arms.
//!
//! Before the first run of an arm has ended, now or before the sweep was resumed, only a bound is known: the steps that a run can take at the most, at the rate of
//! a short probe. Once runs have ended, their mean time is what the others of the arm are expected to take.

use std::time::Duration;
use trestle_proto::config::Config;

/// What is known of an arm's runs.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Pace {
    /// Seconds that a run can take at the most.
    most_s: f64,
    /// Runs that have ended, and the seconds that they took together.
    ended: u32,
    ended_s: f64,
}

impl Pace {
    /// Of an arm whose runs take up to `steps` environment steps, `rate` a second.
    pub(crate) fn new(steps: f64, rate: f64) -> Self {
        Self { most_s: steps / rate.max(1.0), ended: 0, ended_s: 0.0 }
    }

    /// A run has ended after `seconds`.
    pub(crate) fn ended(&mut self, seconds: f64) {
        self.ended += 1;
        self.ended_s += seconds;
    }

    /// Whether a run has ended.
    pub(crate) fn is_measured(&self) -> bool {
        self.ended > 0
    }

    /// Seconds that a run is expected to take.
    fn expected_s(&self) -> f64 {
        if self.is_measured() { self.ended_s / f64::from(self.ended) } else { self.most_s }
    }
}

/// Environment steps that a run of `config` can take at the most.
pub(crate) fn most_steps(config: &Config) -> f64 {
    let by_episodes = config.run.episodes.map(|n| n as f64 * f64::from(config.env.step_limit));
    let by_steps = config.run.env_steps.map(|n| n as f64);
    by_episodes.into_iter().chain(by_steps).fold(f64::INFINITY, f64::min)
}

/// Seconds for the runs that are left of each arm, `jobs` at once; an arm without a pace counts as nothing.
pub(crate) fn seconds_left(arms: &[(Option<Pace>, usize)], jobs: usize) -> f64 {
    let known = arms.iter().filter_map(|(pace, left)| Some(pace.as_ref()?.expected_s() * *left as f64));
    known.sum::<f64>() / jobs as f64
}

/// Whether all arms with runs left have one that has ended.
pub(crate) fn is_measured(arms: &[(Option<Pace>, usize)]) -> bool {
    arms.iter().all(|(pace, left)| *left == 0 || pace.is_some_and(|pace| pace.is_measured()))
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
        let mut pace = Pace::new(20_000.0, 1_000.0);
        assert_eq!(seconds_left(&[(Some(pace), 6), (None, 3)], 2), 60.0);
        assert!(!is_measured(&[(Some(pace), 6)]) && is_measured(&[(Some(pace), 0)]));
        [2.0, 4.0].into_iter().for_each(|seconds| pace.ended(seconds));
        assert_eq!(seconds_left(&[(Some(pace), 4)], 2), 6.0);
        assert!(is_measured(&[(Some(pace), 4)]) && !is_measured(&[(Some(pace), 4), (None, 1)]));
    }

    #[test]
    fn durations_are_said_as_people_say_them() {
        let said = [0.4, 99.9, 100.0, 5400.0, 9000.0].map(duration);
        assert_eq!(said, ["0 s", "99 s", "2 min", "90 min", "2 h 30 min"]);
    }
}
