//! Hosts on which no run can start: shared memory that is missing, too small, or cannot be written to. Each test has
//! its own `/dev/shm` in a mount namespace, which takes the right to make one.

use crate::util::{
    Outcome, Place, TRESTLE, Trace, assert_gone, available, newest_checkpoint, processes, result,
    start_command, start_under, tree,
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
        place.run(name).read_plan().unwrap().life.run
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
        let expected = if name == "run" {
            0o700
        } else if dir {
            0o755
        } else {
            0o644
        };
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

/// A start that fails when the directory has been made already: the run's processes cannot be started.
#[test]
fn a_failed_start_restores_what_was_there() {
    let place = Place::new();
    let no_program = "mount -t tmpfs tmpfs /proc";
    if !available(&["unshare", "--mount", "sh", "-c", no_program]) {
        return;
    }
    let under = ["unshare", "--mount", "sh", "-c", &format!("{no_program} && exec \"$@\""), "sh"];
    let failed = |name: &str, more: &[&str]| {
        let before = tree(place.root());
        let args = place.training(name, &[&ARGS[..], more].concat());
        start_under(&under, &args).finish().refused(&["cannot start learner"]);
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

/// Each limit of the machine is named with its value and the need before anything is written, once and at once.
#[test]
fn limits_are_named() {
    let place = Place::new();
    let limited = |setup: &str, args: &[&str], words: &[&str]| {
        let under = ["sh", "-c", &format!("{setup} && exec \"$@\""), "sh"];
        let args = place.training("run", &[&ARGS[..], args].concat());
        let outcome = start_under(&under, &args).finish().refused(words);
        assert_eq!(outcome.stderr.lines().count(), 1, "{setup}: {outcome:?}");
        assert!(tree(place.root()).is_empty(), "{setup}: nothing is left behind");
    };
    for (files, actors, needs) in [("8", "1", "122"), ("64", "1", "122"), ("200", "32", "432")] {
        let setup = format!("ulimit -n {files}");
        let words = ["open files", files, needs, "ulimit -n"];
        limited(&setup, &["--actors", actors], &words);
    }
    limited("ulimit -n 8", &["--watch"], &["open files", "8", "64", "ulimit -n"]);
    let page = ["sh", "-c", "ulimit -n 8 && exec \"$@\"", "sh"];
    start_under(&page, &["watch", "--port", "0", &place.path("runs")])
        .finish()
        .refused(&["open files", "ulimit -n"]);
    limited("ulimit -f 40", &[], &["cannot write", "File too large (ulimit -f)", "KiB", "needs"]);
    for stack in ["64", "200", "512"] {
        limited(&format!("ulimit -s {stack}"), &[], &["stack", stack, "needs 1024", "ulimit -s"]);
    }
    limited("ulimit -v 100000", &[], &["address space: 100000 KiB allowed", "needs", "ulimit -v"]);
    limited("ulimit -d 20000", &[], &["private memory: 20000 KiB allowed", "needs", "ulimit -d"]);
    let large = ["--set", "learner.replay=10000000"];
    limited("ulimit -v 400000", &large, &["address space: 400000 KiB allowed", "learner.replay"]);
    limited("ulimit -t 2", &[], &["CPU time of a process: 2 s allowed", "needs 3", "ulimit -t"]);
    // A limit that may be raised is raised: no reason to refuse anything.
    let soft = ["sh", "-c", "ulimit -S -n 64 && ulimit -S -s 200 && exec \"$@\"", "sh"];
    start_under(&soft, &place.training("raised", &ARGS)).finish().ok();
    assert_gone(&place.run("raised"));
}

/// A process is killed at the hard limit of its CPU time, so the run saves and leaves before.
#[test]
fn a_run_saves_before_its_cpu_time_is_over() {
    let place = Place::new();
    let under = ["sh", "-c", "ulimit -t 4 && exec \"$@\"", "sh"];
    let args = ["maze-small", "--env-steps", "1000000000", "--set", "checkpoint.every_env_steps=0"];
    let ended = start_under(&under, &place.training("run", &args)).finish();
    assert!(ended.stderr.contains("note: a process may use 2 s of CPU time"), "{ended:?}");
    ended.code(130);
    assert!(place.run("run").last().exists());
}

/// Shared memory may have room for bytes and none for files.
#[test]
fn too_few_inodes() {
    refused(
        "mount -t tmpfs -o nr_inodes=20 tmpfs /dev/shm",
        &["/dev/shm", "inodes", "needs 200", "nr_inodes"],
    );
}

/// Processes are counted by user, and root's are not.
#[test]
fn too_few_processes() {
    let place = Place::new();
    let (program, out) = (place.path("trestle"), place.path("home/run"));
    fs::copy(TRESTLE, &program).unwrap();
    fs::create_dir(place.path("home")).unwrap();
    for (name, mode) in [("", 0o755), ("home", 0o777), ("trestle", 0o755)] {
        fs::set_permissions(place.root().join(name), Permissions::from_mode(mode)).unwrap();
    }
    let id = (30_000 + std::process::id() % 10_000).to_string();
    let user = ["setpriv", "--reuid", &id, "--regid", &id, "--clear-groups"];
    if !available(&[&user[..], &["prlimit", "--nproc=8", "true"]].concat()) {
        return;
    }
    let limited = ["prlimit", "--nproc=8", &program, "train", "--quiet", "--out", &out];
    let outcome = start_command(&[&user[..], &limited].concat(), &ARGS).finish();
    outcome.refused(&["processes and threads", "more allowed", "needs 14", "ulimit -u"]);
}

/// File systems that have no symbolic links, or cannot sync: the run goes on, says what it promises less, and can be gone on
/// with.
#[test]
fn file_systems_that_can_do_less() {
    let place = Place::new();
    if !available(&["cc", "--version"]) {
        return;
    }
    let source = place.write(
        "lesser.c",
        "#include <errno.h>\n#include <stdio.h>\n#include <string.h>\n#include <unistd.h>\n\
         int symlink(const char *a, const char *b) { errno = EPERM; return -1; }\n\
         static int sync_of(int f) { char l[64], p[4096]; snprintf(l, 64, \"/proc/self/fd/%d\", f); \
         ssize_t n = readlink(l, p, 4095); p[n > 0 ? n : 0] = 0; \
         if (strstr(p, \"/trestle-test-\") == NULL) return 0; errno = EINVAL; return -1; }\n\
         int fsync(int f) { return sync_of(f); }\nint fdatasync(int f) { return sync_of(f); }\n",
    );
    let library = place.path("lesser.so");
    assert!(available(&["cc", "-shared", "-fPIC", "-o", &library, &source]));
    let preload = format!("LD_PRELOAD={library}");
    let sets = ["--set", "checkpoint.every_env_steps=1000"];
    let trained = |more: &[&str]| {
        let args = place.training("run", &[&["maze-small", "--seed", "4"], &sets[..], more].concat());
        start_under(&["env", &preload], &args).finish().ok()
    };
    let said = trained(&["--env-steps", "3000"]).stderr;
    assert_eq!(said.matches("has no symbolic links").count(), 1, "{said}");
    assert_eq!(said.matches("cannot be synced").count(), 1, "{said}");
    let dir = place.run("run");
    assert_eq!(result(&dir).restarts, 0);
    let last = fs::read_to_string(dir.last()).unwrap();
    assert_eq!(trestle_learner::checkpoint::last(dir.root()), newest_checkpoint(&dir));
    assert!(dir.root().join(last.trim_end()).join("COMPLETE").is_file());
    trained(&["--env-steps", "6000", "--resume"]);
    let undisturbed = place.train("whole", &["maze-small", "--seed", "4", "--env-steps", "6000"]);
    assert_eq!(Trace::of(&dir).weights_sha256, undisturbed.weights_sha256);
    // On a file system that can, the file becomes a link again.
    place.train(
        "run",
        &[&["maze-small", "--seed", "4", "--env-steps", "8000", "--resume"], &sets[..]].concat(),
    );
    assert!(dir.last().is_symlink());
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
    // The log that it is from may have met the full disk as well, in the middle of the line.
    assert!(last.contains("cannot write") && last.matches("No space left").count() <= 1, "said once: {last}");
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
    let Some(outcome) = trained_after(&place, &setup, &[]) else { return };
    outcome.ok();
    assert_eq!(Trace::of(&place.run("run")).result.env_steps, 3000);
    // Nor does a sweep, unless it has maps of a suite to make.
    let under = ["unshare", "--mount", "sh", "-c", &format!("{setup} && exec \"$@\""), "sh"];
    let out = place.path("sweep");
    let sweep = |what: &[&str]| {
        let args =
            ["sweep", "--algos", "dqn", "--seeds", "0..1", "--episodes", "2", "--quiet", "--out", &out];
        start_under(&under, &[&args[..], what].concat()).finish()
    };
    sweep(&["maze-small"]).ok();
    sweep(&["suite", "--task-set", "choosing"]).refused(&["cannot make a directory in /tmp", "TMPDIR"]);
}
