//! A deterministic simulation of a run's processes, its disk and its shared memory, under faults that a seed determines.
//!
//! The program's own code prepares, trains, saves, resumes and removes, in simulated processes that take turns. A short run is
//! part of `cargo test`. At length:
//!
//! ```text
//! tests/simulation/run.sh 100000 [SEED]     so many schedules; the first failure is shown with its seed
//! tests/simulation/run.sh 1 SEED            one of them again, with all that happened
//! ```
//!
//! - `world`: the scheduler, the clock, and the ends of processes;
//! - `calls`: the C library's calls, which are where the program meets the simulation;
//! - `disk`: what a power cut leaves;
//! - `wire`: messages;
//! - `processes`: the processes and the user;
//! - `schedule`: what a seed means;
//! - here: whether a schedule ended as it must.
//!
//! *Real*: preparation and resumption, the lock of the directory, the learner's loop with session, records and checkpoints, the loops
//! of actors and mentor-server, the supervisor's table of events and its account of restarts, the making, judging and removing
//! of shared memory, and what a sweep does about a run that is there. *Models*: the starting and reaping of processes, which files
//! they make in shared memory, messages, and what a disk keeps. *Absent*: free mode, processes that hang, and the code of tokio
//! and iceoryx2.
//!
//! Each schedule must end with every run complete after a few commands, and then:
//!
//! - no two processes of different commands, and no two learners, have been able to write into a run's directory at the same time;
//! - no command has been refused but for a run in progress, or a call that failed;
//! - weights, evaluations and episodes are those of an undisturbed run, and every line is whole;
//! - all checkpoints are of one history, and of learners in their order;
//! - shared memory is empty, and beside the runs lies nothing.

#![allow(clippy::unwrap_used)]

mod calls;
mod disk;
mod processes;
mod schedule;
mod wire;
mod world;

use disk::Disk;
use processes::{places, result, user};
use schedule::{Fault, Flaw, Scene, Schedule, What};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::Instant;
use trestle_actor::env::registry;
use trestle_learner::checkpoint::Manifest;
use trestle_proto::config::{self, Config};
use trestle_proto::run_files::CHECKPOINTS_DIR;
use trestle_proto::rundir::RunDir;
use world::{Role, World};

/// The directory of the disk in a world's.
const DISK: &str = "disk";
const PRESET: &str = "maze-small";
/// Schedules after which a long run says how far it is.
const PIECE: u64 = 5000;

/// A run of a few ticks, with checkpoints and evaluations on the way.
const SETS: [&str; 14] = [
    "env.step_limit=12",
    "run.episodes=1000000",
    "run.env_steps=64",
    "run.rollout=4",
    "learner.hidden=[4]",
    "learner.batch=4",
    "learner.warmup=8",
    "learner.replay=12",
    "learner.train_every=2",
    "checkpoint.every_env_steps=12",
    "checkpoint.keep=2",
    "eval.every=2",
    "eval.episodes=1",
    "supervise.restarts=100",
];

/// What the configurations differ in.
const CONFIGS: [&[&str]; 4] = [
    &["run.algo=\"dqn\"", "run.actors=1"],
    &["run.algo=\"dqn\"", "run.actors=2", "run.lag=1"],
    &["run.algo=\"ha-diiqn\"", "run.actors=1"],
    &["run.algo=\"ha-diiqn\"", "run.actors=2"],
];

fn sets() -> Vec<String> {
    SETS.iter().map(ToString::to_string).collect()
}

/// Configuration `at` as typed.
fn typed(at: usize) -> Config {
    static ALL: OnceLock<Vec<Config>> = OnceLock::new();
    let load = |own: &[&str]| {
        let all: Vec<String> = SETS.iter().chain(own).map(ToString::to_string).collect();
        config::load(registry(), PRESET, &all).unwrap()
    };
    ALL.get_or_init(|| world::aside(|| CONFIGS.iter().map(|own| load(own)).collect()))[at].clone()
}

