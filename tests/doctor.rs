//! `trestle doctor`: what dead runs have left is found and removed; what living ones need is not.

use crate::util::{Place, available, evaluations, start, start_under, trestle};
use nix::sys::signal::Signal;
use std::fs;
use trestle_link::iceoryx::Domain;

/// What a run leaves whose processes were all killed at once.
fn leftovers(run: u64) -> Domain {
    let domain = Domain::of(run);
    fs::create_dir_all(domain.root().join("nodes")).unwrap();
    fs::write(format!("/dev/shm/{}left-behind", domain.prefix()), [0; 4096]).unwrap();
    domain
}

#[test]
fn leftovers_are_reported_and_removed_and_living_runs_are_left_alone() {
    let place = Place::alone();
    let endless = ["maze-small", "--env-steps", "1000000000", "--episodes", "1000000000"];
    let mut run = start(&place.training("run", &endless));
    let dir = place.run("run");
    run.wait_for("an evaluation", || evaluations(&dir) > 0);
    let living = crate::util::domain(&dir);
    let needed = living.shared_memory().unwrap();
    assert!(!needed.is_empty());

    let dead = leftovers(0xdead_0000 + u64::from(std::process::id() & 0xffff));
    let name = format!("{:08x}", dead.run());
    let line = |text: &str| text.lines().find(|l| l.contains(&name)).map(String::from);

    let found = trestle(&["doctor"]).refused(&["needs attention"]);
    let about = line(&found.stdout).unwrap();
    assert!(about.starts_with("BAD") && about.contains("1 files, 4 KiB"), "{found:?}");
    assert!(about.contains("doctor --fix"), "{found:?}");
    assert!(dead.root().exists() && dead.shared_memory().unwrap().len() == 1, "looking changes nothing");

    let fixed = trestle(&["doctor", "--fix"]);
    let about = line(&fixed.stdout).unwrap();
    assert!(about.starts_with("ok") && about.ends_with("removed"), "{fixed:?}");
    assert!(!dead.root().exists() && dead.shared_memory().unwrap().is_empty());

    let clean = trestle(&["doctor"]);
    assert_eq!(line(&clean.stdout), None);
    for (outcome, what) in [(&found, "found"), (&fixed, "fixed"), (&clean, "clean")] {
        assert!(!outcome.stdout.contains(&format!("{:08x}", living.run())), "{what}: {outcome:?}");
        assert!(!outcome.stdout.contains("runs in progress: 0"), "{what}: {outcome:?}");
    }

    assert_eq!(living.shared_memory().unwrap(), needed);
    let rows = evaluations(&dir);
    run.wait_for("the run to go on", || evaluations(&dir) > rows);
    run.signal(Signal::SIGINT);
    run.finish().code(130);
}

/// A run whose processes were all killed at the same moment leaves something, and `--fix` removes it.
#[test]
fn a_run_that_was_killed_as_a_whole() {
    let place = Place::alone();
    let endless = ["maze-small", "--env-steps", "1000000000", "--episodes", "1000000000"];
    let mut run = start(&place.training("run", &endless));
    let dir = place.run("run");
    run.wait_for("an evaluation", || evaluations(&dir) > 0);
    let domain = crate::util::domain(&dir);
    crate::util::kill_all(run, &dir);
    assert!(!domain.shared_memory().unwrap().is_empty() && domain.is_dead());
    let name = format!("{:08x}", domain.run());
    assert!(trestle(&["doctor"]).refused(&[]).stdout.contains(&name));
    assert!(trestle(&["doctor", "--fix"]).stdout.contains(&name));
    crate::util::assert_gone(&dir);
}

/// In another container that shares nothing with the run's but shared memory: other processes, another `/tmp`.
#[test]
fn a_living_run_is_alive_from_wherever_its_shared_memory_is_seen() {
    let place = Place::alone();
    let setup = "mount -t tmpfs tmpfs /tmp";
    let container = ["unshare", "--mount", "--pid", "--fork", "--mount-proc", "sh", "-c"];
    if !available(&[&container[..], &[setup]].concat()) {
        return;
    }
    let endless = ["maze-small", "--env-steps", "1000000000", "--episodes", "1000000000"];
    let mut run = start(&place.training("run", &endless));
    let dir = place.run("run");
    run.wait_for("an evaluation", || evaluations(&dir) > 0);
    let needed = crate::util::domain(&dir).shared_memory().unwrap();
    let script = format!("{setup} && exec \"$@\"");
    for args in [&["doctor"][..], &["doctor", "--fix"]] {
        let outcome = start_under(&[&container[..], &[&script, "sh"]].concat(), args).finish();
        // There may be runs of others on the machine.
        let runs = outcome.stdout.lines().find_map(|line| line.strip_prefix("ok    runs in progress: "));
        assert!(runs.unwrap().parse::<u32>().unwrap() >= 1, "{outcome:?}");
        let name = format!("{:08x}", dir.read_plan().unwrap().life.run);
        assert!(!outcome.stdout.contains(&name), "{outcome:?}");
    }
    assert_eq!(crate::util::domain(&dir).shared_memory().unwrap(), needed);
    let rows = evaluations(&dir);
    run.wait_for("the run to go on", || evaluations(&dir) > rows);
    run.signal(Signal::SIGINT);
    run.finish().code(130);
}

/// Files without a root and its lock: of a run of another version, perhaps.
#[test]
fn what_cannot_be_judged_is_left_alone_and_said_so() {
    let _place = Place::alone();
    let domain = Domain::of(0xdead_0000 + u64::from(std::process::id() & 0xffff));
    let file = format!("/dev/shm/{}of-another-version", domain.prefix());
    fs::write(&file, [0; 2048]).unwrap();
    for args in [&["doctor"][..], &["doctor", "--fix"]] {
        let outcome = trestle(args);
        let name = format!("{:08x}", domain.run());
        let line = outcome.stdout.lines().find(|line| line.contains(&name)).unwrap();
        assert!(line.starts_with("ok") && line.contains("left alone"), "{line}");
        assert!(line.contains("1 files, 2 KiB") && line.contains(&domain.prefix()), "{line}");
    }
    fs::remove_file(&file).unwrap();
}
