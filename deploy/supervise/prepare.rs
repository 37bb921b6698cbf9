//! From a configuration to a run directory with its plan, or a refusal that leaves nothing behind.
//!
//! Everything that can be refused is refused before the first file is written. Until the run has begun to train, the
//! directory can still be given up; what `--overwrite` replaces is kept beside it until then.

use super::hold::lock;
use crate::build_info::BuildInfo;
use anyhow::{Context, Result, bail, ensure};
use nix::fcntl::Flock;
use nix::sys::statvfs::statvfs;
use std::cell::Cell;
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};
use trestle_learner::checkpoint;
use trestle_learner::record::RunResult;
use trestle_mentor_server::demo_file;
use trestle_mentor_server::demonstration::Demonstration;
use trestle_mentor_server::summary::{Summary, summarise};
use trestle_proto::config::{self, Config, Demos, Mode, PLAN, PhysicsBackend, Threshold};
use trestle_proto::plan::{MentorPart, RunPlan};
use trestle_proto::rundir::{RunDir, write_atomically};
use trestle_proto::similarity::metric::Metric;
use trestle_proto::space::EnvSpec;
use trestle_proto::transport::iceoryx::Domain;
use trestle_proto::transport::iceoryx::services::Sizes;

/// What to do with a directory that exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Existing {
    /// Refuse.
    Keep,
    /// Go on from its newest complete checkpoint.
    Resume,
    /// Replace the run in it.
    Overwrite,
}

/// A configuration that has met its environment and its demonstration: a run could start with it.
#[derive(Clone, Debug)]
pub(crate) struct Resolved {
    pub(crate) config: Config,
    pub(crate) spec: EnvSpec,
    /// None for `dqn`.
    pub(crate) mentors: Option<Mentors>,
}

/// What a run learns from, under its metric.
#[derive(Clone, Debug)]
pub(crate) struct Mentors {
    /// The demonstrations by name, in the order of `mentor.demo`.
    each: Vec<(String, Demonstration)>,
    /// All of them as one.
    pub(crate) all: Demonstration,
    pub(crate) summary: Summary,
}

impl Mentors {
    /// Puts numbers in the place of thresholds that are `auto`.
    fn resolve_thresholds(&self, mentor: &mut config::Mentor) -> Result<()> {
        if mentor.e_th != Threshold::Auto && mentor.e_infeas != Threshold::Auto {
            return Ok(());
        }
        let auto = self.summary.auto().context(
            "mentor.e_th or mentor.e_infeas is auto, but no state of the demonstration differs from those after it; \
             accepted: a number above 0",
        )?;
        for (threshold, kl) in [(&mut mentor.e_th, auto.e_th), (&mut mentor.e_infeas, auto.e_infeas)] {
            if *threshold == Threshold::Auto {
                ensure!(kl > 0.0, "the demonstration's steps are too small for thresholds that are auto");
                *threshold = Threshold::Kl(kl);
            }
        }
        Ok(())
    }
}

/// A run directory that is ready for its processes. If this goes before the run has begun to train, the directory
/// becomes what it was before.
#[derive(Debug)]
pub(crate) struct Prepared {
    dir: RunDir,
    plan: RunPlan,
    /// Whether the run begins anew.
    fresh: bool,
    /// Whether this start made the directory itself.
    made: bool,
    /// Where the run that is being replaced waits.
    replaced: Option<PathBuf>,
    began: Cell<bool>,
    /// Keeps other supervisors away.
    _lock: Option<Flock<File>>,
}

/// Resolves and checks everything about `config` that needs its map and its demonstration.
pub(crate) fn resolve(mut config: Config) -> Result<Resolved> {
    config.validate()?;
    trestle_actor::env::resolve(&mut config.env, config.run.seed)?;
    meet(config)
}

