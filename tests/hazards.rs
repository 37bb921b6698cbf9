//! Environments that crash, stall or give NaN (`env.hazard`): what a run does about it, in both modes.
//!
//! Every process counts its own steps, so a run that takes checkpoints on the way gets past each strike, and one that
//! takes none never does.

use crate::util::{
    LIMIT, Outcome, Place, Process, Trace, assert_gone, counted, evaluations, newest_checkpoint, process,
    result, start, wait_until,
};
use std::fs;
use trestle_proto::rundir::RunDir;

/// Every kind that ends a process, and the words that say so.
const DEADLY: [(&str, &str, &str); 5] = [
    ("abort", "ended with signal: 6 (SIGABRT)", "env.hazard strikes kind=\"abort\" after=700"),
    ("panic", "ended with exit status: 101", ": env.hazard: the panic that was asked for, after 700 steps"),
    (
        "error",
        "ended with exit status: 1",
        "env.hazard: the error that was asked for, after 700 steps of the process",
    ),
    ("nan-reward", "ended with exit status: 1", "gave a reward = NaN"),
    ("nan-state", "ended with exit status: 1", "gave feature 1 of its state = NaN"),
];

/// Episodes so short that a process can take a checkpoint between two strikes, evaluations included.
const SHORT: [&str; 7] =
    ["maze-small", "--set", "env.step_limit=60", "--set", "learner.warmup=100", "--seed", "6"];

/// Checkpoints often enough to get past a strike every 700 steps.
const SAVING: [&str; 2] = ["--set", "checkpoint.every_env_steps=150"];

/// The settings of a hazard.
fn hazard(kind: &str, after: u32) -> [String; 4] {
    ["--set".into(), format!("env.hazard.kind={kind}"), "--set".into(), format!("env.hazard.after={after}")]
}

/// `parts` as one list of arguments.
fn args<'a>(parts: &[&[&'a str]], hazard: &'a [String]) -> Vec<&'a str> {
    parts.concat().into_iter().chain(hazard.iter().map(String::as_str)).collect()
}

/// What the supervisor has noted.
fn notes(dir: &RunDir) -> String {
    fs::read_to_string(dir.log("supervisor")).unwrap_or_default()
}

/// What actor `index` has logged.
fn log(dir: &RunDir, index: u32) -> String {
    fs::read_to_string(dir.log(&format!("actor-{index}"))).unwrap_or_default()
}

/// The run came to what an undisturbed one comes to, after at least so many restarts, each because of the actor.
fn survived(run: Process, dir: &RunDir, least: u64, how: &str, undisturbed: &Trace) {
    run.finish().ok();
    assert_gone(dir);
    let (restarts, notes) = (result(dir).restarts, notes(dir));
    assert!(restarts >= least, "{restarts} restarts: {notes}");
    let how = format!(" actor-0 {how}");
    let again = |line: &&str| line.contains(&how) && line.contains("; starting all processes again from");
    let deaths = notes.lines().filter(again).count();
    assert_eq!(deaths as u64, restarts, "{notes}");
    assert_eq!(Trace::of(dir), *undisturbed, "{notes}");
}

#[test]
fn lockstep_gets_past_every_kind_and_ends_as_if_nothing_had_happened() {
    let place = Place::new();
    let length = ["--env-steps", "1600"];
    let undisturbed = place.train("undisturbed", &[&SHORT[..], &SAVING, &length].concat());
    let runs = DEADLY.map(|(kind, ..)| {
        let hazard = hazard(kind, 700);
        start(&place.training(kind, &args(&[&SHORT, &SAVING, &length], &hazard)))
    });
    for ((kind, how, words), run) in DEADLY.into_iter().zip(runs) {
        let dir = place.run(kind);
        // The steps of training alone are two strikes.
        survived(run, &dir, 2, how, &undisturbed);
        assert!(log(&dir, 0).matches(words).count() >= 2, "{kind}: {}", log(&dir, 0));
    }
}

