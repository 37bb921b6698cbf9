//! From a configuration to a run directory with its plan, or a refusal that leaves nothing behind.
//!
//! Everything that can be refused is refused before the first file is written. Until the run has begun to train, the
//! directory can still be given up; what `--overwrite` replaces is kept beside it until then.

use crate::build_info::BuildInfo;
use anyhow::{Context, Result, bail, ensure};
use nix::sys::statvfs::statvfs;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};
use trestle_learner::checkpoint;
use trestle_learner::record::RunResult;
use trestle_mentor_server::demo_file;
use trestle_mentor_server::demonstration::Demonstration;
use trestle_mentor_server::metric::Metric;
use trestle_mentor_server::summary::summarise;
use trestle_proto::config::{self, Config, Mode};
use trestle_proto::plan::RunPlan;
use trestle_proto::rundir::{RunDir, write_atomically};
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
    pub(crate) demonstration: Option<Demonstration>,
    pub(crate) metric: Option<Metric>,
}

/// A run directory that is ready for its processes.
#[derive(Debug)]
pub(crate) struct Prepared {
    dir: RunDir,
    plan: RunPlan,
    /// Whether this start made the directory.
    fresh: bool,
    /// Where the run that is being replaced waits.
    replaced: Option<PathBuf>,
}

/// Resolves and checks everything about `config` that needs its map and its demonstration.
pub(crate) fn resolve(mut config: Config) -> Result<Resolved> {
    config.validate()?;
    trestle_actor::env::resolve(&mut config.env, config.run.seed)?;
    let env = trestle_actor::env::build(&config.env)?;
    let spec = env.spec().clone();
    spec.validate()?;
    let (demonstration, metric) = if config.run.algo.has_mentor() {
        let demonstration = demonstration(&config, &spec)?;
        let metric = Metric::from_config(
            config.mentor.covariance,
            config.mentor.sigma_floor,
            &spec.scale,
            &demonstration,
        )?;
        (Some(demonstration), Some(metric))
    } else {
        (None, None)
    };
    let resolved = Resolved { config, spec, demonstration, metric };
    trestle_qnet::network_of(&resolved.plan(0, None))?;
    Ok(resolved)
}

/// The demonstration that `config` names: planned, or read from a file.
fn demonstration(config: &Config, spec: &EnvSpec) -> Result<Demonstration> {
    if config.mentor.demo == "plan" {
        let states = trestle_actor::env::plan_states(&config.env, &config.mentor.actions)?;
        let names = (0..spec.obs_dim()).map(|i| format!("s{i}")).collect();
        let mut demonstration = Demonstration::new(names)?;
        demonstration.push_trajectory(&states.concat(), true)?;
        return Ok(demonstration);
    }
    let path = Path::new(&config.mentor.demo);
    let demonstration = demo_file::read(path)?;
    let (found, expected) = (demonstration.dim(), spec.obs_dim());
    ensure!(
        found == expected,
        "mentor.demo = {}: its states have {found} features; accepted: {expected}, as in {}",
        path.display(),
        spec.name
    );
    Ok(demonstration)
}

impl Resolved {
    /// What is likely to be a mistake, though it could be run.
    pub(crate) fn warning(&self) -> Option<String> {
        let (demonstration, metric) = (self.demonstration.as_ref()?, self.metric.as_ref()?);
        let mentor = &self.config.mentor;
        summarise(demonstration, metric, mentor.n as usize).warning(mentor.e_th)
    }

    fn plan(&self, run: u64, resume_tick: Option<u64>) -> RunPlan {
        RunPlan {
            run,
            config: self.config.clone(),
            spec: self.spec.clone(),
            mentor_len: self.demonstration.as_ref().map_or(0, Demonstration::n_transitions),
            resume_tick,
        }
    }

    /// Whether a run with this result has reached the limits of this configuration.
    fn reached(&self, result: &RunResult) -> bool {
        let run = &self.config.run;
        run.episodes.is_some_and(|limit| result.episodes >= limit)
            || run.env_steps.is_some_and(|limit| result.env_steps >= limit)
    }

