//! A state's features as they are stored and sent: numbers of four bytes or, where all of them are whole numbers from 0 to 255,
//! of one byte.

use bytemuck::{cast_slice, cast_slice_mut};
use serde::{Deserialize, Serialize};

/// The type that holds a feature where it is stored or sent. Everything computes with `f32`, which has all its values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Element {
    /// Any number, 4 bytes.
    #[default]
    F32,
    /// A whole number from 0 to 255, 1 byte.
    U8,
}

impl Element {
    /// Its number in messages and files.
    pub const fn code(self) -> u32 {
        self as u32
    }

    /// Whether a feature of this type can be `value`.
    pub fn holds(self, value: f32) -> bool {
        match self {
            Self::F32 => value.is_finite(),
            Self::U8 => f32::from(byte_of(value)).to_bits() == value.to_bits(),
        }
    }

    /// The values that it holds, in words.
    pub fn accepted(self) -> &'static str {
        match self {
            Self::F32 => "finite numbers",
            Self::U8 => "whole numbers from 0 to 255, as its space has one byte for each",
        }
    }
}

/// The byte that is `value`, if one is; any other otherwise. Added to 2^23, a small whole number is the last digits of the sum: that runs
/// through whole registers, which a conversion with its limits does not.
#[inline]
fn byte_of(value: f32) -> u8 {
    (value + 8_388_608.0).to_bits() as u8
}

/// How many features a state has, and their type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RowKind {
    /// Features.
    pub dim: usize,
    /// Type of each.
    pub element: Element,
}

impl From<usize> for RowKind {
    /// So many features of four bytes.
    fn from(dim: usize) -> Self {
        Self { dim, element: Element::F32 }
    }
}

impl RowKind {
    /// 32-bit words of a state; bytes are filled up with zeros.
    pub const fn words(self) -> usize {
        match self.element {
            Element::F32 => self.dim,
            Element::U8 => self.dim.div_ceil(4),
        }
    }

    /// Writes `values`, all of which the type [holds](Element::holds), to the words of one state.
    pub fn pack(self, values: &[f32], words: &mut [u32]) {
        match self.element {
            Element::F32 => cast_slice_mut(words).copy_from_slice(values),
            Element::U8 => {
                let (bytes, rest) = cast_slice_mut::<u32, u8>(words).split_at_mut(self.dim);
                bytes.iter_mut().zip(values).for_each(|(byte, &value)| *byte = byte_of(value));
                rest.fill(0);
            }
        }
    }

    /// The state in `words`.
    #[inline]
    pub fn row(self, words: &[u32]) -> Row<'_> {
        match self.element {
            Element::F32 => Row::F32(cast_slice(words)),
            Element::U8 => Row::U8(&cast_slice(words)[..self.dim]),
        }
    }
}

/// A state, by reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Row<'a> {
    /// Features of four bytes.
    F32(&'a [f32]),
    /// Features of one byte.
    U8(&'a [u8]),
}

impl<'a> Row<'a> {
    /// Features of the state.
    pub fn dim(self) -> usize {
        match self {
            Self::F32(row) => row.len(),
            Self::U8(row) => row.len(),
        }
    }

    /// The features as `f32`: as they lie, or else copied to `scratch`.
    pub fn wide(self, scratch: &'a mut Vec<f32>) -> &'a [f32] {
        match self {
            Self::F32(row) => row,
            Self::U8(row) => {
                scratch.clear();
                scratch.extend(row.iter().copied().map(f32::from));
                scratch
            }
        }
    }

    /// Writes the features as `f32` to `out`, as long as the state.
    pub fn write(self, out: &mut [f32]) {
        match self {
            Self::F32(row) => out.copy_from_slice(row),
            Self::U8(row) => out.iter_mut().zip(row).for_each(|(out, &byte)| *out = f32::from(byte)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_byte_holds_its_own_values() {
        for good in [0.0, 1.0, 255.0] {
            assert!(Element::U8.holds(good) && Element::F32.holds(good));
        }
        for bad in [-0.0, -1.0, 0.5, 256.0, f32::NAN, f32::INFINITY] {
            assert!(!Element::U8.holds(bad), "{bad}");
        }
        assert!(Element::F32.holds(-0.5) && !Element::F32.holds(f32::NAN));
    }

    proptest! {
        #[test]
        fn what_is_packed_comes_back(bytes in prop::collection::vec(any::<u8>(), 1..40)) {
            let values: Vec<f32> = bytes.iter().copied().map(f32::from).collect();
            for (element, words) in [(Element::F32, bytes.len()), (Element::U8, bytes.len().div_ceil(4))] {
                let kind = RowKind { dim: bytes.len(), element };
                prop_assert_eq!(kind.words(), words);
                let mut packed = vec![u32::MAX; words];
                kind.pack(&values, &mut packed);
                let row = kind.row(&packed);
                let (mut scratch, mut out) = (vec![7.0], vec![0.0; bytes.len()]);
                row.write(&mut out);
                prop_assert_eq!(row.dim(), bytes.len());
                prop_assert_eq!(row.wide(&mut scratch), &values[..]);
                prop_assert_eq!(&out, &values);
            }
        }
    }
}
