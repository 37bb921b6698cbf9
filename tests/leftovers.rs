//! What killed starts leave behind, and files that are not what they should be: the next command goes on, or says what is
//! in its way, at once.

use crate::util::{Place, Trace, copy, start, trestle};
use nix::sys::stat::Mode;
use nix::unistd::mkfifo;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use trestle_proto::rundir::RunDir;

const SEED: [&str; 3] = ["maze-small", "--seed", "3"];
const LIMIT: [&str; 2] = ["--env-steps", "700"];

/// Removes from the run in `root` all that a start has not written yet which is killed after `made` files, and leaves the
/// next one half-written.
fn cut(root: &Path, made: usize) {
    const ORDER: [&str; 7] =
        ["logs", "config.toml", "command.txt", "map.json", "build.json", "demonstration.csv", "plan.bin"];
    for entry in fs::read_dir(root).unwrap() {
        let entry = entry.unwrap();
        let name = entry.file_name().into_string().unwrap();
        if ORDER[..made.min(ORDER.len())].contains(&name.as_str()) {
            if name == "logs" {
                fs::remove_dir_all(entry.path()).unwrap();
                fs::create_dir(entry.path()).unwrap();
            }
        } else if entry.file_type().unwrap().is_dir() {
            fs::remove_dir_all(entry.path()).unwrap();
        } else {
            fs::remove_file(entry.path()).unwrap();
        }
    }
    if let Some(next) = ORDER.get(made) {
        fs::write(root.join(format!(".{next}.4711.tmp")), "torn").unwrap();
    }
}

/// A sweep, or a start, that was killed at any moment before the first checkpoint can be gone on with.
#[test]
fn half_made_runs_begin_anew() {
    let place = Place::new();
    let out = place.path("s");
    let args = ["sweep", "maze-small", "--algos", "ha-diiqn", "--seeds", "3..4", "--quiet", "--out", &out];
    let sweep = |more: &[&str]| start(&[&args[..], &LIMIT, more].concat()).finish();
    sweep(&[]).ok();
    let run = place.run("s/ha-diiqn/seed-3");
    let whole = Trace::of(&run);
    let original = place.root().join("original");
    copy(run.root(), &original);
    for made in 0..=7 {
        cut(run.root(), made);
        sweep(&["--resume"]).ok();
        assert_eq!(Trace::of(&run), whole, "{made} files");
        for how in ["--resume", "--overwrite"] {
            let dir = place.run("alone");
            copy(&original, dir.root());
            cut(dir.root(), made);
            let args =
                place.training("alone", &[&SEED[..], &["--algo", "ha-diiqn"], &LIMIT, &[how]].concat());
            start(&args).finish().ok();
            assert_eq!(Trace::of(&dir).weights_sha256, whole.weights_sha256, "{how} after {made} files");
            fs::remove_dir_all(dir.root()).unwrap();
        }
    }
    // Before the first run was made at all, and in the midst of a probe.
    fs::remove_dir_all(&out).unwrap();
    fs::create_dir_all(place.path("s/.probe-x/logs")).unwrap();
    fs::write(place.path("s/.sweep.json.12.tmp"), "{").unwrap();
    sweep(&["--resume"]).ok();
    assert_eq!(Trace::of(&run), whole);
    let hidden = fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    assert_eq!(hidden.filter(|name| name.starts_with('.')).count(), 0);
}

/// A killed `--overwrite` costs neither run: the finished one is named, not counted twice, and comes back.
#[test]
fn a_killed_overwrite_hides_no_run() {
    let place = Place::new();
    let first = place.train("s/best", &[&SEED[..], &LIMIT].concat());
    let (best, aside) = (place.run("s/best"), place.root().join("s/best.replaced-45"));
    let states: [fn(&Path, &Path); 3] = [
        |best, aside| fs::rename(best, aside).unwrap(),
        |best, aside| {
            fs::rename(best, aside).unwrap();
            fs::create_dir(best).unwrap();
        },
        |best, aside| {
            copy(best, aside);
            cut(best, 7);
        },
    ];
    for state in states {
        state(best.root(), &aside);
        let report = trestle(&["report", &place.path("s")]);
        assert!(report.stderr.contains("best.replaced-45"), "{report:?}");
        assert!(!report.stdout.contains("2 runs"), "{report:?}");
        let eval = trestle(&["eval", &place.path("s/best"), "--episodes", "1"]);
        assert!(eval.stderr.contains("best.replaced-45"), "{eval:?}");
        // The next start restores it, and then goes by its own rules.
        let refused = start(&place.training("s/best", &[&SEED[..], &LIMIT].concat())).finish();
        refused.refused(&["best is back", "exists; accepted"]);
        assert_eq!(Trace::of(&best), first);
        assert!(!aside.exists());
    }
    fs::remove_dir_all(place.path("s/report")).unwrap();
    states[2](best.root(), &aside);
    let other = ["maze-small", "--seed", "4", "--overwrite"];
    let second = place.train("s/best", &[&other[..], &LIMIT].concat());
    assert_ne!(second.weights_sha256, first.weights_sha256);
    assert_eq!(fs::read_dir(place.root().join("s")).unwrap().count(), 1, "the first one is gone");
}

