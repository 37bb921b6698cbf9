//! Clients of a run's mentor-server that ask and do not care for the answers, as processes of their own.

use crate::util::{LIMIT, send, wait_until};
use nix::sys::signal::Signal;
use std::env;
use std::io::{self, BufRead, BufReader, Read};
use std::process::{Child, Command, Stdio, exit};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;
use trestle_link::iceoryx::SharedMemory;
use trestle_link::{ClientLink, LinkError, Transport};
use trestle_proto::query::{QueryRequest, STATS};
use trestle_proto::rundir::RunDir;

/// A run's directory, for the process that is to be a client.
const RUN: &str = "TRESTLE_TEST_CLIENT";
/// How long it waits for each answer, in ms.
const PATIENCE: &str = "TRESTLE_TEST_CLIENT_MS";
/// The test that becomes the client; other programs that call [`be_one`] take no notice of it.
const TEST: &str = "faults::a_schedule_of_shortages_changes_nothing";
/// What it says when it has asked for the first time.
const ASKING: &str = "asking";
/// How long it tries to find a place among the clients.
const TRIES: Duration = Duration::from_secs(1);

/// To be called first by every program that starts clients: does what this process is for, if it is one, and ends it.
pub(crate) fn be_one() {
    let Some(dir) = env::var_os(RUN) else { return };
    static LEAVE: AtomicBool = AtomicBool::new(false);
    thread::spawn(|| {
        // Until it is closed.
        let _ = io::stdin().read(&mut [0]);
        LEAVE.store(true, Ordering::Relaxed);
    });
    let patience = env::var(PATIENCE).unwrap().parse().unwrap();
    ask(&RunDir::new(dir), Duration::from_millis(patience), || LEAVE.load(Ordering::Relaxed));
    exit(0);
}

fn ask(dir: &RunDir, patience: Duration, leave: impl Fn() -> bool) {
    let mut client = None;
    wait_until(TRIES, || {
        let plan = dir.read_plan().ok();
        client = plan.and_then(|plan| SharedMemory.client(&plan).ok());
        client.is_some() || leave()
    });
    let Some(client) = client else { return };
    let request = QueryRequest { op: STATS, obs_dim: 2, ..QueryRequest::default() };
    let mut answer = Vec::new();
    let mut said = false;
    while !leave() {
        match client.ask(&request, &[], &mut answer, patience) {
            Ok(_) | Err(LinkError::Deadline { .. }) => {}
            // The run has gone on without it.
            Err(_) => drop(wait_until(LIMIT, &leave)),
        }
        if !said {
            println!("{ASKING}");
            said = true;
        }
        if patience.is_zero() {
            // Ten thousands of questions a second would be another fault.
            thread::sleep(Duration::from_millis(1));
        }
    }
}

/// A client at work.
#[derive(Debug)]
pub(crate) struct Client(Child);

impl Client {
    /// Starts a client of the run in `dir`. It waits for each of its answers for `patience`; without, it never gets one.
    pub(crate) fn start(dir: &RunDir, patience: Duration) -> Self {
        let child = Command::new(env::current_exe().unwrap())
            .args([TEST, "--exact", "--nocapture"])
            .env(RUN, dir.root())
            .env(PATIENCE, patience.as_millis().to_string())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn();
        Self(child.unwrap())
    }

    /// Waits until it asks; false if there was no place for it.
    pub(crate) fn asks(&mut self) -> bool {
        let lines = BufReader::new(self.0.stdout.take().unwrap()).lines();
        lines.map_while(Result::ok).any(|line| line.contains(ASKING))
    }

    /// Stops it in the middle of whatever it does.
    pub(crate) fn stop(&self) {
        send(self.0.id(), Signal::SIGSTOP);
    }

    /// Lets it go on, and go.
    pub(crate) fn leave(mut self) {
        send(self.0.id(), Signal::SIGCONT);
        drop(self.0.stdin.take());
        assert!(wait_until(LIMIT, || self.0.try_wait().unwrap().is_some()));
    }
}

impl Drop for Client {
    /// Without a farewell.
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
