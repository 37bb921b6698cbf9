//! Faults by a schedule that its seed determines, and runs that must come to the same whatever befalls them.
//!
//! Fault number n of a seed is a function of both: what is done, to which process, and when, counted from a mark that the
//! run itself sets. Times between marks are the machine's, so that a schedule that is played again meets the run at about,
//! not exactly, the same instructions.

use crate::client::Client;
use crate::room::{self, Hog, SHARED_MEMORY};
use crate::util::{
    LIMIT, Outcome, Place, Process, Trace, assert_gone, evaluations, logs, process, processes, result, start,
    wait_until,
};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};
use trestle_learner::checkpoint;
use trestle_link::Liveness;
use trestle_link::iceoryx::Domain;
use trestle_proto::config::Mode;
use trestle_proto::plan::RunPlan;
use trestle_proto::rng::mix;
use trestle_proto::rundir::RunDir;

/// What is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// SIGKILL.
    Kill,
    /// SIGKILL, and within [`MOMENT`] the supervisor as well. The run is gone on with by `trestle resume`.
    Both,
    /// SIGSTOP, for good. The supervisor goes on after a moment: nobody watches over it.
    Stop,
    /// SIGSTOP, and SIGCONT before anybody minds.
    Pause,
    /// A file of the newest checkpoint is damaged, and then the process killed.
    Torn,
    /// The newest checkpoint says that it is of another version, and then the process is killed.
    Version,
    /// Shared memory is full for a while, in which the process may be killed.
    Shm,
    /// The disk that the run's directory is on is full for a while, in which the process may be killed.
    Disk,
    /// The mentor-server is slow: stopped once for long or many times for a moment, never for long enough to count as dead.
    Slow,
    /// Clients ask the mentor-server, and are stopped without having read the answer. They go away later.
    Deaf,
}

/// Every kind of fault: those that befall one process, and from [`SHORTAGES`] on those of which a run may not notice anything.
pub(crate) const KINDS: [Kind; 10] = [
    Kind::Kill,
    Kind::Both,
    Kind::Stop,
    Kind::Pause,
    Kind::Torn,
    Kind::Version,
    Kind::Shm,
    Kind::Disk,
    Kind::Slow,
    Kind::Deaf,
];

/// See [`KINDS`].
#[allow(dead_code)] // Played at length they are named.
pub(crate) const SHORTAGES: usize = 6;

impl Kind {
    /// What runs out, if something does: the words of which a run that ends for want of it must say one.
    fn lacks(self) -> Option<&'static [&'static str]> {
        match self {
            Self::Shm => Some(&["/dev/shm", "shared memory"]),
            Self::Disk => Some(&["No space left on device", "cannot create the run's services"]),
            _ => None,
        }
    }
}

/// Whom it befalls.
const ROLES: [&str; 4] = ["actor", "learner", "mentor-server", "supervisor"];

/// How the runs are made: their arguments beside those of all.
const CONFIGS: [&[&str]; 5] = [
    &["--algo", "ha-diiqn"],
    &["--algo", "ha-diiqn", "--actors", "2"],
    &["--algo", "ha-diiqn", "--actors", "2"],
    &["--algo", "diiqn"],
    &["--algo", "dqn", "--actors", "3"],
];
/// The same, for lockstep alone.
const LAGS: [&[&str]; 5] = [&[], &[], &["--set", "run.lag=1"], &["--set", "run.lag=1"], &[]];

/// Long enough for some faults, with checkpoints on the way, and patience with whatever comes.
const ARGS: [&str; 11] = [
    "maze-small",
    "--env-steps",
    "24000", // ENV_STEPS
    "--set",
    "checkpoint.every_env_steps=1500",
    "--set",
    "supervise.restarts=1000",
    "--set",
    "supervise.silence_s=3",
    "--set",
    "eval.every=2",
];

const ENV_STEPS: u64 = 24_000;

/// Faults that one run has to stand, unless it ends before.
const PER_RUN: u64 = 6;

/// The supervisor dies this much later than a process of its run, at the most.
const MOMENT: Duration = Duration::from_millis(50);

/// Clients that a mentor-server has room for, beside the learner.
const CLIENTS: u64 = 7;
/// How long those of them wait that wait at all.
const PATIENCE: Duration = Duration::from_millis(500);

/// One fault.
#[derive(Clone, Copy, Debug)]
struct Fault {
    kind: Kind,
    role: &'static str,
    /// Evaluations that the run plays first, counted from the fault before; 0: as soon as the process is there.
    evaluations: usize,
    /// Time after that.
    after: Duration,
    /// For whatever else is to be chosen.
    word: u64,
}