/// All of a finished run that depends on its configuration alone.
#[derive(Clone, Debug, PartialEq)]
struct Outcome {
    weights_sha256: String,
    /// Without `wall_s`.
    evals: Vec<String>,
    /// Without times.
    episodes: Vec<serde_json::Value>,
}

impl Outcome {
    fn of(dir: &Path) -> Result<Self, String> {
        let said = |error: &dyn std::fmt::Display, what: &str| format!("{}, {what}: {error}", dir.display());
        let run = RunDir::new(dir);
        let weights_sha256 = result(dir).ok_or("no result")?.weights_sha256;
        let evals = fs::read_to_string(run.evals()).map_err(|e| said(&e, "evals.csv"))?;
        let mut rows = Vec::new();
        for line in evals.lines() {
            let mut fields: Vec<&str> = line.split(',').collect();
            if fields.len() != 7 {
                return Err(format!("{}: evals.csv has the line {line:?}", dir.display()));
            }
            fields.remove(3);
            rows.push(fields.join(","));
        }
        let mut episodes = Vec::new();
        for line in fs::read_to_string(run.metrics()).map_err(|e| said(&e, "metrics.jsonl"))?.lines() {
            let mut row: serde_json::Value =
                serde_json::from_str(line).map_err(|e| said(&e, &format!("metrics.jsonl, {line:?}")))?;
            let row = row.as_object_mut().ok_or("metrics.jsonl: no object")?;
            if row.contains_key("rollout/ep_rew") {
                row.retain(|key, _| !key.contains("time_elapsed"));
                episodes.push(serde_json::Value::Object(std::mem::take(row)));
            }
        }
        Ok(Self { weights_sha256, evals: rows, episodes })
    }
}

/// What a schedule came to.
struct Played {
    /// All that happened, as a number.
    trace: u64,
    steps: u64,
    outcomes: Vec<Outcome>,
    /// What is wrong, if anything is.
    failure: Option<String>,
    /// What happened last, in words.
    log: Vec<String>,
}

/// Plays `schedule`; `expected`: what each run must come to.
fn play(schedule: &Schedule, expected: Option<&[Outcome]>) -> Played {
    let place = tempfile::Builder::new().prefix("trestle-simulation-").tempdir_in("/dev/shm").unwrap();
    for dir in [DISK, "shm"] {
        fs::create_dir(place.path().join(dir)).unwrap();
    }
    let disk = Disk::new(&place.path().join(DISK), schedule.power).unwrap();
    let world = World::new(place.path(), schedule, disk);
    let (inner, Schedule { scene, config, io, .. }) = (world.clone(), schedule.clone());
    world.play(move || user(&inner, scene, config, io));
    let (failure, trace, steps, log) = {
        let mut state = world.lock();
        (state.failure.take(), state.trace, state.steps, state.log.drain(..).collect())
    };
    let mut outcomes = Vec::new();
    let checked = failure.map_or(Ok(()), Err).and_then(|()| {
        for (dir, _) in places(place.path(), schedule.scene, &typed(schedule.config)) {
            outcomes.push(Outcome::of(&dir)?);
            check_checkpoints(&dir)?;
        }
        check_rest(place.path(), schedule)?;
        match expected {
            Some(expected) if expected != outcomes => {
                Err(format!("it came to {outcomes:#?}, undisturbed to {expected:#?}"))
            }
            _ => Ok(()),
        }
    });
    let mut log: Vec<String> = log;
    if checked.is_err() {
        tree(place.path(), &mut log);
    }
    Played { trace, steps, outcomes, failure: checked.err(), log }
}

/// The names and sizes of all that is below `dir`.
fn tree(dir: &Path, into: &mut Vec<String>) {
    let mut entries: Vec<_> = fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        let meta = fs::symlink_metadata(&path).unwrap();
        into.push(format!(
            "{} {}",
            path.display(),
            if meta.is_file() { meta.len().to_string() } else { String::new() }
        ));
        if meta.is_dir() {
            tree(&path, into);
        }
    }
}

