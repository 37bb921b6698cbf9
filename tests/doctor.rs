//! `trestle doctor`: what dead runs have left is found and removed; what living ones need is not.

use crate::util::{Place, evaluations, start, trestle};
use nix::sys::signal::Signal;
use std::fs;
use trestle_link::iceoryx::Domain;

/// A process id that no process has: the largest that Linux gives out is 2^22 - 1.
const NOBODY: u32 = 1 << 22;

/// What a run leaves whose processes were all killed at once.
fn leftovers(run: u64) -> Domain {
    let domain = Domain::create(run).unwrap();
    fs::write(domain.root().join("owner"), format!("{NOBODY} 1\n")).unwrap();
    fs::create_dir(domain.root().join("nodes")).unwrap();
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
    assert!(!domain.shared_memory().unwrap().is_empty() && !domain.is_alive());
    let name = format!("{:08x}", domain.run());
    assert!(trestle(&["doctor"]).refused(&[]).stdout.contains(&name));
    assert!(trestle(&["doctor", "--fix"]).stdout.contains(&name));
    crate::util::assert_gone(&dir);
}
