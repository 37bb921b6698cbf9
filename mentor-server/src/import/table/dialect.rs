//! How a table of text is written: what separates its fields, how its numbers look, and whether it has a header.

use std::borrow::Cow;

/// What separates fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Separator {
    /// One character; fields may be quoted.
    Byte(u8),
    /// Any number of blanks and tabs; nothing is quoted.
    Blanks,
}

/// Those that are looked for, the least likely within a field first.
const SEPARATORS: [u8; 4] = [b'\t', b'|', b';', b','];

impl Separator {
    /// The likeliest one for these lines, the first of which may be a header.
    pub(super) fn of(lines: &[&str]) -> Self {
        let Some(first) = lines.first() else { return Self::Byte(b',') };
        // A line's count must be that of the first. A tie goes to the one that comes first in the list: a comma beside a
        // semicolon is a decimal comma.
        let agreeing = |separator: u8| {
            let expected = count(first, separator);
            lines.iter().filter(|line| count(line, separator) == expected).count()
        };
        let candidates = SEPARATORS.into_iter().filter(|&separator| count(first, separator) > 0);
        if let Some(best) = candidates.rev().max_by_key(|&separator| agreeing(separator)) {
            return Self::Byte(best);
        }
        let words = first.split_whitespace().count();
        if words > 1 && lines.iter().all(|line| line.split_whitespace().count() == words) {
            return Self::Blanks;
        }
        Self::Byte(b',')
    }
}

/// How often `separator` is in `line` outside of quotes.
fn count(line: &str, separator: u8) -> usize {
    let mut quoted = false;
    let outside = |&byte: &u8| {
        quoted ^= byte == b'"';
        !quoted && byte == separator
    };
    line.trim_end().bytes().filter(outside).count()
}

/// How the numbers of one file are written. A file has one decimal sign: with both, `1,234` could be either of two numbers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Numbers {
    /// Whether a comma can be a decimal sign: only where it separates nothing.
    comma: bool,
    /// The sign that has been seen.
    seen: Option<char>,
}

impl Numbers {
    pub(super) fn new(separator: Separator) -> Self {
        Self { comma: separator != Separator::Byte(b','), seen: None }
    }

    /// Whether numbers have had a decimal comma so far.
    pub(crate) fn commas(self) -> bool {
        self.seen == Some(',')
    }

    /// `field` as Rust reads numbers; none if it has another decimal sign than those before, or a comma where that
    /// separates fields.
    pub(crate) fn plain<'a>(&mut self, field: &'a str) -> Option<Cow<'a, str>> {
        let sign = match (field.bytes().filter(|&byte| byte == b',').count(), field.contains('.')) {
            (0, false) => return Some(field.into()),
            (0, true) => '.',
            (1, false) if self.comma => ',',
            _ => return None,
        };
        if *self.seen.get_or_insert(sign) != sign {
            return None;
        }
        Some(if sign == ',' { field.replace(',', ".").into() } else { field.into() })
    }

    /// The number in `field`, finite or not.
    pub(crate) fn number(&mut self, field: &str) -> Option<f64> {
        self.plain(field)?.parse().ok()
    }
}

