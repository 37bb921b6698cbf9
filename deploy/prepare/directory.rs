//! A run's directory: made, taken over, replaced or given up.
//!
//! Until the run has begun to train, the directory can still be given up; what `--overwrite` replaces is kept beside it
//! until then.

use super::aside::{discard, move_aside};
use super::fence::Fence;
use super::ground::map_file;
use super::probes::{Needs, check};
use super::resolve::{Resolved, copy_of};
use super::states::{clear_away, clear_unborn, empty, is_unborn, nothing_saved, remove_temporaries};
use crate::build_info::BuildInfo;
use crate::carrier::Listening;
use crate::itself;
use anyhow::{Context, Result, bail, ensure};
use rustix::rand::{GetRandomFlags, getrandom};
use std::cell::{Cell, RefCell};
use std::fs::{self, DirBuilder};
use std::io::{ErrorKind, Write};
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};
use trestle_learner::checkpoint;
use trestle_learner::session::check_records;
use trestle_link::log_file;
use trestle_mentor_server::demo_file;
use trestle_proto::config::{self, Mode};
use trestle_proto::experiment::Experiment;
use trestle_proto::hosts_file::{self, HostRow, HostState};
use trestle_proto::plan::{Life, RunPlan};
use trestle_proto::regular_file;
use trestle_proto::round::Round;
use trestle_proto::run_result::RunResult;
use trestle_proto::rundir::{Durable, RunDir, write_atomically};

/// Largest `result.json` that is read, bytes.
const MAX_RESULT: u64 = 1 << 20;

/// Largest `command.txt` that is read, bytes: a command line has up to 2 MiB, and the newest ones have as many together.
const MAX_COMMANDS: u64 = 8 << 20;
/// Command lines that `command.txt` keeps beside the first and the present one.
const MAX_RESUMES: usize = 98;

/// What to do with a directory that exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Existing {
    /// Keep what is there: the start is refused if the directory holds anything.
    Keep,
    /// Go on from its newest complete checkpoint.
    Resume,
    /// Begin anew in place of a run that has saved nothing. Refused if something is saved by the time that the directory is locked.
    Unsaved,
    /// Replace the run in it.
    Overwrite,
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
    /// Where the run goes on from, if it does.
    from: Option<String>,
    /// Keeps other runs away.
    fence: Fence,
    /// How other hosts join, if they do.
    listening: Option<Listening>,
    /// The rows of `hosts.csv`.
    hosts: RefCell<Vec<HostRow>>,
}

impl Resolved {
    /// Whether a run with these counts has reached the limits of this configuration.
    fn reached(&self, episodes: u64, env_steps: u64) -> bool {
        let run = &self.config.run;
        run.episodes.is_some_and(|limit| episodes >= limit)
            || run.env_steps.is_some_and(|limit| env_steps >= limit)
    }

