//! What a setting accepts beyond its type: a test, and the same in the words that a refusal and the documentation print.

use std::fmt::{Debug, Display};
use std::ops::RangeInclusive;

/// A test of a value, and what passes it in words.
pub struct Accepts<T> {
    words: String,
    test: Box<dyn Fn(&T) -> bool>,
}

impl<T: 'static> Accepts<T> {
    /// Values for which `test` holds, described by `words`.
    pub fn when(words: impl Into<String>, test: impl Fn(&T) -> bool + 'static) -> Self {
        Self { words: words.into(), test: Box::new(test) }
    }

    /// The same values in other words.
    pub fn in_words(mut self, words: impl Into<String>) -> Self {
        self.words = words.into();
        self
    }

    /// Also accepts `value`, which `meaning` explains.
    pub fn or(self, value: T, meaning: &str) -> Self
    where
        T: PartialEq + Display,
    {
        let words = format!("{}, or {value} {meaning}", self.words);
        Self::when(words, move |given| *given == value || (self.test)(given))
    }

    /// What is accepted, in words.
    pub fn words(&self) -> &str {
        &self.words
    }

    /// Whether `value` is accepted.
    pub fn test(&self, value: &T) -> bool {
        (self.test)(value)
    }
}

/// An optional setting accepts what the setting itself accepts, or that it is left out.
impl<T: 'static> From<Accepts<T>> for Accepts<Option<T>> {
    fn from(inner: Accepts<T>) -> Self {
        let words = inner.words.clone();
        Self::when(words, move |given: &Option<T>| given.as_ref().is_none_or(|value| inner.test(value)))
    }
}

/// A number that a setting can have.
pub trait Number: Copy + PartialOrd + Display + 'static {
    /// Whether a configuration file can hold it: it is finite, or a whole number below 2^63.
    fn is_storable(self) -> bool;
}

macro_rules! numbers {
    ($($number:ty: $is_storable:expr;)+) => { $(impl Number for $number {
        fn is_storable(self) -> bool {
            let is_storable: fn(Self) -> bool = $is_storable;
            is_storable(self)
        }
    })+ };
}

numbers! {
    f64: Self::is_finite;
    i64: |_| true;
    u32: |_| true;
    u64: |number| i64::try_from(number).is_ok();
    usize: |number| i64::try_from(number).is_ok();
}

/// `low` to `high`, both included.
pub fn between<T: Number>(low: T, high: T) -> Accepts<T> {
    Accepts::when(format!("{low} to {high}"), move |value| (low..=high).contains(value))
}

/// `low`, included, to `high`, not included.
pub fn below<T: Number>(low: T, high: T) -> Accepts<T> {
    Accepts::when(format!("{low} to below {high}"), move |value| (low..high).contains(value))
}

/// `low`, not included, to `high`, included.
pub fn above_up_to<T: Number>(low: T, high: T) -> Accepts<T> {
    Accepts::when(format!("above {low}, up to {high}"), move |value| *value > low && *value <= high)
}

/// Finite numbers from `low` on.
pub fn at_least<T: Number>(low: T) -> Accepts<T> {
    Accepts::when(format!("{low} or more"), move |value: &T| *value >= low && value.is_storable())
}

/// Finite numbers above `low`, which is not accepted.
pub fn above<T: Number>(low: T) -> Accepts<T> {
    Accepts::when(format!("a number above {low}"), move |value: &T| *value > low && value.is_storable())
}

/// Every finite number.
pub fn finite() -> Accepts<f64> {
    Accepts::when("a finite number", |value: &f64| value.is_finite())
}

/// Whatever the type accepts, described by `words`. What else is wrong with it is found out later.
pub fn any<T: 'static>(words: &str) -> Accepts<T> {
    Accepts::when(words, |_| true)
}

/// Lists of so many values, each accepted by `each`.
pub fn list<T: Debug + 'static>(length: RangeInclusive<usize>, each: Accepts<T>) -> Accepts<Vec<T>> {
    let words = format!("{} to {} numbers, each {}", length.start(), length.end(), each.words);
    Accepts::when(words, move |values: &Vec<T>| {
        length.contains(&values.len()) && values.iter().all(&each.test)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_and_tests_agree_at_the_bounds() {
        let unit = |accepts: Accepts<f64>| {
            let passing =
                [-1.0, 0.0, 0.5, 1.0, 2.0, f64::INFINITY, f64::NAN].map(|x| u8::from(accepts.test(&x)));
            (accepts.words().to_string(), passing)
        };
        assert_eq!(unit(between(0.0, 1.0)), ("0 to 1".into(), [0, 1, 1, 1, 0, 0, 0]));
        assert_eq!(unit(below(0.0, 1.0)), ("0 to below 1".into(), [0, 1, 1, 0, 0, 0, 0]));
        assert_eq!(unit(above_up_to(0.0, 1.0)), ("above 0, up to 1".into(), [0, 0, 1, 1, 0, 0, 0]));
        assert_eq!(unit(at_least(0.0)), ("0 or more".into(), [0, 1, 1, 1, 1, 0, 0]));
        assert_eq!(unit(above(0.0)), ("a number above 0".into(), [0, 0, 1, 1, 1, 0, 0]));
        assert_eq!(unit(finite()), ("a finite number".into(), [1, 1, 1, 1, 1, 0, 0]));
        assert_eq!(unit(above(0.5).or(-1.0, "for none").in_words("x")), ("x".into(), [1, 0, 0, 1, 1, 0, 0]));
    }

    #[test]
    fn options_and_lists_accept_what_their_values_accept() {
        let optional: Accepts<Option<u32>> = between(1, 9).into();
        assert_eq!([None, Some(1), Some(0)].map(|value| optional.test(&value)), [true, true, false]);
        assert_eq!(between(3_u32, 9).or(0, "for never").words(), "3 to 9, or 0 for never");
        let widths = list(1..=2, between(1, 9));
        assert_eq!(widths.words(), "1 to 2 numbers, each 1 to 9");
        assert!(widths.test(&vec![1, 9]));
        let refused: [&[u32]; 3] = [&[], &[1, 2, 3], &[0]];
        assert!(refused.iter().all(|values| !widths.test(&values.to_vec())));
    }
}
