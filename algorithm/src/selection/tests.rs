//! The table of rules, and the configurations that it refuses.

#![allow(clippy::unwrap_used)]

use super::*;
use trestle_proto::config::{Choice, DrawKind};

fn made(selection: &str, draw: DrawKind) -> Result<Box<dyn Rule>, SelectionError> {
    let mentor = Mentor { selection: selection.into(), draw, ..Mentor::default() };
    make(&Need { mentor: &mentor, mentor_len: 3, replay: 10 })
}

#[test]
fn every_rule_can_be_made_with_what_it_accepts_and_with_nothing_else() {
    for (rule, _) in TABLE {
        for &draw in DrawKind::VALUES {
            assert_eq!(made(rule.name, draw).is_ok(), rule.draws.contains(&draw), "{} {draw}", rule.name);
        }
        assert!(rule.about.ends_with('.') && !rule.remembers.ends_with('.'), "{}", rule.name);
    }
    let refusal = made("min-distance", DrawKind::Uniform).unwrap_err().to_string();
    let expected = "mentor.draw = uniform; accepted: similar with mentor.selection = min-distance";
    assert_eq!(refusal, expected);
    let refusal = made("min-distanse", DrawKind::Similar).unwrap_err().to_string();
    assert!(
        refusal.contains("min-distance, confidence, always") && refusal.contains("did you mean"),
        "{refusal}"
    );
}

#[test]
fn no_rule_takes_a_memory_of_another_size() {
    for (rule, _) in TABLE {
        let mut rule = made(rule.name, DrawKind::Similar).unwrap();
        assert!(matches!(rule.restore(&[0; 3], 4), Err(SelectionError::Bytes { found: 3, .. })));
    }
}