/// All of one history, by learners in their order.
fn check_checkpoints(dir: &Path) -> Result<(), String> {
    let plan = RunDir::new(dir).read_plan().map_err(|e| e.to_string())?;
    let mut found: BTreeMap<String, Manifest> = BTreeMap::new();
    for entry in fs::read_dir(dir.join(CHECKPOINTS_DIR)).map_err(|e| e.to_string())?.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let text = fs::read_to_string(entry.path().join("MANIFEST")).map_err(|e| format!("{name}: {e}"))?;
        found.insert(name, serde_json::from_str(&text).map_err(|e| e.to_string())?);
    }
    let mut generation = 0;
    for (name, manifest) in &found {
        if manifest.history != format!("{:016x}", plan.life.history) || manifest.generation < generation {
            return Err(format!("checkpoint {name} is of another past: {:?}", manifest.history));
        }
        generation = manifest.generation;
    }
    if found.is_empty() { Err("no checkpoint is left".into()) } else { Ok(()) }
}

/// Nothing is left that does not belong to the runs.
fn check_rest(root: &Path, schedule: &Schedule) -> Result<(), String> {
    let names = |dir: &Path| -> Vec<String> {
        let entries = fs::read_dir(dir).unwrap();
        let mut names: Vec<_> =
            entries.map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    };
    let shm = names(&root.join("shm"));
    if !shm.is_empty() {
        return Err(format!("left in shared memory: {shm:?}"));
    }
    // After a power cut what had been replaced may be there again, which the next command says.
    let replaced = places(root, schedule.scene, &typed(schedule.config));
    for (dir, _) in replaced.into_iter().filter(|_| !schedule.power) {
        let beside = names(dir.parent().unwrap());
        if beside.iter().any(|name| name.contains(".replaced-") || name.contains(".removed-")) {
            return Err(format!("left beside the runs: {beside:?}"));
        }
    }
    Ok(())
}

/// What an undisturbed run comes to.
fn undisturbed(scene: Scene, config: usize) -> &'static [Outcome] {
    static KNOWN: OnceLock<Vec<Vec<Outcome>>> = OnceLock::new();
    let all = KNOWN.get_or_init(|| {
        let scenes = [Scene::Run, Scene::Sweep];
        let each = scenes.into_iter().flat_map(|scene| (0..CONFIGS.len()).map(move |at| (scene, at)));
        each.map(|(scene, at)| {
            let played = play(&Schedule::calm(scene, at), None);
            assert_eq!(played.failure, None, "{scene:?} {at}: {:#?}", played.log);
            played.outcomes
        })
        .collect()
    });
    &all[scene as usize * CONFIGS.len() + config]
}

/// Plays the schedule of `seed`.
fn play_seed(seed: u64) -> Played {
    let schedule = Schedule::of(seed, CONFIGS.len());
    play(&schedule, Some(undisturbed(schedule.scene, schedule.config)))
}

/// Plays `count` schedules from seed `first` on; the first failure, by its seed, if there is one.
fn play_all(first: u64, count: u64) -> Option<(u64, Played)> {
    let workers = thread::available_parallelism().map_or(1, |n| n.get() as u64).min(count);
    let (next, failed) = (AtomicU64::new(0), AtomicU64::new(u64::MAX));
    undisturbed(Scene::Run, 0);
    thread::scope(|scope| {
        for worker in 0..workers {
            let (next, failed) = (&next, &failed);
            scope.spawn(move || {
                pin(worker as usize);
                loop {
                    let seed = first + next.fetch_add(1, Ordering::Relaxed);
                    if seed >= first + count || failed.load(Ordering::Relaxed) < seed {
                        return;
                    }
                    if play_seed(seed).failure.is_some() {
                        failed.fetch_min(seed, Ordering::Relaxed);
                    }
                }
            });
        }
    });
    let seed = failed.into_inner();
    (seed < u64::MAX).then(|| (seed, play_seed(seed)))
}