/// A copy of a run's directory, or one with another name, is no other run.
#[test]
fn a_copy_is_not_counted() {
    let place = Place::new();
    for seed in ["1", "2"] {
        let name = format!("s/dqn/seed-{seed}");
        place.train(&name, &[&["maze-small", "--algo", "dqn", "--seed", seed][..], &LIMIT].concat());
    }
    let seed_1 = place.run("s/dqn/seed-1");
    for name in ["seed-1.bak", "seed-9", "../old/seed-1"] {
        copy(seed_1.root(), &place.root().join("s/dqn").join(name));
    }
    let report = trestle(&["report", &place.path("s")]).ok();
    assert!(report.stdout.contains("2 runs, 3 notes"), "{report:?}");
    for name in ["seed-1.bak", "seed-9", "old/seed-1"] {
        assert!(report.stderr.contains(&format!("{name} is not counted: it is a copy")), "{report:?}");
    }
    fs::rename(seed_1.root(), place.root().join("s/dqn/seed-7")).unwrap();
    ["s/dqn/seed-1.bak", "s/dqn/seed-9", "s/old"]
        .iter()
        .for_each(|name| fs::remove_dir_all(place.path(name)).unwrap());
    let report = trestle(&["report", &place.path("s")]).ok();
    assert!(report.stderr.contains("seed-7 is called after seed 7; its run is of seed 1"), "{report:?}");
}

/// Makes something at a path.
type Plant<'a> = &'a dyn Fn(&Path);

/// Whatever special or endless file lies in the place of one of a run's: each command that reads it ends at once, and says
/// which file it is and what. None of them changes what a link leads to.
#[test]
fn special_files_in_a_runs_directory_are_refused_by_kind() {
    let place = Place::new();
    let args = [&SEED[..], &["--set", "checkpoint.every_env_steps=300"]].concat();
    place.train("original", &[&args[..], &LIMIT].concat());
    let victim = place.write("victim", "precious");
    let kinds: [(&str, Plant); 4] = [
        ("pipe", &|path| mkfifo(path, Mode::S_IRWXU).unwrap()),
        ("device", &|path| symlink("/dev/zero", path).unwrap()),
        ("directory", &|path| fs::create_dir(path).unwrap()),
        ("bytes", &|path| fs::File::create(path).unwrap().set_len(1 << 43).unwrap()),
    ];
    for file in ["config.toml", "plan.bin", "result.json", "evals.csv", "metrics.jsonl", "logs/learner.log"] {
        for (kind, plant) in kinds {
            // A log is only ever written to, at its end; one that has grown too large is put aside.
            if file == "logs/learner.log" && kind == "bytes" {
                continue;
            }
            let dir = RunDir::new(place.root().join("run"));
            copy(&place.root().join("original"), dir.root());
            fs::remove_file(dir.root().join(file)).unwrap();
            plant(&dir.root().join(file));
            let commands = [
                vec!["eval".to_string(), place.path("run"), "--episodes".into(), "1".into()],
                vec!["report".into(), place.path("run"), "--out".into(), place.path("report")],
                place.training("run", &[&args[..], &["--env-steps", "900", "--resume"]].concat()),
                place.training("run", &[&args[..], &["--env-steps", "100", "--overwrite"]].concat()),
            ];
            for command in commands {
                let outcome = start(&command).finish();
                let said = outcome.status.success() || outcome.stderr.contains(file);
                assert!(said, "{file} as {kind}, {command:?}: {outcome:?}");
                assert!(!outcome.stderr.contains("panicked"), "{outcome:?}");
            }
            fs::remove_dir_all(dir.root()).unwrap();
        }
    }
    // A link is not written through.
    for file in ["metrics.jsonl", "evals.csv", "logs/learner.log", "logs/supervisor.log", "last"] {
        let dir = RunDir::new(place.root().join("run"));
        copy(&place.root().join("original"), dir.root());
        let path = dir.root().join(file);
        let _ = fs::remove_file(&path);
        symlink(&victim, &path).unwrap();
        start(&place.training("run", &[&args[..], &["--env-steps", "900", "--resume"]].concat())).finish();
        assert_eq!(fs::read_to_string(&victim).unwrap(), "precious", "{file}");
        fs::remove_dir_all(dir.root()).unwrap();
    }
}
