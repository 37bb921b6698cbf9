//! What a killed start leaves in a run's directory and beside it, and how the next command puts it right.
//!
//! - *Empty*: the start was killed before it had written anything.
//! - *Unborn*: the start was killed before the run had a plan. Nothing in it is worth keeping.
//! - *Untrained*: it has a plan, but neither a checkpoint nor a result. It begins anew.
//! - *Replaced*: `NAME.replaced-PID` beside it is a run as it was before `--overwrite`. It comes back unless the new run has
//!   got as far as a checkpoint or a result. One that had got no further itself goes then.
//! - *Removed*: `.NAME.removed-PID` is what was on its way out.

use super::aside::{discard, removed, replaced};
use super::fence::{Fence, try_lock};
use crate::TRANSPORT;
use anyhow::{Context, Result, bail};
use std::ffi::OsStr;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use trestle_learner::checkpoint;
use trestle_link::{Liveness, Transport};
use trestle_proto::run_files::{
    ACTORS_FILE, BEST_FILE, BUILD_FILE, CHECKPOINTS_DIR, COMMAND_FILE, CONFIG_FILE, DEMONSTRATION_FILE,
    DEMONSTRATIONS_DIR, EVALS_FILE, HOSTS_FILE, LAST_LINK, LOGS_DIR, MAP_FILE, MENTOR_FILE, METRICS_FILE,
    PLAN_FILE, RESULT_FILE, TIMELINE_FILE,
};
use trestle_proto::rundir::{RunDir, is_temporary};

/// What the entries of a run's directory are called, but for those that are demonstrations.
const OWN: [&str; 16] = [
    CONFIG_FILE,
    COMMAND_FILE,
    BUILD_FILE,
    PLAN_FILE,
    MAP_FILE,
    MENTOR_FILE,
    ACTORS_FILE,
    HOSTS_FILE,
    EVALS_FILE,
    METRICS_FILE,
    TIMELINE_FILE,
    LOGS_DIR,
    CHECKPOINTS_DIR,
    LAST_LINK,
    BEST_FILE,
    RESULT_FILE,
];

/// Whether `root` holds something, and no more than what a start leaves that was killed before the run had a plan.
pub(crate) fn is_unborn(root: &Path) -> bool {
    const FIRST: [&str; 7] =
        [CONFIG_FILE, COMMAND_FILE, MAP_FILE, BUILD_FILE, DEMONSTRATION_FILE, DEMONSTRATIONS_DIR, LOGS_DIR];
    let mut some = false;
    let known = |name: &str| FIRST.contains(&name) || is_temporary(name);
    fs::read_dir(root).is_ok_and(|mut entries| {
        entries.all(|entry| {
            some = true;
            entry.is_ok_and(|entry| entry.file_name().to_str().is_some_and(known))
        })
    }) && some
}

/// Whether the run in `root` has nothing that it could go on from or that it came to. A directory without anything in it may be
/// somebody's, or what a start has left that was killed at once: a run may begin there in either case.
pub(crate) fn nothing_saved(root: &Path) -> bool {
    let dir = RunDir::new(root);
    let empty = || fs::read_dir(root).is_ok_and(|mut entries| entries.next().is_none());
    let untrained = || {
        dir.plan().is_file() && !dir.result().exists() && checkpoint::any_complete(root).is_ok_and(|any| !any)
    };
    empty() || is_unborn(root) || untrained()
}

/// Whether another start has given the directory `root` up since the caller looked: the configuration has gone, and nothing is saved.
/// Waits until nobody is at it.
///
/// # Errors
/// As [`Fence::take`].
pub(crate) fn given_up(root: &Path) -> Result<bool> {
    if RunDir::new(root).config().exists() {
        return Ok(false);
    }
    drop(Fence::take(root)?);
    Ok(!root.exists() || nothing_saved(root))
}

