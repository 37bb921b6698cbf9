//! Runs share a host without noticing each other, and never a directory.

use crate::util::{
    Outcome, Place, Process, TRESTLE, Trace, assert_gone, available, evaluations, process, processes, result,
    send, start, start_command,
};
use nix::sys::signal::Signal;
use std::fs::{self, Permissions};
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown, symlink};
use std::path::{Path, PathBuf};
use trestle_link::Transport;
use trestle_link::iceoryx::{Domain, SharedMemory};
use trestle_proto::rundir::RunDir;

fn args(seed: &str) -> Vec<&str> {
    vec!["maze-small", "--algo", "ha-diiqn", "--env-steps", "6000", "--seed", seed]
}

fn at_once(seeds: &[&str]) {
    let place = Place::new();
    let name = |how: &str, seed: &str| format!("{how}-{seed}");
    let runs: Vec<_> =
        seeds.iter().map(|seed| start(&place.training(&name("together", seed), &args(seed)))).collect();
    for run in runs {
        run.finish().ok();
    }
    for seed in seeds {
        let dir = place.run(&name("together", seed));
        assert_gone(&dir);
        assert_eq!(Trace::of(&dir), place.train(&name("alone", seed), &args(seed)), "seed {seed}");
    }
}

#[test]
fn two_at_once() {
    at_once(&["1", "2"]);
}

#[test]
fn six_at_once() {
    at_once(&["1", "2", "3", "4", "5", "6"]);
}

/// More runs at once than the host has processors by far: all start, and none takes another's slowness for death.
#[test]
fn twenty_four_at_once() {
    let place = Place::new();
    let args = ["maze-small", "--algo", "dqn", "--env-steps", "1000", "--set", "supervise.restarts=0"];
    let runs: Vec<_> = (0..24).map(|i| start(&place.training(&i.to_string(), &args))).collect();
    for run in runs {
        run.finish().ok();
    }
    let hashes: Vec<String> = (0..24).map(|i| result(&place.run(&i.to_string())).weights_sha256).collect();
    assert!(hashes.iter().all(|hash| *hash == hashes[0]));
    (0..24).for_each(|i| assert_gone(&place.run(&i.to_string())));
}

#[test]
fn a_directory_in_use_is_refused() {
    let place = Place::new();
    let endless = ["maze-small", "--episodes", "1000000000", "--set", "checkpoint.every_env_steps=1000"];
    let mut run = start(&place.training("run", &endless));
    let dir = place.run("run");
    run.wait_for("a checkpoint", || dir.last().exists());
    for how in ["--resume", "--overwrite"] {
        let args = place.training("run", &[&endless[..], &[how]].concat());
        start(&args).finish().refused(&["run: a run is in progress", "--out"]);
    }
    let rows = evaluations(&dir);
    run.wait_for("the run to go on", || evaluations(&dir) > rows);
    run.signal(Signal::SIGINT);
    run.finish().code(130);
    assert_gone(&dir);
    assert!(result(&dir).interrupted);
}

#[test]
fn of_two_starts_in_one_directory_one_trains() {
    let place = Place::new();
    let args = place.training("run", &args("1"));
    let both = [start(&args), start(&args)];
    let outcomes = both.map(|run| run.finish());
    let (trained, refused): (Vec<_>, Vec<_>) = outcomes.into_iter().partition(|o| o.status.success());
    assert_eq!((trained.len(), refused.len()), (1, 1), "{trained:?} {refused:?}");
    assert!(refused[0].stderr.contains("accepted: another --out"), "{refused:?}");
    let dir = place.run("run");
    assert_gone(&dir);
    assert!(trained[0].stdout.contains(&result(&dir).weights_sha256));
}

/// A user of the host that has nothing there but what a test gives it.
struct User {
    id: u32,
    /// Where it may write.
    home: String,
    /// The program, where it can be reached.
    program: String,
}

impl User {
    /// Number `n` of this test process, with a place of its own in `place`, which all of them can reach. None where
    /// nobody may become another user.
    fn new(place: &Place, n: u32) -> Option<Self> {
        // Two test processes at once must not meet.
        let id = 20_000 + std::process::id() % 10_000 * 4 + n;
        let user = Self { id, home: place.path(&format!("home-{n}")), program: place.path("trestle") };
        let as_user = user.command("true");
        if !available(&as_user.iter().map(String::as_str).collect::<Vec<_>>()) {
            return None;
        }
        let all_may = |path: &Path| fs::set_permissions(path, Permissions::from_mode(0o755)).unwrap();
        if !Path::new(&user.program).exists() {
            fs::copy(TRESTLE, &user.program).unwrap();
        }
        fs::create_dir(&user.home).unwrap();
        chown(&user.home, Some(id), Some(id)).unwrap();
        [place.root(), Path::new(&user.home), Path::new(&user.program)].into_iter().for_each(all_may);
        Some(user)
    }

