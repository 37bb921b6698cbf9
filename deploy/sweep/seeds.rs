//! Seeds as they are typed: `0..30` is thirty seeds, `1,5,7` three, and both can be joined.

use std::str::FromStr;

/// Seeds of a sweep, at most.
pub(crate) const MAX_SEEDS: usize = 10_000;

/// Seeds in the order in which they were typed, each once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Seeds(pub(crate) Vec<u64>);

impl FromStr for Seeds {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| {
            let seed = text.trim().parse::<u64>().ok().filter(|&seed| i64::try_from(seed).is_ok());
            seed.ok_or(format!("{text:?} is no seed; accepted: 0 to 2^63 - 1, as 7, 1,5,7 or 0..30"))
        };
        let mut seeds = Vec::new();
        for part in text.split(',') {
            let range = match part.split_once("..") {
                Some((first, end)) => number(first)?..number(end)?,
                None => number(part)?..number(part)? + 1,
            };
            if range.is_empty() {
                return Err(format!(
                    "{part:?} holds no seed; accepted: a range that ends after its first seed"
                ));
            }
            if range.end - range.start > (MAX_SEEDS - seeds.len()) as u64 {
                return Err(format!("more than {MAX_SEEDS} seeds; accepted: fewer"));
            }
            seeds.extend(range);
        }
        let mut sorted = seeds.clone();
        sorted.sort_unstable();
        match sorted.windows(2).find(|pair| pair[0] == pair[1]) {
            Some(pair) => Err(format!("seed {} is named twice; accepted: each once", pair[0])),
            None => Ok(Self(seeds)),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn ranges_are_half_open_and_can_be_joined() {
        let seeds = |text: &str| text.parse::<Seeds>().map(|seeds| seeds.0);
        assert_eq!(seeds("0..3").unwrap(), [0, 1, 2]);
        assert_eq!(seeds("9,4..6, 1").unwrap(), [9, 4, 5, 1]);
        assert_eq!(seeds("7").unwrap(), [7]);
        for (text, says) in [
            ("", "no seed"),
            ("3..3", "holds no seed"),
            ("5..2", "holds no seed"),
            ("0..3,2", "seed 2 is named twice"),
            ("-1", "\"-1\" is no seed"),
            ("0..10001", "more than 10000 seeds"),
            ("9223372036854775808", "is no seed"),
        ] {
            let error = seeds(text).unwrap_err();
            assert!(error.contains(says), "{text}: {error}");
        }
    }
}