/// The directory that `path` names as a run's, for a command that looks at its newest checkpoint: that of [`run_of`], or else `path`
/// itself, which the caller will refuse.
///
/// # Errors
/// It is one of the run's checkpoints, which need not be the newest one, or the weights of its best evaluation.
pub(crate) fn run_at(path: &Path) -> Result<PathBuf> {
    let Some(run) = run_of(path) else { return Ok(path.to_path_buf()) };
    if path.parent().is_some_and(|parent| parent.ends_with(CHECKPOINTS_DIR)) {
        let tick = path.file_name().and_then(|name| name.to_str()?.parse::<u64>().ok());
        let how = tick.map_or_else(String::new, |tick| {
            format!(", with --checkpoint {tick} where the command has that option")
        });
        bail!("{} is a checkpoint; accepted: its run, {}{how}", path.display(), run.display());
    }
    if path.ends_with(BEST_FILE) {
        bail!(
            "{} has the weights of the best evaluation; accepted: its run, {}, with --checkpoint best where the command has \
             that option",
            path.display(),
            run.display()
        );
    }
    Ok(run)
}

/// The directory of the run that `path` names: the directory itself, one of its own files, its `last`, its `checkpoints`, or one
/// of those.
pub(crate) fn run_of(path: &Path) -> Option<PathBuf> {
    let is_run = |dir: &Path| dir.join(PLAN_FILE).is_file() && dir.join(CONFIG_FILE).is_file();
    // As typed: `last` is a link to another place.
    let within = |path: &Path| path.file_name().is_some_and(|name| OWN.iter().any(|own| name == *own));
    let mut dir = path.to_path_buf();
    if !is_run(&dir) && !within(&dir) {
        dir = dir.parent().filter(|parent| parent.ends_with(CHECKPOINTS_DIR))?.to_path_buf();
    }
    if !is_run(&dir) {
        let parent = dir.parent()?;
        dir = if parent.as_os_str().is_empty() { ".".into() } else { parent.to_path_buf() };
    }
    is_run(&dir).then_some(dir)
}

/// Removes what a kill left of files that were being written into `root`.
pub(super) fn remove_temporaries(root: &Path) -> Result<()> {
    for dir in [root.to_path_buf(), root.join(DEMONSTRATIONS_DIR), root.join(LOGS_DIR)] {
        for entry in fs::read_dir(&dir).into_iter().flatten().flatten() {
            let temporary = entry.file_name().to_str().is_some_and(is_temporary);
            if temporary && entry.file_type().is_ok_and(|kind| !kind.is_dir()) {
                let path = entry.path();
                fs::remove_file(&path).with_context(|| format!("cannot remove {}", path.display()))?;
            }
        }
    }
    Ok(())
}

/// Removes all that is in `dir`, in an order in which the next command can make something of what a kill leaves: a run to go on
/// with until its checkpoints have gone, and an untrained one until its plan has.
pub(super) fn empty(dir: &Path) -> std::io::Result<()> {
    let mut entries = fs::read_dir(dir)?.collect::<std::io::Result<Vec<_>>>()?;
    entries.sort_by_key(|entry| turn(&entry.file_name()));
    for entry in entries {
        if entry.file_type()?.is_dir() {
            fs::remove_dir_all(entry.path())?
        } else {
            fs::remove_file(entry.path())?
        }
    }
    Ok(())
}

/// When `empty` removes the entry `name`.
fn turn(name: &OsStr) -> u8 {
    match name.to_str() {
        Some(RESULT_FILE) => 0,
        Some(CHECKPOINTS_DIR) => 1,
        Some(PLAN_FILE) => 3,
        _ => 2,
    }
}

