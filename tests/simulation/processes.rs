//! The processes of a run, and who types the commands.
//!
//! Learner, mentor-server and actors are the loops of the program. The supervisor is a model around the program's own
//! preparation, table of events, account of restarts, and removal of shared memory: what is modelled is the starting and
//! reaping of processes, and which files a process makes in shared memory. The order in which that is done is that of
//! `deploy/supervise/mod.rs`.

use super::schedule::{Flaw, Scene};
use super::wire::Seat;
use super::world::{End, MS, Mail, On, Role, World, aside, here};
use super::{DISK, typed};
use crate::output::words;
use crate::prepare::{self, Existing, Prepared};
use crate::status::{INTERRUPTED, LOST_PEER, ORPHANED, TOLD};
use crate::supervise::children::{Death, How, Role as ChildRole};
use crate::supervise::restarts::{Restarts, Verdict};
use crate::supervise::watch::{self, Action, Event, Reach, State};
use crate::sweep::{self, Outcome, arms::Arm, manifest::Manifest};
use anyhow::{Context, Result, bail, ensure};
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::sync::Arc;
use std::time::Instant;
use trestle_actor::worker::Worker;
use trestle_learner::checkpoint;
use trestle_link::LinkError;
use trestle_link::iceoryx::{Departure, Domain, HeldDomain};
use trestle_link::local::{LocalActor, LocalLearner, LocalMentor, Wire};
use trestle_mentor_server::demo_file;
use trestle_proto::config::Config;
use trestle_proto::limits::{BLAME, GRACE};
use trestle_proto::plan::RunPlan;
use trestle_proto::run_result::RunResult;
use trestle_proto::rundir::RunDir;

/// Files that the model of the services makes in shared memory.
const SERVICES: usize = 2;
/// Commands that a user types before giving up, once nothing befalls the run any more.
const PATIENCE: usize = 6;

/// The same where much befalls it.
const MOST: usize = 40;

fn own() -> usize {
    here().map_or(0, |place| place.world.lock().process_of(place.thread))
}

fn wait(world: &World, on: On, time: Option<u64>) -> Result<()> {
    let there = here().is_some_and(|place| world.wait(place.thread, on, time));
    if there { Ok(()) } else { bail!("the process has ended") }
}

/// This process has given its run's directory up.
fn writes_no_more(world: &World) {
    let own = own();
    world.lock().processes[own].writes = None;
}

/// The next mail of this process, if some comes in time.
fn mail(world: &World, time: Option<u64>) -> Result<Option<Mail>> {
    wait(world, On::Mail, time)?;
    let own = own();
    Ok(world.lock().processes[own].mail.pop_front())
}

/// The seeds of a sweep's runs.
pub(super) const SEEDS: [u64; 2] = [0, 1];

/// Where the runs of `scene` are, and the seed of each.
pub(super) fn places(root: &Path, scene: Scene, config: &Config) -> Vec<(PathBuf, u64)> {
    let disk = root.join(DISK);
    match scene {
        Scene::Run => vec![(disk.join("run"), 0)],
        Scene::Sweep => {
            let arm = config.run.algo.name();
            SEEDS.map(|seed| (sweep::manifest::run_dir(&disk.join("sweep"), arm, seed), seed)).to_vec()
        }
    }
}

/// What the run in `dir` came to, if it is complete.
pub(super) fn result(dir: &Path) -> Option<RunResult> {
    let text = fs::read_to_string(RunDir::new(dir).result()).ok()?;
    serde_json::from_str::<RunResult>(&text).ok().filter(|result| !result.interrupted)
}

/// Types commands until all is complete.
pub(super) fn user(world: &Arc<World>, scene: Scene, config: usize, io: bool) {
    if let Err(error) = try_user(world, scene, config, io) {
        let mut state = world.lock();
        if state.failure.is_none() {
            state.fail(words(&error));
        }
    }
}

