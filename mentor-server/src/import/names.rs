//! Names of episodes: patterns with `*`, and the order of their numbers.

/// In the order of the numbers that names end with.
pub(super) fn sorted(mut names: Vec<String>) -> Vec<String> {
    names.sort_by_cached_key(|name| {
        let stem = name.trim_end_matches(|c: char| c.is_ascii_digit());
        (stem.to_string(), name[stem.len()..].parse::<u64>().unwrap_or(0), name.clone())
    });
    names
}

/// Whether `name` is `pattern`, in which each `*` stands for anything.
pub(super) fn matches(pattern: &str, name: &str) -> bool {
    let mut parts = pattern.split('*');
    let first = parts.next().unwrap_or_default();
    let Some(mut rest) = name.strip_prefix(first) else { return false };
    let parts: Vec<&str> = parts.collect();
    let Some((last, middle)) = parts.split_last() else { return rest.is_empty() };
    for part in middle {
        let Some(at) = rest.find(part) else { return false };
        rest = &rest[at + part.len()..];
    }
    rest.ends_with(last)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_and_orders() {
        for (pattern, name, expected) in [
            ("demo_*", "demo_12", true),
            ("demo_*", "demo", false),
            ("*", "x", true),
            ("a*b*c", "a1b2c", true),
            ("a*b*c", "a1c2b", false),
            ("abc", "abc", true),
            ("abc", "abcd", false),
        ] {
            assert_eq!(matches(pattern, name), expected, "{pattern} {name}");
        }
        let names = ["demo_10", "demo_9", "demo_001"].map(String::from).to_vec();
        assert_eq!(sorted(names), ["demo_001", "demo_9", "demo_10"]);
    }
}