/// Puts right what a killed `--overwrite` left beside `root`; returns what the user should know. What a living process is
/// busy with is left alone.
///
/// # Errors
/// A directory that cannot be moved.
pub(crate) fn recover(root: &Path) -> Result<Vec<String>> {
    let mut said = Vec::new();
    for gone in removed(root) {
        // Another process may be removing it; what remains is tried again the next time.
        let _ = fs::remove_dir_all(gone);
    }
    // Of several the one that was moved last is what was there.
    let mut waiting = replaced(root);
    waiting.sort_by_key(|aside| fs::symlink_metadata(aside).and_then(|meta| meta.modified()).ok());
    while let Some(aside) = waiting.pop() {
        let of_aside = match try_lock(&aside) {
            Err(_) => continue,
            Ok(None) => {
                // Nobody knows who is at it.
                said.push(format!("note: {} is a run that was to be replaced", aside.display()));
                continue;
            }
            Ok(of_aside) => of_aside,
        };
        if root.exists() {
            let Ok(Some(_of_root)) = try_lock(root) else { continue };
            if occupied(root) && !nothing_saved(root) {
                if nothing_saved(&aside) {
                    // There is nothing in it to go back to.
                    clear_away(&aside, true);
                    discard(&aside)?;
                    continue;
                }
                said.push(format!(
                    "note: {} is a run that was to be replaced by {}; remove it, or rename it to keep it",
                    aside.display(),
                    root.display()
                ));
                continue;
            }
            if occupied(root) {
                // Its plan, which names what it shared, goes with it.
                clear_away(root, true);
                discard(root)?;
            } else {
                fs::remove_dir(root).with_context(|| format!("cannot remove {}", root.display()))?;
            }
        }
        match fs::rename(&aside, root) {
            // Another start has made the directory meanwhile: the run that lies aside is for the command after it.
            Err(e) if matches!(e.kind(), ErrorKind::DirectoryNotEmpty | ErrorKind::AlreadyExists) => continue,
            renamed => renamed
                .with_context(|| format!("cannot put {} back as {}", aside.display(), root.display()))?,
        }
        drop(of_aside);
        said.push(format!(
            "note: {} is back as it was: an --overwrite of it was killed before anything new was saved",
            root.display()
        ));
    }
    Ok(said)
}

fn occupied(root: &Path) -> bool {
    fs::read_dir(root).is_ok_and(|mut entries| entries.next().is_some())
}

/// Removes what the last run in `root` has left in shared memory: its supervisor and a process of it may have been killed
/// within a moment. A caller that is `alone` in the directory, by its lock, knows that no process of that run is left. Any other
/// caller removes only the remains of processes that are known to be dead. A copy of a directory names the run of the original,
/// which may be alive.
pub(crate) fn clear_away(root: &Path, alone: bool) {
    let Ok(plan) = RunDir::new(root).read_plan() else { return };
    let run = plan.life.run;
    let left = match TRANSPORT.liveness(run) {
        Liveness::Dead => true,
        Liveness::Unknown => alone,
        Liveness::Alive | Liveness::Absent => false,
    };
    if left && let Err(error) = TRANSPORT.remove(run) {
        tracing::warn!("cannot remove what the run before has left in shared memory: {error}");
    }
}