fn try_user(world: &Arc<World>, scene: Scene, config: usize, io: bool) -> Result<()> {
    let places = places(&world.root, scene, &typed(config));
    let (mut commands, mut tries, mut cleaned, mut said) = (0, 0, 0, String::new());
    loop {
        let (there, complete) = aside(|| {
            let complete = places.iter().all(|(dir, _)| result(dir).is_some());
            (places.iter().any(|(dir, _)| dir.exists()), complete)
        });
        let alive = world.lock().processes.iter().any(|p| p.role == Role::Supervisor && p.end.is_none());
        if complete && !alive {
            // The last of the processes may have had nobody to remove what they shared or had put aside: the next command does,
            // unless a call of it fails.
            while world.lock().processes.iter().skip(1).any(|process| process.end.is_none()) {
                wait(world, On::Time, Some(100 * MS))?;
            }
            let shared = aside(|| fs::read_dir(world.root.join("shm")))?.next().is_some();
            let put_aside = |dir: &PathBuf| dir.parent().is_some_and(prepare::has_leftovers);
            cleaned += 1;
            if !shared && !aside(|| places.iter().any(|(dir, _)| put_aside(dir))) || cleaned > PATIENCE {
                return Ok(());
            }
            let last = command(world, scene, config, true);
            wait(world, On::Process(last), None)?;
            continue;
        }
        let quiet = world.lock().is_quiet();
        tries += usize::from(quiet && !alive);
        commands += 1;
        if alive {
            // Somebody is at it: there is no hurry.
            wait(world, On::Time, Some(100 * MS))?;
        }
        if tries > PATIENCE || commands > MOST {
            bail!("it is never complete; the last command said: {said}");
        }
        let first = command(world, scene, config, there);
        loop {
            let news = mail(world, None)?;
            match news {
                // Typed while the first still goes on: by the same user, or another one.
                Some(Mail::Another) => _ = command(world, scene, config, true),
                Some(Mail::Ended { role: Role::Supervisor, end, words }) => {
                    if end == End::Exited(1) {
                        // Of two commands at once one is too late.
                        let known = [
                            "a run is in progress there",
                            "exists by now",
                            "exists; accepted",
                            "is complete with",
                        ];
                        // One may look while another one is making the directory.
                        let between = words.contains("is no run") && {
                            let state = world.lock();
                            state.processes.iter().any(|p| p.role == Role::Supervisor && p.end.is_none())
                        };
                        if !io && !between && !known.iter().any(|known| words.contains(known)) {
                            bail!("a command is refused: {words}");
                        }
                        said = words;
                    }
                    let pause = {
                        let mut state = world.lock();
                        if state.random(2) == 0 { 0 } else { state.random(400 * MS) }
                    };
                    wait(world, On::Time, Some(pause + 1))?;
                    if !world.lock().is_alive(first) {
                        break;
                    }
                }
                _ => {}
            }
        }
    }
}

/// Starts what is typed: to begin, or to go on with what is there.
fn command(world: &Arc<World>, scene: Scene, config: usize, there: bool) -> usize {
    let (inner, user) = (world.clone(), own());
    world.start(Role::Supervisor, user, Vec::new(), move || {
        let done = match scene {
            Scene::Run => train(&inner, config, there),
            Scene::Sweep => sweep(&inner, config, there),
        };
        match done {
            Ok(status) => (status, String::new()),
            Err(error) => (1, words(&error)),
        }
    })
}

/// `trestle train`, or with `resume` what `trestle resume` does, but for what these show.
fn train(world: &Arc<World>, number: usize, resume: bool) -> Result<i32> {
    let root = world.root.join(DISK).join("run");
    prepare::recover(&root)?;
    let config = typed(number);
    let existing = match resume {
        true if !root.exists() || prepare::nothing_saved(&root) => Existing::Unsaved,
        true => Existing::Resume,
        false => Existing::Keep,
    };
    let resolved = match existing {
        Existing::Resume => match prepare::resolve_run(&root, &config) {
            Err(_) if prepare::given_up(&root)? => return train(world, number, resume),
            resolved => resolved?,
        },
        _ => prepare::resolve(config)?,
    };
    let mut prepared = resolved.prepare(&root, existing)?;
    let ended = supervise(world, &mut prepared);
    drop(prepared);
    writes_no_more(world);
    ended
}

