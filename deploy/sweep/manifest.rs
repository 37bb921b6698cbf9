//! `sweep.json`: what a sweep's directory holds, so that `--resume` never mixes it with something else.

use super::arms::Arm;
use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use trestle_proto::rundir::{Durable, write_atomically};

/// Version of the layout of sweep.json.
const FORMAT: u32 = 1;

/// What was asked for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Manifest {
    format: u32,
    /// Preset or configuration file.
    pub(crate) source: String,
    /// Settings of all arms.
    pub(crate) sets: Vec<String>,
    /// The arms.
    pub(crate) arms: Vec<Arm>,
    /// The seeds.
    pub(crate) seeds: Vec<u64>,
}

/// The directory of arm `arm` and seed `seed` in the sweep's directory `out`.
pub(crate) fn run_dir(out: &Path, arm: &str, seed: u64) -> PathBuf {
    out.join(arm).join(format!("seed-{seed}"))
}

impl Manifest {
    pub(crate) fn new(source: &str, sets: Vec<String>, arms: Vec<Arm>, seeds: Vec<u64>) -> Self {
        Self { format: FORMAT, source: source.into(), sets, arms, seeds }
    }

    fn path(out: &Path) -> PathBuf {
        out.join("sweep.json")
    }

    /// Takes the directory `out` for this sweep: a new one, or with `resume` that of the same sweep, to which arms and
    /// seeds may have been added.
    ///
    /// # Errors
    /// A directory that holds something else, or cannot be written.
    pub(crate) fn claim(&self, out: &Path, resume: bool) -> Result<()> {
        let path = Self::path(out);
        let mut union = self.clone();
        if fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some()) {
            if !resume {
                bail!(
                    "{} exists; accepted: another --out, or --resume to go on with its sweep",
                    out.display()
                );
            }
            let text = fs::read_to_string(&path)
                .with_context(|| format!("--resume: {} is no sweep's directory", out.display()))?;
            let before: Self =
                serde_json::from_str(&text).with_context(|| format!("{} cannot be read", path.display()))?;
            before.check_same(self, out)?;
            union.arms.extend(before.arms.into_iter().filter(|arm| !self.arms.contains(arm)));
            union.seeds.extend(before.seeds.into_iter().filter(|seed| !self.seeds.contains(seed)));
        }
        fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
        let text = serde_json::to_string_pretty(&union)?;
        write_atomically(&path, Durable::Now, |file| writeln!(file, "{text}"))
            .with_context(|| format!("cannot write {}", path.display()))
    }

    /// Whether `typed` is this sweep, but for arms and seeds that are new or not named this time.
    fn check_same(&self, typed: &Self, out: &Path) -> Result<()> {
        let refuse = |what: &str, there: &dyn std::fmt::Debug, here: &dyn std::fmt::Debug| {
            let out = out.display();
            bail!(
                "--resume: {out} is another sweep's: {what} {there:?} there, {here:?} here; accepted: the same"
            )
        };
        if self.format != FORMAT {
            return refuse("format", &self.format, &FORMAT);
        }
        if self.source != typed.source {
            return refuse("the configuration is", &self.source, &typed.source);
        }
        if self.sets != typed.sets {
            return refuse("settings are", &self.sets, &typed.sets);
        }
        for arm in &self.arms {
            if let Some(other) =
                typed.arms.iter().find(|other| other.name == arm.name && other.sets != arm.sets)
            {
                return refuse(&format!("arm {} is", arm.name), &arm.sets, &other.sets);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn sweep(arms: &[&str], seeds: &[u64]) -> Manifest {
        let arms = arms.iter().map(|arm| arm.parse().unwrap()).collect();
        Manifest::new("maze-small", vec!["learner.lr=0.001".into()], arms, seeds.to_vec())
    }

    #[test]
    fn a_sweep_can_grow_and_cannot_change() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("s");
        sweep(&["a:x=1"], &[0, 1]).claim(&out, false).unwrap();
        assert!(sweep(&["a:x=1"], &[0, 1]).claim(&out, false).unwrap_err().to_string().contains("--resume"));
        sweep(&["b:x=2", "a:x=1"], &[1, 2]).claim(&out, true).unwrap();
        let text = fs::read_to_string(out.join("sweep.json")).unwrap();
        let all: Manifest = serde_json::from_str(&text).unwrap();
        assert_eq!(all, sweep(&["b:x=2", "a:x=1"], &[1, 2, 0]));
        let other = Manifest { source: "maze30".into(), ..sweep(&["a:x=1"], &[0]) };
        assert!(other.claim(&out, true).unwrap_err().to_string().contains("\"maze-small\" there"));
        let changed = sweep(&["a:x=9"], &[0]).claim(&out, true).unwrap_err().to_string();
        assert!(changed.contains("arm a is [\"x=1\"] there, [\"x=9\"] here"), "{changed}");
        fs::remove_file(out.join("sweep.json")).unwrap();
        fs::write(out.join("notes"), "mine").unwrap();
        assert!(sweep(&["a:x=1"], &[0]).claim(&out, true).is_err());
    }
}
