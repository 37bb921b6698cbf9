//! Faults in the middle of a run, which it survives without a trace in what it learns.

use crate::client;
use crate::schedule::{self, KINDS, SHORTAGES};
use crate::util::{
    LIMIT, Place, Process, Trace, assert_gone, domain, evaluations, newest_checkpoint, process, processes,
    result, send, start, wait_until,
};
use nix::sys::signal::Signal;
use std::fs;
use std::time::{Duration, Instant};
use trestle_link::iceoryx::SharedMemory;
use trestle_link::{ActorLink, ClientLink, Transport};
use trestle_proto::batch::{Batch, BatchHeader, Transition};
use trestle_proto::config::Mode;
use trestle_proto::query::{QueryRequest, STATS};
use trestle_proto::rundir::RunDir;

/// Two actors, and checkpoints on the way.
const ARGS: [&str; 9] = [
    "maze-small",
    "--env-steps",
    "40000",
    "--seed",
    "5",
    "--actors",
    "2",
    "--set",
    "checkpoint.every_env_steps=5000",
];
const ROLES: [&str; 4] = ["learner", "mentor-server", "actor-0", "actor-1"];

/// Kills `role` of the run and waits until another process has its place.
fn replace(run: &mut Process, dir: &RunDir, role: &str) {
    let mut killed = None;
    run.wait_for(role, || {
        killed = process(dir.root(), role);
        killed.is_some()
    });
    send(killed.unwrap(), Signal::SIGKILL);
    run.wait_for("another process", || process(dir.root(), role).is_some_and(|pid| Some(pid) != killed));
}

/// The run came to what an undisturbed one comes to, after so many restarts.
fn survived(place: &Place, run: Process, name: &str, restarts: u64, undisturbed: &Trace) {
    let outcome = run.finish().ok();
    let dir = place.run(name);
    assert_gone(&dir);
    assert_eq!(
        outcome.stderr.matches("starting all processes again").count() as u64,
        restarts,
        "{outcome:?}"
    );
    assert_eq!(result(&dir).restarts, restarts);
    assert_eq!(Trace::of(&dir), *undisturbed);
}

#[test]
fn any_process_may_be_killed() {
    for more in [&[][..], &["--set", "run.lag=1"]] {
        let place = Place::new();
        let args = [&ARGS[..], more].concat();
        let undisturbed = place.train("undisturbed", &args);
        let mut run = start(&place.training("run", &args));
        let dir = place.run("run");
        for role in ROLES {
            let before = newest_checkpoint(&dir);
            run.wait_for("a checkpoint", || newest_checkpoint(&dir) > before);
            replace(&mut run, &dir, role);
        }
        survived(&place, run, "run", 4, &undisturbed);
        let log = fs::read_to_string(dir.log("supervisor")).unwrap();
        assert!(ROLES.iter().all(|role| log.contains(&format!("{role} ended with signal: 9"))), "{log}");
    }
}

#[test]
fn a_run_without_a_checkpoint_begins_again() {
    let place = Place::new();
    let args = ["maze-small", "--env-steps", "20000", "--set", "checkpoint.every_env_steps=0"];
    let undisturbed = place.train("undisturbed", &args);
    let mut run = start(&place.training("run", &args));
    let dir = place.run("run");
    for role in ["actor-0", "learner"] {
        run.wait_for("evaluations", || evaluations(&dir) >= 2);
        replace(&mut run, &dir, role);
    }
    survived(&place, run, "run", 2, &undisturbed);
}

#[test]
fn a_process_may_be_killed_while_the_run_starts() {
    let place = Place::new();
    let args = ["maze-small", "--env-steps", "5000"];
    let undisturbed = place.train("undisturbed", &args);
    for role in ["learner", "mentor-server", "actor-0"] {
        let mut run = start(&place.training(role, &args));
        replace(&mut run, &place.run(role), role);
        survived(&place, run, role, 1, &undisturbed);
    }
}