/// `trestle sweep`, or with `resume` `trestle sweep --resume`.
fn sweep(world: &Arc<World>, config: usize, resume: bool) -> Result<i32> {
    let out = world.root.join(DISK).join("sweep");
    let config = typed(config);
    let arm = Arm::plain(config.run.algo);
    let (sets, limits) = (super::sets(), crate::flags::Limits::default());
    let arms = [arm];
    let (source, seeds) = (super::PRESET, SEEDS);
    // What is there is a sweep if anything of it is.
    let resume = resume || aside(|| out.exists());
    Manifest::new(source, sets.clone(), limits, arms.to_vec(), seeds.to_vec()).claim(&out, resume)?;
    let mut status = 0;
    for job in sweep::jobs(source, &sets, limits, &arms, &seeds, &out)? {
        let mut prepared = if world.flaw == Some(Flaw::HalfForWhole) {
            match former_ready(&job)? {
                Some(prepared) => prepared,
                None => continue,
            }
        } else {
            let disturbed = job.dir.parent().is_some_and(prepare::has_leftovers);
            match sweep::finished(&job, disturbed) {
                Some(Outcome::Complete(_)) => continue,
                Some(Outcome::Failed(error)) => bail!("{}: {error}", job.dir.display()),
                Some(Outcome::Unfinished) | None => {}
            }
            sweep::ready(&job)?
        };
        let ended = supervise(world, &mut prepared);
        drop(prepared);
        writes_no_more(world);
        match ended? {
            0 => {}
            other => {
                status = other;
                break;
            }
        }
    }
    Ok(status)
}

/// What a sweep once did about a run: none if it was complete.
fn former_ready(job: &sweep::Job) -> Result<Option<Prepared>> {
    if !job.dir.exists() {
        return prepare::resolve(job.config.clone())?.prepare(&job.dir, Existing::Keep).map(Some);
    }
    let resolved = prepare::resolve_run(&job.dir, &job.config)?;
    if resolved.complete(&job.dir).is_some() {
        return Ok(None);
    }
    let way = if resolved.has_checkpoint(&job.dir)? { Existing::Resume } else { Existing::Overwrite };
    resolved.prepare(&job.dir, way).map(Some)
}

/// A run's children, and whether they have ended.
struct Child {
    role: Role,
    process: usize,
    running: bool,
}

/// As `supervise` of the program does it.
fn supervise(world: &Arc<World>, prepared: &mut Prepared) -> Result<i32> {
    let plan = prepared.plan();
    let mut restarts = Restarts::new(plan.experiment.config.supervise.restarts, plan.life.resume_tick);
    loop {
        let death = match attempt(world, prepared)? {
            Ok(status) => return Ok(status),
            Err(death) => death,
        };
        let newest = prepared.newest_checkpoint()?;
        match restarts.after(&death, newest, Instant::now()) {
            Verdict::Again(pause) => wait(world, On::Time, Some(pause.as_nanos() as u64 + 1))?,
            Verdict::End(reason) => bail!("{death}; not started again: {reason}; {}", death.last_words),
        }
        prepared.restart_from(newest)?;
    }
}

/// All processes once: a status, or the death after which they may be started again.
fn attempt(world: &Arc<World>, prepared: &mut Prepared) -> Result<Result<i32, Death>> {
    let domain = Domain::create(prepared.plan().life.run)?;
    let plan = prepared.plan().clone();
    for service in 0..SERVICES {
        let file = Path::new("/dev/shm").join(format!("{}service-{service}", domain.prefix()));
        fs::write(file, "").context("cannot create the run's services")?;
    }
    world.lock().wires.insert(plan.life.run, Wire::of(&plan));
    let root = prepared.dir().root().to_path_buf();
    let mut children = Vec::new();
    let mut start = |role: Role, held| {
        let (inner, root, supervisor) = (world.clone(), root.clone(), own());
        let process = world.start(role, supervisor, held, move || child(&inner, role, &root, supervisor));
        children.push(Child { role, process, running: true });
    };
    let lock =
        if world.flaw == Some(Flaw::LockOfSupervisor) { None } else { prepared.fence().inheritable()? };
    start(Role::Learner, lock.into_iter().collect());
    if plan.experiment.config.run.algo.has_mentor() {
        start(Role::Mentor, Vec::new());
    }
    (0..plan.experiment.config.run.actors).for_each(|actor| start(Role::Actor(actor), Vec::new()));
    let outcome = watch_over(world, prepared, &mut children);
    end_all(world, &mut children, &domain)?;
    outcome
}

