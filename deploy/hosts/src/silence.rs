//! Hosts that are silent, but not for so long that they count as lost.

use crate::limits::QUIET;
use std::time::Duration;

/// What people are to hear of a host's silence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Change {
    /// It has been silent for so long.
    Silent(Duration),
    /// It was, and is not any more.
    Back(Duration),
}

/// When a host was heard last before a silence of which people were told, while it lasts.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Silence(Option<Duration>);

impl Silence {
    /// The news at `now` of a host that was heard last at `heard`: once after [`QUIET`], and once when it is back.
    pub(crate) fn look(&mut self, heard: Duration, now: Duration) -> Option<Change> {
        match self.0 {
            None if now.saturating_sub(heard) >= QUIET => {
                self.0 = Some(heard);
                Some(Change::Silent(now - heard))
            }
            Some(before) if heard > before => {
                self.0 = None;
                Some(Change::Back(heard - before))
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_silence_and_its_end_are_told_once_each() {
        let s = Duration::from_secs;
        let mut silence = Silence::default();
        let mut news = Vec::new();
        // It is heard every second, but for the seconds 11 to 17 and 31 to 34.
        let mut heard = Duration::ZERO;
        for now in 0..60 {
            if !(11..18).contains(&now) && !(31..35).contains(&now) {
                heard = s(now);
            }
            news.extend(silence.look(heard, s(now)).map(|change| (now, change)));
        }
        assert_eq!(news, [(15, Change::Silent(s(5))), (18, Change::Back(s(8)))]);
    }
}