/// Empties `root`, which this process has locked, of what a killed start left there.
pub(super) fn clear_unborn(root: &Path) -> Result<()> {
    if is_unborn(root) {
        empty(root).with_context(|| format!("cannot empty {}", root.display()))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn write(path: PathBuf) {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, "").unwrap();
    }

    #[test]
    fn only_the_beginning_of_a_run_is_begun_anew() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        assert!(!is_unborn(root) && nothing_saved(root), "there is nothing to take away");
        assert!(!nothing_saved(&root.join("absent")));
        for name in [".config.toml.17.tmp", "config.toml", "map.json", "logs/x", "demonstrations/a.csv"] {
            write(root.join(name));
            assert!(is_unborn(root) && nothing_saved(root), "{name}");
        }
        write(root.join("plan.bin"));
        write(root.join("evals.csv"));
        assert!(!is_unborn(root) && nothing_saved(root));
        write(root.join("checkpoints/000000000001/model.safetensors"));
        assert!(nothing_saved(root), "a checkpoint that is not complete");
        write(root.join("checkpoints/000000000001/COMPLETE"));
        assert!(nothing_saved(root), "one that was killed in its last moment");
        fs::write(root.join("checkpoints/000000000001/COMPLETE"), "0123abcd\n").unwrap();
        assert!(!nothing_saved(root));
        fs::remove_dir_all(root.join("checkpoints")).unwrap();
        write(root.join("result.json"));
        assert!(!nothing_saved(root));
        fs::remove_file(root.join("plan.bin")).unwrap();
        assert!(!is_unborn(root) && !is_unborn(&root.join("absent")));
    }

    #[test]
    fn a_run_goes_by_the_names_of_its_own_files() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("run");
        ["plan.bin", "config.toml"].iter().for_each(|name| write(root.join(name)));
        for name in ["", "build.json", "map.json", "mentor.csv", "actors.csv", "hosts.csv", "logs", "last"] {
            assert_eq!(run_of(&root.join(name)).as_ref(), Some(&root), "{name}");
            assert_eq!(run_at(&root.join(name)).unwrap(), root, "{name}");
        }
        // These are files for commands of their own.
        for name in ["demonstration.csv", "demonstrations/a.csv", "notes"] {
            assert_eq!(run_of(&root.join(name)), None, "{name}");
        }
        let best = root.join("best.safetensors");
        assert_eq!(run_of(&best).as_ref(), Some(&root));
        assert!(run_at(&best).unwrap_err().to_string().contains("--checkpoint best"));
    }

    /// A kill may come between any two removals.
    #[test]
    fn what_is_emptied_is_in_a_known_state_until_it_is_empty() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        let mut names = ["config.toml", "plan.bin", "evals.csv", "result.json", "timeline.jsonl", "x.log"];
        names.iter().for_each(|name| write(root.join(name)));
        assert!(!nothing_saved(root));
        names.sort_by_key(|name| turn(OsStr::new(name)));
        for name in names {
            fs::remove_file(root.join(name)).unwrap();
            assert!(nothing_saved(root), "after {name}");
        }
        for name in ["plan.bin", "logs/learner.log", "checkpoints/000000000001/COMPLETE"] {
            write(root.join(name));
        }
        empty(root).unwrap();
        assert_eq!(fs::read_dir(root).unwrap().count(), 0);
    }

    /// Every state that a kill in the middle of `--overwrite` can leave ends with the one run that counts.
    #[test]
    fn a_replaced_run_comes_back_unless_the_new_one_has_saved_something() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("best");
        let aside = dir.path().join("best.replaced-45");
        let news: [&[&str]; 4] =
            [&[], &["config.toml"], &["plan.bin", "logs/learner.log"], &["plan.bin", "evals.csv"]];
        for (at, new) in news.into_iter().enumerate() {
            write(aside.join("former"));
            new.iter().for_each(|name| write(root.join(name)));
            if at == 0 {
                fs::create_dir(&root).unwrap();
            }
            assert!(recover(&root).unwrap()[0].contains("best is back"), "{new:?}");
            assert!(root.join("former").exists() && !aside.exists(), "{new:?}");
            assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "{new:?}");
            fs::remove_dir_all(&root).unwrap();
        }
        // Before the new directory was made.
        write(aside.join("former"));
        assert_eq!(recover(&root).unwrap().len(), 1);
        assert!(root.join("former").exists());
        assert!(recover(&root).unwrap().is_empty(), "nothing is left to do");
        // The new run has saved something: neither is touched.
        write(root.join("plan.bin"));
        write(root.join("result.json"));
        write(aside.join("older"));
        assert!(recover(&root).unwrap()[0].contains("best.replaced-45 is a run that was to be replaced"));
        assert!(aside.exists() && root.join("former").exists());
        // The former one had saved nothing.
        fs::remove_file(aside.join("older")).unwrap();
        write(aside.join("plan.bin"));
        assert!(recover(&root).unwrap().is_empty() && !aside.exists());
        // What is being removed is removed to the end, and other names are nobody's.
        write(dir.path().join(".best.removed-7/half"));
        let others = ["best.replaced-", "best.replaced-x", "bestial.replaced-4", ".best.removed-"];
        others.iter().for_each(|name| write(dir.path().join(name).join("mine")));
        recover(&root).unwrap();
        assert!(!dir.path().join(".best.removed-7").exists());
        assert!(others.iter().all(|name| dir.path().join(name).exists()));
    }

    #[test]
    fn a_run_in_progress_is_left_alone() {
        let dir = tempfile::tempdir().unwrap();
        let (root, aside) = (dir.path().join("best"), dir.path().join("best.replaced-45"));
        write(aside.join("former"));
        write(root.join("plan.bin"));
        let held = try_lock(&root).unwrap();
        assert!(recover(&root).unwrap().is_empty() && aside.exists());
        drop(held);
        let held = try_lock(&aside).unwrap();
        assert!(recover(&root).unwrap().is_empty() && aside.exists());
        drop(held);
        assert_eq!(recover(&root).unwrap().len(), 1);
    }
}
