//! Whether a demonstration's states are ones that the environment can be in.
//!
//! States outside of the environment's spaces are refused: networks and encodings do not expect them. States in walls are refused
//! where most are such, or where the axes are swapped. Where only a few are, the run can do without them, and a warning counts
//! them.

use anyhow::{Result, bail};
use std::fmt;
use std::path::Path;
use trestle_actor::env::{Environment, Impossible};
use trestle_algorithm::demonstration::Demonstration;
use trestle_mentor_server::demo_file;

/// Looks at every state of the demonstration in the file at `path`, which has as many features as those of `env`; says what
/// there is to warn of.
///
/// # Errors
/// States from which nothing sensible can be learnt.
pub(super) fn check(
    path: &Path,
    demonstration: &Demonstration,
    env: &dyn Environment,
) -> Result<Option<String>> {
    let spec = env.spec();
    let as_it_stands: Vec<usize> = (0..demonstration.dim()).collect();
    let Some(found) = count(path, demonstration, env, &as_it_stands) else {
        return Ok(by_names(path, demonstration, env));
    };
    let message = format!("mentor.demo = {}: {found}", path.display());
    let Some(swapped) = swapped(demonstration, env) else {
        if found.outside > 0 || 2 * found.impossible > found.total {
            bail!("{message}");
        }
        return Ok(Some(format!("{message}; transitions from and to them are learnt from like others")));
    };
    bail!(
        "{message}; with {swapped} swapped {} can be in every state: are they row and column, not column and row?",
        spec.name
    )
}

/// States that are impossible.
struct Found {
    impossible: usize,
    /// Those of them that are out of the environment's range.
    outside: usize,
    total: usize,
    /// The environment, and where the first is and why.
    name: String,
    first: String,
}

impl fmt::Display for Found {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { impossible, total, name, first, .. } = self;
        write!(f, "{impossible} of {total} states are none that {name} can be in, the first {first}")
    }
}

/// The states that are impossible if their features are taken in this `order`; none if there are no such.
fn count(
    path: &Path,
    demonstration: &Demonstration,
    env: &dyn Environment,
    order: &[usize],
) -> Option<Found> {
    let total = demonstration.n_states();
    let (mut impossible, mut outside, mut first) = (0, 0, None);
    let mut state = vec![0.0; order.len()];
    for m in 0..total {
        let own = demonstration.state(m);
        order.iter().zip(&mut state).for_each(|(&from, to)| *to = own[from]);
        let Err(why) = env.can_be_in(&state) else { continue };
        let range = matches!(why, Impossible::Range { .. });
        // What is refused has the first word.
        if first.is_none() || (range && outside == 0) {
            first = Some((m, why));
        }
        impossible += 1;
        outside += usize::from(range);
    }
    let (first, why) = first?;
    let row = demo_file::row_of(path, first).map_or(String::new(), |row| format!("in row {row}, "));
    let shown: Vec<String> = demonstration.state(first).iter().take(8).map(f32::to_string).collect();
    let more = if demonstration.dim() > shown.len() { ", ..." } else { "" };
    let first = format!("{row}state {first}, ({}{more}): {why}", shown.join(", "));
    Some(Found { impossible, outside, total, name: env.spec().name.clone(), first })
}

/// A warning where the features have the names of the environment's in another order.
fn by_names(path: &Path, demonstration: &Demonstration, env: &dyn Environment) -> Option<String> {
    let (own, expected) = (demonstration.names(), env.features());
    if let Some(unknown) = unknown(own, &expected) {
        return Some(format!(
            "mentor.demo = {}: {} has no feature called {unknown}, so its columns are taken in their order, as {}",
            path.display(),
            env.spec().name,
            expected.join(", ")
        ));
    }
    let place = |name: &&str| own.iter().position(|own| own.trim().eq_ignore_ascii_case(name));
    let order: Vec<usize> = expected.iter().map(place).collect::<Option<_>>()?;
    if order.is_empty() || order.iter().enumerate().all(|(i, &place)| i == place) {
        return None;
    }
    let taken = match count(path, demonstration, env, &order) {
        Some(found) => found.to_string(),
        None => "every state is possible as well".into(),
    };
    Some(format!(
        "mentor.demo = {}: its features are called {}, but those of {} are {}, and their order counts, not their names; taken by their \
         names, {taken}",
        path.display(),
        own.join(", "),
        env.spec().name,
        expected.join(", ")
    ))
}

/// The names among `own` that are those of no feature; none where the features have no names, or where the columns have none: then
/// they are numbered, as `trestle demo record` numbers them.
fn unknown(own: &[String], expected: &[&str]) -> Option<String> {
    let numbered = |(i, name): (usize, &String)| *name == format!("s{i}");
    if expected.is_empty() || own.iter().enumerate().all(numbered) {
        return None;
    }
    let known = |name: &str| expected.iter().any(|expected| name.trim().eq_ignore_ascii_case(expected));
    let unknown: Vec<&str> = own.iter().map(String::as_str).filter(|name| !known(name)).collect();
    (!unknown.is_empty()).then(|| unknown.join(", "))
}

