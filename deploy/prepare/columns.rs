//! Which features of a state the columns of a demonstration are.

use anyhow::{Result, bail};
use std::path::Path;
use trestle_actor::env::Environment;
use trestle_algorithm::demonstration::Demonstration;
use trestle_proto::config::{Config, RivalKind};
use trestle_proto::space::EnvSpec;

/// The demonstration in the file at `path` with a column for each feature of `env`. Columns may be missing that no setting of
/// `config` compares, where all others have the names of their features: their values are then the middle of their range.
///
/// # Errors
/// Another number of columns that cannot be filled up.
pub(super) fn complete(
    config: &Config,
    path: &Path,
    demonstration: Demonstration,
    env: &dyn Environment,
) -> Result<Demonstration> {
    let (spec, expected) = (env.spec(), env.features());
    let (found, dim) = (demonstration.dim(), spec.obs_dim());
    if found == dim {
        return Ok(demonstration);
    }
    let names = if expected.is_empty() { String::new() } else { format!(", {}", expected.join(", ")) };
    let refused = |more: &str| {
        format!(
            "mentor.demo = {}: its states have {found} features; accepted: {dim}, as in {}{names}{more}",
            path.display(),
            spec.name
        )
    };
    let Some(places) = places(&demonstration, &expected).filter(|_| found < dim) else { bail!(refused("")) };
    let missing: Vec<usize> = (0..dim).filter(|feature| !places.contains(feature)).collect();
    if !left_out(config, &missing) {
        let missing: Vec<&str> = missing.iter().map(|&feature| expected[feature]).collect();
        bail!(refused(&format!(
            "; without {} only where mentor.features leaves that out",
            missing.join(" and ")
        )));
    }
    let blank: Vec<f32> = (0..dim).map(|feature| middle(spec, feature)).collect();
    let mut whole = Demonstration::new(expected.iter().map(ToString::to_string).collect())?;
    for i in 0..demonstration.n_trajectories() {
        let states = demonstration.trajectory(i).flat_map(|m| {
            let mut state = blank.clone();
            places.iter().zip(demonstration.state(m)).for_each(|(&place, &value)| state[place] = value);
            state
        });
        whole.push_trajectory(&states.collect::<Vec<_>>(), demonstration.terminal(i))?;
    }
    Ok(whole)
}

/// The feature of each column, by its name; none where a name is that of no feature, or of one that another column is.
fn places(demonstration: &Demonstration, expected: &[&str]) -> Option<Vec<usize>> {
    let place = |own: &String| expected.iter().position(|name| own.trim().eq_ignore_ascii_case(name));
    let places: Vec<usize> = demonstration.names().iter().map(place).collect::<Option<_>>()?;
    let twice = places.iter().enumerate().any(|(at, place)| places[..at].contains(place));
    (!twice).then_some(places)
}

/// Whether nothing that `config` asks for compares the features `missing`.
fn left_out(config: &Config, missing: &[usize]) -> bool {
    let compared = config.mentor.features.numbers().unwrap_or_default();
    let goals = &config.mentor.learned.features;
    let among = |features: &[usize]| missing.iter().any(|feature| features.contains(feature));
    !compared.is_empty() && !among(compared) && !among(goals) && config.rival.kind == RivalKind::None
}

/// The middle of a feature's range.
fn middle(spec: &EnvSpec, feature: usize) -> f32 {
    let (low, high) = (spec.low[feature], spec.high[feature]);
    let middle = low + (high - low) / 2.0;
    if spec.integral || spec.categories.contains(&feature) { middle.floor() } else { middle }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use trestle_actor::env::registry;
    use trestle_proto::config;

    fn completed(names: &[&str], sets: &[&str]) -> Result<Demonstration, String> {
        let sets: Vec<String> = sets.iter().map(ToString::to_string).collect();
        let mut config = config::load(registry(), "point-umaze", &sets).unwrap();
        registry().resolve(&mut config.env, 0).unwrap();
        let env = registry().build(&config.env).unwrap();
        config.mentor.features.resolve("mentor.features", &env.features(), 4).unwrap();
        let mut demonstration = Demonstration::new(names.iter().map(ToString::to_string).collect()).unwrap();
        let states: Vec<f32> = (0..3 * names.len()).map(|i| i as f32 / 8.0).collect();
        demonstration.push_trajectory(&states, true).unwrap();
        complete(&config, Path::new("d.csv"), demonstration, env.as_ref()).map_err(|error| error.to_string())
    }

    #[test]
    fn columns_that_nothing_compares_may_be_missing() {
        let sets = ["env.backend=builtin", "mentor.features=[\"x\", \"y\"]"];
        let whole = completed(&["y", "X"], &sets).unwrap();
        assert_eq!(whole.names(), ["x", "y", "vx", "vy"]);
        assert_eq!(whole.state(1), [0.375, 0.25, 0.0, 0.0]);
        assert!(whole.terminal(0));
        // All of them, and other names.
        assert_eq!(completed(&["a", "b", "c", "d"], &sets).unwrap().names(), ["a", "b", "c", "d"]);
        let error = completed(&["x", "b"], &sets).unwrap_err();
        assert!(error.contains("its states have 2 features; accepted: 4, as in point-maze"), "{error}");
        assert!(completed(&["x", "x"], &sets).is_err() && completed(&["a"; 5], &sets).is_err());
        let error = completed(&["x", "y"], &sets[..1]).unwrap_err();
        assert!(
            error.ends_with("x, y, vx, vy; without vx and vy only where mentor.features leaves that out"),
            "{error}"
        );
        let goals = [sets[0], sets[1], "mentor.learned.features=[0, 3]"];
        assert!(completed(&["x", "y"], &goals).is_err());
    }
}
