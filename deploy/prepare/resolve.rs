//! From a configuration to an experiment, or a refusal. Nothing is written here.

use super::probes::Needs;
use super::{columns, possible};
use anyhow::{Context, Result, bail, ensure};
use std::cmp::Ordering;
use std::path::{Path, PathBuf};
use trestle_actor::env::{EnvError, Environment, registry};
use trestle_algorithm::demonstration::Demonstration;
use trestle_algorithm::learned_bridges;
use trestle_algorithm::rivals;
use trestle_algorithm::similarity::metric::Metric;
use trestle_algorithm::summary::{Summary, summarise, unreachable};
use trestle_learner::checkpoint;
use trestle_mentor_server::demo_file;
use trestle_proto::config::{self, Config, Demos, GuideKind, MetricKind, Mode, PLAN, RivalKind, Threshold};
use trestle_proto::experiment::{Experiment, MentorPart};
use trestle_proto::limits::{MAX_OPTION_WORDS, MAX_TEXT_BYTES};
use trestle_proto::regular_file;
use trestle_proto::rundir::RunDir;
use trestle_proto::space::EnvSpec;

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
    pub(super) each: Vec<(String, Demonstration)>,
    /// All of them as one.
    pub(crate) all: Demonstration,
    pub(crate) summary: Summary,
    /// What its figures are in.
    metric: Metric,
    /// What is odd about their states.
    warnings: Vec<String>,
}

