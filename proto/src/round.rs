//! Rounds of the learner's loop, by which everything that happens in a run is dated.

use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::num::ParseIntError;
use std::str::FromStr;

/// Number of a round, from 1; the default stands for the time before the first.
///
/// Weights bear the number of the round that they were learnt in. A round of lockstep is called a *tick* in files, messages and
/// commands: it has exactly one batch of each actor. There is one type, since the numbers are the same.
#[repr(transparent)]
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Pod, Zeroable, Serialize, Deserialize,
)]
#[serde(transparent)]
pub struct Round(u64);

impl Round {
    /// The round after it.
    pub fn next(self) -> Self {
        self + 1
    }

    /// How many rounds `earlier` lies back; 0 if it is a later one.
    pub fn since(self, earlier: Self) -> u64 {
        self.0.saturating_sub(earlier.0)
    }

    /// The round so many rounds before it, or the time before the first.
    pub fn before(self, rounds: u64) -> Self {
        Self(self.0.saturating_sub(rounds))
    }
}

impl std::ops::Add<u64> for Round {
    type Output = Self;

    fn add(self, rounds: u64) -> Self {
        Self(self.0.saturating_add(rounds))
    }
}

impl From<u64> for Round {
    fn from(number: u64) -> Self {
        Self(number)
    }
}

/// As it travels, is written and is typed.
impl From<Round> for u64 {
    fn from(round: Round) -> Self {
        round.0
    }
}

impl fmt::Display for Round {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // With width and padding, for names of files.
        self.0.fmt(f)
    }
}

impl FromStr for Round {
    type Err = ParseIntError;

    fn from_str(text: &str) -> Result<Self, ParseIntError> {
        text.parse().map(Self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_follow_upon_each_other() {
        let round = Round::from(7);
        assert_eq!((u64::from(round.next()), u64::from(round + 3)), (8, 10));
        assert_eq!((round.since(Round::from(5)), round.since(Round::from(9))), (2, 0));
        assert_eq!((round.before(2), round.before(9)), (Round::from(5), Round::default()));
        assert_eq!((format!("{round:012}"), "7".parse()), ("000000000007".into(), Ok(round)));
    }
}
