//! Sweeps for schedulers: what is handed over, and what its tasks do, with stand-ins for the schedulers' own programs.
//! `tests/slurm/run.sh` does the same with a real SLURM.

use crate::util::{
    LIMIT, Outcome, Place, Process, Trace, start, start_command, start_under, trestle, wait_until,
};
use nix::sys::signal::Signal;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

/// Where programs are found beside the stand-ins.
const SYSTEM: &str = "/usr/bin:/bin";
/// Runs that take a moment.
const SHORT: [&str; 3] = ["maze-small", "--env-steps", "1500"];

/// The directory of stand-ins: `sbatch` keeps what it gets, `scontrol` what it is told.
fn stand_ins(place: &Place) -> String {
    let bin = place.path("bin");
    fs::create_dir(&bin).unwrap();
    for (name, does) in [
        ("sbatch", format!("cat > {}; echo 17", place.path("script"))),
        ("scontrol", format!("echo \"$@\" >> {}", place.path("told"))),
        ("kubectl", format!("cat > {}", place.path("manifest"))),
    ] {
        let path = place.write(&format!("bin/{name}"), format!("#!/bin/sh\n{does}\n"));
        fs::set_permissions(path, fs::Permissions::from_mode(0o755)).unwrap();
    }
    bin
}

fn submit(bin: &str, args: &[&str]) -> Outcome {
    start_under(&["/usr/bin/env", &format!("PATH={bin}:{SYSTEM}")], &[&["sweep"], args].concat()).finish()
}

/// The script of `place` as SLURM starts it for task `task`.
fn task(place: &Place, bin: &str, task: usize) -> Process {
    let [path, task] = [format!("PATH={bin}:{SYSTEM}"), format!("SLURM_ARRAY_TASK_ID={task}")];
    start_command(&["/usr/bin/env", &path, &task, "SLURM_ARRAY_JOB_ID=17", "bash"], &[&place.path("script")])
}

#[test]
fn tasks_of_slurm_come_to_what_a_sweep_comes_to() {
    let place = Place::new();
    let bin = stand_ins(&place);
    let [here, there] = ["here", "there"].map(|name| place.path(name));
    let sweep = [&SHORT[..], &["--algos", "dqn,ha-diiqn", "--seeds", "0..2"]].concat();
    trestle(&[&["sweep"], &sweep[..], &["--out", &here, "--quiet"]].concat()).ok();
    let to_slurm =
        [&sweep[..], &["--submit", "slurm", "--slurm", "time=5,cpus=2", "--jobs", "2", "--out", &there]]
            .concat();
    let shown = submit(&bin, &[&to_slurm[..], &["--dry-run"]].concat()).ok();
    assert!(!Path::new(&there).exists() && !Path::new(&place.path("script")).exists(), "nothing is written");
    let submitted = submit(&bin, &to_slurm).ok();
    assert_eq!(submitted.stdout.trim(), "17");
    assert!(submitted.stderr.contains("scancel 17"), "{}", submitted.stderr);
    let script = fs::read_to_string(place.path("script")).unwrap();
    assert_eq!(script, shown.stdout);
    assert_eq!(script, fs::read_to_string(place.path("there/submit/slurm.sh")).unwrap());
    assert!(
        script.contains("#SBATCH --array=0-3%2\n") && script.contains("#SBATCH --cpus-per-task=2\n"),
        "{script}"
    );
    for number in [2, 0] {
        task(&place, &bin, number).finish().ok();
    }
    // What is complete is not submitted again.
    let again = ["--resume", "--out", &there, "--submit", "slurm"];
    submit(&bin, &again).ok();
    assert!(fs::read_to_string(place.path("script")).unwrap().contains("#SBATCH --array=1,3\n"));
    for number in [1, 3] {
        task(&place, &bin, number).finish().ok();
    }
    assert!(submit(&bin, &again).ok().stderr.contains("all 4 runs are complete"));
    for run in ["dqn/seed-0", "dqn/seed-1", "ha-diiqn/seed-0", "ha-diiqn/seed-1"] {
        assert_eq!(
            Trace::of(&place.run(&format!("there/{run}"))),
            Trace::of(&place.run(&format!("here/{run}"))),
            "{run}"
        );
    }
    assert!(!Path::new(&place.path("told")).exists(), "nothing was requeued");
}

