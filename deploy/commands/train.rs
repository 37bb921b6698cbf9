//! `trestle train`

use super::watch;
use crate::carrier::{Listening, Remote};
use crate::cli::{Beside, Train};
use crate::itself;
use crate::prepare::{self, Existing};
use crate::reference;
use crate::status::{ExitCode, INTERRUPTED};
use crate::supervise::{self, Ended, HeldSignals};
use crate::sweep::manifest::Manifest;
use anyhow::{Result, ensure};
use std::io::{self, Write, stdout};
use std::path::{Path, PathBuf};
use trestle_actor::env::registry;
use trestle_link::logging;
use trestle_proto::config::{self, Config, Environments, Mode};
use trestle_proto::run_files::CONFIG_FILE;
use trestle_proto::run_result::RunResult;
use trestle_proto::rundir::RunDir;
use trestle_report::effect::Effect;

/// Where runs go that no directory is named for.
const RUNS: &str = "runs";

pub(super) fn run(args: &Train) -> Result<ExitCode> {
    logging::init(0, "supervisor", "warn");
    let existing = match (args.resume, args.overwrite) {
        (true, _) => Existing::Resume,
        (_, true) => Existing::Overwrite,
        _ => Existing::Keep,
    };
    let (source, of) = named(&args.typed.source.config, existing)?;
    let config = config::load_with(registry(), &source, &args.typed.sets(), |config| args.apply(config))?;
    let root = match (&args.out, of) {
        (Some(out), _) => out.clone(),
        (None, Some(run)) if existing == Existing::Resume => run,
        (None, _) => default_out(&args.typed.source.config, &config),
    };
    show(args.beside, &root)?;
    prepare::recover(&root)?.iter().for_each(|note| crate::output::say(note));
    go(config, &root, existing, &args.remote, args.quiet)
}

/// Serves the page of the run in `root` beside it, if that is asked for: one of those in `runs` together with them.
pub(super) fn show(beside: Beside, root: &Path) -> Result<()> {
    let among = root.parent().filter(|parent| *parent == Path::new(RUNS));
    match (among, root.file_name().and_then(|name| name.to_str())) {
        (Some(runs), Some(name)) => watch::beside(beside, runs, Some(name)),
        _ => watch::beside(beside, root, None),
    }
}

/// The configuration that `typed` names, and the run that it belongs to, if it does. With `--resume` a run's directory stands
/// for its configuration.
fn named(typed: &str, existing: Existing) -> Result<(String, Option<PathBuf>)> {
    // A name without a directory is a preset's, whatever lies there.
    let preset = registry().presets().iter().any(|preset| preset.name == typed);
    ensure!(
        preset || !Manifest::path(Path::new(typed)).is_file(),
        "{typed} holds a sweep and is no configuration; accepted: `trestle sweep --resume --out {typed}`, which goes on with it"
    );
    let Some(run) = prepare::run_of(Path::new(typed)).filter(|_| !preset) else {
        return Ok((typed.into(), None));
    };
    let config = RunDir::new(&run).config();
    ensure!(
        existing == Existing::Resume || Path::new(typed).ends_with(CONFIG_FILE),
        "{typed} is a run and no configuration; accepted: `trestle resume {run}`, which goes on with it, or \
         `trestle train {} --out DIR`, which begins another one like it",
        config.display(),
        run = run.display()
    );
    if existing == Existing::Keep {
        crate::output::say(&format!(
            "note: this begins another run like {run}; `trestle resume {run}` goes on with that one",
            run = run.display()
        ));
    }
    Ok((config.display().to_string(), Some(run)))
}