/// Which features must be swapped so that every state is possible; none where that does not help.
fn swapped(demonstration: &Demonstration, env: &dyn Environment) -> Option<&'static str> {
    let dim = demonstration.dim();
    let swaps: [(&str, &[[usize; 2]], usize); 2] =
        [("features 0 and 1", &[[0, 1]], 2), ("features 0 and 1, and 2 and 3,", &[[0, 1], [2, 3]], 4)];
    let helps = |pairs: &[[usize; 2]]| {
        let mut state = vec![0.0; dim];
        (0..demonstration.n_states()).all(|m| {
            state.copy_from_slice(demonstration.state(m));
            pairs.iter().for_each(|&[a, b]| state.swap(a, b));
            env.can_be_in(&state).is_ok()
        })
    };
    // Where both help, velocities are swapped with positions.
    swaps.into_iter().rev().find(|(_, pairs, needed)| *needed <= dim && helps(pairs)).map(|(name, _, _)| name)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use trestle_actor::env::registry;
    use trestle_proto::config;

    /// A maze of cells, or of the ball.
    #[derive(Clone, Copy)]
    enum World {
        Cells,
        Ball,
    }

    fn environment(world: World) -> Box<dyn Environment> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("map.txt");
        std::fs::write(&path, "S...\n##.#\n##.#\n##.G\n").unwrap();
        let (preset, table, sets): (&str, &str, &[&str]) = match world {
            World::Cells => ("maze-small", "maze", &["actions=regular"]),
            World::Ball => ("point-umaze", "point-maze", &["actions=orthogonal", "backend=builtin"]),
        };
        let mut sets: Vec<String> = sets.iter().map(|set| format!("env.{table}.{set}")).collect();
        sets.push(format!("env.{table}.map={}", path.display()));
        let mut config = config::load(registry(), preset, &sets).unwrap();
        registry().resolve(&mut config.env, 0).unwrap();
        registry().build(&config.env).unwrap()
    }

    fn checked(world: World, states: &[&[f32]]) -> Result<Option<String>, String> {
        let names: Vec<String> = (0..states[0].len()).map(|i| format!("s{i}")).collect();
        named(world, states, &names)
    }

    fn named(world: World, states: &[&[f32]], names: &[String]) -> Result<Option<String>, String> {
        let mut demonstration = Demonstration::new(names.to_vec()).unwrap();
        demonstration.push_trajectory(&states.concat(), true).unwrap();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("d.csv");
        demo_file::write(&path, &demonstration).unwrap();
        check(&path, &demonstration, environment(world).as_ref()).map_err(|error| error.to_string())
    }

    #[test]
    fn names_in_another_order_are_a_warning() {
        let states: [&[f32]; 3] = [&[0.0, 0.0], &[1.0, 0.0], &[2.0, 0.0]];
        let maze = |names: [&str; 2]| named(World::Cells, &states, &names.map(String::from)).unwrap();
        assert_eq!([maze(["column", "row"]), maze(["s0", "s1"])], [None, None]);
        let unknown = maze(["column", "b"]).unwrap();
        assert!(
            unknown
                .contains("has no feature called b, so its columns are taken in their order, as column, row")
        );
        let warning = maze(["row", "column"]).unwrap();
        assert!(warning.contains("are called row, column, but those of maze"), "{warning}");
        assert!(
            warning.contains("2 of 3 states are none") && warning.contains("in row 3, state 1, (1, 0)"),
            "{warning}"
        );
    }

    #[test]
    fn states_in_walls_are_counted_and_refused_where_they_are_most() {
        let maze = |states: &[&[f32]]| checked(World::Cells, states);
        assert_eq!(maze(&[&[0.0, 0.0], &[1.0, 0.0], &[2.0, 0.0], &[2.0, 1.0]]), Ok(None));
        let warning = maze(&[&[0.0, 0.0], &[1.0, 0.0], &[1.0, 1.0], &[2.0, 0.0]]).unwrap().unwrap();
        assert!(warning.contains("1 of 4 states are none that maze"), "{warning}");
        assert!(
            warning.contains("the first in row 4, state 2, (1, 1): it lies in the wall at column 1, row 1"),
            "{warning}"
        );
        let refused = maze(&[&[0.0, 1.0], &[0.0, 2.0], &[2.0, 2.0], &[1.0, 1.0]]).unwrap_err();
        assert!(refused.contains("3 of 4 states") && !refused.contains("swapped"), "{refused}");
    }

    #[test]
    fn swapped_axes_and_wrong_scales_are_named() {
        let swapped =
            checked(World::Cells, &[&[0.0, 0.0], &[0.0, 1.0], &[0.0, 2.0], &[1.0, 2.0]]).unwrap_err();
        assert!(swapped.contains("with features 0 and 1 swapped maze"), "{swapped}");
        let scaled = checked(World::Cells, &[&[0.0, 0.0], &[0.1, 0.0]]).unwrap_err();
        assert!(
            scaled
                .contains("row 3, state 1, (0.1, 0): feature 0 is 0.1; accepted: whole numbers from 0 to 3"),
            "{scaled}"
        );
        // x is the row there.
        let point: [&[f32]; 3] = [&[0.0, 0.0, 0.0, 0.0], &[0.0, 1.0, 0.0, 0.5], &[0.0, 2.0, 0.0, 0.5]];
        assert_eq!(checked(World::Ball, &point), Ok(None));
        let point: [&[f32]; 3] = [&[0.0, 0.0, 0.0, 0.0], &[1.0, 0.0, 0.5, 0.0], &[2.0, 0.0, 0.5, 0.0]];
        let swapped = checked(World::Ball, &point).unwrap_err();
        assert!(swapped.contains("features 0 and 1, and 2 and 3, swapped"), "{swapped}");
    }
}
