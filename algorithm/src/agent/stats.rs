//! What training and the annotations amount to, for people to look at: nothing here flows back into training.

use super::MentorSide;
use crate::losses::{MentorKind, MentorRule, mentor_term};
use std::ops::Range;

/// Sums over gradient steps. Add those of several calls with [`TrainStats::merge`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrainStats {
    /// Gradient steps.
    pub grad_steps: u64,
    /// Samples drawn.
    pub samples: u64,
    /// Sum over the steps of the mean loss of a step's samples.
    pub loss_sum: f64,
    /// Sum over the samples of the weight of the mentor's loss, 0 to 1 each.
    pub mentor_weight_sum: f64,
    /// Samples that have a similar mentor transition.
    pub with_mentor: u64,
    /// Those of them whose mentor transition was taken as feasible.
    pub feasible: u64,
    /// Those of them whose mentor transition had to be bridged, and could be.
    pub bridged: u64,
    /// Updates of the policy of learned bridges.
    pub policy_steps: u64,
    /// Sum over these updates of the mean loss of their samples, nats.
    pub policy_loss_sum: f64,
    /// Gradient steps that imitated own paths.
    pub imitation_steps: u64,
    /// Sum over these steps of the mean loss of the imitated steps, weighted as it was trained.
    pub imitation_loss_sum: f64,
}

impl TrainStats {
    /// Adds `other`'s sums.
    pub fn merge(&mut self, other: &Self) {
        self.grad_steps += other.grad_steps;
        self.samples += other.samples;
        self.loss_sum += other.loss_sum;
        self.mentor_weight_sum += other.mentor_weight_sum;
        self.with_mentor += other.with_mentor;
        self.feasible += other.feasible;
        self.bridged += other.bridged;
        self.policy_steps += other.policy_steps;
        self.policy_loss_sum += other.policy_loss_sum;
        self.imitation_steps += other.imitation_steps;
        self.imitation_loss_sum += other.imitation_loss_sum;
    }

    /// Mean loss of a sample; NaN without any.
    pub fn loss_mean(&self) -> f64 {
        self.loss_sum / self.grad_steps as f64
    }

    /// Share of the samples that were trained with the mentor's loss; NaN without any.
    pub fn mentor_frac(&self) -> f64 {
        self.mentor_weight_sum / self.samples as f64
    }

    /// Mean loss of a sample of learned bridges, nats; NaN without any.
    pub fn policy_loss_mean(&self) -> f64 {
        self.policy_loss_sum / self.policy_steps as f64
    }

    /// Mean loss of imitation; NaN without any.
    pub fn imitation_loss_mean(&self) -> f64 {
        self.imitation_loss_sum / self.imitation_steps as f64
    }
}

/// What the annotations amount to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MentorSummary {
    /// Mentor transitions.
    pub len: usize,
    /// Those taken as feasible: all with an estimate for `diiqn`, those with e_KL below `e_infeas` for `ha-diiqn`.
    pub feasible: usize,
    /// Those that are infeasible and whose bridge is used.
    pub bridged: usize,
    /// Those that have been picked for an observer transition.
    pub visited: usize,
    /// Samples of all gradient steps so far that were trained with the mentor's loss of one of them.
    pub used: u64,
    /// Mean e_KL over those with an estimate; NaN without any.
    pub e_kl_mean: f64,
    /// Mean length over all bridges, observer steps; NaN without any.
    pub bridge_len_mean: f64,
}

impl MentorSummary {
    pub(super) fn of(rule: &MentorRule, mentor: &MentorSide, range: Range<usize>) -> Self {
        let (table, transitions) = (&mentor.annotations, &mentor.transitions);
        let mut summary = Self {
            len: range.len(),
            feasible: 0,
            bridged: 0,
            visited: 0,
            used: 0,
            e_kl_mean: 0.0,
            bridge_len_mean: 0.0,
        };
        let (mut estimates, mut bridges) = (0u64, 0u64);
        for j in range {
            summary.visited += usize::from(mentor.visited[j] > 0);
            summary.used += mentor.used[j];
            match mentor_term(rule, j, table, transitions, 0.0).map(|term| term.kind) {
                Some(MentorKind::Feasible) => summary.feasible += 1,
                Some(MentorKind::Bridged) => summary.bridged += 1,
                None => {}
            }
            if let Some(estimate) = table.estimate(j) {
                estimates += 1;
                summary.e_kl_mean += f64::from(estimate.e_kl);
            }
            if let Some(bridge) = table.bridge(j) {
                bridges += 1;
                summary.bridge_len_mean += f64::from(bridge.length);
            }
        }
        summary.e_kl_mean /= estimates as f64;
        summary.bridge_len_mean /= bridges as f64;
        summary
    }
}