    /// Makes the run directory `root`, or takes it over, as `existing` says.
    pub(crate) fn prepare(mut self, root: &Path, existing: Existing) -> Result<Prepared> {
        let dir = RunDir::new(root);
        // From the top where another start has given the directory up meanwhile.
        let fence = loop {
            if existing == Existing::Keep || !occupied(root)? {
                break None;
            }
            if let Some(fence) = Fence::take(root)? {
                break Some(fence);
            }
        };
        // Somebody may have been at it until the lock was free. A directory that has come without a lock is `make`'s to judge.
        let occupied = (fence.is_some() || existing == Existing::Keep) && occupied(root)?;
        clear_away(root, fence.as_ref().is_some_and(Fence::holds));
        let followed = match existing {
            Existing::Resume => Some(self.check_resume(&dir)?),
            Existing::Keep if occupied => {
                bail!("{} exists; accepted: another --out, --resume, or --overwrite", root.display())
            }
            // Another command may have trained there between the caller's look and the lock.
            Existing::Unsaved if occupied && !nothing_saved(root) => bail!(
                "{} exists by now: another command has trained in it; accepted: `trestle resume {0}`",
                root.display()
            ),
            Existing::Overwrite if occupied && !is_unborn(root) && !is_run(&dir) => bail!(
                "--overwrite: {} holds something that is not a run (it has no readable plan.bin); remove it yourself",
                root.display()
            ),
            _ => None,
        };
        if followed.is_none() {
            // So that the run's own configuration needs no other file.
            let base = RunDir::new(
                std::path::absolute(root).with_context(|| format!("cannot find {}", root.display()))?,
            );
            let demos = &self.config.mentor.demo;
            self.config.mentor.demo =
                demos.map_files(|name, _| copy_of(&base, demos, name).display().to_string());
        }
        let mut from = None;
        let run = draw()?;
        let life = match &followed {
            None => Life { run, history: draw()?, ..Life::default() },
            Some(former) => Life { run, generation: next_generation(former.generation)?, ..*former },
        };
        if let Some(tick) = life.resume_tick {
            check_records(&dir, tick).context("--resume")?;
            let at = checkpoint::counters(&checkpoint::directory(root, tick))?;
            from = Some(format!(
                "going on from episode {} and environment step {}, the checkpoint of tick {tick}",
                at.episodes, at.env_steps
            ));
        }
        let plan = RunPlan { life, experiment: self.experiment() };
        if self.config.run.mode != Mode::Reference {
            check(&Needs::of(&plan.experiment))?;
        }
        let fresh = followed.is_none();
        if !fresh {
            remove_temporaries(root)?;
        }
        let replaced = if fresh && occupied && !is_unborn(root) { Some(move_aside(root)?) } else { None };
        let made = !root.exists();
        // The former directory stays locked until the new one is: nobody takes it for what a killed start left.
        let (former, fence) = if replaced.is_some() { (fence, None) } else { (None, fence) };
        let fence = match fence {
            Some(fence) => {
                clear_unborn(root)?;
                fence
            }
            None => make(root, fresh, existing).inspect_err(|_| {
                // Where the directory is another start's by now, the replaced run stays aside if there is anything in it.
                if let Some(aside) = &replaced
                    && fs::rename(aside, root).is_err()
                    && nothing_saved(aside)
                    && let Err(error) = discard(aside)
                {
                    tracing::warn!("{error:#}");
                }
            })?,
        };
        drop(former);
        let prepared = Prepared {
            dir,
            plan,
            fresh,
            made,
            replaced,
            began: Cell::new(false),
            from,
            fence,
            listening: None,
            hosts: RefCell::default(),
        };
        prepared.write(&self)?;
        prepared.from.iter().for_each(|from| prepared.note(from));
        Ok(prepared)
    }

    /// What the run in `root` came to, if it has reached the limits of this configuration or stopped because it is solved.
    pub(crate) fn complete(&self, root: &Path) -> Option<RunResult> {
        let text = regular_file::read_to_string(&RunDir::new(root).result(), MAX_RESULT).ok()?;
        let result: RunResult = serde_json::from_str(&text).ok()?;
        (self.stopped_when_solved(&result) || self.reached(result.episodes, result.env_steps))
            .then_some(result)
    }

    /// What ended the run that came to `result`, and what would let it go on.
    fn limits_of(&self, result: &RunResult) -> (String, &'static str) {
        let run = &self.config.run;
        let limit = |key: &str, limit: Option<u64>, count| {
            limit.filter(|&limit| count >= limit).map(|limit| format!("run.{key} = {limit}"))
        };
        let limits = [
            limit("episodes", run.episodes, result.episodes),
            limit("env_steps", run.env_steps, result.env_steps),
        ];
        let mut limits: Vec<String> = limits.into_iter().flatten().collect();
        let solved = self.stopped_when_solved(result).then(|| "it is solved".into());
        let accepted = match (limits.is_empty(), solved.is_some()) {
            (true, _) => "--set run.stop_when_solved=false",
            (false, false) => "a higher --episodes or --env-steps",
            (false, true) => "a higher --episodes or --env-steps, with --set run.stop_when_solved=false",
        };
        limits.extend(solved);
        (limits.join(", "), accepted)
    }

