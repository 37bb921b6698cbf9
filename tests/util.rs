//! Starting the program, waiting for it within limits, and reading what its runs leave behind.

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;
use signal_hook::consts::SIGHUP;
use signal_hook::flag;
use std::collections::BTreeMap;
use std::fs;
use std::io::Read;
use std::net::TcpListener;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, Once, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use trestle_learner::checkpoint;
use trestle_link::iceoryx::Domain;
use trestle_proto::round::Round;
use trestle_proto::run_result::RunResult;
use trestle_proto::rundir::RunDir;

/// The program under test.
pub(crate) const TRESTLE: &str = env!("CARGO_BIN_EXE_trestle");
/// How long anything may take, on the slowest machine, of whose processors others may have the most part.
pub(crate) const LIMIT: Duration = Duration::from_secs(300);
/// How often a condition is looked at.
const POLL: Duration = Duration::from_millis(2);

/// Whether the test has the host to itself: `doctor` sees, and with `--fix` removes, what other tests' runs leave for
/// a moment.
static HOST: RwLock<()> = RwLock::new(());

/// A test's directory.
pub(crate) struct Place {
    dir: TempDir,
    _host: Host,
}

enum Host {
    Shared(#[allow(dead_code)] RwLockReadGuard<'static, ()>),
    Alone(#[allow(dead_code)] RwLockWriteGuard<'static, ()>),
}

impl Place {
    /// For a test that may run beside others. One a test: the second could wait for ever.
    pub(crate) fn new() -> Self {
        Self::on(Host::Shared(HOST.read().unwrap_or_else(PoisonError::into_inner)))
    }

    /// For a test that needs to be the only one on the host.
    pub(crate) fn alone() -> Self {
        Self::on(Host::Alone(HOST.write().unwrap_or_else(PoisonError::into_inner)))
    }

    fn on(host: Host) -> Self {
        Self { dir: TempDir::with_prefix("trestle-test-").unwrap(), _host: host }
    }

    pub(crate) fn root(&self) -> &Path {
        self.dir.path()
    }

    /// The path of `name` in the directory.
    pub(crate) fn path(&self, name: &str) -> String {
        self.root().join(name).to_str().unwrap().into()
    }

    /// Writes a file and returns its path.
    pub(crate) fn write(&self, name: &str, contents: impl AsRef<[u8]>) -> String {
        let path = self.path(name);
        fs::write(&path, contents).unwrap();
        path
    }

    /// The run directory `name`.
    pub(crate) fn run(&self, name: &str) -> RunDir {
        RunDir::new(self.root().join(name))
    }

    /// Trains in the directory `name` to the end and returns what is there then.
    pub(crate) fn train(&self, name: &str, args: &[&str]) -> Trace {
        start(&self.training(name, args)).finish().ok();
        let dir = self.run(name);
        assert_gone(&dir);
        Trace::of(&dir)
    }

    /// The arguments for a training in the directory `name`: by HA-DIIQN, which has all kinds of processes, unless `args`
    /// say something else of the algorithm, and for as many episodes as fit into the steps that they name.
    pub(crate) fn training(&self, name: &str, args: &[&str]) -> Vec<String> {
        let own = ["train", "--quiet", "--out", &self.path(name)].map(ToString::to_string);
        let named = args.iter().any(|arg| arg.contains("algo"));
        let algo: &[&str] = if named { &[] } else { &["--algo", "ha-diiqn"] };
        let by_steps = args.contains(&"--env-steps") && !args.contains(&"--episodes");
        let episodes: &[&str] = if by_steps { &["--episodes", "1000000000"] } else { &[] };
        own.into_iter().chain(args.iter().chain(algo).chain(episodes).map(ToString::to_string)).collect()
    }
}

/// A port that nobody has.
pub(crate) fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// Waits until `condition` holds; false if `limit` was over first.
pub(crate) fn wait_until(limit: Duration, mut condition: impl FnMut() -> bool) -> bool {
    let start = Instant::now();
    while !condition() {
        if start.elapsed() > limit {
            return false;
        }
        thread::sleep(POLL);
    }
    true
}

/// The program at work.
pub(crate) struct Process {
    child: Child,
    /// What `/proc` shows of its arguments and its children's: the place to look for them.
    args: Vec<String>,
    stdout: Output,
    stderr: Output,
}

/// What a process prints, as it comes.
struct Output {
    text: Arc<Mutex<String>>,
    reader: Option<JoinHandle<()>>,
}

impl Output {
    fn of(mut source: impl Read + Send + 'static) -> Self {
        let text = Arc::new(Mutex::new(String::new()));
        let sink = text.clone();
        let reader = thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Ok(n @ 1..) = source.read(&mut buffer) {
                sink.lock().unwrap().push_str(&String::from_utf8_lossy(&buffer[..n]));
            }
        });
        Self { text, reader: Some(reader) }
    }

