//! Options of a scheduler as they are typed: `partition=gpu,time=4:00:00`.

use crate::sweep::arms::pieces;
use std::str::FromStr;

/// `key=value` in the order in which they were typed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Options(Vec<(String, String)>);

impl FromStr for Options {
    type Err = String;

    /// Commas within brackets or quotes belong to the value.
    fn from_str(text: &str) -> Result<Self, String> {
        let pairs = pieces(text)?.into_iter().map(|piece| {
            let (key, value) = piece
                .split_once('=')
                .ok_or_else(|| format!("the option {piece:?}; accepted: KEY=VALUE,KEY=VALUE"))?;
            let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
            if !key.starts_with(|c: char| c.is_ascii_lowercase()) || !key.chars().all(plain) {
                return Err(format!("the option {key:?}; accepted: a name of the letters a-z, 0-9 and -"));
            }
            if value.is_empty() || value.chars().any(|c| c.is_control()) {
                return Err(format!("the value {value:?} of {key}; accepted: text on one line"));
            }
            Ok((key.to_string(), value.to_string()))
        });
        Ok(Self(pairs.collect::<Result<_, _>>()?))
    }
}

impl Options {
    /// All options of several lists. Of a key that is typed more than once, the last value wins.
    pub(crate) fn joined(lists: &[Self]) -> Self {
        let mut all: Vec<(String, String)> = Vec::new();
        for (key, value) in lists.iter().flat_map(|list| &list.0) {
            all.retain(|(known, _)| known != key);
            all.push((key.clone(), value.clone()));
        }
        Self(all)
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = (&str, &str)> {
        self.0.iter().map(|(key, value)| (key.as_str(), value.as_str()))
    }

    /// The value of `key`.
    pub(crate) fn get(&self, key: &str) -> Option<&str> {
        self.iter().find(|(known, _)| *known == key).map(|(_, value)| value)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn options_are_read_and_the_last_one_wins() {
        let lists = ["time=4:00:00,nodelist=a[1,2]", "cpus=4,time=1"].map(|text| text.parse().unwrap());
        let all = Options::joined(&lists);
        let pairs: Vec<_> = all.iter().collect();
        assert_eq!(pairs, [("nodelist", "a[1,2]"), ("cpus", "4"), ("time", "1")]);
        assert_eq!((all.get("cpus"), all.get("mem")), (Some("4"), None));
        for text in ["", "time", "=4", "Time=4", "-x=1", "a b=1", "time=", "time=1\n#SBATCH --uid=0", "a=[1"]
        {
            assert!(text.parse::<Options>().is_err(), "{text:?}");
        }
    }
}
