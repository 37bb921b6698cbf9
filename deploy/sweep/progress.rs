//! What the user sees of a sweep: a line a run that goes on and one for all on a terminal, plain lines elsewhere.

use super::estimate::{Left, Pace, duration, is_measured, most_steps, seconds_left};
use super::{Outcome, Sweep};
use crate::screen::{Line, Part, Screen, bar, fit};
use crate::supervise::display::Display;
use std::collections::VecDeque;

pub(super) struct Progress<'a> {
    sweep: &'a Sweep,
    /// The pace of each kind, where it is known, and its runs that have not ended; empty if nothing is shown.
    paces: Vec<(Option<Pace>, Left)>,
    done: usize,
    to_do: usize,
    /// A terminal, and the line for all runs.
    terminal: Option<(Screen, Line)>,
}

impl<'a> Progress<'a> {
    pub(super) fn new(sweep: &'a Sweep, paces: Vec<Option<Pace>>, queue: &VecDeque<usize>) -> Self {
        let left = |kind| {
            let alike = queue.iter().filter(|&&at| sweep.kind(at) == kind);
            alike.fold(Left::default(), |left, &at| Left {
                runs: left.runs + 1,
                steps: left.steps + most_steps(&sweep.jobs[at].config),
            })
        };
        let paces: Vec<_> = paces.into_iter().enumerate().map(|(kind, pace)| (pace, left(kind))).collect();
        let terminal = (!sweep.quiet).then(Screen::new).flatten().map(|screen| {
            let total = screen.line(false);
            (screen, total)
        });
        let progress = Self { sweep, paces, done: 0, to_do: queue.len(), terminal };
        // Shown from the start.
        progress.show(String::new());
        progress
    }

    /// Shows how many runs have ended, and what is `left`.
    fn show(&self, left: String) {
        let Some((_, line)) = &self.terminal else { return };
        let share = self.done as f64 / self.to_do.max(1) as f64;
        let runs = format!("{}/{} runs", self.done, self.to_do);
        let parts = [(1, bar(share)), (0, runs), (0, left)].map(|(rank, text)| Part { rank, text });
        line.show(move |width| fit(&parts, width));
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
        for (kind, (pace, left)) in self.paces.iter().enumerate() {
            if pace.is_none() && left.runs > 0 {
                let arms = self.sweep.arms.iter().zip(&self.sweep.kinds);
                let alike: Vec<&str> =
                    arms.filter(|(_, of)| **of == kind).map(|(arm, _)| arm.as_str()).collect();
                let Some((first, rest)) = alike.split_first() else { continue };
                let rest =
                    if rest.is_empty() { String::new() } else { format!(" and {} like it", rest.len()) };
                self.say(&format!("without {first}{rest}, whose probe failed"));
            }
        }
    }

    /// The display of job `at`.
    pub(super) fn display(&self, at: usize) -> Display {
        let job = &self.sweep.jobs[at];
        if self.sweep.quiet {
            return Display::quiet();
        }
        let line = self.terminal.as_ref().map(|(screen, _)| screen.line(true));
        Display::named(&job.config.run, &self.sweep.name(at), line)
    }

    /// Job `at` has ended after `seconds`.
    pub(super) fn ended(&mut self, at: usize, seconds: f64, outcome: &Outcome) {
        self.done += 1;
        if let Some((pace, left)) = self.paces.get_mut(self.sweep.kind(at)) {
            let steps = most_steps(&self.sweep.jobs[at].config);
            (left.runs, left.steps) = (left.runs.saturating_sub(1), (left.steps - steps).max(0.0));
            if matches!(outcome, Outcome::Complete(_)) {
                pace.get_or_insert_default().ended(seconds, steps);
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
        let left = format!("{measured} {left} left");
        if self.terminal.is_some() {
            self.say(&said);
            self.show(left);
        } else {
            self.say(&format!("{}/{}  {said}; {left}", self.done, self.to_do));
        }
    }

    fn say(&self, text: &str) {
        if !self.sweep.quiet {
            self.print(text);
        }
    }

    fn print(&self, text: &str) {
        match &self.terminal {
            Some((screen, _)) => screen.print(text),
            None => crate::output::say(text),
        }
    }
}
