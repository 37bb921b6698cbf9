//! The words of `trestle-relay` on its standard error, which are mostly Zenoh's, as people are told them.

use crate::limits::MAX_TROUBLES;
use std::collections::BTreeSet;

/// Levels of log lines that speak of trouble in any case.
const LOUD: [&str; 2] = ["WARN", "ERROR"];
/// How a line begins that says why there is no connection. Zenoh writes it at the level DEBUG.
const UNCONNECTED: &str = "Unable to connect";
/// What follows the reason in Zenoh's messages: a place in its sources, the next attempt, and advice on another matter.
const TAILS: [&str; 3] = [" at /", ". Retry in", " Hint: "];

/// What a line says of something that went wrong, without time and place; none if it says nothing of that. A log line is
/// `TIME LEVEL TARGET: MESSAGE`, and every other line is news as it is.
pub(crate) fn trouble(line: &str) -> Option<String> {
    let mut words = line.split_whitespace();
    let level = words.nth(1).unwrap_or_default();
    let message = line.split_once(": ").map_or("", |(_, message)| message);
    let text = match level {
        _ if LOUD.contains(&level) => message,
        "TRACE" | "DEBUG" | "INFO" if message.starts_with(UNCONNECTED) => message,
        "TRACE" | "DEBUG" | "INFO" => return None,
        _ => line,
    };
    let end = TAILS.iter().filter_map(|tail| text.find(tail)).min().unwrap_or(text.len());
    let text = text[..end].trim().trim_end_matches('.');
    (!text.is_empty()).then(|| text.to_string())
}

/// The troubles that people have been told of.
#[derive(Debug, Default)]
pub(crate) struct Told(BTreeSet<String>);

impl Told {
    /// Whether people are to hear of `trouble`: once, and of [`MAX_TROUBLES`] different ones at the most. Those that differ in
    /// numbers alone, such as a peer's port, are the same.
    pub(crate) fn is_new(&mut self, trouble: &str) -> bool {
        let key = trouble.chars().filter(|c| !c.is_ascii_digit()).collect();
        self.0.len() < MAX_TROUBLES && self.0.insert(key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_are_told_without_time_and_place() {
        for (line, expected) in [
            (
                "2026-11-30T20:34:43.377618Z  WARN zenoh_link_tls::unicast: received fatal alert: DecryptError. Hint: increase \
                 the system open file limit.",
                Some("received fatal alert: DecryptError"),
            ),
            (
                "2026-11-30T20:35:06.9Z DEBUG zenoh::net::runtime::orchestrator: Unable to connect to configured peer \
                 tls/head:7447! invalid peer certificate: BadSignature at /home/a/zenoh/unicast.rs:378.. Retry in 200ms.",
                Some(
                    "Unable to connect to configured peer tls/head:7447! invalid peer certificate: BadSignature",
                ),
            ),
            (
                "2026-11-30T20:35:06.8Z DEBUG zenoh::net::runtime::orchestrator: Try to connect: tls/head:7447",
                None,
            ),
            ("thread 'main' panicked: no", Some("thread 'main' panicked: no")),
            ("error: tls/head:7447: cannot listen there", Some("error: tls/head:7447: cannot listen there")),
            ("", None),
        ] {
            assert_eq!(trouble(line).as_deref(), expected, "{line}");
        }
    }

    #[test]
    fn each_trouble_is_told_once_and_not_too_many_are() {
        let mut told = Told::default();
        assert!(told.is_new("early eof from 127.0.0.1:40001"));
        assert!(!told.is_new("early eof from 127.0.0.1:40002"));
        let letters = ('a'..='z').map(String::from);
        assert_eq!(letters.filter(|text| told.is_new(text)).count(), MAX_TROUBLES - 1);
    }
}
