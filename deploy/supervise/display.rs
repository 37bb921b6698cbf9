//! What the user sees while a run trains: a progress bar on a terminal, plain lines elsewhere.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::cell::Cell;
use std::io::{IsTerminal, stderr};
use std::time::{Duration, Instant};
use trestle_learner::record::Progress;
use trestle_proto::config::Run;

/// Length of a full bar.
const PARTS: u64 = 1000;
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
    Lines { last: Cell<Option<Instant>> },
    Bar(ProgressBar),
}

impl Display {
    /// For the only run of this process.
    pub(crate) fn new(run: &Run, quiet: bool) -> Self {
        if quiet {
            return Self::quiet();
        }
        let bar = stderr()
            .is_terminal()
            .then(|| ProgressBar::with_draw_target(Some(PARTS), ProgressDrawTarget::stderr()));
        Self::named(run, "", bar)
    }

    /// Nothing but what must be seen.
    pub(crate) fn quiet() -> Self {
        Self { name: String::new(), how: How::Quiet, episodes: None, env_steps: None }
    }

    /// For one of several runs, which `name` tells apart: on `bar`, or in plain lines.
    pub(crate) fn named(run: &Run, name: &str, bar: Option<ProgressBar>) -> Self {
        let how = match bar {
            None => How::Lines { last: Cell::new(None) },
            Some(bar) => {
                bar.set_length(PARTS);
                // The template is a constant: it parses, or the bar keeps its default look.
                if let Ok(style) = ProgressStyle::with_template("{bar:16} {percent:>3}%  {wide_msg}") {
                    bar.set_style(style);
                }
                How::Bar(bar)
            }
        };
        let name = if name.is_empty() { String::new() } else { format!("{name}  ") };
        Self { name, how, episodes: run.episodes, env_steps: run.env_steps }
    }

    /// A sentence that must be seen.
    pub(crate) fn say(&self, text: &str) {
        match &self.how {
            How::Bar(bar) => bar.println(format!("{}{text}", self.name)),
            How::Lines { .. } | How::Quiet => crate::output::say(&format!("{}{text}", self.name)),
        }
    }

    pub(crate) fn update(&self, progress: &Progress) {
        match &self.how {
            How::Quiet => {}
            How::Lines { last } => {
                let due = last.get().is_none_or(|at| at.elapsed() >= LINES_EVERY);
                if due {
                    last.set(Some(Instant::now()));
                    crate::output::say(&self.describe(progress));
                }
            }
            How::Bar(bar) => {
                // The run ends at whichever limit comes first.
                let share =
                    |done: u64, limit: Option<u64>| limit.map_or(0, |limit| done * PARTS / limit.max(1));
                let done =
                    share(progress.episodes, self.episodes).max(share(progress.env_steps, self.env_steps));
                bar.set_position(done.min(PARTS));
                bar.set_message(self.describe(progress));
            }
        }
    }

    pub(crate) fn finish(&self) {
        if let How::Bar(bar) = &self.how {
            bar.finish_and_clear();
        }
    }

    fn describe(&self, p: &Progress) -> String {
        let of = |limit: Option<u64>| limit.map_or(String::new(), |limit| format!("/{limit}"));
        let mut text = format!(
            "{}episode {}{}  steps {}{}  {:.0} steps/s",
            self.name,
            p.episodes,
            of(self.episodes),
            p.env_steps,
            of(self.env_steps),
            p.fps
        );
        if let Some(left) = p.seconds_left {
            text += &format!("  {left:.0} s left");
        }
        let number =
            |name: &str, value: Option<f64>| value.map_or(String::new(), |v| format!("  {name} {v:.2}"));
        text += &number("return", p.ep_rew_mean);
        text += &number("greedy", p.eval_return);
        let share = |name: &str, value: Option<f64>| {
            value.map_or(String::new(), |v| format!("  {name} {:.0}%", 100.0 * v))
        };
        text += &share("feasible", p.feasible_frac);
        text += &share("bridged", p.bridged_frac);
        if p.optimal {
            text += "  optimal";
        } else if p.solved {
            text += "  solved";
        }
        text
    }
}