/// The run in `root` as it is to go on: with its own settings, map and demonstration, and the limits of `typed`, which
/// must name the same settings.
pub(crate) fn resolve_run(root: &Path, typed: &Config) -> Result<Resolved> {
    let dir = RunDir::new(root);
    let path = dir.config();
    let text =
        fs::read_to_string(&path).with_context(|| format!("--resume: cannot read {}", path.display()))?;
    let mut own = config::parse_toml(&path.display().to_string(), &text)?;
    own.run.episodes = typed.run.episodes;
    own.run.env_steps = typed.run.env_steps;
    own.run.stop_when_solved = typed.run.stop_when_solved;
    own.supervise = typed.supervise.clone();
    own.env.hazard = typed.env.hazard;
    // The run's map and demonstration are in its directory: where they came from no longer matters.
    let mut typed = typed.clone();
    typed.env.layout.clone_from(&own.env.layout);
    if typed.env.point_maze.backend == PhysicsBackend::Auto {
        typed.env.point_maze.backend = own.env.point_maze.backend;
    }
    typed.mentor.demo = typed.mentor.demo.map_files(|name, source| {
        own.mentor.demo.get(name).filter(|own| *own != PLAN).unwrap_or(source).into()
    });
    let demo = own.mentor.demo.clone();
    own.mentor.demo = demo.map_files(|name, _| copy_of(&dir, &demo, name).display().to_string());
    let mut resolved = meet(own)?;
    resolved.config.mentor.demo = demo;
    let own = &resolved.config;
    if let Some(mentors) = &resolved.mentors {
        mentors.resolve_thresholds(&mut typed.mentor)?;
    }
    if *own != typed {
        let (old, new) = (config::to_toml(own), config::to_toml(&typed));
        let differing = old.lines().zip(new.lines()).find(|(old, new)| old != new);
        let (old, new) = differing.unwrap_or(("more settings", "fewer settings"));
        bail!(
            "--resume: {} was made with other settings: `{old}` there, `{new}` here; accepted: the same, but for \
             run.episodes, run.env_steps, run.stop_when_solved and what is in [env.hazard] and [supervise]",
            root.display()
        );
    }
    Ok(resolved)
}

/// Where the run in `dir` keeps its own copy of the demonstration called `name`, one of `demos`.
fn copy_of(dir: &RunDir, demos: &Demos, name: &str) -> PathBuf {
    if demos.is_one() { dir.demonstration() } else { dir.demonstration_of(name) }
}

/// A configuration with its map meets the environment and the demonstrations.
fn meet(mut config: Config) -> Result<Resolved> {
    let env = trestle_actor::env::build(&config.env)?;
    let spec = env.spec().clone();
    spec.validate()?;
    let mentors = if config.needs_demonstration() {
        let mentors = mentors(&config, &spec)?;
        mentors.resolve_thresholds(&mut config.mentor)?;
        Some(mentors)
    } else {
        None
    };
    let resolved = Resolved { config, spec, mentors };
    let plan = resolved.plan(0, None);
    let run = &plan.config.run;
    ensure!(
        !run.stop_when_solved || plan.threshold().is_some(),
        "run.stop_when_solved = true, but {} has no return that counts as solved; accepted: false, or eval.threshold",
        plan.spec.name
    );
    trestle_qnet::network_of(&plan)?;
    trestle_qnet::kernels_of(&plan)?;
    Ok(resolved)
}

/// The demonstrations that `config` names.
fn mentors(config: &Config, spec: &EnvSpec) -> Result<Mentors> {
    let each = config.mentor.demo.iter().map(|(name, source)| {
        let demonstration = demonstration(config, source, spec)?;
        Ok((name.to_string(), demonstration))
    });
    let each = each.collect::<Result<Vec<_>>>()?;
    let mut rest = each.iter();
    let (_, first) = rest.next().context("mentor.demo names no demonstration")?;
    let mut all = first.clone();
    rest.try_for_each(|(_, demonstration)| all.append(demonstration))?;
    let mentor = &config.mentor;
    let metric = Metric::from_config(mentor.covariance, mentor.sigma_floor, &spec.scale, all.states())?;
    let summary = summarise(&all, &metric, mentor.n as usize);
    Ok(Mentors { each, all, summary })
}