impl Fault {
    /// Fault `n` of `seed`, of one of `kinds`.
    fn of(seed: u64, n: u64, kinds: &[Kind]) -> Self {
        let word = |field: u64| mix(mix(seed ^ n << 8) ^ field);
        let pick = |field, len: usize| (word(field) % len as u64) as usize;
        Self {
            kind: kinds[pick(1, kinds.len())],
            role: ROLES[pick(2, ROLES.len())],
            evaluations: pick(3, 4),
            after: Duration::from_micros(word(4) % 150_000),
            word: word(5),
        }
    }

    /// The same in a run that is made by `config`, and the process that it befalls. One that is not there is replaced by the
    /// learner; without a mentor-server, that one is slow as well.
    fn in_run(self, config: &[&str]) -> (Self, String) {
        let actors = config.iter().skip_while(|arg| **arg != "--actors").nth(1);
        let actors: u64 = actors.map_or(1, |n| n.parse().unwrap());
        let has_mentor = !config.contains(&"dqn");
        let kind = if self.kind == Kind::Deaf && !has_mentor { Kind::Slow } else { self.kind };
        let of_mentor = matches!(kind, Kind::Slow | Kind::Deaf) || self.role == "mentor-server";
        let role = match self.role {
            _ if of_mentor => if has_mentor { "mentor-server" } else { "learner" }.into(),
            // Somebody else dies first.
            "supervisor" if kind == Kind::Both => "learner".into(),
            "actor" => format!("actor-{}", self.word % actors),
            role => role.into(),
        };
        (Self { kind, ..self }, role)
    }
}

/// What a schedule came to.
#[derive(Debug, Default)]
pub(crate) struct Summary {
    pub(crate) faults: u64,
    pub(crate) runs: u64,
    /// How many of them killed the supervisor right after another process.
    pub(crate) doubles: u64,
    /// From a kill to the moment when the run can go on.
    pub(crate) recoveries: Vec<Duration>,
    /// How often a run ended for want of room, said so, and went on later.
    pub(crate) ends: u64,
    /// Clients that asked and were stopped.
    pub(crate) clients: u64,
}

/// Plays `faults` faults of `seed`, of the given kinds, over as many runs in `mode` as that takes. Each must end as an
/// undisturbed one, in free mode with every step counted once, and without a process or a file left in shared memory; fails
/// otherwise. Tells `report` of each run. Where there can be no file systems of its own, kinds that need them are left out.
pub(crate) fn play(
    mode: Mode,
    seed: u64,
    faults: u64,
    kinds: &[Kind],
    report: impl FnMut(&str) + Send,
) -> Summary {
    let place = Place::new();
    let mut kinds = kinds.to_vec();
    let own = kinds.iter().any(|kind| kind.lacks().is_some()) && room::can_have_own();
    if !own && !kinds.extract_if(.., |kind| kind.lacks().is_some()).collect::<Vec<_>>().is_empty() {
        eprintln!("left out, as they need file systems of their own: shm and disk");
    }
    if kinds.is_empty() {
        return Summary::default();
    }
    // In a thread that ends with it: nothing would bring a thread back from there.
    let played = thread::scope(|scope| {
        let thread = scope.spawn(|| {
            if own {
                room::have_own(&place);
            }
            play_at(&place, own, mode, seed, faults, &kinds, report)
        });
        thread.join()
    });
    played.unwrap_or_else(|panic| resume_unwind(panic))
}

