//! Who takes the place of a process that has died while the others go on (free mode), and when.

use super::children::{self, Child, Death, How, Role};
use super::display::Display;
use super::restarts::{Restarts, Verdict};
use super::{Ended, Report, final_error};
use crate::prepare::Prepared;
use anyhow::{Context, Result, anyhow};
use nix::libc::{SIGBUS, SIGKILL};
use std::os::unix::process::ExitStatusExt;
use std::time::Instant;
use tokio::sync::mpsc;
use trestle_link::Host;
use trestle_proto::config::Mode;
use trestle_proto::experiment::Experiment;
use trestle_proto::limits::{HANDSHAKE, RESTART_BACKOFF, SETTLE};

/// What replaces single processes of a run in free mode.
pub(super) struct Replacing<'a> {
    prepared: &'a mut Prepared,
    host: &'a dyn Host,
    reports: &'a mpsc::Sender<Report>,
    /// The processes that have died, each with its account and how often it has been replaced since the learner was
    /// started last.
    accounts: Vec<(Role, Restarts, u16)>,
    /// After which deaths somebody is to be started anew, and when; none where only what the dead left is to be removed.
    due: Vec<(tokio::time::Instant, Option<Death>)>,
    /// When a process was started last.
    started: tokio::time::Instant,
    /// Since when what the dead left cannot be removed.
    stuck: Option<tokio::time::Instant>,
}

impl<'a> Replacing<'a> {
    pub(super) fn new(
        prepared: &'a mut Prepared,
        host: &'a dyn Host,
        reports: &'a mpsc::Sender<Report>,
    ) -> Self {
        let started = tokio::time::Instant::now();
        Self { prepared, host, reports, accounts: Vec::new(), due: Vec::new(), started, stuck: None }
    }

    /// Whether the others can go on without the process that has died until there is another.
    pub(super) fn replaces(&self, role: Role, how: &How) -> bool {
        let signal = match how {
            How::Exited(status) => status.signal(),
            How::Lingering(_) => Some(SIGKILL),
        };
        match (self.prepared.experiment().config.run.mode, role, signal) {
            // There may be no shared memory left for what it does, and a start of all looks for that first.
            (Mode::Free, _, Some(SIGBUS)) => false,
            // A learner that fails by itself may have been brought to it by what the others hold or send.
            (Mode::Free, Role::Learner, signal) => signal.is_some(),
            (Mode::Free, ..) => true,
            _ => false,
        }
    }

    pub(super) fn prepared(&self) -> &Prepared {
        self.prepared
    }

    pub(super) fn experiment(&self) -> &Experiment {
        self.prepared.experiment()
    }

    /// The run has begun to train.
    pub(super) fn commit(&self) -> Result<()> {
        self.prepared.commit()
    }

    /// Adds a line to the supervisor's log.
    pub(super) fn note(&self, text: &str) {
        self.prepared.note(text);
    }

    /// What is known of the end of a process.
    pub(super) fn death(&self, role: Role, how: How) -> Death {
        Death::new(self.prepared.dir(), role, how)
    }

    /// How the run ended whose learner has left.
    pub(super) fn ended(&self) -> Result<Ended> {
        let result = self.prepared.read_result()?;
        Ok(if result.interrupted { Ended::Interrupted(Some(result)) } else { Ended::Complete(result) })
    }

    /// The deaths after which somebody is to be started anew.
    pub(super) fn deaths(&self) -> impl Iterator<Item = &Death> {
        self.due.iter().filter_map(|(_, death)| death.as_ref())
    }

    /// Plans the replacement of the process that has died, or says why there is to be none.
    pub(super) fn schedule(&mut self, death: &Death, display: &Display) -> Result<()> {
        let newest = self.prepared.last_checkpoint();
        let at = match self.accounts.iter().position(|(role, ..)| *role == death.role) {
            Some(at) => at,
            None => {
                let allowed = self.prepared.experiment().config.supervise.restarts;
                self.accounts.push((death.role, Restarts::of_process(allowed, newest), 0));
                self.accounts.len() - 1
            }
        };
        let pause = match self.accounts[at].1.after(death, newest, Instant::now()) {
            Verdict::Again(pause) => pause,
            Verdict::End(reason) => return Err(final_error(self.prepared, death, &reason)),
        };
        let said = format!("{death}; replacing it");
        display.say(&said);
        self.prepared.note(&said);
        self.due.push((tokio::time::Instant::now() + pause, Some(death.clone())));
        Ok(())
    }

    /// Plans nothing but that what a dead process left is removed.
    pub(super) fn tidy(&mut self) {
        self.due.push((tokio::time::Instant::now(), None));
    }

    /// Removes what dead processes left, unless one has been started so shortly before that it might still be making its
    /// place: that could be mistaken for a dead one's. False: something is left.
    pub(super) fn reap(&self) -> bool {
        self.started.elapsed() >= SETTLE && self.host.reap()
    }

    /// Waits until the next replacement is due, for ever if there is none.
    pub(super) async fn next(&self) {
        match self.due.iter().map(|(at, _)| *at).min() {
            Some(at) => tokio::time::sleep_until(at.max(self.started + SETTLE)).await,
            None => std::future::pending().await,
        }
    }

    /// Starts those whose time has come; returns whether the learner is one of them.
    pub(super) fn start(&mut self, children: &mut [Child]) -> Result<bool> {
        let now = tokio::time::Instant::now();
        // They need the dead ones' places.
        if !self.reap() {
            if now - *self.stuck.get_or_insert(now) > HANDSHAKE {
                return Err(anyhow!(
                    "what a dead process left in shared memory cannot be removed (`trestle doctor`)"
                ));
            }
            self.due.iter_mut().for_each(|(at, _)| *at = (*at).max(now + RESTART_BACKOFF));
            return Ok(false);
        }
        self.stuck = None;
        let mut learner = false;
        while let Some(at) = self.due.iter().position(|(at, _)| *at <= now) {
            // Kept until it is done: if it cannot be, the run may begin anew.
            if let Some(role) = self.due[at].1.as_ref().map(|death| death.role) {
                self.replace(role, children)?;
                learner |= role == Role::Learner;
            }
            self.due.swap_remove(at);
        }
        Ok(learner)
    }

    fn replace(&mut self, role: Role, children: &mut [Child]) -> Result<()> {
        if role == Role::Learner {
            let newest = self.prepared.newest_checkpoint()?;
            self.prepared.replace_learner(newest)?;
            self.accounts.iter_mut().for_each(|(_, _, count)| *count = 0);
        } else if let Err(error) = self.prepared.count_restart() {
            // It is counted again at the next occasion.
            tracing::warn!("{error:#}");
        }
        let account = self.accounts.iter_mut().find(|(of, ..)| *of == role);
        let (_, _, count) = account.context("a process is to be replaced that has not died")?;
        *count = count.checked_add(1).with_context(|| format!("{role} has been replaced 65535 times"))?;
        let child = children::start(self.prepared, role, *count, self.reports)?;
        if let Some(place) = children.iter_mut().find(|child| child.role == role) {
            *place = child;
        }
        self.started = tokio::time::Instant::now();
        Ok(())
    }
}
