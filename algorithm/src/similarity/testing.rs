//! Point sets for properties: random ones, and sets that indexes tend to get wrong.

use super::metric::APART;
use proptest::prelude::*;

/// `few` cases, or as many as `PROPTEST_CASES` asks for.
pub(crate) fn cases(few: u32) -> ProptestConfig {
    let asked = std::env::var("PROPTEST_CASES").ok().and_then(|text| text.parse().ok());
    ProptestConfig::with_cases(asked.unwrap_or(few))
}

/// Points of 1 to 16 features, row-major, and the number of features. `count` of them: all equal, on a line, on a coarse
/// lattice (many duplicates and exact ties), anywhere, of very different magnitudes, or on a lattice with some categories.
pub(crate) fn points(count: std::ops::Range<usize>) -> impl Strategy<Value = (usize, Vec<f32>)> {
    (1usize..=16, 0u8..6, count).prop_flat_map(|(dim, kind, count)| {
        proptest::collection::vec(-3.0f32..3.0, (count + 2) * dim).prop_map(move |numbers| {
            let (first, rest) = numbers.split_at(dim);
            let (direction, rest) = rest.split_at(dim);
            let feature = |(at, &x): (usize, &f32)| match kind {
                0 => first[at % dim],
                // The same number times the direction for all features of a point.
                1 => first[at % dim] + rest[at - at % dim].round() * direction[at % dim],
                2 => x.round(),
                3 => x,
                4 if direction[at % dim] > 0.0 => x.round() * APART,
                4 => x,
                _ => x * 10f32.powi(12 * direction[at % dim] as i32 / 2),
            };
            (dim, rest.iter().enumerate().map(feature).collect())
        })
    })
}