impl Mentors {
    /// Puts numbers in the place of thresholds that are `auto`, and of lengths of learned bridges that are automatic.
    fn resolve(&self, config: &mut Config, spec: &EnvSpec) -> Result<()> {
        if config.guide() == Some(GuideKind::Learned) {
            learned_bridges::resolve(&mut config.mentor, spec, &self.all)?;
        }
        let mentor = &mut config.mentor;
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

/// Resolves and checks everything about `config` that needs its map and its demonstration.
pub(crate) fn resolve(mut config: Config) -> Result<Resolved> {
    config.validate()?;
    registry().resolve(&mut config.env, config.run.seed)?;
    meet(config)
}

/// The run in `root` as it is to go on: with its own settings, map and demonstration, and the limits of `typed`, which
/// must name the same settings. One that began in a single process goes on in several: its weights are the same.
///
/// # Errors
/// There is no run, another minor version of the program made it, or `typed` has other settings.
pub(crate) fn resolve_run(root: &Path, typed: &Config) -> Result<Resolved> {
    let dir = RunDir::new(root);
    check_version(&dir)?;
    let path = dir.config();
    let text = regular_file::read_to_string(&path, MAX_TEXT_BYTES)
        .with_context(|| format!("--resume: {} is no run", root.display()))?;
    let mut own = config::parse_toml(&path.display().to_string(), &text)?;
    own.run.episodes = typed.run.episodes;
    own.run.env_steps = typed.run.env_steps;
    own.run.stop_when_solved = typed.run.stop_when_solved;
    own.learner.threads = typed.learner.threads;
    own.supervise = typed.supervise.clone();
    own.checkpoint.keep = typed.checkpoint.keep;
    own.env.hazard = typed.env.hazard;
    // The run's map and demonstration are in its directory: where they came from no longer matters.
    let mut typed = typed.clone();
    for mode in [&mut own.run.mode, &mut typed.run.mode] {
        if *mode == Mode::Reference {
            *mode = Mode::Lockstep;
        }
    }
    registry().adopt(&mut typed.env, &own.env)?;
    typed.mentor.demo = typed.mentor.demo.map_files(|name, source| {
        own.mentor.demo.get(name).filter(|own| *own != PLAN).unwrap_or(source).into()
    });
    let demo = own.mentor.demo.clone();
    own.mentor.demo = demo.map_files(|name, _| copy_of(&dir, &demo, name).display().to_string());
    let mut resolved =
        meet(own).with_context(|| format!("--resume: a run with the settings in {}", path.display()))?;
    resolved.config.mentor.demo = demo;
    typed.mentor.metric = typed.mentor.metric.of(&resolved.spec);
    look_up(&mut typed, registry().build(&resolved.config.env)?.as_ref())?;
    let own = &resolved.config;
    if let Some(mentors) = &resolved.mentors {
        mentors.resolve(&mut typed, &resolved.spec)?;
    }
    if *own != typed {
        let (old, new) = (config::to_toml(own), config::to_toml(&typed));
        let differing = old.lines().zip(new.lines()).find(|(old, new)| old != new);
        let (old, new) = differing.unwrap_or(("more settings", "fewer settings"));
        bail!(
            "--resume: {} was made with other settings: `{old}` there, `{new}` here; accepted: the same, but for \
             run.episodes, run.env_steps, run.stop_when_solved, learner.threads, checkpoint.keep and what is in [env.hazard] \
             and [supervise]",
            root.display()
        );
    }
    Ok(resolved)
}

/// Refuses the run in `dir` if another minor version of the program made it: its checkpoints may mean something else, even where
/// they look the same.
fn check_version(dir: &RunDir) -> Result<()> {
    if let Err(error) = dir.read_plan()
        && error.other_version() == Some(Ordering::Greater)
    {
        bail!("--resume: {error}");
    }
    let minor = |version: &str| version.rsplit_once('.').map_or(version, |(minor, _)| minor).to_string();
    let own = minor(env!("CARGO_PKG_VERSION"));
    match checkpoint::newest_version(dir.root())? {
        Some(version) if minor(&version) != own => bail!(
            "--resume: {} is a run of version {version}; accepted: version {own}, or that version of the program",
            dir.root().display()
        ),
        _ => Ok(()),
    }
}

/// Where the run in `dir` keeps its own copy of the demonstration called `name`, one of `demos`.
pub(super) fn copy_of(dir: &RunDir, demos: &Demos, name: &str) -> PathBuf {
    if demos.is_one() { dir.demonstration() } else { dir.demonstration_of(name) }
}

/// A configuration with its map meets the environment and the demonstrations.
fn meet(mut config: Config) -> Result<Resolved> {
    registry().ready(&config.env)?;
    let env = registry().build(&config.env)?;
    let mut spec = env.spec().clone();
    config.mentor.metric = config.mentor.metric.of(&spec);
    look_up(&mut config, env.as_ref())?;
    if config.rival.kind == RivalKind::Resets && !env.can_be_put() {
        bail!(EnvError::CannotBePut { env: spec.name });
    }
    let wants_states = registry().wants_states(&config.env)?;
    let mentors = if config.needs_demonstration() || wants_states {
        let mentors = mentors(&config, env.as_ref())?;
        if wants_states {
            registry().take_states(&mut config.env, mentors.all.states())?;
            spec = registry().build(&config.env)?.spec().clone();
        }
        mentors.resolve(&mut config, &spec)?;
        Some(mentors)
    } else {
        None
    };
    let resolved = Resolved { config, spec, mentors };
    let experiment = resolved.experiment();
    let run = &experiment.config.run;
    ensure!(
        !run.stop_when_solved || experiment.threshold().is_some(),
        "run.stop_when_solved = true, but {} has no return that counts as solved; accepted: false, or eval.threshold",
        experiment.spec.name
    );
    let options = experiment.rooms().options.words();
    ensure!(
        options <= MAX_OPTION_WORDS,
        "exploration.guide_whole = true: bridges of up to {} steps for {} mentor transitions of {} features may take {options} words of \
         a message; accepted: up to {MAX_OPTION_WORDS}, as with a smaller mentor.k or a shorter demonstration",
        experiment.config.mentor.k,
        experiment.mentor_len(),
        experiment.spec.obs_dim()
    );
    trestle_qnet::network_of(&experiment)?;
    rivals::check(&experiment)?;
    trestle_qnet::kernels_of(&experiment)?;
    Ok(resolved)
}

/// Puts numbers in the place of the names of features.
fn look_up(config: &mut Config, env: &dyn Environment) -> Result<()> {
    let dim = env.spec().obs_dim();
    Ok(config.mentor.features.resolve("mentor.features", &env.features(), dim)?)
}

/// The demonstrations that `config` names.
fn mentors(config: &Config, env: &dyn Environment) -> Result<Mentors> {
    let mut warnings = Vec::new();
    let each = config.mentor.demo.iter().map(|(name, source)| {
        let (demonstration, warning) = demonstration(config, source, env)?;
        warnings.extend(warning);
        Ok((name.to_string(), demonstration))
    });
    let each = each.collect::<Result<Vec<_>>>()?;
    let mut rest = each.iter();
    let (_, first) = rest.next().context("mentor.demo names no demonstration")?;
    let mut all = first.clone();
    rest.try_for_each(|(_, demonstration)| all.append(demonstration))?;
    let mentor = &config.mentor;
    let metric = Metric::of(mentor, env.spec(), all.states())?;
    let velocities = if mentor.metric == MetricKind::Delta { &env.spec().velocities[..] } else { &[] };
    let mut summary = summarise(&all, &metric, mentor.n as usize, velocities);
    // The names of a recording without names are numbers, which say less.
    for ((number, (own, ..)), name) in summary.features.iter_mut().enumerate().zip(env.features()) {
        if *own == format!("s{number}") {
            *own = name.to_string();
        }
    }
    Ok(Mentors { each, all, summary, metric, warnings })
}

/// The demonstration from `source`, planned or read from a file, and what there is to warn of.
fn demonstration(
    config: &Config,
    source: &str,
    env: &dyn Environment,
) -> Result<(Demonstration, Option<String>)> {
    let spec = env.spec();
    if source == PLAN {
        let states = registry().plan_states(&config.env, &config.mentor.actions)?;
        let names = (0..spec.obs_dim()).map(|i| format!("s{i}")).collect();
        let mut demonstration = Demonstration::new(names)?;
        demonstration.push_trajectory(&states.concat(), true)?;
        return Ok((demonstration, None));
    }
    let path = Path::new(source);
    let demonstration = demo_file::read(path)?;
    let demonstration = columns::complete(config, path, demonstration, env)?;
    let warning = possible::check(path, &demonstration, env)?;
    Ok((demonstration, warning))
}

impl Resolved {
    /// What is likely to be a mistake, though it could be run.
    pub(crate) fn warnings(&self) -> Vec<String> {
        let mentor = &self.config.mentor;
        // A resolved configuration's settings are accepted.
        let mut warnings = registry().warnings(&self.config.env).unwrap_or_default();
        if self.threshold().is_none() && !self.spec.defines_success {
            warnings.push(format!(
                "nothing says which return of {} counts as solved, so no run is, and `trestle demo record` knows no success; \
                 eval.threshold says it",
                self.spec.name
            ));
        }
        let Some(mentors) = &self.mentors else { return warnings };
        warnings.extend(mentors.warnings.iter().cloned());
        let annotates = self.config.run.algo.has_mentor();
        if let (true, Some(e_th), Some(e_infeas)) = (annotates, mentor.e_th.known(), mentor.e_infeas.known())
        {
            warnings.extend(mentors.summary.warnings(e_th, e_infeas));
            if !self.spec.integral {
                let (summary, metric) = (&mentors.summary, &mentors.metric);
                warnings.extend(unreachable(summary, metric, &self.spec.scale, e_th, e_infeas));
            }
        }
        warnings
    }

    /// The return that counts as solved, if one is known.
    pub(crate) fn threshold(&self) -> Option<f64> {
        self.config.eval.threshold.or(self.spec.threshold).or(self.spec.best_return)
    }

    /// What the run computes.
    pub(super) fn experiment(&self) -> Experiment {
        let part = |(name, demonstration): &(String, Demonstration)| MentorPart {
            name: name.clone(),
            transitions: demonstration.n_transitions(),
        };
        // Shaping and learned bridges need a demonstration, but no mentor-server.
        let mentors = self.mentors.as_ref().filter(|_| self.config.run.algo.has_mentor());
        let waypoints = self.mentors.as_ref().filter(|_| self.config.needs_waypoints());
        let mut waypoints = waypoints.map(|mentors| mentors.all.waypoints());
        let mut spec = self.spec.clone();
        if self.config.rival.kind == RivalKind::DShape {
            waypoints = waypoints.map(|waypoints| waypoints.with_goals(spec.obs_dim()));
            spec = spec.with_goals();
        }
        Experiment {
            config: self.config.clone(),
            spec,
            mentors: mentors.into_iter().flat_map(|mentors| &mentors.each).map(part).collect(),
            waypoints,
        }
    }

    /// What a run takes of the machine, at the most.
    pub(crate) fn needs(&self) -> Needs {
        Needs::of(&self.experiment())
    }
}
