//! What an actor answers besides batches: the outcome of a greedy evaluation, or a snapshot of itself.
//!
//! The payload is a [`crate::codec`] frame of [`Evaluation`] or of bytes that only the actor understands.

use crate::codec::Kind;
use crate::episode::Episode;
use crate::incarnation::Incarnation;
use crate::message::Message;
use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

/// The payload is an [`Evaluation`], in a frame of [`EVALUATION_KIND`].
pub const EVALUATION: u32 = 1;
/// The payload is the actor's state, to be handed back to it when the run is resumed.
pub const ACTOR_STATE: u32 = 2;
/// An actor has come. The payload is the name of its host where that is not the learner's, as UTF-8, and else empty.
pub const JOINED: u32 = 3;

/// The frame of an [`Evaluation`].
pub const EVALUATION_KIND: Kind = Kind { magic: *b"TREVAL\0\0", version: 4 };

/// What is sent beside a reply.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct ReplyHeader {
    /// Identity of the run.
    pub run: u64,
    /// What was asked for: the number of the evaluation or of the snapshot, as the orders have it; 0 for an actor that has come.
    pub number: u64,
    /// Index of the actor.
    pub actor: u32,
    /// One of the constants of this module.
    pub kind: u32,
    /// The life of the actor that answers.
    pub incarnation: Incarnation,
    /// 0.
    pub reserved: u32,
}

impl Message for ReplyHeader {
    const TYPE_NAME: &'static str = "trestle.ReplyHeader.v3";
}

/// A reply in private memory.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Reply {
    /// Its header.
    pub header: ReplyHeader,
    /// Its payload.
    pub payload: Vec<u8>,
}

/// One greedy episode, and the way it took.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EvaluationEpisode {
    /// What it came to. Its sum of rewards may be anything.
    pub episode: Episode,
    /// Whether it ended in a terminal state rather than at the step limit.
    pub terminated: bool,
    /// The states passed through, `length + 1` times `obs_dim` features, the first one being the start. Empty where
    /// it and the paths before it would not fit into a reply.
    pub path: Vec<f32>,
}

/// The greedy episodes of one evaluation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Number of the evaluation, from 0.
    pub evaluation: u64,
    /// Its episodes.
    pub episodes: Vec<EvaluationEpisode>,
    /// Return of an episode that followed the policy of learned bridges alone; none where they do not guide.
    pub guide_return: Option<f64>,
}
