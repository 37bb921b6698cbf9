//! The processes of a run: this program again, with another subcommand.
//!
//! A child's standard error goes to its log. Its standard input is a socket whose other end only the supervisor holds:
//! when the supervisor is gone, however it went, the child reads its end and leaves. The child gives its signs of life
//! there, and gets the order to leave. Children have process groups of their own, so that Ctrl-C reaches the supervisor
//! alone; other signals that ask a child to leave are passed on to the supervisor.

use super::Report;
use super::line::{Fault, Line};
use crate::carrier::{self, Listening, Network};
use crate::itself;
use crate::prepare::Prepared;
use crate::status::{LOST_HOST, LOST_PEER};
use anyhow::{Context, Result};
use nix::errno::Errno;
use nix::sys::signal::{Signal, killpg};
use nix::sys::wait::{Id, WaitPidFlag, waitid};
use nix::unistd::Pid;
use std::fmt;
use std::io::{Read, Seek, SeekFrom};
use std::os::fd::OwnedFd;
use std::process::{ExitStatus, Stdio};
use std::thread;
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::{self, ChildStdout, Command};
use tokio::sync::{mpsc, oneshot};
use trestle_actor::env::registry;
use trestle_learner::record::Progress;
use trestle_link::{log_file, logging};
use trestle_proto::config::{self, Mode};
use trestle_proto::incarnation::Incarnation;
use trestle_proto::regular_file;
use trestle_proto::rundir::RunDir;

/// Lines of a dead child's log that the user is shown.
const TAIL_LINES: usize = 12;
/// Bytes of it that are looked at.
const MAX_TAIL_BYTES: u64 = 1 << 16;

/// Which process of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    Learner,
    MentorServer,
    /// What speaks to other hosts.
    Relay,
    Actor(u32),
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Learner => write!(f, "learner"),
            Self::MentorServer => write!(f, "mentor-server"),
            Self::Relay => write!(f, "relay"),
            Self::Actor(index) => write!(f, "actor-{index}"),
        }
    }
}

/// The status of a process that panicked.
const PANICKED: i32 = 101;

/// How a process came to be of no use any more.
#[derive(Clone, Debug)]
pub(super) enum How {
    /// It ended by itself or was killed.
    Exited(ExitStatus),
    /// It is there, but nothing comes of it any more.
    Lingering(Fault),
}

/// The end of a process before that of its run.
#[derive(Clone, Debug)]
pub(super) struct Death {
    pub(super) role: Role,
    pub(super) how: How,
    /// The last line of its log.
    pub(super) last_words: String,
}

impl Death {
    pub(super) fn new(dir: &RunDir, role: Role, how: How) -> Self {
        let last_words = log_tail(dir, role).lines().last().unwrap_or_default().into();
        Self { role, how, last_words }
    }

    /// Whether it is only the consequence of another death.
    pub(super) fn is_consequence(&self) -> bool {
        matches!(self.how, How::Exited(status) if status.code() == Some(i32::from(LOST_PEER)))
    }

    /// The relay's words about another host that it has lost, if it has.
    fn lost_host(&self) -> Option<&str> {
        let lost = matches!(self.how, How::Exited(status) if status.code() == Some(i32::from(LOST_HOST)));
        (lost && self.role == Role::Relay).then(|| self.words())
    }

    /// The last line of its log, without the prefix of every error.
    pub(super) fn words(&self) -> &str {
        self.last_words.strip_prefix("error: ").unwrap_or(&self.last_words)
    }

    /// Whether an actor ended by itself and without an error of its own, with `status`: what it runs ended it.
    fn is_silent(&self, status: ExitStatus) -> bool {
        let own = self.last_words.starts_with("error: ") || status.code() == Some(PANICKED);
        matches!(self.role, Role::Actor(_)) && status.code().is_some() && !own && !self.is_consequence()
    }

    /// The reason that the process itself reported, if it did. Another host may be lost again and again, and come back.
    pub(super) fn reported(&self) -> Option<String> {
        let How::Exited(status) = self.how else { return None };
        let code = status.code().filter(|_| !self.is_consequence() && self.lost_host().is_none())?;
        Some(format!("{} {code} {}", self.role, self.last_words))
    }
}

impl fmt::Display for Death {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(lost) = self.lost_host() {
            return f.write_str(lost);
        }
        match &self.how {
            How::Exited(status) if self.is_silent(*status) => {
                write!(
                    f,
                    "{} ended with {status} and without an error, as by os._exit in the environment's code",
                    self.role
                )
            }
            How::Exited(status) => write!(f, "{} ended with {status}", self.role),
            How::Lingering(Fault::Silent(s)) => {
                write!(f, "{} gave no sign of life for {s} s (supervise.silence_s)", self.role)
            }
            How::Lingering(Fault::Stalled(s)) => {
                write!(f, "{} did not get ahead for {s} s (supervise.stall_s)", self.role)
            }
        }
    }
}

