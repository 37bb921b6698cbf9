//! Which life of an actor it is that speaks.

use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::num::ParseIntError;
use std::str::FromStr;

/// One life of an actor, unique over the life of a run: the number of the learner's start (the *generation*) and how often
/// the actor has been replaced since.
///
/// In lockstep, where nobody is replaced alone, every actor is the first incarnation of generation 0.
#[repr(transparent)]
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Pod, Zeroable, Serialize, Deserialize,
)]
#[serde(transparent)]
pub struct Incarnation(u32);

impl Incarnation {
    /// The `replacements`-th replacement, 0 for none, since the learner's start `generation`.
    pub fn new(generation: u16, replacements: u16) -> Self {
        Self((u32::from(generation) << 16) | u32::from(replacements))
    }

    /// The learner's start that it belongs to.
    pub fn generation(self) -> u16 {
        (self.0 >> 16) as u16
    }

    /// The next replacement since the same start of the learner; the last one that can be counted stays.
    pub fn next(self) -> Self {
        Self::new(self.generation(), (self.0 as u16).saturating_add(1))
    }
}

impl From<u32> for Incarnation {
    fn from(number: u32) -> Self {
        Self(number)
    }
}

/// As it travels, is written and is typed: `generation * 2^16 + replacements`.
impl From<Incarnation> for u32 {
    fn from(incarnation: Incarnation) -> Self {
        incarnation.0
    }
}

impl From<Incarnation> for u64 {
    fn from(incarnation: Incarnation) -> Self {
        incarnation.0.into()
    }
}

impl fmt::Display for Incarnation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl FromStr for Incarnation {
    type Err = ParseIntError;

    fn from_str(text: &str) -> Result<Self, ParseIntError> {
        text.parse().map(Self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn later_lives_are_greater() {
        let lives = [(0, 0), (0, 1), (0, u16::MAX), (1, 0), (u16::MAX, u16::MAX)];
        let lives = lives.map(|(generation, replacements)| Incarnation::new(generation, replacements));
        assert!(lives.is_sorted());
        assert_eq!(lives.map(Incarnation::generation), [0, 0, 0, 1, u16::MAX]);
        assert_eq!(Incarnation::new(1, 2).next(), Incarnation::new(1, 3));
        assert_eq!(Incarnation::new(1, u16::MAX).next(), Incarnation::new(1, u16::MAX));
        assert_eq!(Incarnation::new(1, 2).to_string(), "65538");
        assert_eq!("65538".parse(), Ok(Incarnation::new(1, 2)));
    }
}
