//! What of a source is wanted, as it is typed: columns, episodes, and which ends are terminal.

use std::ops::Range;
use std::str::FromStr;
use trestle_proto::limits::MAX_OBS_DIM;

/// Features of a state: `0..4`, `0,1,4..6`, or, where columns have names, `x,y`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Columns(Vec<Item>);

#[derive(Clone, Debug, PartialEq, Eq)]
enum Item {
    Places(Range<usize>),
    Name(String),
}

impl FromStr for Columns {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let item = |item: &str| {
            if let Some(range) = range(item) {
                return if range.is_empty() {
                    Err(format!("`{item}` is empty"))
                } else {
                    Ok(Item::Places(range))
                };
            }
            match item.parse::<usize>() {
                Ok(place) => Ok(Item::Places(place..place.saturating_add(1))),
                Err(_) if item.is_empty() => Err("a name or number is missing".into()),
                Err(_) => Ok(Item::Name(item.into())),
            }
        };
        text.split(',').map(|text| item(text.trim())).collect::<Result<_, _>>().map(Self)
    }
}

impl Columns {
    /// The places of these columns among `width` ones with `names` (none where they have none).
    ///
    /// # Errors
    /// What is missing, and what there is.
    pub(super) fn resolve(&self, width: usize, names: &[String]) -> Result<Vec<usize>, (String, String)> {
        let mut out = Vec::new();
        for item in &self.0 {
            let places = match item {
                Item::Places(places) if places.end <= width => places.clone(),
                Item::Places(places) => {
                    return Err((format!("{}", places.end - 1), format!("0 to {}", width - 1)));
                }
                Item::Name(name) => {
                    let place = names.iter().position(|own| own == name).ok_or_else(|| {
                        let accepted =
                            if names.is_empty() { format!("0 to {}", width - 1) } else { names.join(", ") };
                        (format!("`{name}`"), accepted)
                    })?;
                    place..place + 1
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

/// Episodes in the order of the source: `0..3` are the first three.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Episodes(pub(super) Range<u64>);

impl FromStr for Episodes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let range = range(text.trim()).map(|range| range.start as u64..range.end as u64);
        range
            .filter(|range| !range.is_empty())
            .map(Self)
            .ok_or_else(|| "accepted: FROM..TO, such as 0..3".into())
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
    fn episodes_are_half_open() {
        assert_eq!("0..3".parse::<Episodes>(), Ok(Episodes(0..3)));
        for bad in ["", "3", "3..3", "4..3", "a..b", "-1..3"] {
            assert!(bad.parse::<Episodes>().is_err(), "{bad}");
        }
    }
}
