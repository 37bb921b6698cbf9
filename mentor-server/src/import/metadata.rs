//! Minari's `metadata.json`, beside the data: how many episodes there should be.

use super::error::{ImportError, Place};
use serde_json::Value;
use std::path::Path;
use trestle_proto::limits::MAX_TEXT_BYTES;
use trestle_proto::regular_file;

/// The number of episodes according to the `metadata.json` in `dir`; none if there is no such file.
pub(super) fn total_episodes(dir: &Path) -> Result<Option<u64>, ImportError> {
    let path = dir.join("metadata.json");
    let text = match regular_file::read_to_string(&path, MAX_TEXT_BYTES) {
        Err(error) if error.is_not_found() => return Ok(None),
        text => text?,
    };
    let io =
        |error: &dyn std::fmt::Display| ImportError::Io { path: path.clone(), message: error.to_string() };
    let metadata: Value = serde_json::from_str(&text).map_err(|e| io(&e))?;
    Ok(metadata.get("total_episodes").and_then(Value::as_u64))
}

/// Refuses a data set at `path` that has `found` episodes and not as many as its metadata say.
pub(super) fn check_episodes(path: &Path, found: u64, dir: &Path) -> Result<(), ImportError> {
    match total_episodes(dir)? {
        Some(expected) if expected != found => {
            let accepted = format!("{expected}, as in its metadata.json");
            Err(Place::of(path).refuse("the number of episodes", found, accepted))
        }
        _ => Ok(()),
    }
}

/// Refuses flags of which one other than the last is set, and says whether the last is.
pub(super) fn last_alone(flags: &[bool], place: &Place, what: &str) -> Result<bool, ImportError> {
    let (&last, before) = flags.split_last().unwrap_or((&false, &[]));
    match before.iter().position(|&flag| flag) {
        Some(row) => {
            let accepted = "false before the last step of an episode";
            Err(place.clone().row(row as u64).refuse(what, "true", accepted))
        }
        None => Ok(last),
    }
}