/// A child that has been started.
pub(super) struct Child {
    pub(super) role: Role,
    pub(super) running: bool,
    /// Why it has been killed, if it was.
    pub(super) fault: Option<Fault>,
    /// To the task that waits for the process.
    end: mpsc::UnboundedSender<()>,
    pub(super) line: Line,
}

impl Child {
    /// Asks the process to finish what it is doing and leave.
    pub(super) fn leave(&mut self) {
        self.line.leave();
    }

    /// Ends the process.
    pub(super) fn kill(&self) {
        // The task is gone when the process is.
        let _ = self.end.send(());
    }
}

/// Starts every process of the run; their ends, and the learner's progress, come through `events`.
pub(super) fn start_all(prepared: &Prepared, events: &mpsc::Sender<Report>) -> Result<Vec<Child>> {
    let run = &prepared.experiment().config.run;
    let mut roles = vec![Role::Learner];
    if run.algo.has_mentor() {
        roles.push(Role::MentorServer);
    }
    let here = match prepared.listening() {
        Some(listening) => {
            roles.push(Role::Relay);
            listening.first
        }
        None => run.actors,
    };
    roles.extend((0..here).map(Role::Actor));
    let mut children = Vec::new();
    for role in roles {
        match start(prepared, role, 0, events) {
            Ok(child) => children.push(child),
            Err(error) => {
                children.iter().for_each(Child::kill);
                return Err(error);
            }
        }
    }
    Ok(children)
}

/// Starts one process of the run. `replacements`: how often it has been replaced since all were started.
pub(super) fn start(
    prepared: &Prepared,
    role: Role,
    replacements: u16,
    events: &mpsc::Sender<Report>,
) -> Result<Child> {
    let words = match role {
        Role::Learner => vec!["learner".into()],
        Role::MentorServer => vec!["mentor-server".into()],
        Role::Relay => {
            prepared.lose_hosts();
            prepared.listening().map(|listening| head(listening, replacements)).unwrap_or_default()
        }
        Role::Actor(index) => {
            let free = prepared.experiment().config.run.mode == Mode::Free;
            let incarnation = Incarnation::new(prepared.plan().life.generation, replacements);
            actor(index, free.then_some(incarnation))
        }
    };
    // Only the learner writes into the run's directory beside the supervisor.
    let fence = if role == Role::Learner { prepared.fence().inheritable()? } else { None };
    launch(prepared.dir(), Some(&prepared.experiment().config.env), role, &words, fence, events)
}

/// The arguments of the relay on the learner's host.
fn head(listening: &Listening, replacements: u16) -> Vec<String> {
    let Listening { url, first, network } = listening;
    let mut words: Vec<String> = ["relay", "head", "--first"].map(String::from).to_vec();
    words.extend([first.to_string(), "--listen".into(), url.clone()]);
    words.extend(["--replacements".into(), replacements.to_string()]);
    words.extend(spoken(network));
    words
}

/// A relay's arguments about how hosts speak to each other.
pub(super) fn spoken(network: &Network) -> Vec<String> {
    let silence = ["--host-silence".into(), network.host_silence.to_string()];
    carrier::options(network).into_iter().chain(silence).collect()
}

/// The arguments of actor `index`.
pub(super) fn actor(index: u32, incarnation: Option<Incarnation>) -> Vec<String> {
    let mut words = vec!["actor".into(), "--index".into(), index.to_string()];
    if let Some(incarnation) = incarnation {
        words.extend(["--incarnation".into(), incarnation.to_string()]);
    }
    words
}

