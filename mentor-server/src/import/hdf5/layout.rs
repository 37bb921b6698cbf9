//! Whose layout a file has, and where its states are: a group an episode, or one dataset over all of them.
//!
//! | layout | states | what ends an episode |
//! |---|---|---|
//! | Minari | `episode_N/observations[/KEY]` | the group |
//! | robomimic | `data/demo_N/obs/KEY` | the group |
//! | ManiSkill | `traj_N/obs[/KEY]` | the group |
//! | D4RL | `observations` | flags beside it |
//! | any other | `--key` with the path; `*` in it stands for the episodes | the group, or flags beside the dataset |

use super::links::Found;
use super::{Source, unreadable};
use crate::import::error::{ImportError, list};
use crate::import::labels::{is_no_state, role};
use crate::import::names::{matches, sorted};
use crate::import::{Options, metadata};
use hdf5_pure::DType;
use std::path::Path;
use trestle_proto::limits::MAX_OBS_DIM;

/// Most objects that are looked at for a message, and how deep.
const MAX_LOOKED_AT: usize = 2000;
const MAX_DEPTH: usize = 8;

/// Where the states are.
pub(super) enum Choice {
    Episodes(Episodes),
    /// A dataset by its path.
    Flat(String),
}

/// Episodes that are groups.
pub(super) struct Episodes {
    /// Paths of the groups, in order.
    pub(super) groups: Vec<String>,
    /// The dataset in each; empty if the "groups" are the datasets.
    pub(super) dataset: String,
    /// Whether the flags must be Minari's.
    pub(super) minari: bool,
}

/// A layout with a group an episode: its name, where the groups are, what their names begin with, and the observations in them.
const LAYOUTS: [(&str, &str, &str, &str); 3] = [
    ("Minari (HDF5)", "", "episode_", "observations"),
    ("robomimic (HDF5)", "data", "demo_", "obs"),
    ("ManiSkill (HDF5)", "", "traj_", "obs"),
];
/// What one dataset over all episodes is called at the top; the first one is D4RL's.
const FLAT: [&str; 4] = ["observations", "obs", "states", "observation"];

/// Finds the states that `options` ask for; says whose layout it is.
pub(super) fn choose(source: &Source, options: &Options) -> Result<(&'static str, Choice), ImportError> {
    let key = options.key.as_deref().map(|key| key.trim_matches('/'));
    let (datasets, groups) = source.children("")?;
    if let Some(key) = key {
        let last = key.rsplit(['/', '.']).next().unwrap_or(key);
        if is_no_state(last) {
            let accepted = "what holds states; actions and rewards are no part of a demonstration";
            return Err(source.place().refuse("--key", format!("`{key}`"), accepted));
        }
    }
    // A path from the top, dotted or slashed.
    if let Some(found) = key.and_then(|key| source.at_path(key, &datasets, &groups).transpose()) {
        return Ok(("HDF5", found?));
    }
    for (name, above, prefix, observations) in LAYOUTS {
        let names = match above {
            "" => groups.clone(),
            above if groups.iter().any(|group| group == above) => source.children(above)?.1,
            _ => continue,
        };
        let of_episode = |name: &str| number(name, prefix).is_some();
        source.refuse_unread(above, of_episode)?;
        let matching: Vec<String> = names.into_iter().filter(|name| of_episode(name)).collect();
        if matching.is_empty() {
            continue;
        }
        let minari = prefix == LAYOUTS[0].2;
        if minari {
            check_minari(source, &matching)?;
        }
        let groups: Vec<String> = sorted(matching).iter().map(|name| join(above, name)).collect();
        let dataset = source.observations(&groups[0], observations, key)?;
        return Ok((name, Choice::Episodes(Episodes { groups, dataset, minari })));
    }
    let flat = FLAT.iter().find(|name| datasets.iter().any(|own| own == *name));
    match (flat, key) {
        (Some(&name), None) => Ok(("D4RL (HDF5)", Choice::Flat(name.into()))),
        (_, key) => {
            // A link in the place of the observations has the first word.
            if key.is_none() {
                source.refuse_unread("", |name| FLAT.contains(&name))?;
            }
            let value =
                key.map_or("missing, and the layout is not a known one".into(), |key| format!("`{key}`"));
            let found = source.candidates();
            if found.iter().any(|path| path.contains("/_i_table/")) {
                let next = format!(
                    "`python3 -c 'import pandas; pandas.read_hdf(\"{}\").to_csv(\"demo.csv\", index=False)'` makes CSV of it",
                    source.path.display()
                );
                return Err(source.place().foreign("a table of pandas", next));
            }
            let accepted = match found {
                found if found.is_empty() => "a file with arrays of numbers in it".into(),
                found => format!("a path, such as {}", list(&found)),
            };
            Err(source.place().refuse("--key", value, accepted))
        }
    }
}

