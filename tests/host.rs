//! Hosts on which no run can start: shared memory that is missing, too small, or cannot be written to. Each test has
//! its own `/dev/shm` in a mount namespace, which takes the right to make one.

use crate::util::{
    Outcome, Place, TRESTLE, Trace, assert_gone, available, newest_checkpoint, processes, start_under, tree,
};
use std::collections::BTreeMap;
use std::fs::{self, Permissions};
use std::os::unix::fs::{MetadataExt, PermissionsExt};

const ARGS: [&str; 5] = ["maze-small", "--env-steps", "3000", "--seed", "4"];

/// Trains in `run`, after `setup` in a namespace of its own; none where that is not allowed.
fn trained_after(place: &Place, setup: &str, more: &[&str]) -> Option<Outcome> {
    if !available(&["unshare", "--mount", "sh", "-c", setup]) {
        return None;
    }
    let script = format!("{setup} && exec \"$@\"");
    let args = place.training("run", &[&ARGS[..], more].concat());
    Some(start_under(&["unshare", "--mount", "sh", "-c", &script, "sh"], &args).finish())
}

fn refused(setup: &str, words: &[&str]) {
    let place = Place::new();
    if let Some(outcome) = trained_after(&place, setup, &[]) {
        outcome.refused(words);
        assert!(tree(place.root()).is_empty(), "nothing is left behind");
    }
}

#[test]
fn no_shared_memory() {
    refused("mount -t tmpfs tmpfs /dev", &["/dev/shm", "MiB of shared memory"]);
}

#[test]
fn too_little_shared_memory() {
    refused("mount -t tmpfs -o size=1m tmpfs /dev/shm", &["/dev/shm", "1 MiB free", "needs", "run.actors"]);
}

#[test]
fn read_only_shared_memory() {
    refused("mount -t tmpfs -o ro tmpfs /dev/shm", &["/dev/shm", "cannot be written"]);
}

/// Somebody else has laid links and directories under names that could be guessed: the run does not care, and what the
/// links lead to is as it was. Every file of the run in shared memory has a name that nobody can guess.
#[test]
fn nobody_elses_link_is_followed() {
    let place = Place::new();
    let victim = place.write("thesis", "of years");
    fs::set_permissions(&victim, Permissions::from_mode(0o600)).unwrap();
    let names = "trestle-probe-$$ trestle-model-$$-0.xml trestle_$$ trestle-$$ .trestle-probe-$$";
    for lay in [format!("ln -s {victim}"), "mkdir".into()] {
        let setup = format!(
            "mount -t tmpfs -o mode=1777 tmpfs /dev/shm && mount -t tmpfs -o mode=1777 tmpfs {root}/tmp && \
             for dir in /dev/shm {root}/tmp; do for name in {names}; do \
             setpriv --reuid 4242 --regid 4242 --clear-groups {lay} $dir/$name || exit 1; done; done; \
             export TMPDIR={root}/tmp",
            root = place.root().display()
        );
        fs::create_dir_all(place.path("tmp")).unwrap();
        let Some(outcome) = trained_after(&place, &setup, &["--overwrite"]) else { return };
        outcome.ok();
        assert_eq!(fs::read_to_string(&victim).unwrap(), "of years");
    }
    let identity = |name: &str| {
        place.train(name, &ARGS);
        place.run(name).read_plan().unwrap().run
    };
    let [first, second] = ["first", "second"].map(identity);
    assert!(first != second && first.max(second) >> 32 > 0, "{first:x} {second:x}");
}

/// Whatever the shell's mask says, nobody but the user may look into a run's directory or write anything in it, and the
/// user can let others in by the directory's mode alone.
#[test]
fn modes_do_not_depend_on_the_mask() {
    let place = Place::new();
    let modes = |mask: &str| -> BTreeMap<String, u32> {
        let under = ["sh", "-c", &format!("umask {mask} && exec \"$@\""), "sh"];
        let name = format!("of-{mask}/run");
        let sets = ["--set", "checkpoint.every_env_steps=1000", "--set", "mentor.demo.a=plan"];
        start_under(&under, &place.training(&name, &[&ARGS[..], &sets].concat())).finish().ok();
        let root = place.root().join(format!("of-{mask}"));
        let paths = tree(&root).into_keys().filter(|path| !path.is_symlink());
        paths
            .map(|path| {
                let mode = fs::metadata(&path).unwrap().mode() & 0o7777;
                let name = path.strip_prefix(&root).unwrap().to_str().unwrap();
                // The name of TensorBoard's file has the time in it.
                (if name.contains("tfevents") { "events".into() } else { name.to_string() }, mode)
            })
            .collect()
    };
    let found = modes("000");
    assert_eq!(found, modes("077"));
    assert!(found.len() > 20, "{found:?}");
    for (name, mode) in &found {
        let dir = place.root().join("of-000").join(name).is_dir();
        let expected = if name == "run" { 0o700 } else if dir { 0o755 } else { 0o644 };
        assert_eq!(*mode, expected, "{name} is of mode {mode:o}");
    }
    // A directory of the user's own making stays as it is.
    fs::create_dir(place.path("open")).unwrap();
    fs::set_permissions(place.path("open"), Permissions::from_mode(0o750)).unwrap();
    place.train("open", &ARGS);
    assert_eq!(fs::metadata(place.path("open")).unwrap().mode() & 0o7777, 0o750);
}

