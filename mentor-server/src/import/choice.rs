//! What of a source is wanted, as it is typed: columns, episodes, and which ends are terminal.

use super::error::list;
use std::fmt;
use std::ops::Range;
use std::str::FromStr;
use trestle_proto::limits::MAX_OBS_DIM;

/// Features of a state: `0..4`, `0,1,4..6`, or, where columns have names, `x,y`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Columns(Vec<Item>);

/// What is between two commas.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Item {
    text: String,
    /// Its numbers, unless it can only be a name.
    places: Option<Range<usize>>,
}

impl FromStr for Columns {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let item = |text: &str| {
            let number = |place: usize| place..place.saturating_add(1);
            let places = range(text).or_else(|| text.parse().ok().map(number));
            match &places {
                Some(places) if places.is_empty() => Err(format!("`{text}` is empty")),
                None if text.is_empty() => Err("a name or number is missing".into()),
                _ => Ok(Item { text: text.into(), places }),
            }
        };
        text.split(',').map(|text| item(text.trim())).collect::<Result<_, _>>().map(Self)
    }
}

impl Columns {
    /// The places of these columns among `width` ones with `names` (none where they have none).
    ///
    /// Names win over places: where columns have numbers as names, numbers are names alone.
    ///
    /// # Errors
    /// What is missing, and what there is.
    pub(super) fn resolve(&self, width: usize, names: &[String]) -> Result<Vec<usize>, (String, String)> {
        let place_of = |name: &str| names.iter().position(|own| own == name);
        let numbered = names.iter().any(|name| name.parse::<usize>().is_ok());
        let mut out = Vec::new();
        for item in &self.0 {
            let places: Vec<usize> = match (place_of(&item.text), &item.places) {
                (Some(place), _) => vec![place],
                (None, Some(places)) if places.len() > MAX_OBS_DIM => {
                    return Err((format!("more than {MAX_OBS_DIM}"), format!("up to {MAX_OBS_DIM} of them")));
                }
                (None, Some(places)) if numbered => {
                    let named = |place: usize| {
                        let accepted = || format!("names, as this header has numbers in it: {}", list(names));
                        place_of(&place.to_string()).ok_or_else(|| (format!("{place}"), accepted()))
                    };
                    places.clone().map(named).collect::<Result<_, _>>()?
                }
                (None, Some(places)) if places.end <= width => places.clone().collect(),
                (None, Some(places)) => {
                    return Err((format!("{}", places.end - 1), format!("0 to {}", width.saturating_sub(1))));
                }
                (None, None) => {
                    let accepted = if names.is_empty() {
                        format!("0 to {}", width.saturating_sub(1))
                    } else {
                        list(names)
                    };
                    return Err((format!("`{}`", item.text), accepted));
                }
            };
            if out.len() + places.len() > MAX_OBS_DIM {
                return Err((format!("more than {MAX_OBS_DIM}"), format!("up to {MAX_OBS_DIM} of them")));
            }
            for place in places {
                if out.contains(&place) {
                    return Err((format!("{place} twice"), "each column once".into()));
                }
                out.push(place);
            }
        }
        Ok(out)
    }
}

/// Episodes in the order of the source: `0..3` are the first three, `0..3,5,8..10` leaves some out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Episodes(Vec<Range<u64>>);

impl FromStr for Episodes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let accepted = "accepted: FROM..TO or single ones, in ascending order, such as 0..3 or 0..3,5";
        let one = |text: &str| match text.parse::<u64>() {
            Ok(episode) => Some(episode..episode.saturating_add(1)),
            Err(_) => range(text).map(|range| range.start as u64..range.end as u64),
        };
        let ranges: Option<Vec<Range<u64>>> = text.split(',').map(|text| one(text.trim())).collect();
        let ranges = ranges.ok_or(accepted)?;
        let ascending = ranges.windows(2).all(|pair| pair[0].end <= pair[1].start);
        if !ascending || ranges.iter().any(Range::is_empty) {
            return Err(accepted.into());
        }
        Ok(Self(ranges))
    }
}

impl Episodes {
    pub(super) fn contains(&self, episode: u64) -> bool {
        self.0.iter().any(|range| range.contains(&episode))
    }

    /// What all of them are below.
    pub(super) fn end(&self) -> u64 {
        self.0.last().map_or(0, |range| range.end)
    }
}

impl fmt::Display for Episodes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, range) in self.0.iter().enumerate() {
            write!(f, "{}{}..{}", if i > 0 { "," } else { "" }, range.start, range.end)?;
        }
        Ok(())
    }
}

/// `FROM..TO`.
fn range(text: &str) -> Option<Range<usize>> {
    let (start, end) = text.split_once("..")?;
    Some(start.parse().ok()?..end.parse().ok()?)
}

/// Which trajectories end in a terminal state: one that has no value, as opposed to where a recording was cut off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Ends {
    /// Those of which the source says so.
    #[default]
    Recorded,
    /// All.
    Terminal,
    /// None.
    CutOff,
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn columns_by_place_and_name() {
        let names: Vec<String> = ["x", "y", "speed"].map(String::from).to_vec();
        let resolve = |text: &str| text.parse::<Columns>().unwrap().resolve(3, &names);
        assert_eq!(resolve("0..2"), Ok(vec![0, 1]));
        assert_eq!(resolve("speed, x"), Ok(vec![2, 0]));
        assert_eq!(resolve("2,0..2"), Ok(vec![2, 0, 1]));
        assert_eq!(resolve("1,3"), Err(("3".into(), "0 to 2".into())));
        assert_eq!(resolve("z"), Err(("`z`".into(), "x, y, speed".into())));
        assert_eq!(resolve("0,x"), Err(("0 twice".into(), "each column once".into())));
        for bad in ["", "1,", "3..1"] {
            assert!(bad.parse::<Columns>().is_err(), "{bad}");
        }
    }

    #[test]
    fn names_win_over_places() {
        let resolve = |text: &str, names: [&str; 3]| {
            text.parse::<Columns>().unwrap().resolve(3, &names.map(String::from))
        };
        // A data frame that pandas wrote with its index.
        assert_eq!(resolve("0,1", ["", "0", "1"]), Ok(vec![1, 2]));
        assert_eq!(resolve("0..2", ["", "0", "1"]), Ok(vec![1, 2]));
        assert_eq!(resolve("2..4", ["5", "2", "3"]), Ok(vec![1, 2]));
        let (value, accepted) = resolve("2", ["", "0", "1"]).unwrap_err();
        assert!(value == "2" && accepted.starts_with("names, as"), "{accepted}");
    }

    #[test]
    fn episodes_are_half_open() {
        let parse = |text: &str| text.parse::<Episodes>();
        assert_eq!(parse("0..3").unwrap().to_string(), "0..3");
        let some = parse("0..2, 4,6..8").unwrap();
        assert_eq!((0..10).filter(|&i| some.contains(i)).collect::<Vec<_>>(), [0, 1, 4, 6, 7]);
        assert_eq!((some.end(), some.to_string()), (8, "0..2,4..5,6..8".into()));
        for bad in ["", "3..3", "4..3", "a..b", "-1..3", "0..3,2", "1,"] {
            assert!(parse(bad).is_err(), "{bad}");
        }
    }
}