/// The same with two actors that fail in the same tick, and with weights of one tick earlier.
#[test]
fn lockstep_gets_past_actors_that_fail_together() {
    let place = Place::new();
    let length = ["--env-steps", "2000", "--actors", "2", "--set", "run.lag=1"];
    let undisturbed = place.train("undisturbed", &[&SHORT[..], &SAVING, &length].concat());
    let hazard = hazard("abort", 700);
    start(&place.training("run", &args(&[&SHORT, &SAVING, &length], &hazard))).finish().ok();
    let dir = place.run("run");
    assert_gone(&dir);
    assert!(result(&dir).restarts >= 1, "{}", notes(&dir));
    assert_eq!(Trace::of(&dir), undisturbed);
}

/// What comes again, in the same words, after the restart would come for ever; a crash without words is tried as often as
/// the run's owner likes.
#[test]
fn lockstep_ends_with_the_reason_where_it_cannot_get_past() {
    let place = Place::new();
    let never =
        ["--env-steps", "5000", "--set", "checkpoint.every_env_steps=0", "--set", "supervise.restarts=2"];
    let runs = DEADLY.map(|(kind, ..)| {
        let hazard = hazard(kind, 700);
        start(&place.training(kind, &args(&[&SHORT, &never], &hazard)))
    });
    for ((kind, how, words), run) in DEADLY.into_iter().zip(runs) {
        let dir = place.run(kind);
        let (reason, starts) = match kind {
            "abort" => ("the run has been started again 2 times without getting ahead", 3),
            _ => ("it failed in the same way when it was started again", 2),
        };
        let reason = format!("; not started again: {reason}");
        run.finish().code(1).refused(&[&format!("actor-0 {how}"), &reason, words]);
        assert_ended(&dir);
        assert_eq!(log(&dir, 0).matches(words).count(), starts, "{}", log(&dir, 0));
    }
}

/// The run has failed: nothing of it is left in shared memory, and it has no result.
fn assert_ended(dir: &RunDir) {
    assert!(wait_until(LIMIT, || process(dir.root(), "actor-0").is_none()));
    assert_gone(dir);
    assert!(!dir.result().exists(), "a run that failed has no result");
}

/// The process of actor 0, once its environment has stalled.
fn stalled(run: &mut Process, dir: &RunDir) -> u32 {
    run.wait_for("the stall", || log(dir, 0).contains("env.hazard strikes kind=\"stall\""));
    process(dir.root(), "actor-0").unwrap()
}

/// The time on a processor that all threads of `pid` have had, in clock ticks (proc(5), `stat`, fields 14 and 15).
fn processor_time(pid: u32) -> Option<u64> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let fields: Vec<u64> = stat
        .rsplit_once(')')?
        .1
        .split_whitespace()
        .skip(11)
        .take(2)
        .map(|field| field.parse().unwrap())
        .collect();
    Some(fields.iter().sum())
}

/// A stalled process lives and sleeps, and is noticed all the same.
#[test]
fn a_stall_is_noticed_in_lockstep() {
    let place = Place::new();
    let length = ["--env-steps", "900", "--set", "supervise.stall_s=3"];
    let undisturbed = place.train("undisturbed", &[&SHORT[..], &SAVING, &length].concat());
    let hazard = hazard("stall", 700);
    let mut run = start(&place.training("run", &args(&[&SHORT, &SAVING, &length], &hazard)));
    let dir = place.run("run");
    let pid = stalled(&mut run, &dir);
    let before = processor_time(pid).unwrap();
    let mut last = before;
    run.wait_for("the end of the stalled process", || {
        let now = processor_time(pid);
        last = now.unwrap_or(last);
        now.is_none()
    });
    // The supervisor looks three times, a second apart; a thread that spins has some 300 ticks by then.
    assert!(last - before < 30, "{} ticks of processor time", last - before);
    survived(run, &dir, 1, "did not get ahead for 3 s (supervise.stall_s)", &undisturbed);
}