/// The same in `place`, which has file systems of its `own`, or not.
fn play_at(
    place: &Place,
    own: bool,
    mode: Mode,
    seed: u64,
    faults: u64,
    kinds: &[Kind],
    mut report: impl FnMut(&str),
) -> Summary {
    let mut undisturbed: BTreeMap<usize, Trace> = BTreeMap::new();
    let mut summary = Summary::default();
    while summary.faults < faults {
        let number = summary.runs;
        let which = (mix(seed ^ number) % CONFIGS.len() as u64) as usize;
        let more: &[&str] = if mode == Mode::Free { &["--mode", "free"] } else { LAGS[which] };
        let args = [&ARGS[..], &["--seed", "3"], CONFIGS[which], more].concat();
        let mut run = Run::new(place, number, &args);
        let first = summary.faults;
        let mut said = String::new();
        while summary.faults < faults.min(first + PER_RUN) {
            let (fault, role) = Fault::of(seed, summary.faults, kinds).in_run(CONFIGS[which]);
            let Some(took) = run.befall(&fault, &role) else { break };
            summary.faults += 1;
            summary.doubles += u64::from(fault.kind == Kind::Both);
            summary.recoveries.extend(took);
            let took = took.map_or(String::new(), |took| format!(" ({} ms)", took.as_millis()));
            said += &format!(" {:?} {role}{took},", fault.kind);
        }
        let trace = run.finish(&mut summary);
        if own {
            // There is nobody else.
            let left = fs::read_dir(SHARED_MEMORY).unwrap();
            let left: Vec<_> = left.map(|entry| entry.unwrap().path()).collect();
            assert_eq!(left, [] as [PathBuf; 0], "seed {seed}, run {number}:{said}");
        }
        let hash = trace.weights_sha256[..16].to_string();
        report(&format!("run {number} {:?}:{said} {hash}", CONFIGS[which]));
        if mode == Mode::Free {
            assert_eq!(trace.result.env_steps, ENV_STEPS, "seed {seed}, run {number}:{said}");
            assert_eq!(trace.counted, ENV_STEPS, "seed {seed}, run {number}:{said}");
        } else {
            let undisturbed = undisturbed
                .entry(which)
                .or_insert_with(|| place.train(&format!("undisturbed-{which}"), &args));
            assert_eq!(trace, *undisturbed, "seed {seed}, run {number}:{said}");
        }
        summary.runs += 1;
    }
    summary
}

/// How often the run, or in free mode the process `role` of it alone, has come so far that it could go on.
fn readies(dir: &RunDir, role: &str) -> usize {
    let log = fs::read_to_string(dir.log("learner")).unwrap_or_default();
    let starts = log.matches("ready to train").count();
    match role.strip_prefix("actor-") {
        // At each start of the learner, too, it announces itself.
        Some(index) => starts.max(log.matches(&format!("an actor has come actor={index} ")).count()),
        None if role == "mentor-server" => {
            starts + log.matches("a new mentor-server has the history").count()
        }
        None => starts,
    }
}

/// A run that things happen to.
struct Run<'a> {
    place: &'a Place,
    name: String,
    args: Vec<&'a str>,
    dir: RunDir,
    /// None once it has ended.
    process: Option<Process>,
    /// The identities that it has had, as far as they have been seen.
    identities: BTreeSet<u64>,
    /// What has run out since it was started.
    lacked: Vec<Kind>,
    /// Those that have been stopped and not yet gone.
    clients: Vec<Client>,
    /// How often it ended for want of room, and how many clients have asked.
    ends: u64,
    asked: u64,
}