/// The demonstration from `source`: planned, or read from a file.
fn demonstration(config: &Config, source: &str, spec: &EnvSpec) -> Result<Demonstration> {
    if source == PLAN {
        let states = trestle_actor::env::plan_states(&config.env, &config.mentor.actions)?;
        let names = (0..spec.obs_dim()).map(|i| format!("s{i}")).collect();
        let mut demonstration = Demonstration::new(names)?;
        demonstration.push_trajectory(&states.concat(), true)?;
        return Ok(demonstration);
    }
    let path = Path::new(source);
    let demonstration = demo_file::read(path)?;
    let (found, expected) = (demonstration.dim(), spec.obs_dim());
    ensure!(
        found == expected,
        "mentor.demo = {}: its states have {found} features; accepted: {expected}, as in {}",
        path.display(),
        spec.name
    );
    for (row, state) in demonstration.states().chunks_exact(expected).enumerate() {
        for (feature, &value) in state.iter().enumerate() {
            let (low, high) = (spec.low[feature], spec.high[feature]);
            ensure!(
                (low..=high).contains(&value) && (!spec.integral || value.fract() == 0.0),
                "mentor.demo = {}: state {row} has {value} as feature {feature}; accepted: {}{low} to {high}, as in {}",
                path.display(),
                if spec.integral { "whole numbers from " } else { "" },
                spec.name
            );
        }
    }
    Ok(demonstration)
}

impl Resolved {
    /// What is likely to be a mistake, though it could be run.
    pub(crate) fn warnings(&self) -> Vec<String> {
        let mentor = &self.config.mentor;
        match (&self.mentors, mentor.e_th.known(), mentor.e_infeas.known()) {
            (Some(mentors), Some(e_th), Some(e_infeas)) => mentors.summary.warnings(e_th, e_infeas),
            _ => Vec::new(),
        }
    }

    /// What the run's processes need to know.
    fn plan(&self, run: u64, resume_tick: Option<u64>) -> RunPlan {
        let part = |(name, demonstration): &(String, Demonstration)| MentorPart {
            name: name.clone(),
            transitions: demonstration.n_transitions(),
        };
        // Shaping needs a demonstration, but no mentor-server.
        let mentors = self.mentors.as_ref().filter(|_| self.config.run.algo.has_mentor());
        let waypoints = self.mentors.as_ref().filter(|_| self.config.needs_waypoints());
        RunPlan {
            run,
            config: self.config.clone(),
            spec: self.spec.clone(),
            mentors: mentors.into_iter().flat_map(|mentors| &mentors.each).map(part).collect(),
            waypoints: waypoints.map(|mentors| mentors.all.waypoints()),
            resume_tick,
            restarts: 0,
            generation: 0,
        }
    }

    /// Whether a run with these counts has reached the limits of this configuration.
    fn reached(&self, episodes: u64, env_steps: u64) -> bool {
        let run = &self.config.run;
        run.episodes.is_some_and(|limit| episodes >= limit)
            || run.env_steps.is_some_and(|limit| env_steps >= limit)
    }

