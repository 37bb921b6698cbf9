//! Compass directions and the action sets that are made of them.

use super::GridError;
use std::collections::BTreeMap;
use trestle_proto::names;

/// One of the eight directions of a map. North is up, towards row 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Up.
    N,
    /// Up and right.
    NE,
    /// Right.
    E,
    /// Down and right.
    SE,
    /// Down.
    S,
    /// Down and left.
    SW,
    /// Left.
    W,
    /// Up and left.
    NW,
}

impl Direction {
    /// All of them, clockwise from the north.
    pub const ALL: [Self; 8] = [Self::N, Self::NE, Self::E, Self::SE, Self::S, Self::SW, Self::W, Self::NW];

    /// Its name in configurations.
    pub fn name(self) -> &'static str {
        match self {
            Self::N => "N",
            Self::NE => "NE",
            Self::E => "E",
            Self::SE => "SE",
            Self::S => "S",
            Self::SW => "SW",
            Self::W => "W",
            Self::NW => "NW",
        }
    }

    /// Change of (column, row), each -1, 0 or 1; rows count downwards.
    pub fn delta(self) -> (i32, i32) {
        match self {
            Self::N => (0, -1),
            Self::NE => (1, -1),
            Self::E => (1, 0),
            Self::SE => (1, 1),
            Self::S => (0, 1),
            Self::SW => (-1, 1),
            Self::W => (-1, 0),
            Self::NW => (-1, -1),
        }
    }
}

/// The paper's regular action set, the mentor's: a step to each of the four sides.
pub const REGULAR: &[Direction] = &[Direction::N, Direction::E, Direction::S, Direction::W];

/// The paper's irregular action set, the observer's. The figure that defines it (6b) is not available to us; this
/// is the set of Price and Boutilier's experiments with heterogeneous actions as far as we know it, and it gives
/// the paper's best return on its 30 x 30 maze exactly.
pub const IRREGULAR: &[Direction] = &[Direction::N, Direction::NE, Direction::S, Direction::SW];

/// A named list of directions; action `i` is the `i`-th of them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ActionSet {
    /// Its name.
    pub name: String,
    /// 2 to 8 directions, each at most once. Their order breaks ties.
    pub directions: Vec<Direction>,
}

impl ActionSet {
    /// The built-in set of `directions` called `name`.
    pub fn new(name: &str, directions: &[Direction]) -> Self {
        Self { name: name.into(), directions: directions.to_vec() }
    }

    /// Names of the directions in order, for people.
    pub fn describe(&self) -> String {
        let names: Vec<_> = self.directions.iter().map(|d| d.name()).collect();
        names.join(", ")
    }
}

/// The action sets that a configuration can name.
#[derive(Clone, Copy, Debug)]
pub struct ActionSets<'a> {
    /// Those of the environment.
    pub builtin: &'a [(&'static str, &'static [Direction])],
    /// Those of `env.action_sets`: names of directions.
    pub own: &'a BTreeMap<String, Vec<String>>,
}

impl ActionSets<'_> {
    /// The action set called `name`. All sets of the configuration are checked. `key` is the setting that holds the name.
    ///
    /// # Errors
    /// No set of this name, or any set of the configuration that cannot be used.
    pub fn find(&self, key: &'static str, name: &str) -> Result<ActionSet, GridError> {
        let mut found = self
            .builtin
            .iter()
            .find(|(known, _)| *known == name)
            .map(|(_, directions)| ActionSet::new(name, directions));
        for (own, names) in self.own {
            let set = self.defined(own, names)?;
            if own == name {
                found = Some(set);
            }
        }
        found.ok_or_else(|| {
            let builtin = self.builtin.iter().map(|(known, _)| *known);
            let known: Vec<_> = builtin.chain(self.own.keys().map(String::as_str)).collect();
            let hint = names::hint(name, known.iter().copied());
            GridError::ActionSet { key, name: name.into(), known: known.join(", "), hint }
        })
    }

    /// The set that the configuration defines as `name`.
    fn defined(&self, name: &str, names: &[String]) -> Result<ActionSet, GridError> {
        let refuse = |message: String| Err(GridError::ActionSetDefinition { name: name.into(), message });
        if self.builtin.iter().any(|(known, _)| *known == name) {
            return refuse("this set is built in; accepted: another name".into());
        }
        if !(2..=Direction::ALL.len()).contains(&names.len()) {
            return refuse(format!("{} directions; accepted: 2 to 8", names.len()));
        }
        let mut directions = Vec::with_capacity(names.len());
        for text in names {
            match Direction::ALL.into_iter().find(|d| d.name() == text) {
                None => {
                    let hint = names::hint(text, Direction::ALL.map(Direction::name));
                    return refuse(format!("`{text}`; accepted: N, NE, E, SE, S, SW, W, NW{hint}"));
                }
                Some(d) if directions.contains(&d) => {
                    return refuse(format!("`{text}` is given twice; accepted: each direction once"));
                }
                Some(d) => directions.push(d),
            }
        }
        Ok(ActionSet { name: name.into(), directions })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const BUILTIN: &[(&str, &[Direction])] = &[("regular", REGULAR), ("irregular", IRREGULAR)];

    fn find(sets: &[(&str, &[&str])], key: &'static str, name: &str) -> Result<ActionSet, String> {
        let own = |(name, names): &(&str, &[&str])| {
            ((*name).to_string(), names.iter().map(ToString::to_string).collect())
        };
        let own = sets.iter().map(own).collect();
        ActionSets { builtin: BUILTIN, own: &own }.find(key, name).map_err(|error| error.to_string())
    }

    #[test]
    fn built_in_and_custom_sets_are_found() {
        let described = |name| find(&[("knight", &["SE", "NW"])], "env.actions", name).unwrap().describe();
        assert_eq!(described("regular"), "N, E, S, W");
        assert_eq!(described("irregular"), "N, NE, S, SW");
        assert_eq!(described("knight"), "SE, NW");
        let refused = |name| find(&[("knight", &["SE", "NW"])], "mentor.actions", name).unwrap_err();
        assert_eq!(refused("king"), "mentor.actions = king; action sets: regular, irregular, knight");
        assert!(refused("irregullar").ends_with("irregular, knight; did you mean `irregular`?"));
    }

    #[test]
    fn unusable_sets_are_refused_even_when_unused() {
        let refused =
            |name: &str, names: &[&str]| find(&[(name, names)], "env.actions", "regular").unwrap_err();
        assert!(refused("regular", &["N", "S"]).contains("built in"));
        assert!(refused("mine", &["N"]).contains("1 directions; accepted: 2 to 8"));
        assert!(refused("mine", &["N", "n"]).contains("`n`; accepted: N, NE"));
        assert!(refused("mine", &["N", "N"]).contains("twice"));
    }

    #[test]
    fn directions_are_the_eight_neighbours() {
        let deltas = Direction::ALL.map(Direction::delta);
        for dx in -1..=1 {
            for dy in -1..=1 {
                let times = deltas.iter().filter(|&&d| d == (dx, dy)).count();
                assert_eq!(times, usize::from((dx, dy) != (0, 0)));
            }
        }
        assert_eq!(Direction::N.delta(), (0, -1));
        assert_eq!(Direction::E.delta(), (1, 0));
    }
}