/// An evaluation that fails takes the run down as training does, and back to the checkpoint.
#[test]
fn evaluations_fail_as_training_does_in_lockstep() {
    let place = Place::new();
    let length = ["--env-steps", "1600", "--set", "eval.every=2", "--set", "env.hazard.during=evaluation"];
    let undisturbed = place.train("undisturbed", &[&SHORT[..], &SAVING, &length].concat());
    let kinds = ["error", "nan-reward", "nan-state"];
    // An evaluation is of up to 60 steps: a process gets through a few, or through none.
    let starts = |after: u32, how: &[&'static str]| {
        kinds.map(|kind| {
            let (name, hazard) = (format!("{kind}-{after}"), hazard(kind, after));
            let run = start(&place.training(&name, &args(&[&SHORT, how, &length], &hazard)));
            (kind, place.run(&name), run)
        })
    };
    for (kind, dir, run) in starts(300, &SAVING) {
        survived(run, &dir, 2, "ended with exit status: 1", &undisturbed);
        assert!(kind == "error" || log(&dir, 0).contains(" = NaN in evaluation "), "{}", log(&dir, 0));
    }
    for (kind, dir, run) in starts(5, &[]) {
        let words = match kind {
            "error" => "env.hazard: the error that was asked for, after 5 steps of the process",
            "nan-reward" => "the environment of actor 0 gave a reward = NaN in evaluation 0",
            _ => "the environment of actor 0 gave feature 1 of its state = NaN in evaluation 0",
        };
        run.finish().code(1).refused(&["it failed in the same way when it was started again", words]);
        assert_ended(&dir);
    }
}

/// Free mode: more steps than two actors take that fail after 700.
const FREE: [&str; 8] =
    ["--mode", "free", "--actors", "2", "--env-steps", "1700", "--set", "checkpoint.every_env_steps=300"];

/// In the run only actors have been replaced, and every step has been counted once.
fn replaced(outcome: &Outcome, dir: &RunDir, how: &str) {
    assert_gone(dir);
    let (result, notes) = (result(dir), notes(dir));
    let replaces = |line: &&str| line.contains(how) && line.ends_with("; replacing it");
    let deaths = notes.lines().filter(replaces).count();
    assert!(deaths > 0 && deaths == notes.lines().count(), "{notes}");
    assert!(notes.lines().all(|line| line.contains(" actor-")), "{notes}");
    assert_eq!(outcome.stderr.matches("; replacing it").count(), deaths, "{outcome:?}");
    for role in ["learner", "mentor-server"] {
        let log = fs::read_to_string(dir.log(role)).unwrap();
        assert!(!log.contains("ERROR") && !log.contains("error: "), "{role}: {log}");
    }
    let counted = counted(dir);
    assert!(
        counted.iter().all(|row| row.incarnation >> 16 == 0),
        "the learner is the first one: {counted:?}"
    );
    // One that died at the very end need not have been replaced.
    let incarnations = counted.iter().filter(|row| row.incarnation > 0).count();
    assert!(incarnations <= deaths, "{incarnations} incarnations: {notes}");
    assert_eq!(counted.iter().map(|row| row.env_steps).sum::<u64>(), result.env_steps);
}

#[test]
fn free_mode_replaces_the_actor_whatever_its_environment_does() {
    let place = Place::new();
    let mut runs = Vec::new();
    for (kind, how, words) in DEADLY {
        let hazard = hazard(kind, 700);
        let run = start(&place.training(kind, &args(&[&SHORT, &FREE], &hazard)));
        runs.push((place.run(kind), run, how, words));
    }
    for (dir, run, how, words) in runs {
        let outcome = run.finish().ok();
        replaced(&outcome, &dir, how);
        assert!(log(&dir, 0).contains(words) || log(&dir, 1).contains(words), "{words}");
        assert_eq!(result(&dir).env_steps, 1700);
    }
}

