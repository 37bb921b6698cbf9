//! What the user sees while a run trains: a progress bar on a terminal, plain lines elsewhere.

use crate::screen::{Line, Part, Screen, bar, fit};
use std::cell::{Cell, RefCell};
use std::time::{Duration, Instant};
use trestle_learner::record::Progress;
use trestle_proto::config::Run;

/// Time between two plain lines.
const LINES_EVERY: Duration = Duration::from_secs(5);

pub(crate) struct Display {
    /// Before each line; empty for the only run.
    name: String,
    how: How,
    episodes: Option<u64>,
    env_steps: Option<u64>,
}

enum How {
    Quiet,
    Lines {
        last: Cell<Option<Instant>>,
    },
    /// None once it is over.
    Bar(RefCell<Option<Line>>),
}

impl Display {
    /// For the only run of this process.
    pub(crate) fn new(run: &Run, quiet: bool) -> Self {
        if quiet {
            return Self::quiet();
        }
        Self::named(run, "", Screen::new().map(|screen| screen.line(false)))
    }

    /// Nothing but what must be seen.
    pub(crate) fn quiet() -> Self {
        Self { name: String::new(), how: How::Quiet, episodes: None, env_steps: None }
    }

    /// For one of several runs, which `name` tells apart: on `line`, or in plain lines.
    pub(crate) fn named(run: &Run, name: &str, line: Option<Line>) -> Self {
        let how = match line {
            None => How::Lines { last: Cell::new(None) },
            Some(line) => How::Bar(RefCell::new(Some(line))),
        };
        Self { name: name.into(), how, episodes: run.episodes, env_steps: run.env_steps }
    }

    /// A sentence that must be seen.
    pub(crate) fn say(&self, text: &str) {
        let text = if self.name.is_empty() { text.into() } else { format!("{}  {text}", self.name) };
        match &self.how {
            How::Bar(line) if let Some(line) = line.borrow().as_ref() => line.print(&text),
            _ => crate::output::say(&text),
        }
    }

    /// A sentence that is worth a line, where anything is shown.
    pub(crate) fn remark(&self, text: &str) {
        if !matches!(self.how, How::Quiet) {
            self.say(text);
        }
    }

    pub(crate) fn update(&self, progress: &Progress) {
        match &self.how {
            How::Quiet => {}
            How::Lines { last } => {
                let due = last.get().is_none_or(|at| at.elapsed() >= LINES_EVERY);
                if due {
                    last.set(Some(Instant::now()));
                    crate::output::say(&fit(&self.describe(progress), usize::MAX));
                }
            }
            How::Bar(line) => {
                // The run ends at whichever limit comes first.
                let share = |done: u64, limit: Option<u64>| {
                    limit.map_or(0.0, |limit| done as f64 / limit.max(1) as f64)
                };
                let done =
                    share(progress.episodes, self.episodes).max(share(progress.env_steps, self.env_steps));
                let mut parts = vec![
                    Part { rank: 3, text: bar(done) },
                    Part { rank: 2, text: format!("{:>3.0}%", 100.0 * done.min(1.0)) },
                ];
                parts.extend(self.describe(progress));
                if let Some(line) = line.borrow().as_ref() {
                    line.show(move |width| fit(&parts, width));
                }
            }
        }
    }

    pub(crate) fn finish(&self) {
        if let How::Bar(line) = &self.how {
            line.take();
        }
    }

    /// What there is to say, and what is left out first where a line has no room for all of it.
    fn describe(&self, p: &Progress) -> Vec<Part> {
        let of = |limit: Option<u64>| limit.map_or(String::new(), |limit| format!("/{limit}"));
        let number =
            |name: &str, value: Option<f64>| value.map_or(String::new(), |v| format!("{name} {v:.2}"));
        let share = |name: &str, value: Option<f64>| {
            value.map_or(String::new(), |v| format!("{name} {:.0}%", 100.0 * v))
        };
        let reached = match (p.optimal, p.solved) {
            (true, _) => "optimal",
            (_, true) => "solved",
            _ => "",
        };
        let parts = [
            (0, self.name.clone()),
            (1, format!("episode {}{}", p.episodes, of(self.episodes))),
            (6, format!("steps {}{}", p.env_steps, of(self.env_steps))),
            (5, format!("{:.0} steps/s", p.fps)),
            (4, p.seconds_left.map_or(String::new(), |left| format!("{left:.0} s left"))),
            (0, number("return", p.ep_rew_mean)),
            (0, number("greedy", p.eval_return)),
            (7, share("feasible", p.feasible_frac)),
            (7, share("bridged", p.bridged_frac)),
            (0, reached.into()),
        ];
        parts.into_iter().map(|(rank, text)| Part { rank, text }).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eighty_columns_keep_what_matters_most() {
        let run = Run { episodes: Some(3000), env_steps: Some(2_000_000), ..Run::default() };
        let display = Display::named(&run, "", None);
        let progress = Progress {
            episodes: 2345,
            env_steps: 1_234_567,
            ep_rew_mean: Some(-123.456),
            eval_return: Some(-12.345),
            fps: 123_456.0,
            feasible_frac: Some(0.25),
            bridged_frac: Some(0.5),
            seconds_left: Some(12_345.0),
            solved: true,
            ..Progress::default()
        };
        let line = |width| fit(&display.describe(&progress), width);
        let all = "episode 2345/3000  steps 1234567/2000000  123456 steps/s  12345 s left  return -123.46  \
            greedy -12.35  feasible 25%  bridged 50%  solved";
        assert_eq!(line(usize::MAX), all);
        assert_eq!(line(79), "episode 2345/3000  12345 s left  return -123.46  greedy -12.35  solved");
        assert_eq!(line(40), "return -123.46  greedy -12.35  solved");
    }
}