    /// Makes the run directory `root`, or takes it over, as `existing` says.
    pub(crate) fn prepare(mut self, root: &Path, existing: Existing) -> Result<Prepared> {
        let dir = RunDir::new(root);
        let occupied = occupied(root)?;
        let held = if occupied && existing != Existing::Keep { lock(root)? } else { None };
        let resume_tick = match existing {
            Existing::Resume => Some(self.check_resume(&dir)?),
            Existing::Keep if occupied => {
                bail!("{} exists; accepted: another --out, --resume, or --overwrite", root.display())
            }
            Existing::Overwrite if occupied && dir.read_plan().is_err() => bail!(
                "--overwrite: {} holds something that is not a run (it has no readable plan.bin); remove it yourself",
                root.display()
            ),
            _ => None,
        };
        if resume_tick.is_none() {
            // So that the run's own configuration needs no other file.
            let base = RunDir::new(
                std::path::absolute(root).with_context(|| format!("cannot find {}", root.display()))?,
            );
            let demos = &self.config.mentor.demo;
            self.config.mentor.demo =
                demos.map_files(|name, _| copy_of(&base, demos, name).display().to_string());
        }
        let mut plan = self.plan(new_identity(), resume_tick);
        if resume_tick.is_some() {
            // A plan that cannot be read any more is not needed to go on.
            if let Ok(before) = dir.read_plan() {
                plan.restarts = before.restarts;
                plan.generation = next_generation(before.generation)?;
            }
        }
        if self.config.run.mode != Mode::Reference {
            check_shared_memory(Sizes::of(&plan).shared_memory_bytes())?;
        }
        let fresh = resume_tick.is_none();
        let replaced = if fresh && occupied { Some(move_aside(root)?) } else { None };
        let made = !root.exists();
        let held = match held.filter(|_| !fresh) {
            Some(lock) => Some(lock),
            None => make(root, fresh).inspect_err(|_| {
                // Where the directory is another start's by now, what it would replace stays aside.
                replaced.as_ref().map(|aside| fs::rename(aside, root));
            })?,
        };
        let prepared = Prepared { dir, plan, fresh, made, replaced, began: Cell::new(false), _lock: held };
        prepared.write(&self)?;
        Ok(prepared)
    }

    /// Bytes of shared memory that a run takes, at the most.
    pub(crate) fn shared_memory_bytes(&self) -> u64 {
        Sizes::of(&self.plan(0, None)).shared_memory_bytes()
    }

    /// What the run in `root` came to, if it has reached the limits of this configuration or stopped because it is solved.
    pub(crate) fn complete(&self, root: &Path) -> Option<RunResult> {
        let text = fs::read_to_string(RunDir::new(root).result()).ok()?;
        let result: RunResult = serde_json::from_str(&text).ok()?;
        let stopped =
            self.config.run.stop_when_solved && result.solved_episode.is_some() && !result.interrupted;
        (stopped || self.reached(result.episodes, result.env_steps)).then_some(result)
    }

    /// Whether the run in `root` has a checkpoint that this configuration can go on from.
    pub(crate) fn has_checkpoint(&self, root: &Path) -> Result<bool> {
        Ok(checkpoint::newest_resumable(root, &self.plan(0, None))?.is_some())
    }

    /// The tick of the newest checkpoint that this configuration can go on from.
    fn check_resume(&self, dir: &RunDir) -> Result<u64> {
        let root = dir.root().display();
        if let Some(result) = self.complete(dir.root()) {
            bail!(
                "--resume: {root} is complete with {} episodes and {} environment steps; accepted: a higher --episodes or \
                 --env-steps, or --set run.stop_when_solved=false where it stopped because it is solved",
                result.episodes,
                result.env_steps
            );
        }
        match checkpoint::newest_resumable(dir.root(), &self.plan(0, None))? {
            Some((tick, _)) => Ok(tick),
            None => bail!("--resume: {root} holds no checkpoint to go on from"),
        }
    }
}

impl Prepared {
    pub(crate) fn dir(&self) -> &RunDir {
        &self.dir
    }

    pub(crate) fn plan(&self) -> &RunPlan {
        &self.plan
    }

    /// The place of the run's shared memory.
    pub(crate) fn create_domain(&self) -> Result<Domain> {
        Ok(Domain::create(self.plan.run)?)
    }