    fn stopped_when_solved(&self, result: &RunResult) -> bool {
        self.config.run.stop_when_solved && result.solved_episode.is_some() && !result.interrupted
    }

    /// Whether the run in `root` has a checkpoint that this configuration can go on from.
    pub(crate) fn has_checkpoint(&self, root: &Path) -> Result<bool> {
        Ok(checkpoint::newest_resumable(root, &self.former(&RunDir::new(root))?)?.is_some())
    }

    /// The plan by which the last learner worked in `dir`, as far as it matters to its checkpoints.
    fn former(&self, dir: &RunDir) -> Result<RunPlan> {
        let experiment = self.experiment();
        let life = match dir.read_plan() {
            Ok(plan) => plan.life,
            // A plan that cannot be read any more is not needed to go on.
            Err(_) => checkpoint::newest_life(dir.root(), &experiment)?.unwrap_or_default(),
        };
        Ok(RunPlan { life, experiment })
    }

    /// The life of the learner to follow, from the newest checkpoint on that this configuration can go on from.
    fn check_resume(&self, dir: &RunDir) -> Result<Life> {
        let root = dir.root().display();
        if let Some(result) = self.complete(dir.root()) {
            let (limits, accepted) = self.limits_of(&result);
            bail!(
                "--resume: {root} is complete with {} episodes and {} environment steps ({limits}); accepted: {accepted}",
                result.episodes,
                result.env_steps,
            );
        }
        let former = self.former(dir)?;
        match checkpoint::newest_resumable(dir.root(), &former)? {
            Some((tick, _)) => Ok(Life { resume_tick: Some(tick), ..former.life }),
            None if checkpoint::any_complete(dir.root())? => bail!(
                "--resume: the run cannot go on from any of the checkpoints in {root}, for the reasons above; accepted: \
                 --overwrite, which begins anew"
            ),
            None => bail!(
                "--resume: {root} holds no checkpoint to go on from; accepted: --overwrite, which begins anew"
            ),
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

    /// What the run computes.
    pub(crate) fn experiment(&self) -> &Experiment {
        &self.plan.experiment
    }

    /// Where the run goes on from, in words, if it does not begin anew.
    pub(crate) fn from(&self) -> Option<&str> {
        self.from.as_deref()
    }

    /// The lock of the run's directory.
    pub(crate) fn fence(&self) -> &Fence {
        &self.fence
    }

    /// Some of the run's actors are on other hosts.
    pub(crate) fn listen(&mut self, listening: Listening) {
        self.listening = Some(listening);
    }

    /// How other hosts join, if they do.
    pub(crate) fn listening(&self) -> Option<&Listening> {
        self.listening.as_ref()
    }

    /// The run has begun to train: what it replaces is of no use any more.
    pub(crate) fn commit(&self) -> Result<()> {
        self.began.set(true);
        match &self.replaced {
            Some(aside) if aside.exists() => discard(aside),
            _ => Ok(()),
        }
    }

    /// The tick of the newest checkpoint that the run can go on from, if there is one.
    pub(crate) fn newest_checkpoint(&self) -> Result<Option<Round>> {
        Ok(checkpoint::newest_resumable(self.dir.root(), &self.plan)?.map(|(tick, _)| tick))
    }

    /// The tick that the link to the newest checkpoint names, whether that is sound or not: for a caller that only wants to know
    /// whether the run gets ahead.
    pub(crate) fn last_checkpoint(&self) -> Option<Round> {
        checkpoint::last(self.dir.root())
    }

    /// Makes the directory ready for another start of all processes, from checkpoint `tick` or from the beginning. The
    /// run gets a new identity, so that nothing of the former start can be mistaken for its own.
    pub(crate) fn restart_from(&mut self, tick: Option<Round>) -> Result<()> {
        check(&Needs::of(&self.plan.experiment))?;
        self.plan.life.run = draw()?;
        self.replace_learner(tick)
    }

    /// Makes the directory ready for another learner, which goes on from checkpoint `tick` or from the beginning.
    pub(crate) fn replace_learner(&mut self, tick: Option<Round>) -> Result<()> {
        self.plan.life.resume_tick = tick;
        self.plan.life.generation = next_generation(self.plan.life.generation)?;
        self.count_restart()
    }

    /// Notes that one process more has been started again.
    pub(crate) fn count_restart(&mut self) -> Result<()> {
        self.plan.life.restarts += 1;
        self.write_plan()
    }

    fn write_plan(&self) -> Result<()> {
        save(&self.dir.plan(), &self.plan.encode()?)
    }

    /// Adds a line to the supervisor's log.
    pub(crate) fn note(&self, text: &str) {
        let path = self.dir.log("supervisor");
        let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
        let written = log_file::open(&path).and_then(|mut file| writeln!(file, "{seconds} {text}"));
        if let Err(error) = written {
            tracing::warn!("cannot write {}: {error}", path.display());
        }
    }

    /// Takes what the relay tells of another host, `row` as JSON, over into `hosts.csv`.
    pub(crate) fn tell_host(&self, row: &str) {
        match serde_json::from_str(row) {
            Ok(row) => hosts_file::update(&mut self.hosts.borrow_mut(), row),
            Err(error) => {
                return tracing::warn!("the relay told of a host what cannot be read ({error}): {row}");
            }
        }
        self.write_hosts();
    }

    /// Another relay takes the place of the former one, and with that all hosts are lost that had joined.
    pub(crate) fn lose_hosts(&self) {
        let mut lost = false;
        for row in self.hosts.borrow_mut().iter_mut().filter(|row| row.state == HostState::Joined) {
            (row.state, lost) = (HostState::Lost, true);
        }
        if lost {
            self.write_hosts();
        }
    }

    fn write_hosts(&self) {
        let (path, text) = (self.dir.hosts(), hosts_file::to_csv(&self.hosts.borrow()));
        if let Err(error) = write_atomically(&path, Durable::Later, |file| file.write_all(text.as_bytes())) {
            tracing::warn!("cannot write {}: {error}", path.display());
        }
    }

    /// Makes the directory what it was before this start.
    fn give_up(&self) -> Result<()> {
        let root = self.dir.root();
        if self.made {
            discard(root)?;
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
        let text = regular_file::read_to_string(&path, MAX_RESULT)?;
        serde_json::from_str(&text).with_context(|| format!("{} is no result", path.display()))
    }

    fn write(&self, resolved: &Resolved) -> Result<()> {
        let dir = &self.dir;
        fs::create_dir_all(dir.logs()).with_context(|| format!("cannot make {}", dir.logs().display()))?;
        // It tells of the hosts since the newest start.
        match fs::remove_file(dir.hosts()) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                return Err(error).with_context(|| format!("cannot remove {}", dir.hosts().display()));
            }
            _ => {}
        }
        save(&dir.config(), config::to_toml(&resolved.config).as_bytes())?;
        let command: Vec<String> = itself::args().iter().map(|arg| quoted(&arg.to_string_lossy())).collect();
        let former = if self.fresh { String::new() } else { former_commands(dir) };
        save(&dir.command(), format!("{former}{}\n", command.join(" ")).as_bytes())?;
        if let Some(map) = map_file(&resolved.config.env)? {
            save(&dir.map(), format!("{}\n", serde_json::to_string(&map)?).as_bytes())?;
        }
        let build = serde_json::to_string_pretty(&BuildInfo::new(&resolved.config.env))?;
        save(&dir.build(), format!("{build}\n").as_bytes())?;
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
        self.write_plan()
    }
}

impl Drop for Prepared {
    fn drop(&mut self) {
        // Whatever this process has not heard of yet: a run that has saved something is not taken away.
        if self.fresh
            && !self.began.get()
            && nothing_saved(self.dir.root())
            && let Err(error) = self.give_up()
        {
            tracing::error!("{error:#}");
        }
    }
}

/// Makes the run directory `root`, if it is not there, and takes it for this process. It is its user's alone until that user
/// says otherwise: it holds copies of demonstrations. One that is there keeps its mode.
fn make(root: &Path, fresh: bool, existing: Existing) -> Result<Fence> {
    let mut private = DirBuilder::new();
    private.mode(0o700);
    let fence = loop {
        let made = root.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| private.create(root));
        match made {
            // Another start has given the directory up in between.
            Err(e) if e.kind() == ErrorKind::AlreadyExists && fs::symlink_metadata(root).is_err() => continue,
            Err(e) if e.kind() != ErrorKind::AlreadyExists || !root.is_dir() => {
                return Err(e).with_context(|| format!("cannot make {}", root.display()));
            }
            _ => {}
        }
        if let Some(fence) = Fence::take(root)? {
            break fence;
        }
    };
    if matches!(existing, Existing::Unsaved | Existing::Overwrite) {
        clear_unborn(root)?;
    }
    // Another start may have been quicker, and be over.
    ensure!(!fresh || !occupied(root)?, "{} exists by now; accepted: another --out", root.display());
    Ok(fence)
}