    /// What makes `program` this user's.
    fn command(&self, program: &str) -> Vec<String> {
        let id = self.id.to_string();
        ["setpriv", "--reuid", &id, "--regid", &id, "--clear-groups", program].map(String::from).to_vec()
    }

    fn start_program(&self, program: &str, args: &[&str]) -> Process {
        let command = self.command(program);
        start_command(&command.iter().map(String::as_str).collect::<Vec<_>>(), args)
    }

    /// Starts the program under test.
    fn start(&self, args: &[&str]) -> Process {
        self.start_program(&self.program, args)
    }

    /// A training that is in the middle of it, with all its processes stopped. The supervisor is, too, so it can stay so for
    /// however long.
    fn stopped_run(&self, args: &[&str]) -> (Process, RunDir) {
        for attempt in 0..5 {
            let dir = RunDir::new(format!("{}/run-{attempt}", self.home));
            let out = dir.root().to_str().unwrap();
            let mut run = self.start(&[&["train", "--quiet", "--out", out], args].concat());
            run.wait_for("the training", || dir.evals().exists());
            // First the supervisor, so that what is over already is still there to be sent a signal.
            run.signal(Signal::SIGSTOP);
            let all = processes(dir.root());
            all.iter().for_each(|(pid, _)| send(*pid, Signal::SIGSTOP));
            if all.len() == 4 && processes(dir.root()).len() == 4 {
                return (run, dir);
            }
            // It was over first. The supervisor comes last, for the same reason.
            all.iter().filter(|(pid, _)| *pid != run.pid()).for_each(|(pid, _)| send(*pid, Signal::SIGCONT));
            run.signal(Signal::SIGCONT);
            run.finish().ok();
        }
        panic!("five trainings were over before they could be stopped");
    }

    /// What `trestle doctor` says to this user, who has nothing to be told of but `runs` runs in progress.
    fn doctor(&self, more: &[&str], runs: usize) -> Outcome {
        let outcome = self.start(&[&["doctor"], more].concat()).finish();
        let bad: Vec<&str> = outcome.stdout.lines().filter(|line| !line.starts_with("ok ")).collect();
        // What the host itself lacks is nobody's run.
        let of_the_host = |line: &&str| line.contains("shared memory: ") || line.contains("open files: ");
        assert!(bad.iter().all(of_the_host), "{outcome:?}");
        assert_eq!(outcome.status.success(), bad.is_empty(), "{outcome:?}");
        assert!(outcome.stdout.contains(&format!("runs in progress: {runs}\n")), "{outcome:?}");
        outcome
    }

    /// The root of its run and the run's files in `/dev/shm`.
    fn shared(&self, run: u64) -> (PathBuf, Vec<PathBuf>) {
        let prefix = format!("trestle_{run:08x}_");
        let all = fs::read_dir("/dev/shm").unwrap().map(|entry| entry.unwrap());
        let own = all.filter(|entry| entry.file_name().to_string_lossy().starts_with(&prefix));
        let mut files: Vec<PathBuf> = own.map(|entry| entry.path()).collect();
        files.sort();
        (format!("/dev/shm/trestle_{run:08x}").into(), files)
    }
}

impl Drop for User {
    /// Leaves nothing of the user, also where a test has failed.
    fn drop(&mut self) {
        for entry in fs::read_dir("/dev/shm").into_iter().flatten().flatten() {
            if entry.metadata().is_ok_and(|meta| meta.uid() == self.id) {
                let _ = fs::remove_dir_all(entry.path()).or_else(|_| fs::remove_file(entry.path()));
            }
        }
    }
}

/// The directory of a run of somebody else's, for the process that is a stranger to it.
const STRANGER: &str = "TRESTLE_TEST_STRANGER";