/// Whether the first row of a table names its columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum First {
    Header,
    Data,
    /// It could be either, for this reason.
    Ambiguous(&'static str),
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Field {
    Empty,
    Number,
    Text,
}

/// What the first row is, `second` being the next one.
pub(super) fn first_row(first: &[&str], second: Option<&[&str]>, numbers: Numbers) -> First {
    let kind = |field: &&str| match field.trim() {
        "" => Field::Empty,
        field if numbers.clone().number(field).is_some() => Field::Number,
        field if ["true", "false"].contains(&&*field.to_lowercase()) => Field::Number,
        _ => Field::Text,
    };
    // The numbers from 0 on, each once, whatever their order: a data frame's columns may have been sorted.
    let counts = |fields: &[&str]| {
        let mut places: Vec<Option<usize>> = fields
            .iter()
            .map(|field| field.trim().strip_suffix(".0").unwrap_or(field.trim()).parse().ok())
            .collect();
        places.sort_unstable();
        places.iter().enumerate().all(|(i, place)| *place == Some(i))
    };
    let kinds: Vec<Field> = first.iter().map(kind).collect();
    if !kinds.contains(&Field::Text) {
        // The index column that pandas writes has no name; its columns without names are counted.
        if kinds.first() == Some(&Field::Empty) && first.len() > 1 && counts(&first[1..]) {
            return First::Header;
        }
        if counts(first) {
            return First::Ambiguous("it counts from 0, as columns without names do when pandas writes them");
        }
        return First::Data;
    }
    let Some(second) = second else { return First::Header };
    let below: Vec<Field> = second.iter().map(kind).collect();
    let named = kinds.iter().zip(&below).any(|(&name, &value)| name == Field::Text && value != Field::Text);
    if named || !kinds.contains(&Field::Number) {
        return First::Header;
    }
    First::Ambiguous("it has words where the second row has words, and numbers where that has numbers")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn separators_are_seen() {
        for (text, expected) in [
            ("x,y\n1,2\n3,4", Separator::Byte(b',')),
            ("x;y\n1;2", Separator::Byte(b';')),
            ("x|y\n1,5|2", Separator::Byte(b'|')),
            ("x;y\n0,5;1,5\n2,5;3,5", Separator::Byte(b';')),
            ("0,5;1,5\n2,5;3,5", Separator::Byte(b';')),
            ("x\ty\n1\t2", Separator::Byte(b'\t')),
            ("0,5\t1,5", Separator::Byte(b'\t')),
            ("\"a;b\",y\n1,2", Separator::Byte(b',')),
            ("note;x,y\n1,2\n3,4", Separator::Byte(b',')),
            ("0.5 1.5\n2.5 3.5", Separator::Blanks),
            ("  0   1\n 10  11", Separator::Blanks),
            ("my column\n1\n2", Separator::Byte(b',')),
            ("x\n1\n2", Separator::Byte(b',')),
        ] {
            assert_eq!(Separator::of(&text.lines().collect::<Vec<_>>()), expected, "{text:?}");
        }
    }

    #[test]
    fn a_file_has_one_decimal_sign() {
        let mut commas = Numbers::new(Separator::Byte(b';'));
        assert_eq!(
            [commas.number("0,5"), commas.number("3"), commas.number("-1,25e2")],
            [Some(0.5), Some(3.0), Some(-125.0)]
        );
        assert_eq!([commas.number("1.5"), commas.number("1.234,5"), commas.number("1,2,3")], [None; 3]);
        let mut points = Numbers::new(Separator::Byte(b';'));
        assert_eq!([points.number("1.5"), points.number("1,234")], [Some(1.5), None]);
        assert_eq!(Numbers::new(Separator::Byte(b',')).number("0,5"), None);
    }

    #[test]
    fn a_header_is_seen_not_assumed() {
        let first = |text: &str| {
            let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
            first_row(&rows[0], rows.get(1).map(Vec::as_slice), Numbers::new(Separator::Byte(b',')))
        };
        for header in
            ["x,y\n1,2", "x\n", "episode,x\na,1", ",0,1\n0,5,6", "x,1\n3,4", "name,kind\na,b", "x,y\n,2"]
        {
            assert_eq!(first(header), First::Header, "{header}");
        }
        for data in ["0,0\n1,0", "1,2", "0.0,1.5\n2,3", "nan,1\n2,3", "1,true\n2,false", "3,\n4,"] {
            assert_eq!(first(data), First::Data, "{data}");
        }
        for unclear in ["0,1\n1,1", "0\n1", "1,0\n2,0", "0.0,1.0\n2,3", "0,0,N\n1,0,E"] {
            assert!(matches!(first(unclear), First::Ambiguous(_)), "{unclear}");
        }
    }
}
