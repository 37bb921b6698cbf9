//! `sweep.json`: what a sweep's directory holds, so that `--resume` never mixes it with something else.

use super::arms::{Arm, key_of};
use crate::flags::Limits;
use crate::prepare::try_lock;
use anyhow::{Context, Result, bail, ensure};
use serde::{Deserialize, Serialize};
use std::fs;
use std::io::{ErrorKind, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use trestle_proto::regular_file;
use trestle_proto::rundir::{Durable, write_atomically};

const MANIFEST: &str = "sweep.json";
/// What the names of directories begin with in which a sweep finds out how fast its runs are.
pub(super) const PROBE: &str = ".probe-";
/// Largest sweep.json that is read, bytes: with all arms and seeds that there may be it is smaller.
const MAX_BYTES: u64 = 16 << 20;
/// Version of the layout of sweep.json.
const FORMAT: u32 = 1;
/// How often a sweep that begins writes its file anew. Each time another one must have begun in the middle of it.
const CLAIMS: u32 = 8;

/// What was asked for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Manifest {
    format: u32,
    /// Preset or configuration file.
    pub(crate) source: String,
    /// Settings of all arms.
    pub(crate) sets: Vec<String>,
    /// How long the runs are where the command line says so; the longest that has been asked for.
    #[serde(default)]
    pub(crate) limits: Limits,
    /// The arms.
    pub(crate) arms: Vec<Arm>,
    /// The seeds.
    pub(crate) seeds: Vec<u64>,
}

/// The settings that may differ when a run goes on, as `resolve_run` takes them over, and the tables of such.
const MAY_CHANGE: [&str; 3] = ["run.stop_when_solved", "learner.threads", "checkpoint.keep"];
const TABLES: [&str; 2] = ["env.hazard", "supervise"];
/// The settings that may differ, too, with the flags that come after them.
const LIMITS: [(&str, &str); 2] = [("run.episodes", "--episodes"), ("run.env_steps", "--env-steps")];

/// The flag that stands for the setting `key`, if it is a limit.
fn limit(key: &str) -> Option<&'static str> {
    LIMITS.into_iter().find(|(limit, _)| *limit == key).map(|(_, flag)| flag)
}

/// Whether the setting `key`, which is no limit, may differ when a run goes on.
fn may_change(key: &str) -> bool {
    let within = |table: &str| key.strip_prefix(table).is_some_and(|rest| rest.starts_with('.'));
    MAY_CHANGE.contains(&key) || TABLES.into_iter().any(within)
}

/// The directory of arm `arm` and seed `seed` in the sweep's directory `out`.
pub(crate) fn run_dir(out: &Path, arm: &str, seed: u64) -> PathBuf {
    out.join(arm).join(format!("seed-{seed}"))
}

impl Manifest {
    pub(crate) fn new(
        source: &str,
        sets: Vec<String>,
        limits: Limits,
        arms: Vec<Arm>,
        seeds: Vec<u64>,
    ) -> Self {
        Self { format: FORMAT, source: source.into(), sets, limits, arms, seeds }
    }

    /// That of the sweep in `out`.
    ///
    /// # Errors
    /// There is none, or it cannot be read.
    pub(crate) fn read(out: &Path) -> Result<Self> {
        let path = Self::path(out);
        let text = regular_file::read_to_string(&path, MAX_BYTES)
            .with_context(|| {
                format!(
                    "--resume: {0} is no sweep's directory; accepted: one, or `trestle sweep CONFIG ... --resume --out {0}`, \
                     which begins one there",
                    out.display()
                )
            })?;
        serde_json::from_str(&text).with_context(|| format!("{} cannot be read", path.display()))
    }

    /// The settings but for those that may change.
    fn settings(&self) -> Vec<&String> {
        let fixed = |set: &&String| !may_change(key_of(set)) && limit(key_of(set)).is_none();
        self.sets.iter().filter(fixed).collect()
    }

    /// The settings of all arms with `typed` in the place of former ones.
    ///
    /// # Errors
    /// One that would make other runs of them, and one that something else decides: a limit, which goes by its flag, and a setting
    /// of each arm's own.
    pub(crate) fn sets_with(&self, typed: &[String]) -> Result<Vec<String>> {
        for set in typed {
            if let Some(flag) = limit(key_of(set)) {
                bail!("--resume: --set {set}; accepted without the sweep's configuration: {flag}");
            }
            ensure!(
                may_change(key_of(set)),
                "--resume: --set {set}; accepted without the sweep's configuration: {}, and what is in {}",
                MAY_CHANGE.join(", "),
                TABLES.join(", ")
            );
            ensure!(
                !self.arms.iter().all(|arm| arm.decides(key_of(set))),
                "--resume: --set {set}, which every arm sets itself; accepted: a setting that an arm leaves to the sweep"
            );
        }
        let replaced = |set: &&String| typed.iter().any(|new| key_of(new) == key_of(set));
        Ok(self.sets.iter().filter(|set| !replaced(set)).chain(typed).cloned().collect())
    }