/// Two users train at once. Neither sees, opens, asks or removes anything of the other's run, and nor does root by accident.
/// The runs are stopped while that is tried, so that they cannot be over.
#[test]
fn users_do_not_see_each_other() {
    if let Some(dir) = std::env::var_os(STRANGER) {
        let plan = RunDir::new(dir).read_plan().unwrap();
        println!("refused: {}", SharedMemory.client(&plan).unwrap_err());
        return;
    }
    let place = Place::new();
    let (Some(one), Some(two)) = (User::new(&place, 0), User::new(&place, 1)) else { return };
    let asks = place.path("asks");
    fs::copy(std::env::current_exe().unwrap(), &asks).unwrap();
    let undisturbed = place.train("undisturbed", &args("3"));
    let runs = [&one, &two].map(|user| user.stopped_run(&args("3")));
    let [first, second] = [runs[0].1.clone(), runs[1].1.clone()];
    for (user, own, other, others) in [(&one, &first, &two, &second), (&two, &second, &one, &first)] {
        let run = others.read_plan().unwrap().life.run;
        // Not even the names, unless their user lets it in.
        let listed = user.start_program("ls", &[others.root().to_str().unwrap()]).finish();
        assert!(!listed.status.success() && listed.stdout.is_empty(), "{listed:?}");
        fs::set_permissions(others.root(), Permissions::from_mode(0o755)).unwrap();
        let (root, files) = other.shared(run);
        assert!(files.len() > 5, "{files:?}");
        let private = |path: &Path, mode: u32| {
            let meta = fs::symlink_metadata(path).unwrap();
            assert_eq!(meta.uid(), other.id, "{}", path.display());
            assert_eq!(meta.mode() & mode, 0, "{} is of mode {:o}", path.display(), meta.mode());
        };
        private(&root, 0o077);
        files.iter().for_each(|file| private(file, 0o077));

        // It cannot look.
        let paths: Vec<&str> = files.iter().map(|file| file.to_str().unwrap()).collect();
        let read = user.start_program("head", &[&["-c", "1"], &paths[..]].concat()).finish().code(1);
        assert_eq!((read.stdout.as_str(), read.stderr.lines().count()), ("", files.len()), "{read:?}");
        let listed = user.start_program("ls", &["-A", root.to_str().unwrap()]).finish();
        assert!(!listed.status.success() && listed.stdout.is_empty(), "{listed:?}");

        // It sees its own run alone, and removes nothing.
        let of_other = format!("{run:08x}");
        for more in [&[][..], &["--fix"]] {
            let outcome = user.doctor(more, 1);
            assert!(!outcome.stdout.contains(&of_other), "{outcome:?}");
        }

        // It cannot ask, nor take a part in it.
        let ask = ["concurrency::users_do_not_see_each_other", "--exact", "--nocapture"];
        let env = format!("{STRANGER}={}", others.root().display());
        let asked = user.start_program("env", &[&[env.as_str(), &asks], &ask[..]].concat()).finish().ok();
        assert!(
            asked.stdout.contains("refused: joining the run: it is not in progress, or another user's"),
            "{asked:?}"
        );
        let theirs = others.root().to_str().unwrap();
        for role in [&["mentor-server"][..], &["learner"], &["actor", "--index", "0"]] {
            let joined = user.start(&[role, &["--run", theirs]].concat()).finish();
            joined.refused(&["joining the run", "not in progress"]);
        }
        // Root could; but what it does under its own name is about its own runs.
        let plan = others.read_plan().unwrap();
        assert!(SharedMemory.client(&plan).is_err());
        assert_eq!(Domain::of(run).shared_memory().unwrap(), [] as [PathBuf; 0]);
        Domain::of(run).remove().unwrap();

        assert_eq!(other.shared(run), (root.clone(), files));
        assert!(root.join("owner").exists() && process(own.root(), "learner").is_some());
    }
    for (run, dir) in runs {
        processes(dir.root()).iter().for_each(|(pid, _)| send(*pid, Signal::SIGCONT));
        run.finish().ok();
        assert_eq!(Trace::of(&dir), undisturbed);
        assert_eq!(result(&dir).restarts, 0);
    }
    for (user, dir) in [(&one, &first), (&two, &second)] {
        let (root, files) = user.shared(dir.read_plan().unwrap().life.run);
        assert!(!root.exists() && files.is_empty(), "{files:?}");
        user.doctor(&[], 0);
    }
}

/// What somebody else has put in the place of a user's run is not taken for it, least of all to be removed.
#[test]
fn a_trap_in_the_place_of_a_run_is_not_stepped_into() {
    let place = Place::new();
    let Some(user) = User::new(&place, 2) else { return };
    // Its own files, behind a link that root has made.
    let precious = Path::new(&user.home).join("precious");
    fs::create_dir(&precious).unwrap();
    fs::write(precious.join("thesis.tex"), "").unwrap();
    for path in [&precious, &precious.join("thesis.tex")] {
        chown(path, Some(user.id), Some(user.id)).unwrap();
    }
    let out = format!("{}/run", user.home);
    let train = |more: &[&str]| {
        let args = ["train", "maze-small", "--quiet", "--out", &out];
        user.start(&[&args[..], more].concat()).finish().ok();
    };
    train(&["--env-steps", "1024"]);
    let run = RunDir::new(&out).read_plan().unwrap().life.run;
    let (trap, _) = user.shared(run);
    symlink(&precious, &trap).unwrap();
    for more in [&["doctor"][..], &["doctor", "--fix"]] {
        let outcome = user.start(more).finish();
        assert!(!outcome.stdout.contains(&format!("{run:08x}")), "{outcome:?}");
    }
    train(&["--env-steps", "2048", "--resume"]);
    assert!(precious.join("thesis.tex").exists() && trap.is_symlink());
    fs::remove_file(trap).unwrap();
}
