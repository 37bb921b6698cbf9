//! The program that carries messages between hosts, `trestle-relay`: where it is, and its arguments.

use crate::flags::whole;
use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use std::env;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use trestle_hosts::limits::{MAX_SILENCE_S, MIN_SILENCE_S, SILENCE_S};
use trestle_proto::config::{Mode, Run};
use trestle_proto::limits::MAX_ACTORS;

/// Its name.
const NAME: &str = "trestle-relay";
/// Names it where it is nowhere else.
const VARIABLE: &str = "TRESTLE_RELAY";

/// Other hosts of a run. Its result does not depend on them.
#[derive(Clone, Debug, Args)]
pub(crate) struct Remote {
    /// Actors of other hosts, which `trestle join` runs; --actors then counts those of this host
    #[arg(long, value_name = "N", requires = "listen", value_parser = whole::<u32>(1..=u64::from(MAX_ACTORS)))]
    pub(crate) remote_actors: Option<u32>,
    /// Where they reach this host, such as tls/0.0.0.0:7447, or tcp/127.0.0.1:7447 on one machine
    #[arg(long, value_name = "URL", requires = "remote_actors")]
    pub(crate) listen: Option<String>,
    #[command(flatten)]
    pub(crate) network: Network,
}

/// How hosts of a run speak to each other.
#[derive(Clone, Debug, Args)]
pub(crate) struct Network {
    /// What this host proves its identity by, and knows the others by; see `trestle hosts credentials`
    #[arg(long, value_name = "FILE")]
    pub(crate) credentials: Option<PathBuf>,
    /// Allow plain TCP beyond this machine, which everybody on the way can read and change
    #[arg(long)]
    pub(crate) insecure: bool,
    /// Seconds without a sign of life after which another host counts as lost
    #[arg(long, value_name = "SECONDS", default_value_t = SILENCE_S, value_parser = whole::<u32>(MIN_SILENCE_S.into()..=MAX_SILENCE_S.into()))]
    pub(crate) host_silence: u32,
}

/// The command that starts it; arguments are to be added.
///
/// # Errors
/// It is not to be found.
pub(crate) fn command() -> Result<Command> {
    if let Some(named) = env::var_os(VARIABLE) {
        let path = PathBuf::from(named);
        ensure!(
            path.is_file(),
            "{VARIABLE} = {}: no such file; accepted: the path of {NAME}",
            path.display()
        );
        return Ok(Command::new(path));
    }
    let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/relay/target");
    let beside = env::current_exe().ok().and_then(|program| Some(program.parent()?.to_path_buf()));
    let path = env::var_os("PATH").unwrap_or_default();
    let places = beside.into_iter().chain(env::split_paths(&path));
    let places = places.chain(["release", "debug"].map(|profile| sources.join(profile)));
    match places.map(|place| place.join(NAME)).find(|path| path.is_file()) {
        Some(path) => Ok(Command::new(path)),
        None => bail!(
            "{NAME}, which carries messages between hosts, is not there; in Trestle's sources \
             `cargo build --release --manifest-path deploy/relay/Cargo.toml` builds \
             deploy/relay/target/release/{NAME}; accepted: that file beside `trestle`, on PATH, or named by {VARIABLE}"
        ),
    }
}

/// The options of the program that `network` asks for.
pub(crate) fn options(network: &Network) -> Vec<String> {
    let mut options = Vec::new();
    if let Some(file) = &network.credentials {
        options.extend(["--credentials".into(), file.display().to_string()]);
    }
    if network.insecure {
        options.push("--insecure".into());
    }
    options
}

/// Asks the program whether it would listen at `url`, or connect to it, with what `network` says.
///
/// # Errors
/// It would not, or is not to be found.
pub(crate) fn check(url: &str, network: &Network) -> Result<()> {
    let mut command = command()?;
    command.arg("check").arg(url).args(options(network)).stdin(Stdio::null());
    let program = command.get_program().to_string_lossy().into_owned();
    let output = command.output().with_context(|| format!("cannot start {program}"))?;
    if output.status.success() {
        return Ok(());
    }
    let text = String::from_utf8_lossy(&output.stderr);
    let reason = text.lines().rev().find_map(|line| line.strip_prefix("error: "));
    bail!("{}", reason.map_or_else(|| format!("{program} ended with {}", output.status), str::to_string))
}

/// How this host joins a run.
#[derive(Clone, Debug)]
pub(crate) struct Joining {
    /// Where the run listens.
    pub(crate) url: String,
    /// The name by which the run knows this host.
    pub(crate) name: String,
    /// Actors that it offers.
    pub(crate) actors: u32,
    /// How it speaks.
    pub(crate) network: Network,
    /// Seconds to wait for an answer.
    pub(crate) wait_s: u32,
    /// Print nothing but errors.
    pub(crate) quiet: bool,
}

/// How other hosts join a run.
#[derive(Clone, Debug)]
pub(crate) struct Listening {
    /// Where.
    pub(crate) url: String,
    /// The first of the actors that they run: all from there on.
    pub(crate) first: u32,
    /// How they speak.
    pub(crate) network: Network,
}

impl Listening {
    /// As `typed`, in a run as `run` says; none if it has no other hosts.
    ///
    /// # Errors
    /// It cannot be, for a reason that is known before anything is started.
    pub(crate) fn of(typed: &Remote, run: &Run) -> Result<Option<Self>> {
        let (Some(remote), Some(url)) = (typed.remote_actors, &typed.listen) else { return Ok(None) };
        ensure!(
            run.mode != Mode::Reference,
            "--remote-actors: run.mode = reference is one process; accepted: lockstep, free"
        );
        let Some(first) = run.actors.checked_sub(remote) else {
            bail!(
                "--remote-actors {remote}: the run has {} actors in all (run.actors); accepted: --actors N for those of this host, \
                 or up to {} remote ones",
                run.actors,
                run.actors
            )
        };
        check(url, &typed.network)?;
        Ok(Some(Self { url: url.clone(), first, network: typed.network.clone() }))
    }
}
