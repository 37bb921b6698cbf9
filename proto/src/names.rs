//! The nearest right name to a misspelt one. Every refusal of a name uses it.

/// The name in `known` that `name` was probably meant to be. Of several that are equally near, one with the same first letter
/// goes before the others, and the first one before the rest.
///
/// Two names are near if at most a third of the letters differ (inserted, left out, exchanged or swapped with a neighbour).
/// Case does not count, and `_`, `-` and a blank are the same.
pub fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let folded = fold(name);
    let most = (folded.chars().count() / 3).max(1);
    let distances = known.into_iter().map(|word| (strsim::osa_distance(&folded, &fold(word)), word));
    let other_start = |word: &str| fold(word).chars().next() != folded.chars().next();
    // `min_by_key` keeps the first of equals.
    distances
        .filter(|(distance, _)| *distance <= most)
        .min_by_key(|(distance, word)| (*distance, other_start(word)))
        .map(|(_, word)| word)
}

/// What a message adds about a misspelt `name`: "; did you mean ...?", or nothing where no name in `known` is near.
pub fn hint<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    nearest(name, known).map_or_else(String::new, |word| format!("; did you mean `{word}`?"))
}

/// Longest name that is compared, characters: the time grows with its square.
const MAX_CHARS: usize = 100;

fn fold(name: &str) -> String {
    name.chars()
        .take(MAX_CHARS)
        .flat_map(char::to_lowercase)
        .map(|c| if "_ ".contains(c) { '-' } else { c })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slips_find_their_name_and_strangers_none() {
        let known = ["maze30", "maze-small", "point-maze", "gamma", "k"];
        for (typed, meant) in [
            ("maze31", "maze30"),
            ("mazesmall", "maze-small"),
            ("MAZE_SMALL", "maze-small"),
            ("pointmaze", "point-maze"),
            ("gama", "gamma"),
            ("gmama", "gamma"),
        ] {
            assert_eq!(nearest(typed, known), Some(meant), "{typed}");
        }
        for typed in ["", "cartpole", "beta", &"x".repeat(100_000)] {
            assert_eq!(nearest(typed, known.into_iter().take(4)), None, "{typed}");
        }
        assert_eq!(nearest("iregular", ["regular", "irregular"]), Some("irregular"));
        assert_eq!(nearest("a", ["b", "c"]), Some("b"), "the first of equals");
        assert_eq!(hint("gama", known), "; did you mean `gamma`?");
        assert_eq!(hint("cartpole", known), "");
    }
}
