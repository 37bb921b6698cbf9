//! What the user sees of a sweep: a line a run that goes on and one for all on a terminal, plain lines elsewhere.

use super::estimate::{Pace, duration, is_measured, seconds_left};
use super::{Outcome, Sweep};
use crate::supervise::display::Display;
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::collections::VecDeque;
use std::io::{IsTerminal, stderr};

pub(super) struct Progress<'a> {
    sweep: &'a Sweep,
    /// The pace of each arm, where it is known, and its runs that have not ended; empty if nothing is shown.
    paces: Vec<(Option<Pace>, usize)>,
    done: usize,
    to_do: usize,
    bars: Option<(MultiProgress, ProgressBar)>,
}

impl<'a> Progress<'a> {
    pub(super) fn new(sweep: &'a Sweep, paces: Vec<Option<Pace>>, queue: &VecDeque<usize>) -> Self {
        let left = |arm| queue.iter().filter(|&&at| sweep.jobs[at].arm == arm).count();
        let paces: Vec<_> = paces.into_iter().enumerate().map(|(arm, pace)| (pace, left(arm))).collect();
        let bars = (!sweep.quiet && stderr().is_terminal()).then(|| {
            let all = MultiProgress::with_draw_target(ProgressDrawTarget::stderr());
            let total = all.add(ProgressBar::new(queue.len() as u64));
            // The template is a constant: it parses, or the bar keeps its default look.
            if let Ok(style) = ProgressStyle::with_template("{bar:16} {pos}/{len} runs  {wide_msg}") {
                total.set_style(style);
            }
            // Shown from the start.
            total.tick();
            (all, total)
        });
        Self { sweep, paces, done: 0, to_do: queue.len(), bars }
    }

    /// Says how long it will take.
    pub(super) fn announce(&self) {
        if !self.paces.is_empty() {
            let left = duration(seconds_left(&self.paces, self.sweep.at_once));
            self.say(&if is_measured(&self.paces) {
                format!("about {left}, if the others take as long as the runs that are finished")
            } else {
                format!(
                    "at most {left}: the runs of an arm of which none is finished take as many steps as they may, at the \
                     rate of a short probe"
                )
            });
        }
        let unknown =
            self.paces.iter().zip(&self.sweep.arms).filter(|((pace, left), _)| pace.is_none() && *left > 0);
        for (_, arm) in unknown {
            self.say(&format!("without {arm}, whose probe failed"));
        }
    }

    /// The display of job `at`.
    pub(super) fn display(&self, at: usize) -> Display {
        let job = &self.sweep.jobs[at];
        match &self.bars {
            _ if self.sweep.quiet => Display::quiet(),
            None => Display::named(&job.config.run, &self.sweep.name(at), None),
            Some((all, total)) => Display::named(
                &job.config.run,
                &self.sweep.name(at),
                Some(all.insert_before(total, ProgressBar::new(0))),
            ),
        }
    }

    /// Job `at` has ended after `seconds`.
    pub(super) fn ended(&mut self, at: usize, seconds: f64, outcome: &Outcome) {
        self.done += 1;
        let job = &self.sweep.jobs[at];
        if let Some((pace, left)) = self.paces.get_mut(job.arm) {
            *left = left.saturating_sub(1);
            if matches!(outcome, Outcome::Complete(_)) {
                pace.get_or_insert_default().ended(seconds);
            }
        }
        let name = self.sweep.name(at);
        let said = match outcome {
            Outcome::Complete(result) => match result.solved_episode {
                Some(episode) => format!("{name}: solved at episode {episode}, {}", duration(seconds)),
                None => format!("{name}: not solved in {} episodes, {}", result.episodes, duration(seconds)),
            },
            Outcome::Unfinished => format!("{name}: interrupted"),
            // A failure is shown even where nothing else is.
            Outcome::Failed(error) => return self.print(&format!("{name}: failed: {error}")),
        };
        let measured = if is_measured(&self.paces) { "about" } else { "at most" };
        let left = duration(seconds_left(&self.paces, self.sweep.at_once));
        match &self.bars {
            Some((_, total)) => {
                total.inc(1);
                total.set_message(format!("{measured} {left} left"));
                self.say(&said);
            }
            None => self.say(&format!("{}/{}  {said}; {measured} {left} left", self.done, self.to_do)),
        }
    }

    pub(super) fn finish(&self) {
        if let Some((_, total)) = &self.bars {
            total.finish_and_clear();
        }
    }

    fn say(&self, text: &str) {
        if !self.sweep.quiet {
            self.print(text);
        }
    }

    fn print(&self, text: &str) {
        match &self.bars {
            // Where the terminal has gone nobody is reading.
            Some((all, _)) => drop(all.println(text)),
            None => crate::output::say(text),
        }
    }
}
