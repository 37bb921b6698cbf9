//! `mentor/query`: any process may ask a running mentor-server, and the run does not notice.

use crate::util::{LIMIT, Place, Process, Trace, assert_gone, domain, kill_all, start, wait_until};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;
use trestle_link::iceoryx::{IceoryxClient, SharedMemory};
use trestle_link::{ClientLink, LinkError, Transport};
use trestle_proto::annotation::AnnotationTable;
use trestle_proto::mentor::MentorTransitions;
use trestle_proto::plan::RunPlan;
use trestle_proto::query::{ANNOTATIONS, BRIDGE, QueryRequest, SIMILAR, STATS, Stats, TRANSITIONS};
use trestle_proto::rundir::RunDir;

const ENDLESS: [&str; 5] = ["maze-small", "--env-steps", "1000000000", "--episodes", "1000000000"];
const ARGS: [&str; 5] = ["maze-small", "--env-steps", "60000", "--seed", "9"];
const DEADLINE: Duration = Duration::from_secs(10);

/// A client and what it must know to judge the answers.
struct Asker {
    client: IceoryxClient,
    plan: RunPlan,
    answer: Vec<u32>,
}

impl Asker {
    /// A client of the run in `dir`, once it has one to be.
    fn of(dir: &RunDir) -> Option<Self> {
        let plan = dir.read_plan().ok()?;
        let client = SharedMemory.client(&plan).ok()?;
        Some(Self { client, plan, answer: Vec::new() })
    }

    /// The same, as soon as the mentor-server answers.
    fn wait_for(run: &mut Process, dir: &RunDir) -> Self {
        let mut asker = None;
        run.wait_for("the mentor-server", || {
            asker = Self::of(dir);
            asker.as_mut().is_some_and(|asker| asker.ask(STATS, 0, 0, &[]).is_ok())
        });
        asker.unwrap()
    }

    fn ask(&mut self, op: u32, first: u32, count: u32, state: &[f32]) -> Result<u32, LinkError> {
        let request = QueryRequest { op, first, count, obs_dim: 2, ..QueryRequest::default() };
        let header = self.client.ask(&request, state, &mut self.answer, DEADLINE)?;
        Ok(header.count)
    }

    /// One question of each kind, every answer checked.
    fn round(&mut self, transitions: &MentorTransitions) -> Result<Stats, LinkError> {
        let len = self.plan.experiment.mentor_len() as u32;
        self.ask(STATS, 0, 0, &[])?;
        let [mentor, feasible, bridged, stored, bridge_len_mean, e_kl_mean] = self.answer[..] else {
            panic!("six words are expected: {:?}", self.answer);
        };
        let (bridge_len_mean, e_kl_mean) = (f32::from_bits(bridge_len_mean), f32::from_bits(e_kl_mean));
        let stats = Stats { mentor, feasible, bridged, stored, bridge_len_mean, e_kl_mean };
        assert_eq!(stats.mentor, len);
        assert!(stats.feasible + stats.bridged <= len && stats.bridge_len_mean >= 0.0, "{stats:?}");

        assert_eq!(self.ask(ANNOTATIONS, 0, len, &[])?, len);
        let experiment = &self.plan.experiment;
        let table = AnnotationTable::new(len as usize, 2, experiment.spec.n_actions());
        let mut table = table.keeping(experiment.further());
        table.apply(&self.answer).unwrap();

        let j = stats.stored as usize % transitions.len();
        let state = transitions.state(j).to_vec();
        let count = self.ask(SIMILAR, 0, 5, &state)?;
        assert!(count >= 1 && self.answer.len() == 2 * count as usize, "a state is similar to itself");
        let found: Vec<(u32, f32)> =
            self.answer.chunks(2).map(|pair| (pair[0], f32::from_bits(pair[1]))).collect();
        assert_eq!(found[0].1, 0.0);
        assert!(found.iter().all(|(i, _)| *i < len) && found.is_sorted_by(|a, b| a.1 <= b.1), "{found:?}");

        // What had a bridge a moment ago has one still.
        let bridged = table.bridge(j).is_some();
        let count = self.ask(BRIDGE, j as u32, 0, &state)?;
        assert!(self.answer.len() == count as usize * table.record_words() && count <= 1);
        assert!(count == 1 || !bridged);
        Ok(stats)
    }

    /// Requests that cannot be right.
    fn nonsense(&mut self) {
        let len = self.plan.experiment.mentor_len() as u32;
        let cases: [(u32, u32, u32, &[f32], &str); 9] = [
            (99, 0, 0, &[], "unknown operation"),
            (0, 0, 0, &[], "unknown operation"),
            (SIMILAR, 0, 5, &[1.0], "malformed request"),
            (SIMILAR, 0, 5, &[1.0, f32::NAN], "malformed request"),
            (BRIDGE, 0, 0, &[f32::INFINITY, 1.0], "malformed request"),
            (BRIDGE, len, 0, &[1.0, 1.0], "out of range"),
            (ANNOTATIONS, 0, len + 1, &[], "out of range"),
            (ANNOTATIONS, u32::MAX, 2, &[], "out of range"),
            (TRANSITIONS, 1, len, &[], "out of range"),
        ];
        for (op, first, count, state, expected) in cases {
            match self.ask(op, first, count, state) {
                Err(LinkError::Refused { reason, .. }) => {
                    assert_eq!(reason, expected, "{op} {first} {count}")
                }
                other => panic!("{op} {first} {count} {state:?}: {other:?}"),
            }
        }
    }
}