impl<'a> Run<'a> {
    fn new(place: &'a Place, number: u64, args: &[&'a str]) -> Self {
        let name = format!("run-{number}");
        let (args, dir) = (args.to_vec(), place.run(&name));
        let process = Some(start(&place.training(&name, &args)));
        let (lacked, clients) = (Vec::new(), Vec::new());
        let identities = BTreeSet::new();
        Self { place, name, args, dir, process, identities, lacked, clients, ends: 0, asked: 0 }
    }

    /// Waits for `condition`; false if the run has ended by itself, well, before.
    fn reaches(&mut self, mut condition: impl FnMut(&RunDir) -> bool) -> bool {
        let mut met = false;
        assert!(wait_until(LIMIT, || {
            met = condition(&self.dir);
            met || !self.goes_on()
        }));
        met
    }

    /// Whether the run goes on. One that has ended for want of room must have said so, and left nothing; as there is room
    /// again, it is started again.
    fn goes_on(&mut self) -> bool {
        if self.process.as_mut().is_some_and(Process::is_running) {
            return true;
        }
        let Some(outcome) = self.process.take().map(Process::finish) else { return false };
        if outcome.status.success() {
            return false;
        }
        self.ended_for_want_of_room(outcome);
        if self.dir.plan().exists() {
            assert_gone(&self.dir);
        }
        self.start_again(false);
        self.process.is_some()
    }

    fn ended_for_want_of_room(&mut self, outcome: Outcome) {
        let words: Vec<&str> =
            self.lacked.iter().filter_map(|kind| kind.lacks()).flatten().copied().collect();
        let outcome = outcome.code(1);
        assert!(words.iter().any(|word| outcome.stderr.contains(word)), "none of {words:?}: {outcome:?}");
        self.ends += 1;
    }

    /// Lets `fault` befall the process `role` of the run. Returns how long the run took to recover, if it had to; none at
    /// all if it ended before.
    fn befall(&mut self, fault: &Fault, role: &str) -> Option<Option<Duration>> {
        let rows = evaluations(&self.dir);
        // A restart may go back behind the mark: then the run passes it again.
        if fault.evaluations > 0 && !self.reaches(|dir| evaluations(dir) >= rows + fault.evaluations) {
            return None;
        }
        wait_until(fault.after, || false);
        let mut pid = None;
        if role == "supervisor" {
            pid = self.process.as_ref().map(Process::pid);
        }
        if !self.reaches(|dir| {
            pid = pid.or_else(|| process(dir.root(), role));
            pid.is_some()
        }) {
            return None;
        }
        let pid = Pid::from_raw(pid?.cast_signed());
        match fault.kind {
            Kind::Torn => self.damage(fault.word),
            Kind::Version => self.change_version(),
            Kind::Shm => return Some(self.fill(fault, Path::new(SHARED_MEMORY), pid, role)),
            Kind::Disk => return Some(self.fill(fault, self.place.root(), pid, role)),
            Kind::Slow => return Some(hold_up(pid, fault.word)),
            Kind::Deaf => return Some(self.bring_clients(fault.word)),
            Kind::Kill | Kind::Both | Kind::Stop | Kind::Pause => {}
        }
        self.identities.extend(self.dir.read_plan().map(|plan| plan.life.run));
        let (readies, began) = (readies(&self.dir, role), Instant::now());
        let pause = Duration::from_millis(fault.word % 900);
        let stops = fault.kind == Kind::Stop && role != "supervisor";
        if fault.kind == Kind::Pause || fault.kind == Kind::Stop && role == "supervisor" {
            kill(pid, Signal::SIGSTOP).ok()?;
            wait_until(pause, || false);
            // It may have been killed by a supervisor that had other reasons.
            let _ = kill(pid, Signal::SIGCONT);
            return Some(None);
        }
        kill(pid, if stops { Signal::SIGSTOP } else { Signal::SIGKILL }).ok()?;
        if fault.kind == Kind::Both {
            wait_until(MOMENT.mul_f64((fault.word >> 32 & 0xffff) as f64 / 65536.0), || false);
            self.process.as_ref()?.signal(Signal::SIGKILL);
        }
        if role == "supervisor" || fault.kind == Kind::Both {
            self.start_again(fault.kind == Kind::Both);
        }
        let recovered = self.reaches(|dir| self::readies(dir, role) > readies);
        // A run that was at its end may have ended nevertheless.
        Some((recovered && !stops).then(|| began.elapsed()))
    }

    /// Takes all the room at `place` for a while, in which process `pid`, which is `role`, may be killed.
    fn fill(&mut self, fault: &Fault, place: &Path, pid: Pid, role: &str) -> Option<Duration> {
        let choices = [33, 34, 35].map(|bit| fault.word >> bit & 1 == 1);
        let [kills, files, greedy] = choices;
        self.lacked.push(fault.kind);
        let mut hog = Hog::new(place, files);
        let killed = kills && kill(pid, Signal::SIGKILL).is_ok();
        wait_until(Duration::from_millis(fault.word % 1500), || {
            if greedy {
                // Also what the dead leave.
                hog.take();
            }
            false
        });
        drop(hog);
        if killed && role == "supervisor" {
            self.start_again(false);
        }
        None
    }

    /// Sends the clients away that are there, and lets others ask and be stopped in the middle of it.
    fn bring_clients(&mut self, word: u64) -> Option<Duration> {
        self.send_clients_away();
        // Every other one never waits for an answer, and the rest is stopped while it does.
        let patience = |i| if i % 2 == 0 { Duration::ZERO } else { PATIENCE };
        let come = 1 + word % CLIENTS;
        self.clients = (0..come).map(|i| Client::start(&self.dir, patience(i))).collect();
        // Not where the run has just ended, or there is no room for them.
        self.clients.retain_mut(Client::asks);
        self.asked += self.clients.len() as u64;
        wait_until(Duration::from_millis(word >> 8 & 127), || false);
        self.clients.iter().for_each(Client::stop);
        None
    }

    /// Half of them leave in order, half are killed as they are: of both kinds.
    fn send_clients_away(&mut self) {
        for (i, client) in self.clients.drain(..).enumerate() {
            if i % 4 < 2 { client.leave() } else { drop(client) }
        }
    }

    /// After the death of the supervisor: waits until its children have gone, and does what a user would. `resume`: by
    /// the command of that name, which needs nothing but the directory.
    fn start_again(&mut self, resume: bool) {
        self.lacked.clear();
        if let Some(process) = self.process.take() {
            process.finish();
        }
        assert!(wait_until(LIMIT, || processes(self.dir.root()).is_empty()));
        let plan = self.dir.read_plan().ok();
        self.identities.extend(plan.as_ref().map(|plan| plan.life.run));
        if self.dir.result().exists() {
            // It had finished, and only not said so yet.
            return;
        }
        // Whatever the dead have left in shared memory goes with the next start.
        let resumable = |plan: &RunPlan| checkpoint::newest_resumable(self.dir.root(), plan).unwrap();
        let more: &[&str] = match &plan {
            Some(plan) if resumable(plan).is_some() => &["--resume"],
            Some(_) => &["--overwrite"],
            None => &[],
        };
        if more.is_empty() && self.dir.root().exists() {
            // Not even a run.
            fs::remove_dir_all(self.dir.root()).unwrap();
        }
        let resumes = resume && more == ["--resume"];
        let args = match resumes {
            true => ["resume", "--quiet", &self.place.path(&self.name)].map(String::from).to_vec(),
            false => self.place.training(&self.name, &[&self.args, more].concat()),
        };
        self.process = Some(start(&args));
    }

    fn finish(mut self, summary: &mut Summary) -> Trace {
        self.reaches(|_| false);
        assert_gone(&self.dir);
        // Nothing comes back with those who go only now.
        self.send_clients_away();
        assert_gone(&self.dir);
        for identity in &self.identities {
            assert_eq!(Domain::of(*identity).liveness(), Liveness::Absent, "{identity:x}");
        }
        assert!(!result(&self.dir).interrupted);
        // A restart would hide it.
        let logs = logs(&self.dir);
        assert!(!logs.contains("panicked"), "{logs}");
        let trace = Trace::of(&self.dir);
        fs::remove_dir_all(self.dir.root()).unwrap();
        summary.ends += self.ends;
        summary.clients += self.asked;
        trace
    }

    /// The directory of the newest checkpoint, if there is one.
    fn newest(&self) -> Option<PathBuf> {
        fs::canonicalize(self.dir.last()).ok()
    }

    /// Damages a file of the newest checkpoint. It may be on its way out meanwhile: then nothing is damaged.
    fn damage(&self, word: u64) {
        let Some(files) = self.newest().and_then(|dir| fs::read_dir(dir).ok()) else { return };
        let mut files: Vec<PathBuf> = files.filter_map(|file| Some(file.ok()?.path())).collect();
        files.sort();
        let Some(path) = files.get((word % files.len().max(1) as u64) as usize) else { return };
        let Ok(mut bytes) = fs::read(path) else { return };
        let at = (mix(word) % bytes.len().max(1) as u64) as usize;
        let _ = match word >> 32 & 3 {
            0 => fs::remove_file(path),
            1 => fs::OpenOptions::new().write(true).open(path).and_then(|file| file.set_len(at as u64)),
            _ => {
                bytes[at] ^= 1 << (word >> 40 & 7);
                // Only if it is still there.
                fs::OpenOptions::new()
                    .write(true)
                    .open(path)
                    .and_then(|mut file| std::io::Write::write_all(&mut file, &bytes))
            }
        };
    }

    /// Makes the newest checkpoint one of another version, in good order otherwise.
    fn change_version(&self) {
        let Some(dir) = self.newest() else { return };
        let manifest = dir.join("MANIFEST");
        let Ok(text) = fs::read_to_string(&manifest) else { return };
        let text = text.replacen("\"format\": ", "\"format\": 9", 1);
        if fs::OpenOptions::new()
            .write(true)
            .open(dir.join("COMPLETE"))
            .and_then(|mut file| {
                std::io::Write::write_all(
                    &mut file,
                    format!("{:08x}\n", crc32c::crc32c(text.as_bytes())).as_bytes(),
                )
            })
            .is_ok()
        {
            let _ = fs::write(&manifest, text);
        }
    }
}

/// Stops a process once for long or many times for a moment, for less than it takes to count as dead.
fn hold_up(pid: Pid, word: u64) -> Option<Duration> {
    let (times, stopped, running) =
        if word >> 40 & 1 == 0 { (1, 1000 + word % 900, 0) } else { (40, 1 + word % 25, 1 + word % 9) };
    for _ in 0..times {
        for (signal, ms) in [(Signal::SIGSTOP, stopped), (Signal::SIGCONT, running)] {
            // It may have been killed by a supervisor that had other reasons.
            let _ = kill(pid, signal);
            wait_until(Duration::from_millis(ms), || false);
        }
    }
    None
}