/// Starts this program again as process `role` of the run in `dir`, with `words` as its first arguments. `env` is the environment of
/// an actor. `fence` is the lock of the directory, which the process keeps as long as it lives.
pub(super) fn launch(
    dir: &RunDir,
    env: Option<&config::Env>,
    role: Role,
    words: &[String],
    fence: Option<OwnedFd>,
    events: &mpsc::Sender<Report>,
) -> Result<Child> {
    let path = dir.log(&role.to_string());
    let log = log_file::open(&path).with_context(|| format!("cannot open {}", path.display()))?;
    let foreign = match role {
        Role::Actor(_) => env.and_then(|env| registry().foreign(env)),
        Role::Learner | Role::MentorServer | Role::Relay => None,
    };
    let elsewhere = foreign.as_ref().and_then(|foreign| foreign.program.as_deref());
    let mut command = Command::from(elsewhere.map_or_else(itself::again, itself::command));
    if let Some(foreign) = &foreign {
        command.envs(foreign.variables.iter().copied());
    }
    command.args(words).arg("--run").arg(dir.root()).arg("--watch-stdin");
    // candle asks for the number of threads at every product, and takes all cores if it is not told; a run's
    // processes have one working thread each.
    command.env("RAYON_NUM_THREADS", "1");
    let (line, theirs) = Line::new().context("cannot make a socket")?;
    command.stdin(Stdio::from(OwnedFd::from(theirs)));
    let speaks = matches!(role, Role::Learner | Role::Relay);
    command.stdout(match (speaks, &foreign) {
        (true, _) => Stdio::piped(),
        // What an environment prints is for its author to read.
        (false, Some(_)) => Stdio::from(log.try_clone().context("cannot open a log twice")?),
        (false, None) => Stdio::null(),
    });
    command.stderr(Stdio::from(log)).process_group(0).kill_on_drop(true);
    let mut process = command.spawn().with_context(|| format!("cannot start {role}"))?;
    drop(fence);
    // So that the child alone holds its end.
    drop(command);
    let stdout = process.stdout.take();
    let (end, received) = mpsc::unbounded_channel();
    let forwarding = stdout.map(|stdout| tokio::spawn(forward(role, stdout, events.clone())));
    let events = events.clone();
    tokio::spawn(async move {
        let group = foreign.and_then(|_| process.id()).map(end_of_group);
        let status = wait(&mut process, received, group).await;
        // All of its progress comes before its end.
        if let Some(forwarding) = forwarding {
            let _ = forwarding.await;
        }
        // A supervisor that no longer listens is itself on its way out.
        let _ = events.send(Report::Exited(role, status)).await;
    });
    Ok(Child { role, running: true, fault: None, end, line })
}

/// Waits for `process`, and kills it when that is ordered: never after it has been waited for, when its id could be
/// another's.
///
/// With a `group` the process is waited for only after that.
async fn wait(
    process: &mut process::Child,
    mut end: mpsc::UnboundedReceiver<()>,
    group: Option<oneshot::Receiver<()>>,
) -> std::io::Result<ExitStatus> {
    let mut foreign = group.is_some();
    let mut ended = group.unwrap_or_else(|| oneshot::channel().1);
    loop {
        tokio::select! {
            _ = &mut ended, if foreign => foreign = false,
            status = process.wait(), if !foreign => return status,
            Some(()) = end.recv() => process.start_kill()?,
        }
    }
}

/// Says when the process `id` has ended, and all that it has started has been ended, too: its group, which nobody else can have
/// while the process has not been waited for.
fn end_of_group(id: u32) -> oneshot::Receiver<()> {
    let (ended, receiver) = oneshot::channel();
    let group = Pid::from_raw(id.cast_signed());
    thread::spawn(move || {
        while let Err(Errno::EINTR) = waitid(Id::Pid(group), WaitPidFlag::WEXITED | WaitPidFlag::WNOWAIT) {}
        // Nothing may be left of it.
        let _ = killpg(group, Signal::SIGKILL);
        let _ = ended.send(());
    });
    receiver
}

/// Passes on the learner's progress, or a relay's lines, until it closes its standard output.
async fn forward(role: Role, stdout: ChildStdout, events: mpsc::Sender<Report>) {
    let mut lines = BufReader::new(stdout).lines();
    while let Ok(Some(line)) = lines.next_line().await {
        if role == Role::Relay {
            let _ = events.send(Report::Said(line)).await;
            continue;
        }
        match serde_json::from_str::<Progress>(&line) {
            Ok(progress) => _ = events.send(Report::Progress(progress)).await,
            Err(error) => tracing::warn!("the learner printed a line that is no progress ({error}): {line}"),
        }
    }
}

/// The last lines of a process's log.
pub(super) fn log_tail(dir: &RunDir, role: Role) -> String {
    let path = dir.log(&role.to_string());
    let tail = || -> Result<Vec<u8>> {
        let (mut file, mut bytes) = (regular_file::open(&path, u64::MAX)?, Vec::new());
        let length = file.metadata()?.len();
        file.seek(SeekFrom::Start(length.saturating_sub(MAX_TAIL_BYTES)))?;
        file.take(MAX_TAIL_BYTES).read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    match tail() {
        Ok(bytes) => {
            let text = String::from_utf8_lossy(&bytes);
            // What the transport says of memory that a dead process has left would bury the process's own words.
            let aside = |line: &&str| line.contains(" WARN ") && line.contains(logging::IPC);
            let lines: Vec<&str> = text.lines().filter(|line| !aside(line)).collect();
            lines[lines.len().saturating_sub(TAIL_LINES)..].join("\n")
        }
        Err(error) => format!("(cannot read {}: {error:#})", path.display()),
    }
}
