//! Faults by a schedule that its seed determines, and runs that must come to the same whatever befalls them.
//!
//! Fault number n of a seed is a function of both: what is done, to which process, and when, counted from a mark that the
//! run itself sets. Times between marks are the machine's, so that a schedule that is played again meets the run at about,
//! not exactly, the same instructions.

use crate::util::{
    LIMIT, Place, Process, Trace, assert_gone, evaluations, process, processes, result, start, wait_until,
};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::time::{Duration, Instant};
use trestle_learner::checkpoint;
use trestle_proto::config::Mode;
use trestle_proto::rng::mix;
use trestle_proto::rundir::RunDir;
use trestle_proto::transport::iceoryx::Domain;

/// What is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// SIGKILL.
    Kill,
    /// SIGSTOP, for good. The supervisor goes on after a moment: nobody watches over it.
    Stop,
    /// SIGSTOP, and SIGCONT before anybody minds.
    Pause,
    /// A file of the newest checkpoint is damaged, and then the process killed.
    Torn,
    /// The newest checkpoint says that it is of another version, and then the process is killed.
    Version,
}

/// Every kind of fault.
pub(crate) const KINDS: [Kind; 5] = [Kind::Kill, Kind::Stop, Kind::Pause, Kind::Torn, Kind::Version];

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

    /// The process that it befalls; one that is not there is replaced by the learner.
    fn role(&self, config: &[&str]) -> String {
        let actors = config.iter().skip_while(|arg| **arg != "--actors").nth(1);
        let actors: u64 = actors.map_or(1, |n| n.parse().unwrap());
        match self.role {
            "actor" => format!("actor-{}", self.word % actors),
            "mentor-server" if config.contains(&"dqn") => "learner".into(),
            role => role.into(),
        }
    }
}

/// What a schedule came to.
#[derive(Debug, Default)]
pub(crate) struct Summary {
    pub(crate) faults: u64,
    pub(crate) runs: u64,
    /// From a kill to the moment when the run can go on.
    pub(crate) recoveries: Vec<Duration>,
}

/// Plays `faults` faults of `seed`, of the given kinds, over as many runs in `mode` as that takes. Each must end as an
/// undisturbed one, in free mode with every step counted once, and without a process or a file left in shared memory; fails
/// otherwise. Tells `report` of each run.
pub(crate) fn play(
    mode: Mode,
    seed: u64,
    faults: u64,
    kinds: &[Kind],
    mut report: impl FnMut(&str),
) -> Summary {
    let place = Place::new();
    let mut undisturbed: BTreeMap<usize, Trace> = BTreeMap::new();
    let mut summary = Summary::default();
    while summary.faults < faults {
        let number = summary.runs;
        let which = (mix(seed ^ number) % CONFIGS.len() as u64) as usize;
        let more: &[&str] = if mode == Mode::Free { &["--mode", "free"] } else { LAGS[which] };
        let args = [&ARGS[..], &["--seed", "3"], CONFIGS[which], more].concat();
        let mut run = Run::new(&place, number, &args);
        let first = summary.faults;
        let mut said = String::new();
        while summary.faults < faults.min(first + PER_RUN) {
            let fault = Fault::of(seed, summary.faults, kinds);
            let role = fault.role(CONFIGS[which]);
            let Some(took) = run.befall(&fault, &role) else { break };
            summary.faults += 1;
            summary.recoveries.extend(took);
            let took = took.map_or(String::new(), |took| format!(" ({} ms)", took.as_millis()));
            said += &format!(" {:?} {role}{took},", fault.kind);
        }
        let trace = run.finish();
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
}

impl<'a> Run<'a> {
    fn new(place: &'a Place, number: u64, args: &[&'a str]) -> Self {
        let name = format!("run-{number}");
        let (args, dir) = (args.to_vec(), place.run(&name));
        let process = Some(start(&place.training(&name, &args)));
        Self { place, name, args, dir, process }
    }

    /// Waits for `condition`; false if the run has ended by itself, well, before.
    fn reaches(&mut self, mut condition: impl FnMut(&RunDir) -> bool) -> bool {
        let Some(process) = &mut self.process else { return false };
        let (mut met, mut running) = (false, true);
        assert!(wait_until(LIMIT, || {
            met = condition(&self.dir);
            running = met || process.is_running();
            met || !running
        }));
        if !running && let Some(process) = self.process.take() {
            process.finish().ok();
        }
        met
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
            Kind::Kill | Kind::Stop | Kind::Pause => {}
        }
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
        if role == "supervisor" {
            self.start_again();
        }
        let recovered = self.reaches(|dir| self::readies(dir, role) > readies);
        // A run that was at its end may have ended nevertheless.
        Some((recovered && !stops).then(|| began.elapsed()))
    }

    /// After the death of the supervisor: waits until its children have gone, and does what a user would.
    fn start_again(&mut self) {
        if let Some(process) = self.process.take() {
            process.finish();
        }
        assert!(wait_until(LIMIT, || processes(self.dir.root()).is_empty()));
        let plan = self.dir.read_plan().ok();
        if let Some(plan) = &plan {
            // A supervisor that died before it had children has nobody who removes what it shared.
            let domain = Domain::of(plan.run);
            if !wait_until(LIMIT / 60, || !domain.root().exists()) {
                domain.remove().unwrap();
            }
        }
        if self.dir.result().exists() {
            // It had finished, and only not said so yet.
            return;
        }
        let resumable = plan.and_then(|plan| checkpoint::newest_resumable(self.dir.root(), &plan).unwrap());
        let more: &[&str] = if resumable.is_some() { &["--resume"] } else { &[] };
        if more.is_empty() && self.dir.root().exists() {
            // Nothing to go on from, and perhaps not even a run.
            fs::remove_dir_all(self.dir.root()).unwrap();
        }
        self.process = Some(start(&self.place.training(&self.name, &[&self.args, more].concat())));
    }

    fn finish(mut self) -> Trace {
        if let Some(process) = self.process.take() {
            process.finish().ok();
        }
        assert_gone(&self.dir);
        assert!(!result(&self.dir).interrupted);
        let trace = Trace::of(&self.dir);
        fs::remove_dir_all(self.dir.root()).unwrap();
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