    /// Makes the run directory `root`, or takes it over, as `existing` says.
    pub(crate) fn prepare(self, root: &Path, existing: Existing) -> Result<Prepared> {
        let dir = RunDir::new(root);
        let occupied = occupied(root)?;
        let resume_tick = match existing {
            Existing::Resume => Some(self.check_resume(&dir)?),
            Existing::Keep if occupied => {
                bail!("{} exists; accepted: another --out, --resume, or --overwrite", root.display())
            }
            Existing::Overwrite if occupied && !dir.config().is_file() => bail!(
                "--overwrite: {} holds something that is not a run (it has no config.toml); remove it yourself",
                root.display()
            ),
            _ => None,
        };
        let plan = self.plan(new_identity(), resume_tick);
        if self.config.run.mode == Mode::Lockstep {
            check_shared_memory(Sizes::of(&plan).shared_memory_bytes())?;
        }
        let mut prepared = Prepared { dir, plan, fresh: resume_tick.is_none(), replaced: None };
        if prepared.fresh && occupied {
            let aside = aside(root)?;
            fs::rename(root, &aside).with_context(|| format!("cannot move {} aside", root.display()))?;
            prepared.replaced = Some(aside);
        }
        if let Err(error) = prepared.write(&self) {
            prepared.give_up(false)?;
            return Err(error);
        }
        Ok(prepared)
    }

    /// The tick of the newest complete checkpoint, if this configuration may go on from it: only the run's length may
    /// differ from what the directory holds.
    fn check_resume(&self, dir: &RunDir) -> Result<u64> {
        let path = dir.config();
        let text =
            fs::read_to_string(&path).with_context(|| format!("--resume: cannot read {}", path.display()))?;
        let mut before = config::parse_toml(&path.display().to_string(), &text)?;
        before.run.episodes = self.config.run.episodes;
        before.run.env_steps = self.config.run.env_steps;
        if before != self.config {
            let (old, new) = (config::to_toml(&before), config::to_toml(&self.config));
            let differing = old.lines().zip(new.lines()).find(|(old, new)| old != new);
            let (old, new) = differing.unwrap_or(("more settings", "fewer settings"));
            bail!(
                "--resume: {} was made with other settings: `{old}` there, `{new}` here; accepted: the same, but \
                 for run.episodes and run.env_steps",
                dir.root().display()
            );
        }
        if let Ok(text) = fs::read_to_string(dir.result())
            && let Ok(result) = serde_json::from_str::<RunResult>(&text)
            && !result.interrupted
            && self.reached(&result)
        {
            bail!(
                "--resume: {} is complete; accepted: a higher --episodes or --env-steps",
                dir.root().display()
            );
        }
        match checkpoint::newest_resumable(dir.root())? {
            Some((tick, _)) => Ok(tick),
            None => bail!("--resume: {} holds no checkpoint to go on from", dir.checkpoints().display()),
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

    /// The run has begun to train: what it replaces is no longer needed.
    pub(crate) fn commit(&self) -> Result<()> {
        match &self.replaced {
            Some(aside) if aside.exists() => fs::remove_dir_all(aside)
                .with_context(|| format!("cannot remove the replaced run in {}", aside.display())),
            _ => Ok(()),
        }
    }

    /// The run has failed or was stopped. If it had not begun to train, the directory becomes what it was before.
    pub(crate) fn give_up(&self, began: bool) -> Result<()> {
        let root = self.dir.root();
        if began || !self.fresh {
            return Ok(());
        }
        if root.exists() {
            fs::remove_dir_all(root).with_context(|| format!("cannot remove {}", root.display()))?;
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
        let build = serde_json::to_string_pretty(&BuildInfo::new())?;
        write_atomically(&dir.build(), format!("{build}\n").as_bytes())?;
        if let Some(demonstration) = &resolved.demonstration {
            demo_file::write(&dir.demonstration(), demonstration)?;
        }
        write_atomically(&dir.plan(), &self.plan.encode()?)?;
        Ok(())
    }
}

/// Whether there is anything at `path` that a new run would disturb.
fn occupied(path: &Path) -> Result<bool> {
    match fs::read_dir(path) {
        Ok(mut entries) => Ok(entries.next().is_some()),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(false),
        Err(e) => Err(e).with_context(|| format!("cannot use {} as a run's directory", path.display())),
    }
}

/// A name beside `root` for the run that is being replaced.
fn aside(root: &Path) -> Result<PathBuf> {
    let name = root.file_name().with_context(|| format!("{} has no name", root.display()))?;
    let mut aside = name.to_os_string();
    aside.push(format!(".replaced-{}", std::process::id()));
    Ok(root.with_file_name(aside))
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
