//! Where runs are that stand beside a run's directory: one that waits while another takes its place, and one that is on its
//! way out. Their names say so, and so does the id of the process that has moved them.

use anyhow::{Context, Result};
use std::ffi::OsString;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use trestle_proto::rundir::sync_parent;

/// Follows the name of a run that waits while another takes its place, before the process that replaces it.
const REPLACED: &str = ".replaced-";
/// The same of one that is being removed; there is a dot before the name.
const REMOVED: &str = ".removed-";

/// Renames the run that is being replaced; returns where it is.
pub(super) fn move_aside(root: &Path) -> Result<PathBuf> {
    let name = root.file_name().with_context(|| format!("{} has no name", root.display()))?;
    let mut aside = name.to_os_string();
    aside.push(format!("{REPLACED}{}", std::process::id()));
    let aside = root.with_file_name(aside);
    // A power cut keeps this name, or nothing that is changed under it.
    fs::rename(root, &aside)
        .and_then(|()| sync_parent(&aside))
        .with_context(|| format!("cannot move {} aside", root.display()))?;
    Ok(aside)
}

/// Removes the run in `path`: out of the way first, so that a kill never leaves a part of it that looks like a run.
pub(super) fn discard(path: &Path) -> Result<()> {
    let name = path.file_name().with_context(|| format!("{} has no name", path.display()))?;
    let name = name.to_string_lossy();
    let name = name.rsplit_once(REPLACED).map_or(name.as_ref(), |(name, _)| name);
    let gone = path.with_file_name(format!(".{name}{REMOVED}{}", std::process::id()));
    let failed = || format!("cannot remove {}", path.display());
    // A power cut does not bring the name back without its contents.
    fs::rename(path, &gone).and_then(|()| sync_parent(&gone)).with_context(failed)?;
    match fs::remove_dir_all(&gone) {
        // Another command is removing it as well.
        Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::DirectoryNotEmpty) => Ok(()),
        removed => removed.with_context(failed),
    }
}

/// Directories beside `root` with its name between `before` and `mark`, and a process id at the end, by name.
fn beside(root: &Path, before: &str, mark: &str) -> Vec<PathBuf> {
    let Some(name) = root.file_name() else { return Vec::new() };
    let mut start = OsString::from(before);
    start.push(name);
    start.push(mark);
    let is_id = |rest: &[u8]| !rest.is_empty() && rest.iter().all(u8::is_ascii_digit);
    let parent = root.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut found: Vec<PathBuf> = fs::read_dir(parent)
        .into_iter()
        .flatten()
        .flatten()
        .filter(|entry| {
            let name = entry.file_name();
            let rest = name.as_encoded_bytes().strip_prefix(start.as_encoded_bytes());
            rest.is_some_and(is_id) && entry.file_type().is_ok_and(|kind| kind.is_dir())
        })
        .map(|entry| root.with_file_name(entry.file_name()))
        .collect();
    found.sort();
    found
}

/// Whether `parent` holds anything that killed starts leave beside the directories of runs.
pub(crate) fn has_leftovers(parent: &Path) -> bool {
    let is_mark = |name: &str| name.contains(REPLACED) || name.contains(REMOVED);
    let entries = fs::read_dir(parent).into_iter().flatten().flatten();
    entries.into_iter().any(|entry| is_mark(&entry.file_name().to_string_lossy()))
}

/// The runs beside `root` that wait for a killed `--overwrite`, or for one that is only just starting.
pub(crate) fn replaced(root: &Path) -> Vec<PathBuf> {
    beside(root, "", REPLACED)
}

/// What is on its way out beside `root`.
pub(super) fn removed(root: &Path) -> Vec<PathBuf> {
    beside(root, ".", REMOVED)
}