impl Source {
    /// The names of datasets and groups in the group at `path`, the names of soft links included.
    pub(super) fn children(&self, path: &str) -> Result<(Vec<String>, Vec<String>), ImportError> {
        let group = self.group(path)?;
        let mut datasets = group.datasets().map_err(unreadable(&self.path))?;
        let mut groups = group.groups().map_err(unreadable(&self.path))?;
        for name in self.finder.linked(path) {
            // One of the old style is a hard link by now.
            if datasets.contains(&name) || groups.contains(&name) {
                continue;
            }
            let Found::Object(real, _) = self.finder.find(&join(path, &name)) else { continue };
            if self.file.dataset(&real).is_ok() {
                datasets.push(name);
            } else if self.group(&real).is_ok() {
                groups.push(name);
            }
        }
        datasets.sort();
        groups.sort();
        Ok((datasets, groups))
    }

    /// What `key` leads to from the top; none where it leads nowhere.
    fn at_path(
        &self,
        key: &str,
        datasets: &[String],
        groups: &[String],
    ) -> Result<Option<Choice>, ImportError> {
        let slashed: Vec<&str> = key.split('/').collect();
        let dotted: Vec<&str> = key.split(['/', '.']).collect();
        for parts in [slashed, dotted] {
            let first = parts[0];
            if parts.iter().any(|part| part.contains('*')) {
                if let Some(episodes) = self.expand(&parts)? {
                    return Ok(Some(Choice::Episodes(episodes)));
                }
            } else if datasets.iter().chain(groups).any(|name| name == first) {
                let path = parts.join("/");
                if self.dataset_if_any(&path)?.is_some() {
                    return Ok(Some(Choice::Flat(path)));
                }
            }
        }
        if key.contains('*') {
            let accepted = format!("a path of the file, such as {}", list(&self.candidates()));
            return Err(self.place().refuse("--key", format!("`{key}`, which matches nothing"), accepted));
        }
        Ok(None)
    }

    /// The episodes that a path with `*` in it leads to.
    fn expand(&self, parts: &[&str]) -> Result<Option<Episodes>, ImportError> {
        let last = parts.iter().rposition(|part| part.contains('*')).unwrap_or(0);
        let mut paths = vec![String::new()];
        for (i, part) in parts[..=last].iter().enumerate() {
            let mut next = Vec::new();
            for path in paths {
                let Ok((datasets, groups)) = self.children(&path) else { continue };
                self.refuse_unread(&path, |name| matches(part, name))?;
                // Where nothing follows, the datasets themselves are episodes.
                let names = if i + 1 == parts.len() { datasets } else { groups };
                let matching = names.into_iter().filter(|name| matches(part, name)).collect();
                next.extend(sorted(matching).iter().map(|name| join(&path, name)));
            }
            paths = next;
        }
        let dataset = parts[last + 1..].join("/");
        let Some(first) = paths.first() else { return Ok(None) };
        if self.dataset_if_any(&join(first, &dataset))?.is_none() {
            return Ok(None);
        }
        Ok(Some(Episodes { groups: paths, dataset, minari: false }))
    }

