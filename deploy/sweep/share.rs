//! A part of a sweep, for one of several processes that work in its directory beside each other.

use std::fmt;
use std::str::FromStr;

/// Parts of a sweep, at most.
const MAX_PARTS: usize = 100_000;

/// Every `of`th run of a sweep, from number `part` on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Share {
    part: usize,
    of: usize,
}

impl Share {
    /// Whether the run with this number, from 0, belongs to the share.
    pub(crate) fn has(self, number: usize) -> bool {
        number % self.of == self.part
    }
}

impl fmt::Display for Share {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.part, self.of)
    }
}

impl FromStr for Share {
    type Err = String;

    /// `PART/OF`, the first part being 0.
    fn from_str(text: &str) -> Result<Self, String> {
        let numbers =
            text.split_once('/').and_then(|(part, of)| Some((part.parse().ok()?, of.parse().ok()?)));
        match numbers {
            Some((part, of)) if part < of && of <= MAX_PARTS => Ok(Self { part, of }),
            _ => Err(format!("accepted: PART/OF, such as 0/6 to 5/6, with up to {MAX_PARTS} parts")),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn every_run_is_in_one_share() {
        let shares: Vec<Share> = (0..4).map(|part| format!("{part}/4").parse().unwrap()).collect();
        for number in 0..11 {
            assert_eq!(shares.iter().filter(|share| share.has(number)).count(), 1);
        }
        assert_eq!(shares[2].to_string(), "2/4");
        for text in ["", "4/4", "1", "-1/4", "1/0", "0/100001", "a/b"] {
            assert!(text.parse::<Share>().unwrap_err().contains("accepted: PART/OF"), "{text}");
        }
    }
}