/// What a run says it needs is enough, and a start that is refused puts a replaced run back.
#[test]
fn as_much_shared_memory_as_is_asked_for() {
    let place = Place::new();
    let little = "mount -t tmpfs -o size=1m tmpfs /dev/shm";
    let first = place.train("run", &ARGS);
    let before = tree(place.root());
    let more = ["--actors", "3", "--overwrite"];
    let Some(outcome) = trained_after(&place, little, &more) else { return };
    let outcome = outcome.refused(&["needs"]);
    assert!(tree(place.root()) == before);
    assert_eq!(Trace::of(&place.run("run")), first);
    let needs = outcome.stderr.split("needs ").nth(1).unwrap().split(' ').next().unwrap();
    let enough = format!("mount -t tmpfs -o size={needs}m tmpfs /dev/shm");
    trained_after(&place, &enough, &more).unwrap().ok();
    let dir = place.run("run");
    assert_gone(&dir);
    let undisturbed = place.train("again", &[&ARGS[..], &["--actors", "3"]].concat());
    assert_eq!(Trace::of(&dir), undisturbed);
}

/// Somebody fills shared memory, and then the learner dies: the run ends with the reason, and can go on later. All processes
/// are stopped meanwhile, so that none of the others dies first, for want of a page.
#[test]
fn no_room_for_a_restart() {
    let place = Place::new();
    let setup = "mount -t tmpfs -o size=32m tmpfs /dev/shm";
    if !available(&["unshare", "--mount", "sh", "-c", setup]) {
        return;
    }
    let dir = place.run("run");
    let root = dir.root().display();
    let script = format!(
        "{setup} && \"$@\" & run=$!; until [ -e {root}/last ]; do sleep 0.01; done; \
         all=$(pgrep -f '[-]-run {root}'); kill -STOP $all; head -c 40000000 /dev/zero > /dev/shm/full; \
         kill -9 $(pgrep -f 'learner [-]-run {root}'); kill -CONT $all; wait $run"
    );
    let more = ["--set", "checkpoint.every_env_steps=1000"];
    let args = place.training("run", &[&["maze-small", "--episodes", "1000000000"], &more[..]].concat());
    let outcome = start_under(&["unshare", "--mount", "sh", "-c", &script, "sh"], &args).finish();
    outcome.refused(&["learner ended with signal", "not started again: /dev/shm has 0 MiB free"]);
    assert!(newest_checkpoint(&dir).is_some());
    assert!(processes(dir.root()).is_empty());
}

/// A start that fails when the directory has been made already: too few open files for the run's services.
#[test]
fn a_failed_start_restores_what_was_there() {
    let place = Place::new();
    let few = ["sh", "-c", "ulimit -n 24 && exec \"$@\"", "sh"];
    let failed = |name: &str, more: &[&str]| {
        let before = tree(place.root());
        let args = place.training(name, &[&ARGS[..], more].concat());
        start_under(&few, &args).finish().refused(&["cannot", "open files"]);
        assert!(tree(place.root()) == before, "{name}");
    };
    failed("new", &[]);
    failed("new", &["--mode", "lockstep", "--actors", "3"]);
    fs::create_dir(place.root().join("empty")).unwrap();
    failed("empty", &[]);
    let first = place.train("run", &ARGS);
    failed("run", &["--overwrite"]);
    assert_eq!(Trace::of(&place.run("run")), first);
}

/// The disk is full in the middle of a run: it ends with the file's name, and what was saved before is sound.
#[test]
fn a_full_disk_ends_a_run_and_spares_its_checkpoints() {
    let place = Place::new();
    let root = place.root().display();
    let setup = format!("mount -t tmpfs -o size=3m tmpfs {root}");
    if !available(&["unshare", "--mount", "sh", "-c", &setup]) {
        return;
    }
    // Checkpoints beyond what is kept need room: the first ones fit, and then no more.
    let sets = ["--set", "checkpoint.every_env_steps=2000", "--set", "checkpoint.keep=1000"];
    let args = place.training("run", &[&["maze-small", "--env-steps", "1000000"], &sets[..]].concat());
    let eval = format!("{} eval {root}/run", TRESTLE);
    let script = format!("{setup}; \"$@\"; code=$?; {eval} && exit $code");
    let outcome = start_under(&["unshare", "--mount", "sh", "-c", &script, "sh"], &args).finish();
    assert!(outcome.stdout.contains("mean return"), "{outcome:?}");
    let outcome = outcome.refused(&["learner", "cannot write", "No space left on device"]);
    let last = outcome.stderr.lines().last().unwrap();
    assert_eq!(last.matches("No space left").count(), 1, "said once: {last}");
}

/// A run needs nothing of `/tmp`.
#[test]
fn tmp_may_be_read_only() {
    let place = Place::new();
    let root = place.root().display();
    let setup = format!(
        "mount --bind /tmp /tmp && mkdir -p {root} && mount --bind {root} {root} && mount -o remount,bind,ro /tmp \
         && ! touch /tmp/trestle-test 2>/dev/null"
    );
    if let Some(outcome) = trained_after(&place, &setup, &[]) {
        outcome.ok();
        assert_eq!(Trace::of(&place.run("run")).result.env_steps, 3000);
    }
}