    /// The path, within the episode's group, of the observations that `key` names.
    fn observations(&self, group: &str, name: &str, key: Option<&str>) -> Result<String, ImportError> {
        let place = || self.place().episode(0);
        let top = join(group, name);
        // A dataset beside the observations: `env_states/actors/cube`, `states`.
        if let Some(key) = key
            && self.dataset_if_any(&join(group, key))?.is_some()
        {
            return Ok(key.into());
        }
        if self.dataset_if_any(&top)?.is_some() {
            return match key {
                None => Ok(name.into()),
                Some(key) => {
                    let accepted = "no --key: the observations are no dictionary";
                    Err(place().refuse("--key", format!("`{key}`"), accepted))
                }
            };
        }
        if self.children(group)?.1.iter().all(|own| own != name) {
            return Err(place().refuse(name, "missing", "a dataset, or a group of datasets"));
        }
        let missing = |path: &str, value: String| -> ImportError {
            let names = self.children(path).map(|(datasets, groups)| sorted([datasets, groups].concat()));
            names.map_or_else(
                |e| e,
                |names| place().refuse("--key", value, format!("one of {}", list(&names))),
            )
        };
        let Some(key) = key else {
            return Err(missing(&top, "missing, and the observations are a dictionary".into()));
        };
        for parts in [key.split('/').collect::<Vec<_>>(), key.split(['/', '.']).collect()] {
            let path = join(name, &parts.join("/"));
            if self.dataset_if_any(&join(group, &path))?.is_some() {
                return Ok(path);
            }
        }
        // The last part that is there says what there is.
        let mut known = top.clone();
        for part in key.split('/') {
            match self.children(&join(&known, part)) {
                Ok(_) => known = join(&known, part),
                Err(_) => break,
            }
        }
        Err(missing(&known, format!("`{key}`")))
    }

    /// Paths of arrays of numbers that could be states, `*` in the place of an episode's number.
    fn candidates(&self) -> Vec<String> {
        let (mut open, mut found, mut looked) = (vec![(String::new(), String::new(), 0)], Vec::new(), 0);
        while let Some((path, pattern, depth)) = open.pop() {
            looked += 1;
            let Ok((datasets, groups)) = self.children(&path) else { continue };
            if looked > MAX_LOOKED_AT || depth > MAX_DEPTH {
                break;
            }
            for name in datasets {
                let dataset = self.dataset_if_any(&join(&path, &name)).ok().flatten();
                let numbers = dataset.is_some_and(|dataset| {
                    let kind = dataset.dtype().is_ok_and(|kind| {
                        !matches!(kind, DType::String | DType::VariableLengthString | DType::Compound(_))
                    });
                    let shape = dataset.shape().unwrap_or_default();
                    let width = shape.iter().skip(1).try_fold(1_u64, |a, &b| a.checked_mul(b));
                    kind && shape.len() > 1 && width.is_some_and(|width| width <= MAX_OBS_DIM as u64)
                });
                if numbers && !is_no_state(&name) && role(&name).is_none() {
                    found.push(join(&pattern, &name));
                }
            }
            let mut seen = Vec::new();
            for name in groups {
                let star = starred(&name);
                if !seen.contains(&star) {
                    open.push((join(&path, &name), join(&pattern, &star), depth + 1));
                    seen.push(star);
                }
            }
        }
        found.sort();
        found
    }
}

/// Minari numbers its episodes without a gap, and says how many there are.
fn check_minari(source: &Source, names: &[String]) -> Result<(), ImportError> {
    let prefix = LAYOUTS[0].2;
    let mut numbers: Vec<u64> = names.iter().filter_map(|name| number(name, prefix)).collect();
    numbers.sort_unstable();
    if let Some(missing) = (0..numbers.len() as u64).find(|&n| numbers[n as usize] != n) {
        let accepted = format!("{prefix}0 to {prefix}{}, each once", numbers.len() - 1);
        return Err(source.place().refuse(format!("{prefix}{missing}"), "missing", accepted));
    }
    let above = source.path.parent().unwrap_or(Path::new(""));
    metadata::check_episodes(&source.path, numbers.len() as u64, above)
}

/// The number after `prefix`, however many zeros pad it.
fn number(name: &str, prefix: &str) -> Option<u64> {
    name.strip_prefix(prefix).filter(|rest| rest.bytes().all(|byte| byte.is_ascii_digit()))?.parse().ok()
}

/// `name` with a star for the number at its end.
fn starred(name: &str) -> String {
    match name.trim_end_matches(|c: char| c.is_ascii_digit()) {
        stem if stem.len() < name.len() => format!("{stem}*"),
        _ => name.into(),
    }
}

/// A path in a group; the root is empty.
pub(super) fn join(group: &str, name: &str) -> String {
    match (group, name) {
        ("", name) => name.into(),
        (group, "") => group.into(),
        _ => format!("{group}/{name}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_episodes() {
        let number = |name: &str| number(name, "episode_");
        assert_eq!([number("episode_007"), number("episode_x"), number("episode_")], [Some(7), None, None]);
        assert_eq!([starred("traj_3"), starred("obs")], ["traj_*", "obs"]);
    }
}
