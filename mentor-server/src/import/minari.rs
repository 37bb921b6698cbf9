//! Minari's HDF5: groups `episode_N` with `observations`, T + 1 of them for T steps, a dataset or a group of datasets.
//! The last observation is the state in which the episode ended; `terminations[T - 1]` says whether it is terminal.

use super::Options;
use super::error::{ImportError, Place};
use super::hdf5::{Table, all_flags, damaged, names, open};
use super::metadata::{check_episodes, last_alone};
use super::sink::Sink;
use hdf5_pure::{Dataset, Group};
use std::path::Path;

const PREFIX: &str = "episode_";

/// Reads the episodes that are wanted into `sink`.
pub(super) fn read(path: &Path, options: &Options, sink: &mut Sink<'_>) -> Result<(), ImportError> {
    let file = open(path)?;
    let groups = file.root().groups().map_err(damaged(path))?;
    let mut numbers: Vec<u64> =
        groups.iter().filter_map(|name| name.strip_prefix(PREFIX)?.parse().ok()).collect();
    numbers.sort_unstable();
    if let Some(missing) = (0..numbers.len() as u64).find(|&n| numbers[n as usize] != n) {
        let accepted = format!("episode_0 to episode_{} without a gap", numbers.len() - 1);
        return Err(Place::of(path).refuse(format!("{PREFIX}{missing}"), "missing", accepted));
    }
    check_episodes(path, numbers.len() as u64, path.parent().unwrap_or(Path::new("")))?;
    for number in numbers {
        if sink.satisfied() {
            break;
        }
        let terminal = if sink.wanted() {
            let group = file.group(&format!("{PREFIX}{number}")).map_err(damaged(path))?;
            episode(path, &group, options, sink)?
        } else {
            false
        };
        sink.end(terminal)?;
    }
    Ok(())
}

/// Reads an episode's states; says whether it was terminated.
fn episode(path: &Path, group: &Group, options: &Options, sink: &mut Sink<'_>) -> Result<bool, ImportError> {
    let place = sink.place();
    let dataset = observations(path, group, options, &place)?;
    let table = Table::new(path, dataset, place.clone(), "the observations")?;
    let flags = |name: &str| {
        let missing = |_| place.clone().refuse(format!("dataset {name}"), "missing", "one flag a step");
        let table = Table::new(path, group.dataset(name).map_err(missing)?, place.clone(), name)?;
        all_flags(&table, &place, name)
    };
    let (terminations, truncations) = (flags("terminations")?, flags("truncations")?);
    let steps = terminations.len() as u64;
    if table.rows() != steps + 1 || truncations.len() as u64 != steps {
        let what = "the number of observations";
        let accepted = format!("{}, one more than steps; it may be cut off", steps + 1);
        return Err(place.refuse(what, table.rows(), accepted));
    }
    sink.columns(table.width(), &[])?;
    let mut first = 0;
    while first < table.rows() {
        let count = table.window().min(table.rows() - first);
        let values = table.read(first, count)?;
        for (i, state) in values.chunks_exact(table.width()).enumerate() {
            sink.row(first + i as u64, |column| state[column])?;
        }
        first += count;
    }
    last_alone(&truncations, &place, "truncations")?;
    last_alone(&terminations, &place, "terminations")
}

/// The dataset of observations that `--key` names.
fn observations(
    path: &Path,
    group: &Group,
    options: &Options,
    place: &Place,
) -> Result<Dataset, ImportError> {
    let key = options.key.as_deref();
    if let Ok(dataset) = group.dataset("observations") {
        return match key {
            None => Ok(dataset),
            Some(key) => {
                let accepted = "no --key: the observations are no dictionary";
                Err(place.clone().refuse("--key", format!("`{key}`"), accepted))
            }
        };
    }
    let mut part = group
        .group("observations")
        .map_err(|_| place.clone().refuse("observations", "missing", "a dataset, or a group of datasets"))?;
    let missing = |part: &Group, value: &str| {
        place.clone().refuse("--key", value, format!("one of {}", names(part).join(", ")))
    };
    let Some(key) = key else { return Err(missing(&part, "missing, and the observations are a dictionary")) };
    let parts: Vec<&str> = key.split('/').collect();
    let Some((last, before)) = parts.split_last() else { return Err(missing(&part, "empty")) };
    for name in before {
        part = part.group(name).map_err(|_| missing(&part, &format!("`{key}`")))?;
    }
    if names(&part).iter().all(|name| name != last) || part.group(last).is_ok() {
        return Err(missing(&part, &format!("`{key}`")));
    }
    part.dataset(last).map_err(damaged(path))
}