/// Keeps this thread, and those that it starts, on one processor: they take turns in any case.
fn pin(worker: usize) {
    use nix::sched::{CpuSet, sched_getaffinity, sched_setaffinity};
    use nix::unistd::Pid;
    let Ok(allowed) = sched_getaffinity(Pid::from_raw(0)) else { return };
    let all: Vec<usize> = (0..CpuSet::count()).filter(|&at| allowed.is_set(at).unwrap_or(false)).collect();
    let mut own = CpuSet::new();
    if own.set(all[worker % all.len()]).is_ok() {
        // Slower without.
        let _ = sched_setaffinity(Pid::from_raw(0), &own);
    }
}

/// `name` of the environment, or what is usual.
fn asked(name: &str, usual: u64) -> u64 {
    std::env::var(name).map_or(usual, |text| text.parse().unwrap_or_else(|_| panic!("{name}={text}")))
}

#[test]
fn whatever_befalls_a_run_it_ends_as_an_undisturbed_one() {
    let (first, count) = (asked("TRESTLE_SEED", 1), asked("TRESTLE_SCHEDULES", 100));
    let began = Instant::now();
    let seconds = || began.elapsed().as_secs_f64();
    // In pieces, so that a long run says how far it is, and can be gone on with from there.
    for from in (first..first + count).step_by(PIECE as usize) {
        let piece = PIECE.min(first + count - from);
        if let Some((seed, Played { failure, log, .. })) = play_all(from, piece) {
            panic!(
                "seed {seed}: {}\n{:#?}\n{}",
                failure.unwrap_or_else(|| "it did not fail again".into()),
                Schedule::of(seed, CONFIGS.len()),
                log.join("\n")
            );
        }
        if count > PIECE {
            println!("seeds {from} to {}: none failed, {:.0} s so far", from + piece - 1, seconds());
        }
    }
    if count == 1 {
        println!("{}", play_seed(first).log.join("\n"));
    }
    println!("{count} schedules from seed {first} on, none of which failed, in {:.0} s", seconds());
}

/// A start that is stopped before it trains takes away what it has made. Killed at any step of that, it leaves nothing that the next
/// command cannot begin with.
#[test]
fn a_start_may_be_killed_while_it_is_given_up() {
    for stop in [110, 150] {
        for later in 1..100 {
            let kill = Fault { after: stop + later, what: What::Kill(Role::Supervisor) };
            let faults = vec![Fault { after: stop, what: What::Stop }, kill];
            let schedule = Schedule { faults, ..Schedule::calm(Scene::Run, 0) };
            let played = play(&schedule, Some(undisturbed(Scene::Run, 0)));
            assert_eq!(played.failure, None, "{:?}: {:#?}", schedule.faults, played.log);
        }
    }
}

/// What was once wrong is found where it is put back, and by how it shows.
#[test]
fn each_former_flaw_is_found() {
    let flaws = [
        (Flaw::LockOfSupervisor, "lives, which writes there, too"),
        (Flaw::NothingCleared, "left in shared memory"),
        (Flaw::HalfForWhole, "a command is refused"),
    ];
    for (flaw, shows) in flaws {
        let found = (1..1000).find_map(|seed| {
            let mut schedule = Schedule { flaw: Some(flaw), ..Schedule::of(seed, CONFIGS.len()) };
            if flaw == Flaw::HalfForWhole {
                schedule.scene = Scene::Sweep;
            }
            let played = play(&schedule, Some(undisturbed(schedule.scene, schedule.config)));
            played.failure.filter(|failure| failure.contains(shows)).map(|failure| (seed, failure))
        });
        let (seed, failure) = found.unwrap_or_else(|| panic!("{flaw:?} is not found"));
        println!("{flaw:?}: seed {seed}: {}", failure.lines().next().unwrap_or_default());
    }
}

#[test]
fn a_seed_tells_the_whole_story() {
    for seed in [3, 17] {
        let [one, other] = [play_seed(seed), play_seed(seed)];
        assert_eq!((one.trace, one.steps), (other.trace, other.steps), "seed {seed}");
    }
}
