//! Whether a run whose process has died is started again, and when.
//!
//! Deaths are forgiven as long as the run gets ahead: a new complete checkpoint since the last start clears the account,
//! as does time. A failure that the process itself reports twice from the same checkpoint is no accident; a run is a
//! function of its configuration, so it would come a third time.

use super::children::Death;
use std::collections::VecDeque;
use std::time::{Duration, Instant};
use trestle_proto::limits::{RESTART_BACKOFF, RESTART_BACKOFF_MOST, RESTART_WINDOW};
use trestle_proto::round::Round;

/// What is to be done after a death.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Start again after this time.
    Again(Duration),
    /// End the run, for this reason.
    End(String),
}

/// The account of a run's deaths.
#[derive(Debug)]
pub(super) struct Restarts {
    allowed: u32,
    /// Whether the same failure twice is the end.
    deterministic: bool,
    /// When the run was started again since it last got ahead.
    spent: VecDeque<Instant>,
    /// The checkpoint that the last start went on from.
    from: Option<Round>,
    /// The last death, as [`Death::reported`].
    reported: Option<String>,
}

impl Restarts {
    /// For a run that starts from checkpoint `from` and may be started again `allowed` times without getting ahead.
    pub(super) fn new(allowed: u32, from: Option<Round>) -> Self {
        Self { allowed, deterministic: true, spent: VecDeque::new(), from, reported: None }
    }

    /// For a process that may be replaced `allowed` times without a new checkpoint, each time meeting something else.
    pub(super) fn of_process(allowed: u32, from: Option<Round>) -> Self {
        Self { deterministic: false, ..Self::new(allowed, from) }
    }

    /// `death` happened at `now`, with `checkpoint` as the newest complete one.
    pub(super) fn after(&mut self, death: &Death, checkpoint: Option<Round>, now: Instant) -> Verdict {
        let ahead = checkpoint != self.from;
        let reported = death.reported();
        let repeated = self.deterministic && !ahead && reported.is_some() && reported == self.reported;
        (self.from, self.reported) = (checkpoint, reported);
        if ahead {
            self.spent.clear();
        }
        self.spent.retain(|at| now.duration_since(*at) < RESTART_WINDOW);
        if self.allowed == 0 {
            return Verdict::End("supervise.restarts = 0".into());
        }
        if repeated {
            return Verdict::End("it failed in the same way when it was started again".into());
        }
        if self.spent.len() >= self.allowed as usize {
            return Verdict::End(format!(
                "{} has been started again {} times without getting ahead",
                if self.deterministic { "the run" } else { "it" },
                self.spent.len()
            ));
        }
        let doublings = self.spent.len() as u32;
        self.spent.push_back(now);
        Verdict::Again(match doublings {
            0 => Duration::ZERO,
            n => (RESTART_BACKOFF * 2_u32.saturating_pow(n - 1)).min(RESTART_BACKOFF_MOST),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::children::{How, Role};
    use super::*;
    use std::os::unix::process::ExitStatusExt;
    use std::process::ExitStatus;

    fn killed() -> Death {
        Death { role: Role::Learner, how: How::Exited(ExitStatus::from_raw(9)), last_words: String::new() }
    }

    fn failed(words: &str) -> Death {
        Death {
            role: Role::Actor(1),
            how: How::Exited(ExitStatus::from_raw(1 << 8)),
            last_words: words.into(),
        }
    }

    const SECOND: Duration = Duration::from_secs(1);

    #[test]
    fn a_run_that_does_not_get_ahead_ends() {
        let start = Instant::now();
        let mut restarts = Restarts::new(3, None);
        let mut after = |s: u32| restarts.after(&killed(), None, start + s * SECOND);
        assert_eq!(after(0), Verdict::Again(Duration::ZERO));
        assert_eq!(after(1), Verdict::Again(RESTART_BACKOFF));
        assert_eq!(after(2), Verdict::Again(2 * RESTART_BACKOFF));
        assert!(matches!(after(3), Verdict::End(reason) if reason.contains("3 times")));
    }

    #[test]
    fn a_run_that_gets_ahead_goes_on() {
        let start = Instant::now();
        let mut restarts = Restarts::new(1, Some(4.into()));
        for tick in 5..50 {
            assert_eq!(restarts.after(&killed(), Some(tick.into()), start), Verdict::Again(Duration::ZERO));
        }
        assert!(matches!(restarts.after(&killed(), Some(49.into()), start), Verdict::End(_)));
    }

    #[test]
    fn old_deaths_are_forgotten() {
        let start = Instant::now();
        let mut restarts = Restarts::new(1, None);
        for n in 0..9 {
            let verdict = restarts.after(&killed(), None, start + n * RESTART_WINDOW);
            assert_eq!(verdict, Verdict::Again(Duration::ZERO));
        }
    }

    #[test]
    fn the_pause_has_a_limit() {
        let start = Instant::now();
        let mut restarts = Restarts::new(100, None);
        let pauses: Vec<Verdict> = (0..100).map(|_| restarts.after(&killed(), None, start)).collect();
        assert_eq!(pauses[99], Verdict::Again(RESTART_BACKOFF_MOST));
    }

    #[test]
    fn the_same_failure_twice_ends_the_run() {
        let start = Instant::now();
        let mut restarts = Restarts::new(5, None);
        assert!(matches!(restarts.after(&failed("loss"), None, start), Verdict::Again(_)));
        assert!(matches!(restarts.after(&failed("disk"), None, start), Verdict::Again(_)));
        assert!(matches!(restarts.after(&killed(), None, start), Verdict::Again(_)));
        assert!(matches!(restarts.after(&failed("disk"), None, start), Verdict::Again(_)));
        assert!(
            matches!(restarts.after(&failed("disk"), Some(1.into()), start), Verdict::Again(_)),
            "it got ahead"
        );
        assert!(matches!(restarts.after(&failed("disk"), Some(1.into()), start), Verdict::End(_)));
        let mut never = Restarts::new(0, None);
        assert_eq!(
            never.after(&killed(), Some(1.into()), start),
            Verdict::End("supervise.restarts = 0".into())
        );
    }
}