    /// Refuses limits below those of this sweep, which may have runs that are longer: with `typed` its runs would no longer be
    /// equally long.
    pub(crate) fn check_limits(&self, typed: Limits) -> Result<()> {
        let both = [
            ("--episodes", typed.episodes, self.limits.episodes),
            ("--env-steps", typed.env_steps, self.limits.env_steps),
        ];
        for (flag, typed, before) in both {
            if let (Some(typed), Some(before)) = (typed, before) {
                ensure!(
                    typed >= before,
                    "--resume: {flag} {typed}; accepted: {before} or more, which the runs of the sweep have been given before"
                );
            }
        }
        Ok(())
    }

    pub(crate) fn path(out: &Path) -> PathBuf {
        out.join(MANIFEST)
    }

    /// Takes the directory `out` for this sweep: a new one, or with `resume` that of the same sweep, to which arms and
    /// seeds may have been added, and whose runs may be longer now. Returns what the directory holds from now on.
    ///
    /// # Errors
    /// A directory that holds something else, or cannot be written.
    pub(crate) fn claim(&self, out: &Path, resume: bool) -> Result<Self> {
        let path = Self::path(out);
        clear(out)?;
        let union = self.united(out, resume)?;
        let text = serde_json::to_string_pretty(&union)?;
        // Another sweep that begins here at the same time may take the file that is being written for a leftover (`clear`).
        let mut attempts = 0;
        loop {
            fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
            match write_atomically(&path, Durable::Now, |file| writeln!(file, "{text}")) {
                Err(e) if e.kind() == ErrorKind::NotFound && attempts < CLAIMS => attempts += 1,
                written => {
                    written.with_context(|| format!("cannot write {}", path.display()))?;
                    return Ok(union);
                }
            }
        }
    }

    /// What [`Manifest::claim`] would return, without touching anything.
    ///
    /// # Errors
    /// A directory that holds something else.
    pub(crate) fn united(&self, out: &Path, resume: bool) -> Result<Self> {
        let mut union = self.clone();
        if fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some()) {
            if !resume {
                bail!(
                    "{} exists; accepted: another --out, or --resume to go on with its sweep",
                    out.display()
                );
            }
            let before = Self::read(out)?;
            before.check_same(self, out)?;
            union.arms.extend(before.arms.into_iter().filter(|arm| !self.arms.contains(arm)));
            union.seeds.extend(before.seeds.into_iter().filter(|seed| !self.seeds.contains(seed)));
        }
        Ok(union)
    }

    /// Takes part in the sweep in `out` beside other processes, perhaps on other hosts. The first one that comes writes what the
    /// sweep is, and the others only read it.
    ///
    /// # Errors
    /// A directory that holds another sweep, or cannot be written.
    pub(crate) fn join(&self, out: &Path) -> Result<()> {
        let path = Self::path(out);
        if !path.exists() {
            fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
            // Processes of several hosts can have one number, so the name of the file is drawn.
            let written =
                tempfile::Builder::new().prefix(".sweep.json.").suffix(".tmp").tempfile_in(out).and_then(
                    |mut file| {
                        writeln!(file, "{}", serde_json::to_string_pretty(self)?)?;
                        file.as_file().set_permissions(fs::Permissions::from_mode(0o644))?;
                        file.as_file().sync_all()?;
                        match file.persist_noclobber(&path) {
                            Err(lost) if lost.error.kind() != ErrorKind::AlreadyExists => Err(lost.error),
                            _ => Ok(()),
                        }
                    },
                );
            written.with_context(|| format!("cannot write {}", path.display()))?;
        }
        let there = Self::read(out)?;
        there.check_same(self, out)?;
        let lacks = |what: &str| format!("--share: {} is of a sweep without {what}", path.display());
        for arm in &self.arms {
            ensure!(there.arms.contains(arm), lacks(&format!("the arm {}", arm.name)));
        }
        for seed in &self.seeds {
            ensure!(there.seeds.contains(seed), lacks(&format!("the seed {seed}")));
        }
        Ok(())
    }

    /// Whether `typed` is this sweep, but for what may change, and arms and seeds that are new or not named this time.
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
        if self.settings() != typed.settings() {
            return refuse("settings are", &self.sets, &typed.sets);
        }
        for arm in &self.arms {
            if let Some(other) = typed.arms.iter().find(|other| other.name == arm.name && *other != arm) {
                let what = format!("arm {} is", arm.name);
                return match arm.sets == other.sets {
                    true => refuse(&what, &arm.task, &other.task),
                    false => refuse(&what, &arm.sets, &other.sets),
                };
            }
        }
        Ok(())
    }
}

