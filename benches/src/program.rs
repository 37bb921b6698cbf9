//! The program `trestle`, whose processes are measured, and directories for them.

use anyhow::{Context, Result, ensure};
use std::fs;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The subdirectory that [`training`] trains in.
pub(super) const RUN: &str = "run";

/// The program `trestle` that lies beside this program. Under cargo it is brought up to date first: otherwise it would
/// be an older one that is measured.
///
/// # Errors
/// If cargo cannot build it, or if there is none.
pub(super) fn trestle() -> Result<PathBuf> {
    let own = std::env::current_exe().context("cannot find the program itself")?;
    let program = own.with_file_name("trestle");
    let dirs = own.parent().and_then(|dir| Some((dir.parent()?, dir.file_name()?.to_str()?)));
    if let (Some(cargo), Some((target, profile))) = (std::env::var_os("CARGO"), dirs) {
        let profile = if profile == "debug" { "dev" } else { profile };
        let mut build = Command::new(cargo);
        build.args(["build", "--bin", "trestle", "--profile", profile, "--manifest-path"]);
        build.arg(concat!(env!("CARGO_MANIFEST_DIR"), "/../Cargo.toml")).arg("--target-dir").arg(target);
        let status = build.stdout(Stdio::null()).status().context("cannot start cargo to build trestle")?;
        ensure!(status.success(), "cargo cannot build trestle: {status}");
    }
    ensure!(
        program.is_file(),
        "{} is not there, and this benchmark measures its processes; `cargo build --release` builds it",
        program.display()
    );
    Ok(program)
}

/// The command by which `program` trains on maze30, with coordinates as input and a gradient step every fourth step, in the
/// subdirectory [`RUN`] of `dir`.
pub(super) fn training(program: &Path, algo: &str, mode: &str, env_steps: u64, dir: &Path) -> Command {
    let mut command = Command::new(program);
    command.args(["train", "maze30", "--algo", algo, "--mode", mode, "--seed", "1", "--quiet"]);
    command.args(["--set", "env.encoding=coordinates", "--set", "learner.train_every=4"]);
    command.args(["--episodes", "1000000000", "--env-steps", &env_steps.to_string(), "--out"]);
    command.arg(dir.join(RUN)).stdin(Stdio::null()).stdout(Stdio::null());
    command
}

/// A private directory that goes when this does.
pub(super) struct Scratch(pub(super) PathBuf);

impl Scratch {
    pub(super) fn new(name: &str) -> Result<Self> {
        let dir = std::env::temp_dir().join(format!("trestle-bench-{}-{name}", std::process::id()));
        let made = fs::DirBuilder::new().mode(0o700).create(&dir);
        made.with_context(|| format!("cannot make {}", dir.display()))?;
        Ok(Self(dir))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        if let Err(error) = fs::remove_dir_all(&self.0) {
            eprintln!("cannot remove {}: {error}", self.0.display());
        }
    }
}