#[test]
fn a_client_gets_sound_answers_and_the_run_does_not_notice() {
    let place = Place::new();
    let undisturbed = place.train("alone", &ARGS);

    let mut run = start(&place.training("asked", &ARGS));
    let dir = place.run("asked");
    let mut asker = Asker::wait_for(&mut run, &dir);

    let len = asker.plan.experiment.mentor_len() as u32;
    assert_eq!(asker.ask(TRANSITIONS, 0, len, &[]).unwrap(), len);
    let mut transitions = MentorTransitions::new(2);
    transitions.decode(&asker.answer).unwrap();
    assert_eq!(transitions.len(), len as usize);
    assert!(transitions.terminal(len as usize - 1) && !transitions.terminal(0));
    asker.nonsense();

    // Until the run ends: then, and only then, a question stays without an answer.
    let (mut rounds, mut last) = (0, Stats::default());
    while let Ok(stats) = asker.round(&transitions) {
        assert!(stats.stored >= last.stored && stats.feasible >= last.feasible, "{stats:?} after {last:?}");
        (rounds, last) = (rounds + 1, stats);
    }
    assert!(wait_until(LIMIT, || !run.is_running()), "the run goes on without an answer");
    run.finish().ok();
    assert!(rounds > 20 && last.stored > 0, "{rounds} rounds");
    drop(asker);
    assert_gone(&dir);
    assert_eq!(Trace::of(&dir), undisturbed);
}

/// Several clients at once, one that never waits for its answers and one that leaves in the middle of a question: every
/// patient one gets sound answers within its deadline, and the run does not notice.
#[test]
fn clients_do_not_harm_each_other() {
    let place = Place::new();
    let undisturbed = place.train("alone", &ARGS);
    let mut run = start(&place.training("asked", &ARGS));
    let dir = place.run("asked");
    Asker::wait_for(&mut run, &dir);

    let patient = || {
        let mut asker = Asker::of(&dir).unwrap();
        let len = asker.plan.experiment.mentor_len() as u32;
        let mut transitions = MentorTransitions::new(2);
        asker.ask(TRANSITIONS, 0, len, &[]).unwrap();
        transitions.decode(&asker.answer).unwrap();
        let mut rounds = 0;
        // The first fault is the end of the run, and must not come before.
        let fault = loop {
            match asker.round(&transitions) {
                Ok(_) => rounds += 1,
                Err(fault) => break fault,
            }
        };
        assert!(wait_until(LIMIT, || dir.result().exists()), "{fault} after {rounds} rounds");
        rounds
    };
    let impatient = || {
        let mut questions = 0;
        while let Some(asker) = Asker::of(&dir) {
            // The last of these leaves with its question unanswered.
            for _ in 0..5 {
                let request = QueryRequest { op: STATS, obs_dim: 2, ..QueryRequest::default() };
                let asked = asker.client.ask(&request, &[], &mut Vec::new(), Duration::ZERO);
                questions += u32::from(matches!(asked, Ok(_) | Err(LinkError::Deadline { .. })));
            }
            if dir.result().exists() {
                break;
            }
        }
        questions
    };
    std::thread::scope(|scope| {
        let patient: Vec<_> = (0..3).map(|_| scope.spawn(patient)).collect();
        let impatient = scope.spawn(impatient);
        for client in patient {
            assert!(client.join().unwrap() > 5);
        }
        assert!(impatient.join().unwrap() > 5);
    });
    run.finish().ok();
    assert_gone(&dir);
    assert_eq!(Trace::of(&dir), undisturbed);
}

/// Joining a run that is over, or becomes so meanwhile, would make its directory anew.
#[test]
fn a_client_that_comes_too_late_leaves_nothing() {
    let place = Place::alone();
    let mut run = start(&place.training("run", &ENDLESS));
    let dir = place.run("run");
    Asker::wait_for(&mut run, &dir);
    let early = Asker::of(&dir).unwrap();
    kill_all(run, &dir);
    assert!(domain(&dir).root().exists());
    let late = SharedMemory.client(&early.plan).unwrap_err();
    assert_eq!(late.to_string(), "joining the run: it is not in progress, or another user's");
    assert_gone(&dir);
    // As if it had been joining while the run was removed.
    domain(&dir).node().unwrap();
    assert!(domain(&dir).root().exists());
    drop(early);
    assert_gone(&dir);
}

/// A run's directory, for the process that [`killed_clients_leave_nothing`] kills.
const VICTIM: &str = "TRESTLE_TEST_VICTIM";

/// Clients that are killed in the middle of a question, each with its part of the shared memory still open: the others get
/// their answers, the run does not notice, and nothing of them remains.
#[test]
fn killed_clients_leave_nothing() {
    let ask_for_ever = |dir: &Path| {
        let mut asker = Asker::of(&RunDir::new(dir)).unwrap();
        loop {
            asker.ask(STATS, 0, 0, &[]).unwrap();
            println!("answered");
        }
    };
    if let Some(dir) = std::env::var_os(VICTIM) {
        ask_for_ever(Path::new(&dir));
    }
    let place = Place::new();
    let undisturbed = place.train("alone", &ARGS);
    let mut run = start(&place.training("asked", &ARGS));
    let dir = place.run("asked");
    let mut survivor = Asker::wait_for(&mut run, &dir);
    for _ in 0..3 {
        let mut victim = Command::new(std::env::current_exe().unwrap())
            .args(["query::killed_clients_leave_nothing", "--exact", "--nocapture"])
            .env(VICTIM, dir.root())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(victim.stdout.take().unwrap()).lines();
        assert!(lines.any(|line| line.unwrap().contains("answered")));
        // SIGKILL, while it asks.
        victim.kill().unwrap();
        victim.wait().unwrap();
        survivor.ask(STATS, 0, 0, &[]).unwrap();
    }
    run.finish().ok();
    drop(survivor);
    assert_gone(&dir);
    assert_eq!(Trace::of(&dir), undisturbed);
}