/// Removes from the sweep's directory `out` what a sweep left that was killed in it: a sweep.json that was being written, and
/// probes that no living sweep is at. A directory that holds something else and no sweep.json is somebody else's.
fn clear(out: &Path) -> Result<()> {
    let mut leftovers = Vec::new();
    for entry in fs::read_dir(out).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        let is_dir = entry.file_type().is_ok_and(|kind| kind.is_dir());
        let torn = !is_dir && name.starts_with(&format!(".{MANIFEST}.")) && name.ends_with(".tmp");
        if torn || is_dir && name.starts_with(PROBE) {
            leftovers.push((entry.path(), is_dir));
        } else if !Manifest::path(out).exists() {
            return Ok(());
        }
    }
    for (path, is_dir) in leftovers {
        let removed = match is_dir {
            true if matches!(try_lock(&path), Ok(Some(_))) => fs::remove_dir_all(&path),
            true => continue,
            false => fs::remove_file(&path),
        };
        match removed {
            Err(e) if e.kind() != ErrorKind::NotFound => {
                return Err(e).with_context(|| format!("cannot remove {}", path.display()));
            }
            _ => {}
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::thread;

    fn sweep(arms: &[&str], seeds: &[u64]) -> Manifest {
        let arms = arms.iter().map(|arm| arm.parse().unwrap()).collect();
        let sets = vec!["learner.lr=0.001".into()];
        Manifest::new("maze-small", sets, Limits::default(), arms, seeds.to_vec())
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
        let limits = Limits { episodes: Some(9), env_steps: None };
        let longer = Manifest { limits, ..sweep(&["b:x=2", "a:x=1"], &[1, 2, 0]) };
        longer.claim(&out, true).unwrap();
        assert_eq!(Manifest::read(&out).unwrap(), longer);
        let said = |typed: &str| longer.sets_with(&[typed.into()]).map_err(|error| error.to_string());
        let solved = said("run.stop_when_solved=true").unwrap();
        assert_eq!(solved, ["learner.lr=0.001", "run.stop_when_solved=true"]);
        let solved = Manifest { sets: solved, ..longer.clone() };
        solved.claim(&out, true).unwrap();
        assert_eq!(solved.sets_with(&["run.stop_when_solved = false".into()]).unwrap().len(), 2);
        for (typed, flag) in [("run.episodes=50", "--episodes"), (" run.env_steps = 5", "--env-steps")] {
            assert!(said(typed).unwrap_err().ends_with(flag), "{typed}");
        }
        let own = |arms: &[&str]| sweep(arms, &[0]).sets_with(&["run.stop_when_solved=false".into()]);
        assert!(own(&["a:run.stop_when_solved=true", "b:x=1"]).is_ok());
        let error = own(&["a:run.stop_when_solved=true"]).unwrap_err().to_string();
        assert!(error.contains("every arm sets itself"), "{error}");
        // Where a whole configuration is typed, limits may be among its settings, and differ.
        let short =
            Manifest { sets: vec!["learner.lr=0.001".into(), "run.episodes=5".into()], ..longer.clone() };
        short.check_same(&longer, &out).unwrap();
        for typed in ["learner.lr=1", "supervised=1", "supervise=1", "env.hazards.kind=none"] {
            assert!(said(typed).unwrap_err().contains("accepted without"), "{typed}");
        }
        let less = |episodes, env_steps| longer.check_limits(Limits { episodes, env_steps }).is_err();
        assert_eq!([less(Some(8), None), less(Some(9), Some(1)), less(None, None)], [true, false, false]);
        let other = Manifest { source: "maze30".into(), ..sweep(&["a:x=1"], &[0]) };
        assert!(other.claim(&out, true).unwrap_err().to_string().contains("\"maze-small\" there"));
        let changed = sweep(&["a:x=9"], &[0]).claim(&out, true).unwrap_err().to_string();
        assert!(changed.contains("arm a is [\"x=1\"] there, [\"x=9\"] here"), "{changed}");
        fs::remove_file(out.join("sweep.json")).unwrap();
        fs::write(out.join("notes"), "mine").unwrap();
        fs::write(out.join(".sweep.json.7.tmp"), "mine, too").unwrap();
        assert!(sweep(&["a:x=1"], &[0]).claim(&out, true).is_err());
        assert!(out.join(".sweep.json.7.tmp").exists(), "nothing of somebody else's is touched");
        fs::remove_file(out.join("notes")).unwrap();
        fs::create_dir_all(out.join(".probe-x/logs")).unwrap();
        sweep(&["a:x=1"], &[0]).claim(&out, false).unwrap();
        assert_eq!(fs::read_dir(&out).unwrap().count(), 1);
    }
    #[test]
    fn several_take_part_in_one_sweep() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("s");
        let ours = sweep(&["a:x=1"], &[0, 1]);
        thread::scope(|scope| {
            let joined: Vec<_> = (0..8).map(|_| scope.spawn(|| ours.join(&out))).collect();
            joined.into_iter().for_each(|joined| joined.join().unwrap().unwrap());
        });
        assert_eq!(fs::read_dir(&out).unwrap().count(), 1);
        assert_eq!(Manifest::read(&out).unwrap(), ours);
        sweep(&["a:x=1"], &[1]).join(&out).unwrap();
        let says = |other: Manifest| other.join(&out).unwrap_err().to_string();
        assert!(says(sweep(&["a:x=1"], &[2])).contains("without the seed 2"));
        assert!(says(sweep(&["b:x=1"], &[0])).contains("without the arm b"));
        assert!(says(sweep(&["a:x=2"], &[0])).contains("arm a is"));
        assert_eq!(Manifest::read(&out).unwrap(), ours);
    }
}