    /// The run has begun to train: what it replaces is of no use any more.
    pub(crate) fn commit(&self) -> Result<()> {
        self.began.set(true);
        match &self.replaced {
            Some(aside) if aside.exists() => fs::remove_dir_all(aside)
                .with_context(|| format!("cannot remove the replaced run in {}", aside.display())),
            _ => Ok(()),
        }
    }

    /// The tick of the newest checkpoint that the run can go on from, if there is one.
    pub(super) fn newest_checkpoint(&self) -> Result<Option<u64>> {
        Ok(checkpoint::newest_resumable(self.dir.root(), &self.plan)?.map(|(tick, _)| tick))
    }

    /// The tick that the link to the newest checkpoint names, whether that is sound or not: for whoever only wants to know
    /// whether the run gets ahead.
    pub(super) fn last_checkpoint(&self) -> Option<u64> {
        let target = fs::read_link(self.dir.last()).ok()?;
        target.file_name()?.to_str()?.parse().ok()
    }

    /// Makes the directory ready for another start of all processes, from checkpoint `tick` or from the beginning. The
    /// run gets a new identity, so that nothing of the former start can be mistaken for its own.
    pub(super) fn restart_from(&mut self, tick: Option<u64>) -> Result<()> {
        check_shared_memory(Sizes::of(&self.plan).shared_memory_bytes())?;
        self.plan.run = new_identity();
        self.replace_learner(tick)
    }

    /// Makes the directory ready for another learner, which goes on from checkpoint `tick` or from the beginning.
    pub(super) fn replace_learner(&mut self, tick: Option<u64>) -> Result<()> {
        self.plan.resume_tick = tick;
        self.plan.generation = next_generation(self.plan.generation)?;
        self.count_restart()
    }

    /// Notes that one process more has been started again.
    pub(super) fn count_restart(&mut self) -> Result<()> {
        self.plan.restarts += 1;
        Ok(write_atomically(&self.dir.plan(), &self.plan.encode()?)?)
    }

    /// Adds a line to the supervisor's log.
    pub(super) fn note(&self, text: &str) {
        let path = self.dir.log("supervisor");
        let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
        let written = OpenOptions::new()
            .create(true)
            .append(true)
            .open(&path)
            .and_then(|mut file| writeln!(file, "{seconds} {text}"));
        if let Err(error) = written {
            tracing::warn!("cannot write {}: {error}", path.display());
        }
    }

    /// Makes the directory what it was before this start.
    fn give_up(&self) -> Result<()> {
        let root = self.dir.root();
        if self.made {
            fs::remove_dir_all(root).with_context(|| format!("cannot remove {}", root.display()))?;
        } else {
            empty(root).with_context(|| format!("cannot empty {}", root.display()))?;
        }
        if let Some(aside) = &self.replaced {
            fs::rename(aside, root)
                .with_context(|| format!("cannot put {} back as {}", aside.display(), root.display()))?;
        }
        Ok(())
    }

    /// What the learner left as the outcome.
    pub(crate) fn read_result(&self) -> Result<RunResult> {
        let path = self.dir.result();
        let text = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        serde_json::from_str(&text).with_context(|| format!("{} is no result", path.display()))
    }

    fn write(&self, resolved: &Resolved) -> Result<()> {
        let dir = &self.dir;
        fs::create_dir_all(dir.logs()).with_context(|| format!("cannot make {}", dir.logs().display()))?;
        write_atomically(&dir.config(), config::to_toml(&resolved.config).as_bytes())?;
        let command: Vec<String> = std::env::args_os().map(|arg| quoted(&arg.to_string_lossy())).collect();
        write_atomically(&dir.command(), format!("{}\n", command.join(" ")).as_bytes())?;
        let build = serde_json::to_string_pretty(&BuildInfo::new(&resolved.config.env))?;
        write_atomically(&dir.build(), format!("{build}\n").as_bytes())?;
        if let Some(mentors) = resolved.mentors.as_ref().filter(|_| self.fresh) {
            demo_file::write(&dir.demonstration(), &mentors.all)?;
            let demos = &resolved.config.mentor.demo;
            for (name, demonstration) in mentors.each.iter().filter(|_| !demos.is_one()) {
                let path = dir.demonstration_of(name);
                if let Some(parent) = path.parent() {
                    fs::create_dir_all(parent)
                        .with_context(|| format!("cannot make {}", parent.display()))?;
                }
                demo_file::write(&path, demonstration)?;
            }
        }
        write_atomically(&dir.plan(), &self.plan.encode()?)?;
        Ok(())
    }
}

