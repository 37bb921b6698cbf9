//! The line between the supervisor and a child: signs of life in the one direction, and in the other the order to leave,
//! and the end of the supervisor.

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use trestle_link::pulse;
use trestle_proto::config::Supervise;

/// What is wrong with a process that has not ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    /// It gave no sign of life for so many seconds.
    Silent(u32),
    /// It lives, but its work did not get ahead for so many seconds.
    Stalled(u32),
}

/// What came over the line since the last look.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Signs {
    /// What the process counts as dead for, if it does.
    pub(super) fault: Option<Fault>,
    /// Whether somebody has asked the process to leave.
    pub(super) asked: bool,
}

/// The supervisor's end. Closing it tells the child that its supervisor is gone.
#[derive(Debug)]
pub(super) struct Line {
    socket: UnixStream,
    /// Beats without a sign of life, and without progress.
    silent: u32,
    stalled: u32,
}

impl Line {
    /// A new line, and the child's end of it.
    pub(super) fn new() -> std::io::Result<(Self, UnixStream)> {
        let (socket, theirs) = UnixStream::pair()?;
        socket.set_nonblocking(true)?;
        Ok((Self { socket, silent: 0, stalled: 0 }, theirs))
    }

    /// Asks the process to finish what it is doing and leave.
    pub(super) fn leave(&mut self) {
        // A process that is gone needs no order. One that does not read has room for this one: there is no other.
        let _ = self.socket.write(&[pulse::LEAVE]);
    }

    /// Tells the child that the run's services are there.
    pub(super) fn go(&mut self) {
        let _ = self.socket.write(&[pulse::GO]);
    }

    /// Takes in what has come since the last call, and says whether the process counts as dead by now. To be called once
    /// a [`BEAT`](trestle_proto::limits::BEAT), which is a second.
    ///
    /// Time is counted in calls: while the whole machine sleeps, or the supervisor itself is stopped, no child grows
    /// silent.
    pub(super) fn beat(&mut self, deadlines: &Supervise) -> Signs {
        let (mut buffer, mut alive, mut busy, mut asked) = ([0; 64], false, false, false);
        while let Ok(n @ 1..) = self.socket.read(&mut buffer) {
            alive = true;
            busy |= buffer[..n].contains(&pulse::BUSY);
            asked |= buffer[..n].contains(&pulse::ASKED);
        }
        self.silent = if alive { 0 } else { self.silent + 1 };
        // Of a process that is not run at all nothing else can be said.
        self.stalled = if busy { 0 } else { self.stalled + u32::from(alive) };
        let over = |beats: u32, limit: u32| limit > 0 && beats >= limit;
        let fault = if over(self.silent, deadlines.silence_s) {
            Some(Fault::Silent(self.silent))
        } else {
            over(self.stalled, deadlines.stall_s).then_some(Fault::Stalled(self.stalled))
        };
        Signs { fault, asked }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::io::Write;

    /// What the line says at each beat, given the signs of life that came before it.
    fn line(silence_s: u32, stall_s: u32) -> impl FnMut(&[u8]) -> Option<Fault> {
        let deadlines = Supervise { silence_s, stall_s, ..Supervise::default() };
        let (mut line, mut child) = Line::new().unwrap();
        move |signs| {
            child.write_all(signs).unwrap();
            line.beat(&deadlines).fault
        }
    }

    #[test]
    fn silence_is_counted_from_the_last_sign_of_life() {
        let mut beat = line(3, 0);
        for _ in 0..5 {
            assert_eq!([beat(b""), beat(b""), beat(&[pulse::IDLE])], [None; 3]);
        }
        assert_eq!([beat(b""), beat(b""), beat(b"")], [None, None, Some(Fault::Silent(3))]);
    }

    #[test]
    fn a_process_that_lives_and_does_not_get_ahead_has_stalled() {
        let mut beat = line(9, 3);
        let (busy, idle) = ([pulse::BUSY], [pulse::IDLE]);
        for _ in 0..5 {
            assert_eq!([beat(&idle), beat(&idle), beat(&busy)], [None; 3]);
        }
        // What piled up while the supervisor did not look is one beat; silence is not stalling.
        assert_eq!([beat(&[pulse::IDLE; 100]), beat(b""), beat(&idle)], [None; 3]);
        assert_eq!(beat(&idle), Some(Fault::Stalled(3)));
    }

    #[test]
    fn a_request_to_leave_is_passed_on_and_an_order_gets_through() {
        let (mut line, mut child) = Line::new().unwrap();
        let deadlines = Supervise::default();
        child.write_all(&[pulse::BUSY, pulse::ASKED]).unwrap();
        assert_eq!(line.beat(&deadlines), Signs { fault: None, asked: true });
        assert_eq!(line.beat(&deadlines), Signs::default());
        line.leave();
        let mut order = [0; 8];
        assert_eq!(child.read(&mut order).unwrap(), 1);
        assert_eq!(order[0], pulse::LEAVE);
        drop(child);
        line.leave();
    }

    #[test]
    fn without_deadlines_nobody_dies() {
        let mut beat = line(0, 0);
        assert!((0..1000).all(|_| beat(b"").is_none()));
        assert!((0..1000).all(|_| beat(&[pulse::IDLE]).is_none()));
    }
}
