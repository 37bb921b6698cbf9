//! The watch over a run's processes: what tokio reports becomes an event of `watch`, and its actions are carried out.

use super::children::{Child, Death, How, Role};
use super::display::Display;
use super::joined::HOST;
use super::replacing::Replacing;
use super::signals::{Request, Signals};
use super::watch::{Action, End, Event, Reach, State, step};
use super::{Ended, Report, final_error};
use anyhow::{Context, Result, anyhow};
use std::collections::VecDeque;
use std::ops::ControlFlow;
use tokio::sync::mpsc;
use tokio::time::{Instant, Interval, MissedTickBehavior, interval_at, sleep_until};
use trestle_learner::record::Progress;
use trestle_proto::limits::{BEAT, BLAME, REAP};

/// What an event is about.
enum Matter {
    /// Nothing that its name does not say.
    None,
    Progress(Progress),
    /// Those that have died, or count as dead.
    Deaths(Vec<Death>),
}

/// How a watch ended: with the run, or with a death after which the run may be started again.
type Outcome = ControlFlow<Ended, Death>;

/// Watches over `children` until the learner has left, a death ends the attempt, or the run is to stop at once.
pub(super) async fn watch(
    children: &mut [Child],
    inbox: &mut mpsc::Receiver<Report>,
    signals: &mut Signals,
    display: &Display,
    replacing: &mut Replacing<'_>,
) -> Result<Outcome> {
    let now = Instant::now();
    let mut beat = interval_at(now + BEAT, BEAT);
    // Beats that this process has missed are nobody's silence.
    beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let reap = interval_at(now + REAP, REAP);
    let mut watch = Watch {
        children,
        inbox,
        signals,
        display,
        replacing,
        beat,
        reap,
        faulty: VecDeque::new(),
        suspects: Vec::new(),
        blame: now,
    };
    let mut state = State::Starting;
    loop {
        let (event, mut matter) = watch.next().await?;
        let mut next = Some(event);
        while let Some(event) = next.take() {
            let (after, actions) = step(state, event);
            tracing::debug!("{event:?} in {state:?}: {actions:?}, {after:?}");
            state = after;
            for action in actions {
                if let Action::End(end) = action {
                    return watch.end(end, matter);
                }
                next = watch.carry_out(action, &mut matter)?.or(next);
            }
        }
    }
}

struct Watch<'a, 'b> {
    children: &'a mut [Child],
    inbox: &'a mut mpsc::Receiver<Report>,
    signals: &'a mut Signals,
    display: &'a Display,
    replacing: &'a mut Replacing<'b>,
    beat: Interval,
    reap: Interval,
    /// The processes that count as dead since the last beat.
    faulty: VecDeque<Death>,
    /// The processes that have ended because they lost another one.
    suspects: Vec<Death>,
    /// When they are to blame themselves, if there are any.
    blame: Instant,
}

impl Watch<'_, '_> {
    /// Waits for the next event.
    async fn next(&mut self) -> Result<(Event, Matter)> {
        loop {
            if let Some(death) = self.faulty.pop_front() {
                return Ok((Event::Faulty(self.reach(&death)), Matter::Deaths(vec![death])));
            }
            let request = tokio::select! {
                _ = self.reap.tick() => return Ok((Event::Reap, Matter::None)),
                () = self.replacing.next() => return Ok((Event::Due, Matter::None)),
                () = sleep_until(self.blame), if !self.suspects.is_empty() => return Ok(self.blame()),
                request = self.signals.next() => Some(request),
                _ = self.beat.tick() => {
                    if self.signs_of_life() { self.signals.passed_on() } else { None }
                }
                report = self.inbox.recv() => match report {
                    Some(Report::Progress(progress)) => {
                        return Ok((Event::Progress, Matter::Progress(progress)));
                    }
                    Some(Report::Said(line)) => {
                        match line.strip_prefix(HOST) {
                            Some(row) => self.replacing.prepared().tell_host(row),
                            None => {
                                self.display.remark(&line);
                                self.replacing.note(&line);
                            }
                        }
                        None
                    }
                    Some(Report::Exited(role, status)) => {
                        let status = status.with_context(|| format!("cannot wait for {role}"))?;
                        if let Some(event) = self.exited(role, How::Exited(status)) {
                            return Ok(event);
                        }
                        None
                    }
                    // The other end is held by the caller.
                    None => return Err(anyhow!("all processes of the run are gone without a result")),
                },
            };
            match request {
                Some(Request::Stop) => return Ok((Event::Stop, Matter::None)),
                Some(Request::StopNow) => return Ok((Event::StopNow, Matter::None)),
                None => {}
            }
        }
    }

    /// What a death means for the others.
    fn reach(&self, death: &Death) -> Reach {
        match self.replacing.replaces(death.role, &death.how) {
            false => Reach::All,
            true if death.role == Role::Learner => Reach::Learner,
            true => Reach::One,
        }
    }

