//! A host that lends its actors to a run of another one: a relay, and its actors. It knows of the run only the messages of
//! the head, and keeps nothing of it.
//!
//! It goes from session to session. A session begins with a hello and ends with the run, with the loss of the head, or with the death of a
//! process of this host. The counts of a session mean nothing to the next.

use super::children::{self, Child, Death, How, Role, log_tail};
use super::restarts::{Restarts, Verdict};
use super::signals::{HeldSignals, Request, Signals};
use super::{Report, until_gone};
use crate::TRANSPORT;
use crate::carrier::Joining;
use crate::prepare::{Needs, check, draw};
use crate::status::LOST_HOST;
use anyhow::{Context, Result, anyhow};
use std::fs;
use std::io::ErrorKind;
use std::path::Path;
use std::time::Instant;
use tokio::sync::mpsc;
use tokio::time::{MissedTickBehavior, interval_at, sleep};
use trestle_link::Transport;
use trestle_link::iceoryx::IceoryxHost;
use trestle_proto::config::{Mode, Supervise};
use trestle_proto::incarnation::Incarnation;
use trestle_proto::limits::{BEAT, GRACE, RESTART_BACKOFF};
use trestle_proto::rundir::RunDir;

/// A relay's line begins with this when its host has been let in; the host's actors and their incarnations follow.
pub(crate) const GRANTED: &str = "granted ";
/// A line of the head's relay begins with this when it has counted what went to a host and came from it; a [`HostRow`] as JSON follows.
///
/// [`HostRow`]: trestle_proto::hosts_file::HostRow
pub(crate) const HOST: &str = "host-row ";
/// The file in the directory of a joined host that says why it leaves.
pub(crate) const FAREWELL: &str = "farewell";

/// How a host that had joined a run has parted from it.
pub(crate) enum Parted {
    /// The run is over.
    Over,
    /// This host was asked to leave.
    Interrupted,
}

/// How a session ended.
enum Ended {
    Parted(Parted),
    /// This host may join again. None of its own processes has died.
    Again(String),
    /// One has.
    Died(Death),
}

/// Joins the run at `joining.url`, again and again until it is over.
pub(crate) fn join(joining: &Joining, held: HeldSignals) -> Result<Parted> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let place =
        tempfile::Builder::new().prefix("trestle-joined-").tempdir().context("cannot make a directory")?;
    let dir = RunDir::new(place.path());
    let outcome = runtime.block_on(async {
        let mut signals = Signals::new()?;
        drop(held);
        sessions(joining, &dir, &mut signals).await
    });
    outcome.inspect_err(|_| {
        // Its logs may be wanted.
        let kept = place.keep();
        crate::output::say(&format!("the logs of this host are in {}", kept.join("logs").display()));
    })
}

async fn sessions(joining: &Joining, dir: &RunDir, signals: &mut Signals) -> Result<Parted> {
    let say = |text: &str| {
        if !joining.quiet {
            crate::output::say(text);
        }
    };
    let mut restarts = None;
    loop {
        let (ended, allowed) = session(joining, dir, signals, &say).await?;
        let pause = match ended {
            Ended::Parted(parted) => return Ok(parted),
            Ended::Again(reason) => {
                say(&format!("{reason}; joining again"));
                RESTART_BACKOFF
            }
            Ended::Died(death) => {
                let account = restarts.get_or_insert_with(|| Restarts::of_process(allowed, None));
                match account.after(&death, None, Instant::now()) {
                    Verdict::Again(pause) => {
                        say(&format!("{death}; joining again"));
                        pause.max(RESTART_BACKOFF)
                    }
                    Verdict::End(reason) => {
                        let tail = log_tail(dir, death.role);
                        return Err(anyhow!(
                            "{death}; not joining again: {reason}; the end of its log:\n{tail}"
                        ));
                    }
                }
            }
        };
        tokio::select! {
            () = sleep(pause) => {}
            _ = signals.next() => return Ok(Parted::Interrupted),
        }
    }
}

/// One session. Also returns how often a process may die.
async fn session(
    joining: &Joining,
    dir: &RunDir,
    signals: &mut Signals,
    say: &dyn Fn(&str),
) -> Result<(Ended, u32)> {
    clear(dir)?;
    let run = draw()?;
    let (reports, mut inbox) = mpsc::channel(64);
    let relay = children::launch(dir, None, Role::Relay, &words(joining, run), None, &reports)?;
    let mut session =
        Session { dir, children: vec![relay], held: None, supervise: Supervise::default(), leaving: None };
    let mut beat = interval_at(tokio::time::Instant::now() + BEAT, BEAT);
    beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let outcome = loop {
        let request = tokio::select! {
            request = signals.next() => Some(request),
            _ = beat.tick() => if session.signs_of_life() { signals.passed_on() } else { None },
            report = inbox.recv() => match report {
                Some(Report::Said(line)) => {
                    match line.strip_prefix(GRANTED) {
                        Some(seats) => match session.begin(seats, &reports) {
                            Ok(said) => say(&said),
                            Err(error) => break Err(error),
                        },
                        None => say(&line),
                    }
                    None
                }
                Some(Report::Exited(role, status)) => match status {
                    Ok(status) => match session.exited(role, How::Exited(status)) {
                        Ok(Some(ended)) => break Ok(ended),
                        Ok(None) => None,
                        Err(error) => break Err(error),
                    },
                    Err(error) => break Err(error).with_context(|| format!("cannot wait for {role}")),
                },
                Some(Report::Progress(_)) => None,
                None => break Err(anyhow!("all processes of this host are gone")),
            },
        };
        match request {
            Some(Request::Stop) => session.leave(Ended::Parted(Parted::Interrupted), "it was asked to leave"),
            Some(Request::StopNow) => break Ok(Ended::Parted(Parted::Interrupted)),
            None => {}
        }
    };
    if let Err(error) = &outcome {
        session.farewell(&format!("{error:#}"));
    }
    session.end_all(&mut inbox).await;
    Ok((outcome?, session.supervise.restarts))
}