/// As the program's `drive`, but that nobody counts as dead who lives.
fn watch_over(world: &Arc<World>, prepared: &Prepared, children: &mut [Child]) -> Result<Result<i32, Death>> {
    let mut state = State::Starting;
    let mut suspect: Option<Death> = None;
    loop {
        let time = suspect.is_some().then_some(BLAME.as_nanos() as u64);
        let mut death = None;
        let event = match mail(world, time)? {
            None => {
                death = suspect.take();
                Event::Blamed(Reach::All)
            }
            Some(Mail::Progress) => Event::Progress,
            Some(Mail::Stop) => Event::Stop,
            Some(Mail::Another) => continue,
            Some(Mail::Ended { role, end, words }) => {
                children
                    .iter_mut()
                    .filter(|child| child.role == role)
                    .for_each(|child| child.running = false);
                if role == Role::Learner && end == End::Exited(0) {
                    Event::Left
                } else {
                    let found =
                        Death { role: child_role(role), how: How::Exited(status(&end)), last_words: words };
                    let event =
                        if found.is_consequence() { Event::LostPeer } else { Event::Died(Reach::All) };
                    death = Some(found);
                    event
                }
            }
        };
        let (next, actions) = watch::step(state, event);
        state = next;
        for action in actions {
            match action {
                Action::Commit => prepared.commit()?,
                Action::Ask => tell(world, children, |role| role == Role::Learner),
                Action::Suspect => suspect = suspect.or(death.take()),
                Action::End(watch::End::Left) => {
                    let left = prepared.read_result()?;
                    return Ok(Ok(if left.interrupted { INTERRUPTED.into() } else { 0 }));
                }
                Action::End(watch::End::Interrupted) => return Ok(Ok(INTERRUPTED.into())),
                Action::End(watch::End::Again) => return Ok(Err(death.context("an end without a death")?)),
                // What would have been saved is lost; what was saved before is there.
                Action::End(watch::End::Failed) => return Ok(Ok(INTERRUPTED.into())),
                _ => {}
            }
        }
    }
}

fn tell(world: &World, children: &[Child], whom: impl Fn(Role) -> bool) {
    let mut state = world.lock();
    for child in children.iter().filter(|child| whom(child.role)) {
        state.processes[child.process].told = true;
    }
}

/// As the program's `end_all`.
fn end_all(world: &World, children: &mut [Child], domain: &HeldDomain) -> Result<()> {
    let learner_left = children.iter().all(|child| child.role != Role::Learner || !child.running);
    if learner_left {
        tell(world, children, |_| true);
    } else {
        domain.remove()?;
    }
    let mut time = if learner_left { GRACE.as_nanos() as u64 } else { 0 };
    while children.iter().any(|child| child.running) {
        match mail(world, Some(time))? {
            Some(Mail::Ended { role, .. }) => {
                children
                    .iter_mut()
                    .filter(|child| child.role == role)
                    .for_each(|child| child.running = false);
            }
            Some(_) => {}
            None => {
                time = GRACE.as_nanos() as u64;
                let mut state = world.lock();
                for child in children.iter().filter(|child| child.running) {
                    state.kill(child.process);
                }
            }
        }
    }
    Ok(())
}

fn child_role(role: Role) -> ChildRole {
    match role {
        Role::Mentor => ChildRole::MentorServer,
        Role::Actor(index) => ChildRole::Actor(index),
        _ => ChildRole::Learner,
    }
}

fn status(end: &End) -> ExitStatus {
    match end {
        End::Killed => ExitStatus::from_raw(9),
        End::Exited(status) => ExitStatus::from_raw(status << 8),
    }
}