    /// Takes in all signs of life, and notes who counts as dead. Returns whether a process was asked to leave.
    fn signs_of_life(&mut self) -> bool {
        let deadlines = &self.replacing.experiment().config.supervise;
        let mut asked = false;
        for child in self.children.iter_mut().filter(|child| child.running && child.fault.is_none()) {
            let signs = child.line.beat(deadlines);
            asked |= signs.asked;
            let death = signs.fault.map(|fault| self.replacing.death(child.role, How::Lingering(fault)));
            self.faulty.extend(death);
        }
        asked
    }

    /// What the end of a process is, if it is worth mention.
    fn exited(&mut self, role: Role, how: How) -> Option<(Event, Matter)> {
        let mut fault = None;
        if let Some(child) = self.children.iter_mut().find(|child| child.role == role) {
            child.running = false;
            fault = child.fault.take();
        }
        // No other process ends like this of itself: code of others may have ended it.
        if let How::Exited(status) = how
            && role == Role::Learner
            && status.success()
        {
            return Some((Event::Left, Matter::None));
        }
        let death = self.replacing.death(role, fault.map_or(how, How::Lingering));
        let event = match death.is_consequence() {
            true => Event::LostPeer,
            false => Event::Died(self.reach(&death)),
        };
        Some((event, Matter::Deaths(vec![death])))
    }

    /// The suspects are to blame themselves.
    fn blame(&mut self) -> (Event, Matter) {
        let mut deaths = std::mem::take(&mut self.suspects);
        let far = |death: &Death| self.reach(death) != Reach::One;
        match deaths.iter().position(far) {
            Some(at) => {
                let death = deaths.swap_remove(at);
                (Event::Blamed(self.reach(&death)), Matter::Deaths(vec![death]))
            }
            None => (Event::Blamed(Reach::One), Matter::Deaths(deaths)),
        }
    }

    /// Does what is to be done; returns the event that it leads to, if it does.
    fn carry_out(&mut self, action: Action, matter: &mut Matter) -> Result<Option<Event>> {
        let deaths = match matter {
            Matter::Deaths(deaths) => deaths.as_mut_slice(),
            _ => &mut [],
        };
        match action {
            Action::Commit => self.replacing.commit()?,
            Action::Show => {
                if let Matter::Progress(progress) = matter {
                    self.display.update(progress);
                }
            }
            Action::Ask => {
                self.display
                    .say("interrupted: finishing the tick and saving; Ctrl-C once more to stop at once");
                self.children.iter_mut().filter(|child| child.role == Role::Learner).for_each(Child::leave);
            }
            Action::Kill => {
                for death in deaths {
                    let How::Lingering(fault) = death.how else { continue };
                    // Its end, which will be noticed in its turn, is what it is replaced after.
                    for child in self.children.iter_mut().filter(|child| child.role == death.role) {
                        child.fault = Some(fault);
                        child.kill();
                    }
                }
            }
            Action::Plan => {
                for death in deaths {
                    self.replacing.schedule(death, self.display)?;
                }
            }
            Action::Tidy => self.replacing.tidy(),
            Action::Start => return self.start(matter).map(Some),
            Action::Suspect => {
                if self.suspects.is_empty() {
                    self.blame = Instant::now() + BLAME;
                }
                self.suspects.extend_from_slice(deaths);
            }
            Action::Reap => _ = self.replacing.reap(),
            Action::End(_) => {}
        }
        Ok(None)
    }

    /// Starts the replacements that are due. Where that fails, the first death among them becomes the matter.
    fn start(&mut self, matter: &mut Matter) -> Result<Event> {
        match self.replacing.start(self.children) {
            Ok(true) => Ok(Event::NewLearner),
            Ok(false) => Ok(Event::Replaced),
            Err(error) => {
                let Some(death) = self.replacing.deaths().next().cloned() else { return Err(error) };
                let said = format!("{} cannot be replaced: {error:#}", death.role);
                self.display.say(&said);
                self.replacing.note(&said);
                *matter = Matter::Deaths(vec![death]);
                Ok(Event::Irreplaceable)
            }
        }
    }

    fn end(&self, end: End, matter: Matter) -> Result<Outcome> {
        let death = match matter {
            Matter::Deaths(deaths) => deaths.into_iter().next(),
            _ => None,
        };
        match (end, death) {
            (End::Left, _) => Ok(ControlFlow::Break(self.replacing.ended()?)),
            (End::Interrupted, _) => Ok(ControlFlow::Break(Ended::Interrupted(None))),
            (End::Again, Some(death)) => Ok(ControlFlow::Continue(death)),
            (End::Failed, Some(death)) => {
                Err(final_error(self.replacing.prepared(), &death, "the run was interrupted"))
            }
            (End::Again | End::Failed, None) => Err(anyhow!("the run ended without a death or a result")),
        }
    }
}