    fn so_far(&self) -> String {
        self.text.lock().unwrap().clone()
    }

    fn all(&mut self) -> String {
        if let Some(reader) = self.reader.take() {
            reader.join().unwrap();
        }
        self.so_far()
    }
}

/// How the program ended.
#[derive(Debug)]
pub(crate) struct Outcome {
    pub(crate) status: ExitStatus,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

/// Starts the program.
pub(crate) fn start<S: AsRef<str>>(args: &[S]) -> Process {
    start_under(&[] as &[&str], args)
}

/// Starts the program as the last part of another command, such as `taskset -c 0`.
pub(crate) fn start_under<S: AsRef<str>>(command: &[&str], args: &[S]) -> Process {
    start_command(&[command, &[TRESTLE]].concat(), args)
}

/// Starts any other command, `args` being those that tell it from others.
pub(crate) fn start_command<S: AsRef<str>>(command: &[&str], args: &[S]) -> Process {
    heed_hangups();
    let mut words: Vec<&str> = command.to_vec();
    words.extend(args.iter().map(AsRef::as_ref));
    let mut child = Command::new(words[0])
        .args(&words[1..])
        .env_remove("RUST_LOG")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let (stdout, stderr) = (child.stdout.take().unwrap(), child.stderr.take().unwrap());
    let args = args.iter().map(|arg| arg.as_ref().to_string()).collect();
    Process { child, args, stdout: Output::of(stdout), stderr: Output::of(stderr) }
}

/// Sees to it that what is started from here does not ignore SIGHUP, as it would where the tests were started by `nohup`: a signal
/// that is handled is not ignored any more, and the next program begins without the handler.
fn heed_hangups() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let status = fs::read_to_string("/proc/self/status").unwrap();
        let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).unwrap();
        if u64::from_str_radix(ignored.trim(), 16).unwrap() & 1 == 1 {
            flag::register(SIGHUP, Arc::default()).unwrap();
        }
    });
}

/// Runs the program to its end.
pub(crate) fn trestle(args: &[&str]) -> Outcome {
    start(args).finish()
}

impl Process {
    pub(crate) fn pid(&self) -> u32 {
        self.child.id()
    }

    pub(crate) fn signal(&self, signal: Signal) {
        send(self.pid(), signal);
    }

    pub(crate) fn stderr_so_far(&self) -> String {
        self.stderr.so_far()
    }

    pub(crate) fn is_running(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    /// Waits for a condition of the run while it goes on; fails if the process ends before.
    pub(crate) fn wait_for(&mut self, what: &str, mut condition: impl FnMut() -> bool) {
        let mut ended = false;
        let met = wait_until(LIMIT, || {
            let met = condition();
            ended = !met && !self.is_running();
            met || ended
        });
        assert!(met && !ended, "waiting for {what}; standard error: {}", self.stderr_so_far());
    }

    /// Waits for the end.
    pub(crate) fn finish(mut self) -> Outcome {
        let ended = wait_until(LIMIT, || !self.is_running());
        assert!(ended, "{:?} has not ended; standard error: {}", self.args, self.stderr_so_far());
        let status = self.child.wait().unwrap();
        Outcome { status, stdout: self.stdout.all(), stderr: self.stderr.all() }
    }
}

impl Drop for Process {
    /// Leaves nothing running where a test has failed.
    fn drop(&mut self) {
        if let Ok(None) = self.child.try_wait() {
            let out = self.args.iter().skip_while(|arg| *arg != "--out").nth(1);
            let others = out.map(|out| processes(Path::new(out))).unwrap_or_default();
            let _ = self.child.kill();
            let _ = self.child.wait();
            for (pid, _) in others {
                let _ = kill(Pid::from_raw(pid.cast_signed()), Signal::SIGKILL);
            }
        }
    }
}

impl Outcome {
    /// It did what was asked.
    pub(crate) fn ok(self) -> Self {
        assert!(self.status.success(), "{self:?}");
        self
    }