#[test]
fn free_mode_ends_with_the_reason_where_an_actor_does_not_get_ahead() {
    let place = Place::new();
    let never = ["--mode", "free", "--env-steps", "9000", "--set", "checkpoint.every_env_steps=0"];
    let most = ["--set", "supervise.restarts=1"];
    let runs = DEADLY.map(|(kind, ..)| {
        let hazard = hazard(kind, 700);
        start(&place.training(kind, &args(&[&SHORT, &never, &most], &hazard)))
    });
    for ((kind, how, words), run) in DEADLY.into_iter().zip(runs) {
        let reason = "; not started again: it has been started again 1 times without getting ahead";
        run.finish().code(1).refused(&[&format!("actor-0 {how}"), reason, words]);
        assert_ended(&place.run(kind));
    }
}

#[test]
fn a_stall_is_noticed_in_free_mode() {
    let place = Place::new();
    let hazard = hazard("stall", 700);
    let run =
        start(&place.training("run", &args(&[&SHORT, &FREE, &["--set", "supervise.stall_s=3"]], &hazard)));
    let dir = place.run("run");
    let outcome = run.finish().ok();
    replaced(&outcome, &dir, "did not get ahead for 3 s (supervise.stall_s)");
    assert_eq!(result(&dir).env_steps, 1700);
}

/// The actor that fails in an evaluation is replaced, and the evaluation is played by the next one.
#[test]
fn evaluations_fail_as_training_does_in_free_mode() {
    let place = Place::new();
    let more = ["--set", "env.hazard.during=evaluation", "--set", "eval.every=2"];
    let kinds =
        [("error", "exit status: 1"), ("nan-reward", "exit status: 1"), ("abort", "signal: 6 (SIGABRT)")];
    let runs = kinds.map(|(kind, _)| {
        // An evaluation is of up to 60 steps: a process gets through one.
        let hazard = hazard(kind, 70);
        start(&place.training(kind, &args(&[&SHORT, &FREE, &more], &hazard)))
    });
    for ((kind, how), run) in kinds.into_iter().zip(runs) {
        let (dir, outcome) = (place.run(kind), run.finish().ok());
        replaced(&outcome, &dir, &format!("actor-0 ended with {how}"));
        assert!(evaluations(&dir) >= 2, "{}", notes(&dir));
    }
}

/// `trestle eval` looks at a run from outside: its environment is sound.
#[test]
fn a_run_is_looked_at_without_its_hazard() {
    let place = Place::new();
    let (length, hazard) = (["--env-steps", "400"], hazard("stall", 5000));
    place.train("run", &args(&[&SHORT, &length], &hazard));
    let dir = place.path("run");
    let outcome = crate::util::trestle(&["eval", &dir, "--episodes", "200"]).ok();
    assert!(outcome.stdout.contains("episodes      200"), "{outcome:?}");
    assert!(newest_checkpoint(&place.run("run")).is_some());
}

/// What a configuration says of it, and what `--resume` makes of that.
#[test]
fn a_hazard_is_a_setting_like_any_other() {
    let place = Place::new();
    let length = ["--env-steps", "640"];
    let hazard = hazard("error", 100_000);
    place.train("none", &[&SHORT[..], &length].concat());
    place.train("some", &args(&[&SHORT, &length], &hazard));
    let config = |name: &str| fs::read_to_string(place.run(name).config()).unwrap();
    let table =
        |kind, after| format!("[env.hazard]\nkind = \"{kind}\"\nafter = {after}\nduring = \"both\"\n");
    assert!(config("some").contains(&table("error", 100_000)), "{}", config("some"));
    assert!(config("none").contains(&table("none", 0)), "{}", config("none"));
    let longer = ["--env-steps", "1280", "--resume"];
    let other = place.training("some", &[&SHORT[..], &longer].concat());
    // It is no part of what is learnt: a run that one has ended goes on without it.
    start(&other).finish().ok();
    assert!(config("some").contains(&table("none", 0)), "{}", config("some"));
    start(&place.training("none", &[&SHORT[..], &longer].concat())).finish().ok();
    assert_eq!(Trace::of(&place.run("some")), Trace::of(&place.run("none")));
}
