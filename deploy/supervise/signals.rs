//! The signals that ask a run to end, and what they ask for together.
//!
//! SIGINT, SIGTERM and SIGHUP ask for an end in good order, and so do the warnings of batch systems: SIGUSR1, SIGUSR2,
//! SIGXCPU and SIGXFSZ. However many of them come, that is one request: systemd sends SIGTERM and then SIGHUP, and a
//! wrapper may pass on a Ctrl-C that the terminal has already given to the whole group. Only a second SIGINT, at least
//! [`REPEAT`] after the first, asks for an end at once.

use anyhow::{Context, Result};
use nix::libc;
use nix::sys::signal::{SigSet, Signal};
use std::fs;
use std::future::{Future as _, poll_fn};
use std::pin::Pin;
use std::task::Poll;
use std::time::{Duration, Instant};
use tokio::signal::unix::{self, SignalKind};
use tokio::time::Sleep;
use trestle_proto::limits::REPEAT;

/// The signals that ask for an end, SIGINT first.
const ASKING: [Signal; 7] = [
    Signal::SIGINT,
    Signal::SIGTERM,
    Signal::SIGHUP,
    Signal::SIGUSR1,
    Signal::SIGUSR2,
    Signal::SIGXCPU,
    Signal::SIGXFSZ,
];

/// The numbers of the signals that ask this process for an end. SIGHUP is none of them in a run that is to outlive its
/// terminal.
pub(crate) fn asking() -> impl Iterator<Item = libc::c_int> {
    let deaf = ignores_hangup();
    ASKING.into_iter().filter(move |signal| !(deaf && *signal == Signal::SIGHUP)).map(|signal| signal as i32)
}

/// Whether SIGHUP is ignored, as `nohup` asks of a program.
fn ignores_hangup() -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask & 1 << (Signal::SIGHUP as u32 - 1) != 0)
}

/// The signals that ask for an end, held back until this is dropped: they then end what has been prepared meanwhile in
/// good order.
pub(crate) struct HeldSignals(SigSet);

impl HeldSignals {
    pub(crate) fn new() -> Result<Self> {
        let signals = SigSet::from_iter(ASKING);
        signals.thread_block().context("cannot hold signals back")?;
        Ok(Self(signals))
    }
}

impl Drop for HeldSignals {
    fn drop(&mut self) {
        if let Err(error) = self.0.thread_unblock() {
            tracing::error!("cannot let signals through again: {error}");
        }
    }
}

/// What a run is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Request {
    /// To finish the tick, save and leave.
    Stop,
    /// To leave at once.
    StopNow,
}

/// What has been asked for so far.
#[derive(Debug, Default)]
struct Requests {
    asked: bool,
    /// When the first SIGINT came.
    interrupted: Option<Instant>,
}

impl Requests {
    /// What one signal more asks for: nothing where it repeats what is being done already.
    fn after(&mut self, interrupt: bool, now: Instant) -> Option<Request> {
        let repeated = interrupt && self.interrupted.is_some_and(|first| now.duration_since(first) >= REPEAT);
        if interrupt {
            self.interrupted.get_or_insert(now);
        }
        if repeated {
            return Some(Request::StopNow);
        }
        (!std::mem::replace(&mut self.asked, true)).then_some(Request::Stop)
    }
}

/// What asks a run to end early.
#[derive(Debug)]
pub(crate) struct Signals {
    /// Each, and whether it is SIGINT.
    streams: Vec<(bool, unix::Signal)>,
    /// Asks for an end as a signal does, once.
    deadline: Option<Pin<Box<Sleep>>>,
    requests: Requests,
}

impl Signals {
    /// From here on the signals do not end the process by themselves.
    pub(crate) fn new() -> Result<Self> {
        let stream = |number| {
            let stream = unix::signal(SignalKind::from_raw(number)).context("cannot handle signals")?;
            Ok((number == libc::SIGINT, stream))
        };
        let streams = asking().map(stream).collect::<Result<_>>()?;
        Ok(Self { streams, deadline: None, requests: Requests::default() })
    }

    /// The signals, or else an end in good order after `limit`.
    pub(crate) fn within(limit: Duration) -> Result<Self> {
        Ok(Self { deadline: Some(Box::pin(tokio::time::sleep(limit))), ..Self::new()? })
    }

    /// Waits for the next request.
    pub(crate) async fn next(&mut self) -> Request {
        loop {
            let interrupt = poll_fn(|context| {
                for (interrupt, stream) in &mut self.streams {
                    if let Poll::Ready(Some(())) = stream.poll_recv(context) {
                        return Poll::Ready(*interrupt);
                    }
                }
                match self.deadline.as_mut().map(|deadline| deadline.as_mut().poll(context)) {
                    Some(Poll::Ready(())) => {
                        self.deadline = None;
                        Poll::Ready(false)
                    }
                    _ => Poll::Pending,
                }
            });
            let interrupt = interrupt.await;
            if let Some(request) = self.requests.after(interrupt, Instant::now()) {
                return request;
            }
        }
    }

    /// Somebody has asked one of the run's processes to leave, which is to ask the run.
    pub(super) fn passed_on(&mut self) -> Option<Request> {
        self.requests.after(false, Instant::now())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// What each of these signals asks for: whether it is SIGINT, and milliseconds since the beginning.
    fn asked<const N: usize>(signals: [(bool, u64); N]) -> [Option<Request>; N] {
        let (mut requests, start) = (Requests::default(), Instant::now());
        signals.map(|(interrupt, ms)| requests.after(interrupt, start + Duration::from_millis(ms)))
    }

    const INT: bool = true;
    const TERM: bool = false;
    const LATER: u64 = REPEAT.as_millis() as u64;

    #[test]
    fn signals_together_are_one_request() {
        let stop = Some(Request::Stop);
        assert_eq!(asked([(TERM, 0), (TERM, 0), (INT, 1), (TERM, 9999)]), [stop, None, None, None]);
        assert_eq!(
            asked([(INT, 0), (INT, 1), (INT, LATER - 1), (TERM, 2 * LATER)]),
            [stop, None, None, None]
        );
    }

    #[tokio::test]
    async fn a_deadline_asks_for_an_end_once() {
        let mut signals = Signals::within(Duration::ZERO).unwrap();
        assert_eq!(signals.next().await, Request::Stop);
        assert!(signals.deadline.is_none());
    }

    #[test]
    fn a_repeated_interrupt_is_an_end_at_once() {
        let (stop, now) = (Some(Request::Stop), Some(Request::StopNow));
        assert_eq!(asked([(INT, 0), (INT, LATER)]), [stop, now]);
        // It is counted from the first interrupt, whatever came before and in between.
        assert_eq!(
            asked([(TERM, 0), (INT, LATER), (INT, LATER + 1), (INT, 2 * LATER)]),
            [stop, None, None, now]
        );
    }
}
