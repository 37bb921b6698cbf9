//! One dataset over all episodes, with flags in its group or in those around it.

use super::Source;
use super::layout::join;
use super::table::Table;
use crate::import::Options;
use crate::import::error::ImportError;
use crate::import::flat::Flat;
use crate::import::labels::{Role, role};
use crate::import::rows::Rows;
use crate::import::sink::Sink;

/// Observations, and the ones after each step.
const SUCCESSORS: [(&str, &str); 2] = [("observations", "next_observations"), ("obs", "next_obs")];

/// Where a file may say at which rows episodes end.
const ENDS: &str = "meta/episode_ends";

/// Reads the episodes that are wanted from the dataset at `path` into `sink`.
pub(super) fn read(
    source: &Source,
    path: &str,
    options: &Options,
    sink: &mut Sink<'_>,
) -> Result<(), ImportError> {
    let place = source.place();
    let table = |path: &str, what: &str| Table::new(source, path, &place, what);
    let states = table(path, "observations")?;
    if let [rows, first, rest @ ..] = states.shape()
        && !rest.is_empty()
    {
        let sides: Vec<String> = [first].into_iter().chain(rest).map(ToString::to_string).collect();
        sink.note(format!(
            "each of the {rows} rows is an array of {}: its {} numbers are the features of a state",
            sides.join(" x "),
            states.width()
        ));
    }
    let (mut group, _) = path.rsplit_once('/').unwrap_or(("", path));
    let mut marks: Vec<(String, Role, Box<dyn Rows>)> = Vec::new();
    loop {
        source.refuse_unread(group, |name| role(name).is_some())?;
        for name in source.children(group)?.0 {
            let own = join(group, &name);
            match role(&name) {
                None | Some(Role::Step) => {}
                Some(kind) if own != path => {
                    let what = own.clone();
                    marks.push((what, kind, Box::new(table(&own, &name)?)));
                }
                Some(_) => {}
            }
        }
        if group.is_empty() {
            break;
        }
        group = group.rsplit_once('/').map_or("", |(above, _)| above);
    }
    // As the data sets of Diffusion Policy are laid out.
    if marks.is_empty() && source.dataset_if_any(ENDS)?.is_some() {
        marks.push((ENDS.into(), Role::End, Box::new(table(ENDS, "episode ends")?)));
    }
    let mut successors: Option<(String, Box<dyn Rows>)> = None;
    for (own, next) in SUCCESSORS {
        if path == own && source.dataset_if_any(next)?.is_some() {
            successors = Some((next.into(), Box::new(table(next, "next observations")?)));
        }
    }
    let one_episode = options.key.is_some();
    Flat { states: Box::new(states), successors, marks, one_episode, length: None }.read(&place, sink)
}