/// Trains with `config` in the directory `root`, and says what came of it. What a killed start has left beside the directory has
/// been put right.
pub(super) fn go(
    config: Config,
    root: &Path,
    existing: Existing,
    remote: &Remote,
    quiet: bool,
) -> Result<ExitCode> {
    let existing = match existing {
        // A batch script types the same command each time, the first time included.
        Existing::Resume if !root.exists() || prepare::nothing_saved(root) => {
            crate::output::say(&format!("note: nothing is saved in {}: the run begins", root.display()));
            Existing::Unsaved
        }
        existing => existing,
    };
    let metrics = RunDir::new(root).metrics();
    if existing == Existing::Resume && RunDir::new(root).config().exists() && !metrics.exists() {
        crate::output::say(&format!("note: {} is missing: a new one is begun", metrics.display()));
    }
    let typed = config.run.mode;
    if typed == Mode::Reference && existing != Existing::Resume {
        itself::hand_over(&config.env)?;
    }
    let resolved = match existing {
        Existing::Resume => match prepare::resolve_run(root, &config) {
            Err(_) if prepare::given_up(root)? => return go(config, root, existing, remote, quiet),
            resolved => resolved?,
        },
        Existing::Keep | Existing::Unsaved | Existing::Overwrite => prepare::resolve(config)?,
    };
    let mode = resolved.config.run.mode;
    let listening = Listening::of(remote, &resolved.config.run)?;
    if mode != typed {
        crate::output::say("note: a run that began in one process goes on in several, with the same weights");
    }
    for warning in resolved.warnings() {
        crate::output::say(&format!("warning: {warning}"));
    }
    // From here on there is something that an early Ctrl-C must not leave behind.
    let held = HeldSignals::new()?;
    let mut prepared = resolved.prepare(root, existing)?;
    if let Some(listening) = listening {
        prepared.listen(listening);
    }
    if let Some(from) = prepared.from().filter(|_| !quiet) {
        crate::output::say(from);
    }
    for weakness in prepare::weaknesses(root) {
        crate::output::say(&format!("note: {weakness}"));
    }
    let ended = match mode {
        Mode::Lockstep | Mode::Free => supervise::run(prepared, held, quiet)?,
        Mode::Reference => reference::run(&prepared, held, quiet)?,
    };
    match ended {
        Ended::Complete(result) => {
            // Nobody may be reading; the run has still done what was asked.
            let _ = report(&mut stdout().lock(), &result, root, quiet);
            Ok(ExitCode::SUCCESS)
        }
        Ended::Interrupted(result) => {
            if let Some(result) = result {
                let _ = report(&mut stdout().lock(), &result, root, quiet);
                crate::output::say(&format!("interrupted; `trestle resume {}` goes on", root.display()));
            } else if RunDir::new(root).last().exists() {
                crate::output::say(&format!(
                    "interrupted; `trestle resume {}` goes on from the newest checkpoint",
                    root.display()
                ));
            } else {
                crate::output::say("interrupted before anything was saved");
            }
            Ok(ExitCode::from(INTERRUPTED))
        }
    }
}

/// `runs/<config>-<algo>-seed<N>`
fn default_out(name: &str, config: &Config) -> PathBuf {
    let stem = Path::new(name).file_stem().unwrap_or_default().to_string_lossy().replace(':', "-");
    Path::new(RUNS).join(format!("{stem}-{}-seed{}", config.arm(), config.run.seed))
}

/// The result in a few lines on standard output, and what to type next.
fn report(out: &mut impl Write, r: &RunResult, root: &Path, quiet: bool) -> io::Result<()> {
    let at = |episode: Option<u64>, steps: Option<u64>| match (episode, steps) {
        (Some(episode), Some(steps)) => format!("episode {episode}, {steps} environment steps"),
        _ => "not reached".into(),
    };
    let number = |value: Option<f64>| value.map_or("none".into(), |v| format!("{v:.2}"));
    writeln!(out, "{} on {}, seed {}: {}", r.algo, r.env, r.seed, root.display())?;
    writeln!(out, "  solved   {}", at(r.solved_episode, r.solved_env_steps))?;
    writeln!(out, "  optimal  {}", at(r.optimal_episode, r.optimal_env_steps))?;
    writeln!(
        out,
        "  greedy return  last {}, best {}, threshold {}",
        number(r.final_return),
        number(r.best_return),
        number(r.threshold)
    )?;
    writeln!(
        out,
        "  {} episodes, {} environment steps, {} gradient steps in {:.1} s",
        r.episodes, r.env_steps, r.grad_steps, r.wall_s
    )?;
    if let Some(effect) = Effect::of(r) {
        match effect.warning() {
            Some(warning) => writeln!(out, "  warning: {warning}")?,
            None => writeln!(out, "  mentor   {effect}")?,
        }
    }
    writeln!(out, "  weights_sha256  {}", r.weights_sha256)?;
    if !quiet {
        writeln!(out, "next: trestle eval {}", root.display())?;
    }
    Ok(())
}
