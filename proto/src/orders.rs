//! The learner's standing orders to the actors: how many batches each may send, with which weights, and what else is
//! wanted of it. Only the newest orders count, so an actor that comes late, or was replaced, misses nothing.
//!
//! In free mode an actor may be a window of batches ahead. Lockstep is the same with a barrier: one batch of each actor,
//! and no new orders before all of them have come.

use crate::incarnation::Incarnation;
use crate::limits::{MAX_ACTORS, MAX_ROLLOUT};
use crate::message::Message;
use crate::round::Round;
use bytemuck::{Pod, Zeroable};

/// What one actor may do.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Share {
    /// Batches of this incarnation that the learner has counted: what is acknowledged.
    pub counted: u64,
    /// Batches that this incarnation may have sent in all.
    pub granted: u64,
    /// The incarnation that the other numbers are meant for; they mean nothing to another one.
    pub incarnation: Incarnation,
    /// 0.
    pub reserved: u32,
}

impl Message for Share {
    const TYPE_NAME: &'static str = "trestle.Share.v1";
}

/// Orders as they travel, the same to every actor; plain numbers only, so that no bit pattern is invalid.
///
/// An actor carries them out in this order: the evaluation, the snapshot, the batches.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct Orders {
    /// Identity of the run.
    pub run: u64,
    /// Number of the round that the granted batches are for, from 1; in lockstep that of the tick.
    pub round: Round,
    /// Environment steps of all actors before that round: where the exploration schedule stands.
    pub env_steps: u64,
    /// The weights to act with: this version or a later one. It is published before the orders.
    pub weights_version: Round,
    /// Number of the evaluation that actor 0 is to play, counted from 1; 0 for none. One that it has answered is not
    /// played again.
    pub evaluation: u64,
    /// Number of the snapshot of itself that every actor is to send before its next batch, counted from 1; 0 for none.
    /// One that it has sent is not sent again.
    pub snapshot: u64,
    /// Greedy episodes of that evaluation.
    pub episodes: u32,
    /// 1: the run is over. An actor stays until it is told to leave: the learner could still die before its result is
    /// written, and another one go on.
    pub stop: u32,
    /// The learner's start that they are of ([`crate::plan::Life::generation`]). The first orders of a later one than
    /// before mean that the learner has been replaced: it knows of no actor before that has announced itself anew.
    pub generation: u16,
    /// 0.
    pub reserved: [u16; 3],
    /// Each actor's share, by its index.
    pub shares: [Share; MAX_ACTORS as usize],
}

/// The work that orders grant an actor: one batch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Collect {
    /// Identity of the run.
    pub run: u64,
    /// Number of the round.
    pub round: Round,
    /// Version of the weights to act with.
    pub weights_version: Round,
    /// Environment steps of all actors before the round.
    pub env_steps: u64,
    /// Steps to take, 1 to [`MAX_ROLLOUT`].
    pub steps: u32,
}

impl Message for Orders {
    const TYPE_NAME: &'static str = "trestle.Orders.v3";
}

impl Default for Orders {
    fn default() -> Self {
        Self::zeroed()
    }
}

/// Orders that cannot be right.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum OrdersError {
    /// Another run's.
    #[error("orders are of run {found:016x}; this is run {expected:016x}")]
    Run {
        /// Their run.
        found: u64,
        /// This run.
        expected: u64,
    },
    /// Too many episodes, or none.
    #[error("evaluation {evaluation} is to have {episodes} episodes; accepted: 1 to {MAX_ROLLOUT}")]
    Episodes {
        /// Number of the evaluation.
        evaluation: u64,
        /// Its episodes.
        episodes: u32,
    },
    /// An unknown order.
    #[error("orders say stop = {0}; accepted: 0 or 1")]
    Stop(u32),
}

impl Orders {
    /// Checks what came from a peer.
    pub fn validate(&self, run: u64) -> Result<(), OrdersError> {
        if self.run != run {
            return Err(OrdersError::Run { found: self.run, expected: run });
        }
        if self.stop > 1 {
            return Err(OrdersError::Stop(self.stop));
        }
        if self.evaluation > 0 && !(1..=MAX_ROLLOUT).contains(&self.episodes) {
            return Err(OrdersError::Episodes { evaluation: self.evaluation, episodes: self.episodes });
        }
        Ok(())
    }

    /// A batch of `steps` steps under these orders, with the weights `weights_version`.
    pub fn collect(&self, weights_version: Round, steps: u32) -> Collect {
        Collect { run: self.run, round: self.round, weights_version, env_steps: self.env_steps, steps }
    }

    /// The actors, by index, that these orders give something to do which `former` did not: all of them where anything but shares and
    /// the place in the schedule has changed.
    pub fn concern(&self, former: &Self) -> impl Iterator<Item = usize> {
        let Self { round, env_steps, weights_version, shares, .. } = *former;
        let all = Self { round, env_steps, weights_version, shares, ..*self } != *former;
        let mine = |share: &Share| (share.granted, share.incarnation);
        let pairs = self.shares.into_iter().zip(shares).enumerate();
        pairs.filter(move |(_, (new, old))| all || mine(new) != mine(old)).map(|(actor, _)| actor)
    }

    /// Batches that incarnation `incarnation` of `actor` may have sent in all.
    pub fn granted(&self, actor: u32, incarnation: Incarnation) -> u64 {
        match self.shares.get(actor as usize) {
            Some(share) if share.incarnation == incarnation => share.granted,
            _ => 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_fault_is_refused() {
        let good = Orders { run: 5, evaluation: 2, episodes: 10, ..Orders::default() };
        assert_eq!(good.validate(5), Ok(()));
        assert!(matches!(good.validate(6), Err(OrdersError::Run { .. })));
        assert_eq!(Orders { stop: 2, ..good }.validate(5), Err(OrdersError::Stop(2)));
        for episodes in [0, MAX_ROLLOUT + 1] {
            assert!(matches!(Orders { episodes, ..good }.validate(5), Err(OrdersError::Episodes { .. })));
        }
        assert_eq!(Orders { evaluation: 0, episodes: 0, ..good }.validate(5), Ok(()));
    }

    #[test]
    fn orders_concern_the_actors_whose_grant_has_changed_and_else_all() {
        let former = Orders { run: 5, ..Orders::default() };
        let concern = |orders: Orders| orders.concern(&former).collect::<Vec<_>>();
        assert_eq!(concern(former), []);
        assert_eq!(
            concern(Orders { round: 2.into(), env_steps: 9, weights_version: 1.into(), ..former }),
            []
        );
        let mut granted = Orders { round: 2.into(), ..former };
        granted.shares[3].granted = 1;
        granted.shares[7].incarnation = 1.into();
        granted.shares[9].counted = 1;
        assert_eq!(concern(granted), [3, 7]);
        for orders in [Orders { stop: 1, ..former }, Orders { snapshot: 1, ..granted }] {
            assert_eq!(concern(orders).len(), MAX_ACTORS as usize);
        }
    }

    #[test]
    fn a_grant_is_for_one_incarnation() {
        let mut orders = Orders::default();
        orders.shares[3] = Share { incarnation: 2.into(), counted: 4, granted: 6, ..Share::default() };
        assert_eq!(
            [(3, 2), (3, 1), (3, 3), (2, 2), (64, 2)].map(|(a, i)| orders.granted(a, i.into())),
            [6, 0, 0, 0, 0]
        );
        assert_eq!(orders.granted(2, 0.into()), 0, "nothing is granted before an actor has announced itself");
    }
}