/// The command lines of a run that goes on: the first one, and the newest later ones. None if the file cannot be read, which is
/// no reason to refuse the run.
fn former_commands(dir: &RunDir) -> String {
    let Ok(text) = regular_file::read_to_string(&dir.command(), MAX_COMMANDS) else { return String::new() };
    let lines: Vec<&str> = text.lines().collect();
    let Some((first, rest)) = lines.split_first() else { return String::new() };
    let mut room = (MAX_COMMANDS / 2) as usize;
    let newest = rest.iter().rev().take_while(|line| {
        let fits = line.len() < room;
        room = room.saturating_sub(line.len() + 1);
        fits
    });
    let mut kept: Vec<&str> = newest.copied().take(MAX_RESUMES).collect();
    kept.push(*first);
    kept.iter().rev().fold(String::new(), |text, line| text + line + "\n")
}

/// Writes a small file of the run.
fn save(path: &Path, bytes: &[u8]) -> Result<()> {
    write_atomically(path, Durable::Now, |file| file.write_all(bytes))
        .with_context(|| format!("cannot write {}", path.display()))
}

/// Whether there is anything at `path` that a new run would disturb.
fn occupied(path: &Path) -> Result<bool> {
    match fs::read_dir(path) {
        Ok(mut entries) => Ok(entries.next().is_some()),
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(false),
        Err(e) => Err(e).with_context(|| format!("cannot use {} as a run's directory", path.display())),
    }
}

/// Whether `dir` holds a run, of this version or another.
fn is_run(dir: &RunDir) -> bool {
    dir.read_plan().map_or_else(|error| error.other_version().is_some(), |_| true)
}

/// The number of the learner's start after `generation`.
fn next_generation(generation: u16) -> Result<u16> {
    generation.checked_add(1).context("the learner has been started 65536 times")
}

/// 64 bits that nobody can guess. A run's identity begins the names of its files in a directory where everybody may create
/// some; that it is no other run's is found out when the run gets its place there.
pub(crate) fn draw() -> Result<u64> {
    let mut word = [0; 8];
    getrandom(&mut word, GetRandomFlags::empty()).context("the system gives no random numbers")?;
    Ok(u64::from_ne_bytes(word))
}

/// `arg` as a shell would need it.
pub(crate) fn quoted(arg: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,+@%".contains(c);
    if !arg.is_empty() && arg.chars().all(plain) {
        arg.into()
    } else {
        format!("'{}'", arg.replace('\'', r"'\''"))
    }
}