    /// It ended with `code`.
    pub(crate) fn code(self, code: i32) -> Self {
        assert_eq!(self.status.code(), Some(code), "{self:?}");
        self
    }

    /// It failed, and said all of `words` on standard error.
    pub(crate) fn refused(self, words: &[&str]) -> Self {
        assert!(matches!(self.status.code(), Some(1..=2)), "{self:?}");
        for word in words {
            assert!(self.stderr.contains(word), "`{word}` is missing: {self:?}");
        }
        self
    }
}

/// Sends a signal to a process that lives.
pub(crate) fn send(pid: u32, signal: Signal) {
    kill(Pid::from_raw(pid.cast_signed()), signal).unwrap();
}

/// The processes of the run in `dir`: id and arguments.
pub(crate) fn processes(dir: &Path) -> Vec<(u32, Vec<String>)> {
    let dir = dir.to_str().unwrap();
    let mut found = Vec::new();
    for entry in fs::read_dir("/proc").unwrap() {
        let entry = entry.unwrap();
        let Ok(pid) = entry.file_name().to_string_lossy().parse() else { continue };
        // A process that has just ended has no arguments any more.
        let line = fs::read(entry.path().join("cmdline")).unwrap_or_default();
        let args: Vec<String> =
            line.split(|b| *b == 0).map(|arg| String::from_utf8_lossy(arg).into_owned()).collect();
        if args.iter().any(|arg| arg == dir) {
            found.push((pid, args));
        }
    }
    found
}

/// The id of the process of the run in `dir` that is `role`: the subcommand, and for actors the index.
pub(crate) fn process(dir: &Path, role: &str) -> Option<u32> {
    let name = |args: &[String]| match args.get(1).map(String::as_str) {
        Some("actor") => format!("actor-{}", args[3]),
        other => other.unwrap_or_default().to_string(),
    };
    processes(dir).into_iter().find(|(_, args)| name(args) == role).map(|(pid, _)| pid)
}

/// Kills all four processes of `run` at once, so that none of them can remove anything.
pub(crate) fn kill_all(run: Process, dir: &RunDir) {
    let all = processes(dir.root());
    assert_eq!(all.len(), 4);
    // Stopped, none of them can react to the end of another.
    all.iter().for_each(|(pid, _)| send(*pid, Signal::SIGSTOP));
    all.iter().for_each(|(pid, _)| send(*pid, Signal::SIGKILL));
    run.finish();
    assert!(wait_until(LIMIT, || processes(dir.root()).is_empty()));
}

/// The place of the run's shared memory.
pub(crate) fn domain(dir: &RunDir) -> Domain {
    Domain::of(dir.read_plan().unwrap().life.run)
}

/// Fails unless the run has neither processes nor anything in shared memory.
pub(crate) fn assert_gone(dir: &RunDir) {
    assert_eq!(processes(dir.root()), []);
    let domain = domain(dir);
    assert_eq!(domain.shared_memory().unwrap(), [] as [PathBuf; 0], "{}", logs(dir));
    assert!(!domain.root().exists(), "{}", logs(dir));
}

/// What all of the run's processes have logged.
pub(crate) fn logs(dir: &RunDir) -> String {
    let files = fs::read_dir(dir.root().join("logs")).unwrap().map(|entry| entry.unwrap().path());
    files.map(|file| format!("{}:\n{}", file.display(), fs::read_to_string(&file).unwrap())).collect()
}

/// Waits until the run has neither processes nor anything in shared memory.
pub(crate) fn wait_until_gone(dir: &RunDir, limit: Duration) {
    let domain = domain(dir);
    wait_until(limit, || {
        processes(dir.root()).is_empty()
            && !domain.root().exists()
            && domain.shared_memory().unwrap().is_empty()
    });
    assert_gone(dir);
}

/// Rows of `evals.csv` so far; the learner hands each to the operating system at once.
pub(crate) fn evaluations(dir: &RunDir) -> usize {
    fs::read_to_string(dir.evals()).unwrap_or_default().lines().skip(1).count()
}

/// What `result.json` says.
pub(crate) fn result(dir: &RunDir) -> RunResult {
    serde_json::from_slice(&fs::read(dir.result()).unwrap()).unwrap()
}

/// The tick of the newest complete checkpoint.
pub(crate) fn newest_checkpoint(dir: &RunDir) -> Option<Round> {
    checkpoint::newest_complete(dir.root()).unwrap().map(|(tick, _)| tick)
}

/// All of a finished run that depends on configuration and seed alone.
#[derive(Debug, PartialEq)]
pub(crate) struct Trace {
    pub(crate) weights_sha256: String,
    pub(crate) result: RunResult,
    /// `evals.csv` without `wall_s`.
    pub(crate) evals: Vec<Vec<String>>,
    /// The rows of `metrics.jsonl` that belong to episodes, without `time/time_elapsed`.
    pub(crate) episodes: Vec<Value>,
    /// `mentor.csv`, empty where there is no mentor.
    pub(crate) mentor: String,
    /// Environment steps in `actors.csv`; 0 where there is none.
    pub(crate) counted: u64,
}

impl Trace {
    pub(crate) fn of(dir: &RunDir) -> Self {
        let result = RunResult { wall_s: 0.0, restarts: 0, ..result(dir) };
        let evals = fs::read_to_string(dir.evals()).unwrap();
        let without_wall = |line: &str| {
            let mut fields: Vec<String> = line.split(',').map(String::from).collect();
            fields.remove(3);
            fields
        };
        let mut episodes: Vec<Value> = metrics(dir);
        episodes.retain(|row| row.get("rollout/ep_rew").is_some());
        for row in &mut episodes {
            row.as_object_mut().unwrap().remove("time/time_elapsed");
        }
        Self {
            weights_sha256: result.weights_sha256.clone(),
            result,
            evals: evals.lines().map(without_wall).collect(),
            episodes,
            mentor: fs::read_to_string(dir.mentor()).unwrap_or_default(),
            counted: counted(dir).iter().map(|row| row.env_steps).sum(),
        }
    }
}

/// A row of `actors.csv`.
#[derive(Debug)]
pub(crate) struct Counted {
    pub(crate) actor: u32,
    pub(crate) incarnation: u32,
    pub(crate) batches: u64,
    pub(crate) env_steps: u64,
    /// Of its host, where that is not the learner's.
    pub(crate) host: String,
}

/// The rows of `actors.csv`, none where there is none.
pub(crate) fn counted(dir: &RunDir) -> Vec<Counted> {
    let text = fs::read_to_string(dir.actors()).unwrap_or_default();
    let row = |line: &str| {
        let fields: Vec<&str> = line.split(',').collect();
        Counted {
            actor: fields[0].parse().unwrap(),
            incarnation: fields[1].parse().unwrap(),
            batches: fields[2].parse().unwrap(),
            env_steps: fields[3].parse().unwrap(),
            host: fields[6].into(),
        }
    };
    text.lines().skip(1).map(row).collect()
}

/// The rows of `metrics.jsonl`.
pub(crate) fn metrics(dir: &RunDir) -> Vec<Value> {
    let text = fs::read_to_string(dir.metrics()).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Copies a run's directory, its links as links.
pub(crate) fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let (path, to) = (entry.as_ref().unwrap().path(), to.join(entry.unwrap().file_name()));
        if path.is_symlink() {
            symlink(fs::read_link(path).unwrap(), to).unwrap();
        } else if path.is_dir() {
            copy(&path, &to);
        } else {
            fs::copy(path, to).unwrap();
        }
    }
}

/// Every file below `root` with its contents, every directory and link with none.
pub(crate) fn tree(root: &Path) -> BTreeMap<PathBuf, Option<Vec<u8>>> {
    let mut found = BTreeMap::new();
    let mut open = vec![root.to_path_buf()];
    while let Some(dir) = open.pop() {
        for entry in fs::read_dir(&dir).unwrap() {
            let entry = entry.unwrap();
            let kind = entry.file_type().unwrap();
            let contents = kind.is_file().then(|| fs::read(entry.path()).unwrap());
            if kind.is_dir() {
                open.push(entry.path());
            }
            found.insert(entry.path(), contents);
        }
    }
    found
}

/// The identities of runs that have left something and whose supervisor is dead.
pub(crate) fn dead_runs() -> Vec<u64> {
    let all = Domain::all().unwrap();
    all.iter().filter(|domain| domain.is_dead()).map(Domain::run).collect()
}

/// Whether `command` works here; says so where it does not, as the test then cannot.
pub(crate) fn available(command: &[&str]) -> bool {
    let works = Command::new(command[0]).args(&command[1..]).output().is_ok_and(|o| o.status.success());
    if !works {
        eprintln!("not tested: `{}` does not work here", command.join(" "));
    }
    works
}