#[test]
fn a_stopped_process_is_replaced() {
    let place = Place::new();
    let args = [&ARGS[..], &["--set", "supervise.silence_s=3"]].concat();
    let undisturbed = place.train("undisturbed", &args);
    for role in ["learner", "mentor-server", "actor-1"] {
        let mut run = start(&place.training(role, &args));
        let dir = place.run(role);
        run.wait_for("an evaluation", || evaluations(&dir) > 0);
        send(process(dir.root(), role).unwrap(), Signal::SIGSTOP);
        survived(&place, run, role, 1, &undisturbed);
        let log = fs::read_to_string(dir.log("supervisor")).unwrap();
        assert!(log.contains(&format!("{role} gave no sign of life for 3 s")), "{log}");
    }
}

/// However often: it is slow, but it lives.
#[test]
fn a_process_that_is_stopped_again_and_again_is_not_replaced() {
    let place = Place::new();
    let args = [&ARGS[..], &["--set", "supervise.silence_s=3"]].concat();
    let undisturbed = place.train("undisturbed", &args);
    let mut run = start(&place.training("run", &args));
    let dir = place.run("run");
    run.wait_for("an evaluation", || evaluations(&dir) > 0);
    let slow = ["learner", "mentor-server"].map(|role| process(dir.root(), role).unwrap());
    for _ in 0..20 {
        for (signal, ms) in [(Signal::SIGSTOP, 220), (Signal::SIGCONT, 30)] {
            slow.iter().for_each(|pid| send(*pid, signal));
            assert!(!wait_until(Duration::from_millis(ms), || !run.is_running()));
        }
    }
    survived(&place, run, "run", 0, &undisturbed);
}

/// Nobody dies of it that the supervisor itself, or the whole run, has been stopped.
#[test]
fn a_pause_is_no_death() {
    let place = Place::new();
    let args = [&ARGS[..], &["--set", "supervise.silence_s=3", "--set", "supervise.stall_s=3"]].concat();
    let undisturbed = place.train("undisturbed", &args);
    let mut run = start(&place.training("run", &args));
    let dir = place.run("run");
    run.wait_for("an evaluation", || evaluations(&dir) > 0);
    let all = processes(dir.root());
    assert_eq!(all.len(), 5);
    all.iter().for_each(|(pid, _)| send(*pid, Signal::SIGSTOP));
    let stopped = Instant::now();
    assert!(wait_until(LIMIT, || stopped.elapsed() > Duration::from_secs(5)));
    all.iter().for_each(|(pid, _)| send(*pid, Signal::SIGCONT));
    survived(&place, run, "run", 0, &undisturbed);
}

/// A short piece of what `cargo test --test faults` plays at length.
#[test]
fn a_schedule_of_faults_changes_nothing() {
    let summary = schedule::play(Mode::Lockstep, 1, 12, &KINDS[..SHORTAGES], |_| {});
    assert_eq!(summary.faults, 12);
}

/// The same of full file systems, of a mentor-server that is slow, and of its clients.
#[test]
fn a_schedule_of_shortages_changes_nothing() {
    client::be_one();
    let summary = schedule::play(Mode::Lockstep, 7, 8, &KINDS[SHORTAGES..], |_| {});
    assert_eq!(summary.faults, 8);
    assert!(summary.clients > 0);
}