/// The arguments of this host's relay.
fn words(joining: &Joining, run: u64) -> Vec<String> {
    let mut words: Vec<String> =
        ["relay", "joined", "--url", &joining.url, "--name", &joining.name].map(String::from).to_vec();
    let numbers =
        [("--identity", run), ("--actors", joining.actors.into()), ("--wait", joining.wait_s.into())];
    words.extend(numbers.into_iter().flat_map(|(flag, number)| [flag.into(), number.to_string()]));
    words.extend(children::spoken(&joining.network));
    words
}

/// Removes what an earlier session has left in `dir`, but for logs.
fn clear(dir: &RunDir) -> Result<()> {
    fs::create_dir_all(dir.logs()).with_context(|| format!("cannot make {}", dir.logs().display()))?;
    let remove =
        |path: &Path| match if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) } {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                Err(error).with_context(|| format!("cannot remove {}", path.display()))
            }
            _ => Ok(()),
        };
    remove(&dir.plan())?;
    remove(&dir.checkpoints())?;
    remove(&dir.root().join(FAREWELL))
}

struct Session<'a> {
    dir: &'a RunDir,
    /// The relay first.
    children: Vec<Child>,
    /// What this host shares, once it has been let in.
    held: Option<IceoryxHost>,
    supervise: Supervise,
    /// How the session is going to end, once that is known.
    leaving: Option<Ended>,
}

impl Session<'_> {
    /// This host has been let in: makes what its processes share, and starts the actors.
    fn begin(&mut self, seats: &str, reports: &mpsc::Sender<Report>) -> Result<String> {
        let plan = self.dir.read_plan()?;
        let experiment = &plan.experiment;
        check(&Needs::of(experiment))?;
        self.supervise = experiment.config.supervise.clone();
        self.held = Some(TRANSPORT.host(&plan).context("cannot create the services of this host")?);
        self.children[0].line.go();
        let free = experiment.config.run.mode == Mode::Free;
        let mut actors = Vec::new();
        for seat in seats.split_whitespace() {
            let numbers = seat
                .split_once(':')
                .and_then(|(actor, life)| Some((actor.parse().ok()?, life.parse().ok()?)));
            let (actor, life): (u32, Incarnation) =
                numbers.with_context(|| format!("the relay granted `{seat}`"))?;
            let words = children::actor(actor, free.then_some(life));
            let env = Some(&experiment.config.env);
            self.children.push(children::launch(self.dir, env, Role::Actor(actor), &words, None, reports)?);
            actors.push(actor.to_string());
        }
        let run = &experiment.config.run;
        Ok(format!(
            "joined: running actors {} of {}, seed {}",
            actors.join(", "),
            experiment.config.arm(),
            run.seed
        ))
    }

    /// Takes in all signs of life, and kills each process that counts as dead. Returns whether a process was asked to leave.
    fn signs_of_life(&mut self) -> bool {
        let mut asked = false;
        for child in self.children.iter_mut().filter(|child| child.running && child.fault.is_none()) {
            let signs = child.line.beat(&self.supervise);
            asked |= signs.asked;
            if let Some(fault) = signs.fault {
                child.fault = Some(fault);
                child.kill();
            }
        }
        asked
    }

    /// A process has ended. How the session has, if it has.
    fn exited(&mut self, role: Role, how: How) -> Result<Option<Ended>> {
        let mut fault = None;
        if let Some(child) = self.children.iter_mut().find(|child| child.role == role) {
            child.running = false;
            fault = child.fault.take();
        }
        let death = Death::new(self.dir, role, fault.map_or(how, How::Lingering));
        if role != Role::Relay {
            // The last line of its log, where that is an error.
            let said = match death.last_words.strip_prefix("error: ") {
                Some(words) => format!("{death}: {words}"),
                None => death.to_string(),
            };
            self.leave(Ended::Died(death), &said);
            return Ok(None);
        }
        if let Some(ended) = self.leaving.take() {
            return Ok(Some(ended));
        }
        match &death.how {
            How::Exited(status) if status.success() => Ok(Some(Ended::Parted(Parted::Over))),
            How::Exited(status) if status.code() == Some(LOST_HOST.into()) && self.held.is_some() => {
                Ok(Some(Ended::Again(death.to_string())))
            }
            How::Exited(status) if status.code().is_some() && !death.is_consequence() => {
                Err(anyhow!("{}", death.words()))
            }
            _ => Ok(Some(Ended::Died(death))),
        }
    }

    /// The session is going to end as `ended` says: the relay tells the head `why`, and leaves.
    fn leave(&mut self, ended: Ended, why: &str) {
        if self.leaving.is_none() {
            self.farewell(why);
            self.leaving = Some(ended);
            self.children[0].leave();
        }
    }

    /// Notes why this host leaves, for the relay.
    fn farewell(&self, why: &str) {
        let path = self.dir.root().join(FAREWELL);
        if let Err(error) = fs::write(&path, why) {
            tracing::warn!("cannot write {}: {error}", path.display());
        }
    }

    /// Asks all processes that still run to leave, and kills those that do not.
    async fn end_all(&mut self, inbox: &mut mpsc::Receiver<Report>) {
        self.children.iter_mut().filter(|child| child.running).for_each(Child::leave);
        until_gone(&mut self.children, inbox, GRACE, &mut |_| {}).await;
    }
}
