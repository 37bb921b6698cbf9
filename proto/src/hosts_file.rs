//! `hosts.csv`: a line for each time that another host has joined the run, with what has gone over the network since.
//!
//! The relay of the run's own host counts, the supervisor writes, and the learner reads it for its metrics.

use serde::{Deserialize, Serialize};
use std::fmt::Write;

/// The first line.
const COLUMNS: &str = "host,actors,state,round_trip_ms,bytes_sent,bytes_received,resent,repeated";
/// Longest name of a host, bytes.
pub const MAX_NAME: usize = 64;
/// Lines that are kept: of more, those of hosts that are gone are dropped, the oldest first.
pub const MAX_ROWS: usize = 1000;
/// Most bytes of the file that a reader takes.
pub const MAX_BYTES: u64 = 1 << 20;

/// Whether the name of a host may have this character.
pub fn is_plain(c: char) -> bool {
    c.is_ascii_alphanumeric() || "-_.".contains(c)
}

/// Whether this can be the name of a host: 1 to [`MAX_NAME`] plain characters.
pub fn is_name(name: &str) -> bool {
    (1..=MAX_NAME).contains(&name.len()) && name.chars().all(is_plain)
}

/// Whether a host is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum HostState {
    /// It takes part.
    #[serde(rename = "joined")]
    Joined,
    /// It has said farewell, or the run has.
    #[serde(rename = "left")]
    Left,
    /// It was silent for too long, or was sent away, or the relay that it had joined is gone.
    #[serde(rename = "lost")]
    Lost,
}

impl HostState {
    const ALL: [Self; 3] = [Self::Joined, Self::Left, Self::Lost];

    /// Its word in the file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Joined => "joined",
            Self::Left => "left",
            Self::Lost => "lost",
        }
    }
}

/// A host, from when it joined to when it left or was lost.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HostRow {
    /// A number that tells it from all others, and from itself at another time. It is not part of the file.
    #[serde(default)]
    pub peer: u64,
    /// Its name. Two hosts may have the same.
    pub host: String,
    /// The actors that it was given, by index.
    pub actors: Vec<u32>,
    /// Whether it is still there.
    pub state: HostState,
    /// Smoothed time from a piece of a message to its acknowledgement, milliseconds; none before the first one.
    pub round_trip_ms: Option<f64>,
    /// Bytes of frames sent to it, without what TLS, TCP and IP add.
    pub bytes_sent: u64,
    /// Bytes of frames received from it, likewise.
    pub bytes_received: u64,
    /// Pieces that were sent to it again.
    pub resent: u64,
    /// Pieces that came from it again.
    pub repeated: u64,
}

/// Takes news of a host over into `rows`.
pub fn update(rows: &mut Vec<HostRow>, news: HostRow) {
    match rows.iter_mut().find(|row| row.peer == news.peer && row.state == HostState::Joined) {
        Some(row) => *row = news,
        None => {
            if rows.len() >= MAX_ROWS
                && let Some(oldest) = rows.iter().position(|row| row.state != HostState::Joined)
            {
                rows.remove(oldest);
            }
            rows.push(news);
        }
    }
}

/// The file's contents.
pub fn to_csv(rows: &[HostRow]) -> String {
    let mut text = format!("{COLUMNS}\n");
    for row in rows {
        let actors: Vec<String> = row.actors.iter().map(u32::to_string).collect();
        let round_trip = row.round_trip_ms.map_or(String::new(), |ms| format!("{ms:.3}"));
        let (state, actors) = (row.state.name(), actors.join(" "));
        let HostRow { host, bytes_sent, bytes_received, resent, repeated, .. } = row;
        let _ = writeln!(
            text,
            "{host},{actors},{state},{round_trip},{bytes_sent},{bytes_received},{resent},{repeated}"
        );
    }
    text
}

/// The rows in `text`. Lines that are none are passed over.
pub fn of_csv(text: &str) -> Vec<HostRow> {
    text.lines().skip(1).filter_map(of_line).collect()
}

fn of_line(line: &str) -> Option<HostRow> {
    let cells: Vec<&str> = line.split(',').collect();
    let &[host, actors, state, round_trip, bytes_sent, bytes_received, resent, repeated] = cells.as_slice()
    else {
        return None;
    };
    Some(HostRow {
        peer: 0,
        host: host.into(),
        actors: actors.split_whitespace().map(str::parse).collect::<Result<_, _>>().ok()?,
        state: HostState::ALL.into_iter().find(|known| known.name() == state)?,
        round_trip_ms: if round_trip.is_empty() { None } else { Some(round_trip.parse().ok()?) },
        bytes_sent: bytes_sent.parse().ok()?,
        bytes_received: bytes_received.parse().ok()?,
        resent: resent.parse().ok()?,
        repeated: repeated.parse().ok()?,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn row(peer: u64, state: HostState) -> HostRow {
        HostRow {
            peer,
            host: format!("host{peer}"),
            actors: vec![2, 3],
            state,
            round_trip_ms: (peer > 1).then_some(20.25),
            bytes_sent: 10 * peer,
            bytes_received: 5,
            resent: 1,
            repeated: 0,
        }
    }

    #[test]
    fn a_file_is_read_as_it_was_written() {
        let rows = [row(1, HostState::Left), row(2, HostState::Joined)];
        let text = to_csv(&rows);
        assert_eq!(
            text,
            "host,actors,state,round_trip_ms,bytes_sent,bytes_received,resent,repeated\n\
             host1,2 3,left,,10,5,1,0\nhost2,2 3,joined,20.250,20,5,1,0\n"
        );
        let unnumbered = rows.map(|row| HostRow { peer: 0, ..row });
        assert_eq!(of_csv(&text), unnumbered);
        assert_eq!(of_csv("host\nx,y\n,,,,,,,\nhost2,2 3,joined,20.250,20,5,1\n"), []);
    }

    #[test]
    fn news_of_a_host_replace_those_before_until_it_is_gone() {
        let mut rows = Vec::new();
        update(&mut rows, row(1, HostState::Joined));
        update(&mut rows, row(2, HostState::Joined));
        update(&mut rows, HostRow { bytes_sent: 99, ..row(1, HostState::Joined) });
        assert_eq!(rows.iter().map(|row| row.bytes_sent).collect::<Vec<_>>(), [99, 20]);
        update(&mut rows, row(1, HostState::Lost));
        update(&mut rows, row(1, HostState::Joined));
        assert_eq!(rows.len(), 3, "it has joined another time");
        for peer in 3..3 + MAX_ROWS as u64 {
            update(&mut rows, row(peer, HostState::Left));
        }
        assert_eq!(rows.len(), MAX_ROWS);
        assert!(rows[..2].iter().all(|row| row.state == HostState::Joined), "those that are there stay");
    }
}
