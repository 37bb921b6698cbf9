//! `mentor/query`: questions that any client may ask the mentor-server at any time.
//!
//! | op | request | answer payload |
//! |---|---|---|
//! | [`SIMILAR`] | state s (payload), `first` unused, `count` = most answers | pairs (index, KL as `f32`), nearest first |
//! | [`BRIDGE`] | state s (payload), `first` = mentor transition j | annotation record of j, empty if it has no bridge or s is not similar to s_m |
//! | [`ANNOTATIONS`] | `first`, `count` | annotation records |
//! | [`TRANSITIONS`] | `first`, `count` | mentor transitions ([`crate::mentor`]) |
//! | [`STATS`] | nothing | [`Stats`] |

use crate::message::Message;
use bytemuck::{Pod, Zeroable};

/// Mentor states similar to a state.
pub const SIMILAR: u32 = 1;
/// The bridge from a state back onto the mentor's path.
pub const BRIDGE: u32 = 2;
/// A range of annotations.
pub const ANNOTATIONS: u32 = 3;
/// A range of mentor transitions.
pub const TRANSITIONS: u32 = 4;
/// Counters of the mentor-server.
pub const STATS: u32 = 5;

/// What an answer's `status` says: its position in this list.
pub const STATUS: [&str; 6] =
    ["ok", "unknown operation", "malformed request", "out of range", "out of order", "not ready"];
/// All is well.
pub const OK: u32 = 0;
/// The operation does not exist.
pub const UNKNOWN_OP: u32 = 1;
/// Sizes do not fit, or a number is not finite.
pub const MALFORMED: u32 = 2;
/// An index or a count beyond what there is.
pub const OUT_OF_RANGE: u32 = 3;
/// The history would have a gap.
pub const OUT_OF_ORDER: u32 = 4;
/// The learner has not let this mentor-server in yet.
pub const NOT_READY: u32 = 5;

/// What is sent beside a request.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct QueryRequest {
    /// Identity of the run.
    pub run: u64,
    /// One of the operations of this module.
    pub op: u32,
    /// First index of a range, or the mentor transition.
    pub first: u32,
    /// Number of rows wanted.
    pub count: u32,
    /// Features of an observation.
    pub obs_dim: u32,
}

impl Message for QueryRequest {
    const TYPE_NAME: &'static str = "trestle.QueryRequest.v1";
}

/// What is sent beside an answer.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct QueryAnswer {
    /// A position in [`STATUS`].
    pub status: u32,
    /// Rows in the payload.
    pub count: u32,
}

impl Message for QueryAnswer {
    const TYPE_NAME: &'static str = "trestle.QueryAnswer.v1";
}

/// Counters of the mentor-server, as the words of a [`STATS`] answer.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Stats {
    /// Mentor transitions.
    pub mentor: u32,
    /// Those with e_KL below `e_infeas`.
    pub feasible: u32,
    /// Infeasible ones with a bridge.
    pub bridged: u32,
    /// Observer transitions held as history; without bridges only the newest.
    pub stored: u32,
    /// Mean l_feas over those with a bridge; 0 if there is none.
    pub bridge_len_mean: f32,
    /// Mean e_KL over those with an estimate; 0 if there is none.
    pub e_kl_mean: f32,
}

/// The words of `status`, also for a number that no version of ours would send.
pub fn status_text(status: u32) -> &'static str {
    STATUS.get(status as usize).copied().unwrap_or("unknown status")
}