/// Somebody who takes the name of an actor and sends what cannot be right: the learner says what is wrong and ends, and the
/// run begins again under a new identity, without him.
#[test]
fn a_rogue_peer_is_named_and_shaken_off() {
    let place = Place::new();
    let undisturbed = place.train("undisturbed", &ARGS);
    // The last one is what an environment would send that has lost its footing.
    let spoil: [fn(&mut BatchHeader, &mut f32); 5] = [
        |header, _| header.run ^= 1,
        |header, _| header.first_seq = 1,
        |header, _| header.actor = 63,
        |header, _| header.obs_dim = 3,
        |_, reward| *reward = f32::NAN,
    ];
    let mut run = start(&place.training("run", &ARGS));
    let dir = place.run("run");
    for (restarts, spoil) in spoil.into_iter().enumerate() {
        // In the same words from the same checkpoint, it would be the run's end.
        let before = newest_checkpoint(&dir);
        run.wait_for("a checkpoint", || newest_checkpoint(&dir) > before);
        let plan = dir.read_plan().unwrap();
        assert_eq!(plan.life.restarts, restarts as u64);
        let mut rogue = SharedMemory.actor(&plan, 0).unwrap();
        let mut batch = Batch::default();
        let mut header = BatchHeader { run: plan.life.run, count: 4, obs_dim: 2, ..BatchHeader::default() };
        let mut reward = 0.0;
        spoil(&mut header, &mut reward);
        batch.prepare(header);
        let (obs, flags) = (vec![0.0; header.obs_dim as usize], 0);
        batch.set(0, &Transition { obs: &obs, next_obs: &obs, action: 0, reward, flags });
        // He takes no orders, which keeps nobody waiting.
        rogue.send_batch(&batch).unwrap();
        run.wait_for("the learner to notice", || dir.read_plan().unwrap().life.restarts > restarts as u64);
    }
    survived(&place, run, "run", 5, &undisturbed);
    let log = fs::read_to_string(dir.log("supervisor")).unwrap();
    assert_eq!(log.matches("learner ended with exit status: 1").count(), 5, "{log}");
    let log = fs::read_to_string(dir.log("learner")).unwrap();
    for words in [
        "unexpected message: batch BatchHeader { run: ",
        "a batch of actor 0 from number 1 on; ",
        "batch of actor 63; this run has 2",
        "has observations of 3 features; this run's have 2",
        "transition 0 of actor 0 has a reward that is not finite",
    ] {
        assert!(log.contains(words), "`{words}` is missing: {log}");
    }
}

/// Clients that ask and never listen to the answers cost the run nothing.
#[test]
fn clients_that_do_not_listen_are_their_own_affair() {
    let place = Place::new();
    let undisturbed = place.train("undisturbed", &ARGS);
    let mut run = start(&place.training("run", &ARGS));
    let dir = place.run("run");
    run.wait_for("an evaluation", || evaluations(&dir) > 0);
    let plan = dir.read_plan().unwrap();
    let clients: Vec<_> = (0..4).map(|_| SharedMemory.client(&plan).unwrap()).collect();
    let request = QueryRequest { op: STATS, obs_dim: 2, ..QueryRequest::default() };
    for _ in 0..50 {
        for client in &clients {
            // No time to wait: the answer finds nobody.
            let _ = client.ask(&request, &[], &mut Vec::new(), Duration::ZERO);
        }
    }
    let rows = evaluations(&dir);
    run.wait_for("the run to go on", || evaluations(&dir) > rows);
    survived(&place, run, "run", 0, &undisturbed);
}

#[test]
fn a_run_that_does_not_get_ahead_ends() {
    let place = Place::new();
    let endless = ["maze-small", "--env-steps", "1000000000", "--episodes", "1000000000"];
    let mut run = start(&place.training("run", &[&endless[..], &["--set", "supervise.restarts=2"]].concat()));
    let dir = place.run("run");
    for _ in 0..2 {
        replace(&mut run, &dir, "actor-0");
    }
    let shared = domain(&dir);
    send(process(dir.root(), "actor-0").unwrap(), Signal::SIGKILL);
    let words = ["actor-0 ended with signal: 9", "started again 2 times without getting ahead", "its log"];
    run.finish().code(1).refused(&words);
    assert!(wait_until(LIMIT, || !shared.root().exists()));
    assert!(!dir.result().exists(), "a run that failed has no result");
}
