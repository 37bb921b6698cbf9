//! The limits of what crosses hosts.

use std::time::Duration;

/// Bytes of a message that one frame carries, at most: a frame is one batch of Zenoh's then.
pub const CHUNK: usize = 60_000;
/// Frames with chunks that may be under way to a peer.
pub const WINDOW: u64 = 64;
/// Bytes of messages to a peer that wait to be acknowledged; above, nothing more is taken from the processes of this host.
pub const BACKLOG: usize = 32 << 20;
/// Most bytes of a hello, a refusal or a farewell.
pub const MAX_TEXT: usize = 4096;
/// Hosts whose refusal a head tells people of, at the most.
pub const MAX_HOSTS: usize = 80;
/// Troubles of `trestle-relay` that people are told of, at the most.
pub const MAX_TROUBLES: usize = 16;
/// Frames that may wait to be looked at, or to be sent. More are dropped, and sent again.
pub const QUEUE: usize = 256;

/// First guess of how long an acknowledgement takes.
pub const FIRST_PATIENCE: Duration = Duration::from_millis(500);
/// Least time after which a chunk that was not acknowledged is sent again.
pub const LEAST_PATIENCE: Duration = Duration::from_millis(100);
/// Most such time.
pub const MOST_PATIENCE: Duration = Duration::from_secs(5);
/// How often a peer gives a sign of life where it has nothing to say.
pub const SIGN: Duration = Duration::from_secs(1);
/// How often a head tells what has gone over the network to each host.
pub const TOLD_EVERY: Duration = Duration::from_secs(1);
/// How often an unanswered hello is repeated.
pub const HELLO: Duration = Duration::from_millis(300);
/// How often a farewell is said that nobody returns.
pub const FAREWELLS: u32 = 5;
/// After how long a farewell is said again to a peer that has not returned it.
pub const FAREWELL: Duration = Duration::from_millis(200);
/// For how long that is done. On a slow network weights are under way before it. A relay that is told to leave has 5 s.
pub const LAST_WORDS: Duration = Duration::from_secs(3);
/// After how long without a sign of life people are told that a host is silent.
pub const QUIET: Duration = Duration::from_secs(5);
/// Seconds without a sign of life after which a host counts as lost, if nothing else is asked for.
pub const SILENCE_S: u32 = 30;
/// Least such seconds.
pub const MIN_SILENCE_S: u32 = 3;
/// Most such seconds.
pub const MAX_SILENCE_S: u32 = 86_400;
