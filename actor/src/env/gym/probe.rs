//! Makes an environment before a run, in a process of its own, and takes in what is found there.
//!
//! The process can do whatever other people's code does: crash, hang, write without end, leave others behind. None of it is
//! this process's harm.

use super::{Found, GymError, Settings};
use crate::env::build;
use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

/// The subcommand of Trestle's Python package that looks at an environment.
const SUBCOMMAND: &str = "gym-probe";
/// Largest answer that is read, bytes.
const MAX_ANSWER: u64 = 8 << 20;
/// How long the last words of a process that has ended are waited for.
const LAST_WORDS: Duration = Duration::from_secs(1);
/// Bytes of the end of what the process says that a message shows.
const MAX_SAID: usize = 1500;

/// What the process answers: one line of JSON.
#[derive(serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Answer {
    Found(Box<Found>),
    Refused(String),
    /// Of the same build, which was all that was asked.
    Same {},
    /// Of another build, which may find other things.
    Other {
        version: String,
        build: String,
    },
}

/// The last bytes of what a process has said.
type Said = Arc<Mutex<VecDeque<u8>>>;

/// Makes the environment of `settings` with the Trestle that `trestle` starts, and looks at it.
pub(super) fn probe(
    trestle: &[String],
    settings: &Settings,
    step_limit: u32,
    seed: u64,
) -> Result<Found, GymError> {
    let question = serde_json::json!({ "settings": settings, "step_limit": step_limit, "seed": seed });
    match put(trestle, question, settings)? {
        Answer::Found(found) => Ok(*found),
        Answer::Refused(why) => Err(GymError::Refused(why)),
        Answer::Same {} | Answer::Other { .. } => Err(GymError::Found("another question's answer".into())),
    }
}

/// Checks that the Trestle that `trestle` starts is of this build.
pub(super) fn same_build(trestle: &[String], settings: &Settings) -> Result<(), GymError> {
    put(trestle, serde_json::json!({ "settings": null }), settings).map(drop)
}

/// Puts `question` to the Trestle that `trestle` starts. One of another build gives no answer.
fn put(trestle: &[String], mut question: serde_json::Value, settings: &Settings) -> Result<Answer, GymError> {
    let (program, args) = trestle.split_first().ok_or(GymError::NoPython)?;
    question["version"] = env!("CARGO_PKG_VERSION").into();
    question["build"] = build().into();
    let mut child = Command::new(program)
        .args(args)
        .arg(SUBCOMMAND)
        .env("PYTHONHASHSEED", "0")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .process_group(0)
        .spawn()
        .map_err(|error| GymError::Start { program: program.clone(), error })?;
    let (said, heard) = listen(&mut child);
    let answer = ask(&mut child, &question.to_string(), Duration::from_secs(settings.probe_s));
    // With all that it has started. It has not been waited for, so its id is still its own.
    let group = nix::unistd::Pid::from_raw(child.id() as i32);
    let answered = matches!(answer, Ok(Some(_)));
    if answered || matches!(answer, Err(RecvTimeoutError::Timeout)) {
        let _ = nix::sys::signal::killpg(group, nix::sys::signal::Signal::SIGKILL);
    }
    let status = child.wait();
    // Its last words may still be on their way; what it has left behind may keep the line open.
    let _ = heard.recv_timeout(LAST_WORDS);
    let tail = || {
        let said = said.lock().map_or_else(|_| Vec::new(), |said| said.iter().copied().collect());
        let said = String::from_utf8_lossy(&said).trim().to_string();
        if said.is_empty() { said } else { format!("; it said:\n{said}") }
    };
    match answer {
        Ok(Some(line)) => match serde_json::from_str(&line) {
            Ok(Answer::Other { version, build: theirs }) => Err(GymError::Build {
                program: program.clone(),
                version,
                build: theirs,
                own_version: env!("CARGO_PKG_VERSION").into(),
                own_build: build().into(),
            }),
            Ok(answer) => Ok(answer),
            Err(error) => Err(GymError::Found(error.to_string())),
        },
        Err(RecvTimeoutError::Timeout) => Err(GymError::Slow { seconds: settings.probe_s, said: tail() }),
        Ok(None) | Err(RecvTimeoutError::Disconnected) => {
            let status = status.map_or_else(|error| error.to_string(), |status| status.to_string());
            Err(GymError::Ended { status, said: tail() })
        }
    }
}

/// Keeps the end of what `child` says, and tells when it has said all.
fn listen(child: &mut Child) -> (Said, mpsc::Receiver<()>) {
    let said = Said::default();
    let (ended, heard) = mpsc::channel();
    if let Some(mut stderr) = child.stderr.take() {
        let said = said.clone();
        thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Ok(n @ 1..) = stderr.read(&mut buffer) {
                let Ok(mut said) = said.lock() else { return };
                said.extend(&buffer[..n]);
                let excess = said.len().saturating_sub(MAX_SAID);
                said.drain(..excess);
            }
            let _ = ended.send(());
        });
    }
    (said, heard)
}

/// Puts `question` to `child`; none if it ends without an answer.
fn ask(child: &mut Child, question: &str, limit: Duration) -> Result<Option<String>, RecvTimeoutError> {
    // A process that reads nothing ends without an answer.
    let mut stdin = child.stdin.take();
    if let Some(stdin) = &mut stdin {
        let _ = writeln!(stdin, "{question}");
    }
    let (answer, answered) = mpsc::channel();
    if let Some(stdout) = child.stdout.take() {
        thread::spawn(move || {
            let mut line = String::new();
            let read = BufReader::new(stdout.take(MAX_ANSWER)).read_line(&mut line);
            let _ = answer.send(read.ok().filter(|&n| n > 0).map(|_| line));
        });
    }
    // The process leaves when its standard input is closed, whatever becomes of this one.
    let received = answered.recv_timeout(limit);
    drop(stdin);
    received
}