/// A process of the run in `root`.
fn child(world: &Arc<World>, role: Role, root: &Path, supervisor: usize) -> (i32, String) {
    match try_child(world, role, root, supervisor) {
        Ok(status) => (status, String::new()),
        Err(error) => {
            let lost = error.chain().filter_map(|cause| cause.downcast_ref::<LinkError>());
            let lost = lost.into_iter().any(LinkError::is_lost_peer);
            (if lost { LOST_PEER.into() } else { 1 }, words(&error))
        }
    }
}

fn try_child(world: &Arc<World>, role: Role, root: &Path, supervisor: usize) -> Result<i32> {
    let (dir, process) = (RunDir::new(root), own());
    let plan = dir.read_plan()?;
    let (inner, run) = (world.clone(), plan.life.run);
    drop(world.spawn(process, move || outlive(&inner, supervisor, run)));
    let index = if let Role::Actor(index) = role { index } else { 0 };
    let stop = || world.lock().processes[process].told;
    let demonstration = (role == Role::Mentor).then(|| demo_file::read(&dir.demonstration())).transpose()?;
    let mut worker = matches!(role, Role::Actor(_)).then(|| worker(&plan, &dir, index)).transpose()?;
    let _departure = join(&plan, role)?;
    let seat = Seat::take(plan.life.run).context("no simulated process")?;
    match role {
        Role::Learner => {
            let progress = Box::new(|_: &_| {
                let mut state = world.lock();
                if state.is_alive(process) {
                    state.processes[supervisor].mail.push_back(Mail::Progress);
                }
            });
            let mut link = LocalLearner::new(seat, &plan);
            trestle_learner::run::run(&mut link, &plan, &dir, &stop, progress)?;
            Ok(0)
        }
        Role::Mentor => {
            let demonstration = demonstration.context("a mentor-server without a demonstration")?;
            let mut link = LocalMentor::new(seat);
            trestle_mentor_server::run::run(&mut link, &plan.experiment, &demonstration, &stop)?;
            Ok(TOLD.into())
        }
        _ => {
            let worker = worker.as_mut().context("an actor without an environment")?;
            let mut link = LocalActor::new(seat, &plan, index);
            trestle_actor::run::run(&mut link, &plan, worker, &stop)?;
            Ok(TOLD.into())
        }
    }
}

fn worker(plan: &RunPlan, dir: &RunDir, index: u32) -> Result<Worker> {
    let mut worker = Worker::new(&plan.experiment, index)?;
    if let Some(tick) = plan.life.resume_tick {
        let states = checkpoint::load_actors(&checkpoint::directory(dir.root(), tick))?;
        worker.restore(states.get(index as usize).context("the checkpoint has no state of this actor")?)?;
    }
    Ok(worker)
}

/// Joins the run's shared memory: a model. The services must be there, and the process makes a file of its own.
fn join(plan: &RunPlan, role: Role) -> Result<Departure> {
    let domain = Domain::of(plan.life.run);
    let departure = Departure::of(&domain);
    ensure!(departure.joined(), "the run is not in progress");
    for service in 0..SERVICES {
        let file = Path::new("/dev/shm").join(format!("{}service-{service}", domain.prefix()));
        fs::metadata(file).context("the run's services are not there")?;
    }
    let name = format!("{}{role:?}", domain.prefix()).replace(['(', ')'], "-");
    fs::write(Path::new("/dev/shm").join(name), "").context("cannot join the run's shared memory")?;
    Ok(departure)
}

/// The thread of a child that waits for the end of its supervisor: it then ends all others, removes what the run shared, and
/// leaves.
fn outlive(world: &Arc<World>, supervisor: usize, run: u64) {
    let late = {
        let mut state = world.lock();
        if state.random(2) == 0 { 0 } else { state.random(300 * MS) }
    };
    if wait(world, On::Process(supervisor), None).is_err() || wait(world, On::Time, Some(late + 1)).is_err() {
        return;
    }
    if let Some(place) = here() {
        world.lock().begin_anew(place.thread);
    }
    if wait(world, On::Siblings, None).is_err() {
        return;
    }
    let removed = Domain::of(run).remove();
    let said = removed.map_or_else(|error| error.to_string(), |()| "the supervisor is gone".into());
    world.exit(ORPHANED.into(), said);
}