#[test]
fn a_warned_task_saves_and_is_requeued() {
    let place = Place::new();
    let bin = stand_ins(&place);
    let out = place.path("s");
    let long =
        ["maze30", "--env-steps", "1000000", "--episodes", "1000000", "--algos", "dqn", "--seeds", "4"];
    submit(&bin, &[&long[..], &["--submit", "slurm", "--out", &out]].concat()).ok();
    let begun = || {
        let metrics = place.run("s/dqn/seed-4").metrics();
        assert!(
            wait_until(LIMIT, || fs::metadata(&metrics).is_ok_and(|found| found.len() > 0)),
            "no metrics"
        );
    };
    for (signal, status, told) in [(Signal::SIGUSR1, 0, "requeue 17_0\n"), (Signal::SIGTERM, 130, "")] {
        let running = task(&place, &bin, 0);
        begun();
        running.signal(signal);
        running.finish().code(status);
        assert!(place.run("s/dqn/seed-4").last().exists(), "nothing was saved");
        let heard = fs::read_to_string(place.path("told")).unwrap_or_default();
        assert_eq!(heard, told);
        _ = fs::remove_file(place.path("told"));
        fs::remove_file(place.run("s/dqn/seed-4").metrics()).unwrap();
    }
}

#[test]
fn what_cannot_be_submitted_is_refused_before_anything_is_written() {
    let place = Place::new();
    let out = place.path("s");
    let sweep = |more: &[&str]| {
        let own = ["maze-small", "--algos", "dqn", "--seeds", "0..2", "--out", &out];
        let outcome = start(&[&["sweep"], &own[..], more].concat()).finish();
        assert!(!Path::new(&out).exists(), "something was written");
        outcome
    };
    sweep(&["--submit", "pbs"]).code(2);
    sweep(&["--dry-run"]).code(2);
    sweep(&["--share", "0/2"]).code(2);
    sweep(&["--resume", "--share", "2/2"]).code(2);
    sweep(&["--submit", "slurm", "--slurm", "time"]).code(2);
    sweep(&["--submit", "slurm", "--watch"]).code(2);
    let slurm = sweep(&["--submit", "slurm", "--dry-run", "--slurm", "array=1"]);
    slurm.refused(&["--slurm array=1", "accepted: options of sbatch"]);
    sweep(&["--submit", "slurm", "--kubernetes", "cpus=1"]).refused(&["accepted: --slurm"]);
    sweep(&["--submit", "kubernetes", "--slurm", "cpus=1"]).refused(&["accepted: --kubernetes"]);
    let unknown = sweep(&["--submit", "kubernetes", "--dry-run", "--kubernetes", "gpus=1"]);
    unknown.refused(&["--kubernetes gpus=1", "accepted: image, claim"]);
    sweep(&["--submit", "kubernetes", "--set", "learner.gama=1"]).refused(&["learner.gama", "did you mean"]);
}

/// `deploy/kubernetes/sweep.yaml` is what its first line says; with TRESTLE_WRITE_DOCS=1 it is written anew.
#[test]
fn the_example_for_kubernetes_is_what_the_program_makes() {
    let place = Place::new();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/kubernetes/sweep.yaml");
    let example =
        "sweep maze30 --algos dqn,trestle --seeds 0..10 --out runs/maze30 --submit kubernetes --dry-run";
    let args: Vec<&str> = example.split(' ').collect();
    let made = trestle(&args).ok().stdout;
    let text = format!("# trestle {example}\n{made}");
    if std::env::var_os("TRESTLE_WRITE_DOCS").is_some() {
        fs::write(&path, &text).unwrap();
    }
    assert_eq!(fs::read_to_string(&path).unwrap(), text, "see the head of this test");
    let bin = stand_ins(&place);
    submit(&bin, &args[1..args.len() - 1]).ok();
    assert_eq!(fs::read_to_string(place.path("manifest")).unwrap(), made);
}
