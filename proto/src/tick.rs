//! A tick: what the learner asks of the actors.

use crate::limits::MAX_ROLLOUT;
use crate::message::Message;
use bytemuck::{Pod, Zeroable};

/// A tick as it travels, the same to every actor; plain numbers only, so that no bit pattern is invalid.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Tick {
    /// Identity of the run.
    pub run: u64,
    /// Number of the tick, from 1. An evaluation or a snapshot carries the number of the last collection.
    pub tick: u64,
    /// The weights to act with. They have been published before the tick is sent.
    pub weights_version: u64,
    /// Environment steps of all actors before this tick: where the exploration schedule stands.
    pub env_steps: u64,
    /// Number of the evaluation, from 0 (kind [`EVALUATE`]).
    pub evaluation: u64,
    /// What to do: one of the constants of this module.
    pub kind: u32,
    /// Steps to take (kind [`COLLECT`]) or greedy episodes to play (kind [`EVALUATE`]).
    pub amount: u32,
}

impl Message for Tick {
    const TYPE_NAME: &'static str = "trestle.Tick.v1";
}

/// Every actor steps its environment `amount` times and sends one batch.
pub const COLLECT: u32 = 1;
/// Actor 0 plays `amount` greedy episodes and sends what they gave; the others do nothing.
pub const EVALUATE: u32 = 2;
/// Every actor sends a snapshot of its environment and its random streams.
pub const SNAPSHOT: u32 = 3;
/// Every actor leaves.
pub const STOP: u32 = 4;

/// A tick that cannot be right.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TickError {
    /// Another run's tick.
    #[error("tick {tick} is of run {found:016x}; this is run {expected:016x}")]
    Run {
        /// Number of the tick.
        tick: u64,
        /// Its run.
        found: u64,
        /// This run.
        expected: u64,
    },
    /// Unknown kind.
    #[error("tick {tick} is of kind {kind}; accepted: {COLLECT} to {STOP}")]
    Kind {
        /// Number of the tick.
        tick: u64,
        /// Its kind.
        kind: u32,
    },
    /// Too much work, or none.
    #[error("tick {tick} asks for {amount} steps or episodes; accepted: 1 to {MAX_ROLLOUT}")]
    Amount {
        /// Number of the tick.
        tick: u64,
        /// What it asks for.
        amount: u32,
    },
}

impl Tick {
    /// Checks what a peer sent.
    pub fn validate(&self, run: u64) -> Result<(), TickError> {
        if self.run != run {
            return Err(TickError::Run { tick: self.tick, found: self.run, expected: run });
        }
        if !(COLLECT..=STOP).contains(&self.kind) {
            return Err(TickError::Kind { tick: self.tick, kind: self.kind });
        }
        let works = matches!(self.kind, COLLECT | EVALUATE);
        if works && !(1..=MAX_ROLLOUT).contains(&self.amount) {
            return Err(TickError::Amount { tick: self.tick, amount: self.amount });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_fault_is_refused() {
        let good = Tick { run: 5, tick: 3, kind: COLLECT, amount: 32, ..Tick::default() };
        assert_eq!(good.validate(5), Ok(()));
        assert!(matches!(good.validate(6), Err(TickError::Run { .. })));
        assert!(matches!(Tick { kind: 0, ..good }.validate(5), Err(TickError::Kind { .. })));
        assert!(matches!(Tick { kind: 5, ..good }.validate(5), Err(TickError::Kind { .. })));
        assert!(matches!(Tick { amount: 0, ..good }.validate(5), Err(TickError::Amount { .. })));
        assert_eq!(Tick { kind: STOP, amount: 0, ..good }.validate(5), Ok(()));
    }
}