impl Drop for Prepared {
    fn drop(&mut self) {
        if self.fresh
            && !self.began.get()
            && let Err(error) = self.give_up()
        {
            tracing::error!("{error:#}");
        }
    }
}

/// Makes the run directory `root`, if it is not there, and takes it for this process.
fn make(root: &Path, fresh: bool) -> Result<Option<Flock<File>>> {
    fs::create_dir_all(root).with_context(|| format!("cannot make {}", root.display()))?;
    let lock = lock(root)?;
    // Another start may have been quicker, and be over.
    ensure!(!fresh || !occupied(root)?, "{} exists by now; accepted: another --out", root.display());
    Ok(lock)
}

/// Removes all that is in `dir`.
fn empty(dir: &Path) -> std::io::Result<()> {
    for entry in fs::read_dir(dir)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            fs::remove_dir_all(entry.path())?
        } else {
            fs::remove_file(entry.path())?
        }
    }
    Ok(())
}

/// Whether there is anything at `path` that a new run would disturb.
fn occupied(path: &Path) -> Result<bool> {
    match fs::read_dir(path) {
        Ok(mut entries) => Ok(entries.next().is_some()),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(false),
        Err(e) => Err(e).with_context(|| format!("cannot use {} as a run's directory", path.display())),
    }
}

/// Renames the run that is being replaced; returns where it is.
fn move_aside(root: &Path) -> Result<PathBuf> {
    let name = root.file_name().with_context(|| format!("{} has no name", root.display()))?;
    let mut aside = name.to_os_string();
    aside.push(format!(".replaced-{}", std::process::id()));
    let aside = root.with_file_name(aside);
    fs::rename(root, &aside).with_context(|| format!("cannot move {} aside", root.display()))?;
    Ok(aside)
}

/// The number of the learner's start after `generation`.
fn next_generation(generation: u16) -> Result<u16> {
    generation.checked_add(1).context("the learner has been started 65536 times")
}

/// An identity for the run's shared memory: 32 bits that no living run has; a clash is found when the domain is made.
fn new_identity() -> u64 {
    let nanos = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_nanos() as u64);
    let word = trestle_proto::rng::mix(nanos ^ u64::from(std::process::id()) << 32);
    word >> 32
}

/// Refuses to start where shared memory is missing or too small.
fn check_shared_memory(needed: u64) -> Result<()> {
    let shm = Path::new("/dev/shm");
    let stat = statvfs(shm).with_context(|| {
        format!("{} cannot be used; a run needs {} MiB of shared memory there", shm.display(), needed >> 20)
    })?;
    let free = stat.blocks_available() * stat.fragment_size();
    ensure!(
        free >= needed,
        "{} has {} MiB free; this run needs {} MiB: make room, mount it larger, or lower run.actors, run.rollout \
         or learner.hidden",
        shm.display(),
        free >> 20,
        needed.div_ceil(1 << 20)
    );
    let probe = shm.join(format!("trestle-probe-{}", std::process::id()));
    fs::write(&probe, b"x")
        .and_then(|()| fs::remove_file(&probe))
        .with_context(|| format!("{} cannot be written to", shm.display()))
}

/// `arg` as a shell would need it.
fn quoted(arg: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,+@%".contains(c);
    if !arg.is_empty() && arg.chars().all(plain) {
        arg.into()
    } else {
        format!("'{}'", arg.replace('\'', r"'\''"))
    }
}
