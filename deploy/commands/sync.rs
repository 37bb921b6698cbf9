//! `trestle sync`: the trackers' own libraries are Python's, so the Python package sends what is in the files of runs.

use crate::cli::Sync;
use crate::itself::command;
use crate::status::ExitCode;
use crate::stored::read_experiment;
use anyhow::{Context, Result, bail, ensure};
use serde_json::json;
use std::os::unix::process::CommandExt;
use std::process::Stdio;
use trestle_actor::env::{again, registry};
use trestle_proto::rundir::RunDir;

/// The subcommand of the Python package that does the work.
const SENDER: &str = "tracker-sync";
/// What runs that name no Python are sent with.
const PYTHON: &str = "python3";

pub(super) fn run(args: &Sync) -> Result<ExitCode> {
    ensure!(
        args.dir.is_dir(),
        "{} is no directory; accepted: a run, a sweep, or any directory with runs in it",
        args.dir.display()
    );
    let dir =
        args.dir.to_str().with_context(|| format!("{}; accepted: a path in UTF-8", args.dir.display()))?;
    let order = json!({"dir": dir, "to": args.to.name(), "project": args.project, "once": args.once, "quiet": args.quiet});
    let words = sender(args);
    let python = &words[0];
    let package = format!("trestle-rl[{}]", args.to.name());
    let how = format!(
        "`trestle sync` is part of the Python package; accepted: {python} with it: pip install '{package}'"
    );
    let mut found = command(&words[..1]);
    found.args(["-c", "import importlib.util as u, sys; sys.exit(u.find_spec('trestle') is None)"]);
    match found.stdin(Stdio::null()).stderr(Stdio::null()).status() {
        Ok(status) if status.success() => {}
        Ok(_) => bail!("{python} has no package trestle: {how}"),
        Err(error) => bail!("cannot start {python}: {error}: {how}"),
    }
    let error = command(&words).arg(SENDER).arg(order.to_string()).exec();
    Err(error).with_context(|| format!("cannot start {python}"))
}

/// The words that start the Python package: this program's own if it is that, or else that of the run's environment.
fn sender(args: &Sync) -> Vec<String> {
    let own = again();
    if own.len() > 1 {
        return own;
    }
    let experiment = read_experiment(&RunDir::new(&args.dir)).ok();
    let foreign = experiment.and_then(|experiment| registry().foreign(&experiment.config.env)?.program);
    foreign.unwrap_or_else(|| [PYTHON, "-m", "trestle"].map(Into::into).into())
}
