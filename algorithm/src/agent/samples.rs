//! The samples of a gradient step: stored transitions, and for each a mentor transition where there is one.
//!
//! A sample is one row of the network's input (s_o) and, where its mentor transition has an L_m, a second one behind it (s_m).

use super::rows::{Rows, Values};
use super::{AgentError, MentorSide, Settings, TrainStats};
use crate::losses::{MentorKind, MentorTerm, mentor_term};
use crate::replay::Replay;
use crate::rivals::Shown;
use crate::rivals::dshape::View;
use crate::selection::{Candidate, Own};
use rand::{Rng, RngCore};
use trestle_proto::config::DrawKind;
use trestle_proto::row::Row;
use trestle_qnet::{Encoding, Layout, QNetwork, Workspace, forward_train};

/// What samples and their terms are made from.
#[derive(Clone, Copy)]
pub(super) struct Sources<'a> {
    pub(super) settings: &'a Settings,
    pub(super) encoding: &'a Encoding,
    pub(super) replay: &'a Replay,
    pub(super) mentor: Option<&'a MentorSide>,
    /// What a rival adds to rewards, or puts in the place of the samples.
    pub(super) shown: Shown<'a>,
}

/// A stored transition, and where its rows are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub(super) slot: usize,
    /// Row of s_o.
    pub(super) row: usize,
    pub(super) action: u32,
    /// The mentor transition that belongs to it.
    mentor: Option<usize>,
    /// That, if it has an L_m.
    pub(super) with_loss: Option<WithLoss>,
}

/// A sample's mentor transition that has an L_m.
#[derive(Clone, Copy, Debug)]
pub(super) struct WithLoss {
    pub(super) j: usize,
    /// Row of s_m.
    pub(super) row: usize,
    pub(super) term: MentorTerm,
}

/// Samples and the Q-values of their states, in memory that is allocated once.
#[derive(Debug)]
pub(super) struct Samples {
    /// Most samples.
    most: usize,
    slots: Vec<u32>,
    /// The mentor transitions drawn with them; empty where a stored transition keeps its own.
    drawn: Vec<u32>,
    pub(super) all: Vec<Sample>,
    pub(super) x: Rows,
    pub(super) q: Values,
}

impl Samples {
    /// Memory for up to `most` samples of a network with `layout`.
    pub(super) fn new(layout: &Layout, most: usize) -> Self {
        Self {
            most,
            slots: Vec::with_capacity(most),
            drawn: Vec::with_capacity(most),
            all: Vec::with_capacity(most),
            x: Rows::new(layout.input(), 2 * most),
            q: Values::new(layout.output(), 2 * most),
        }
    }

    /// Draws as many transitions as there is room for, with `mentor.draw = "uniform"` a mentor transition for each.
    pub(super) fn draw(&mut self, from: &Sources<'_>, rng: &mut impl RngCore) {
        from.replay.sample(rng, self.most, &mut self.slots);
        self.drawn.clear();
        if let (DrawKind::Uniform, Some(mentor)) = (from.settings.draw, from.mentor) {
            let len = mentor.transitions.len() as u32;
            self.drawn.extend((0..self.most).map(|_| rng.random_range(0..len)));
        }
        self.clear();
        for at in 0..self.slots.len() {
            let slot = self.slots[at] as usize;
            let j = self.drawn.get(at).map_or(from.replay.get(slot).mentor, |&j| Some(j as usize));
            self.add(slot, j, from);
        }
    }

    /// Forgets all samples.
    pub(super) fn clear(&mut self) {
        self.all.clear();
        self.x.clear();
    }

    /// Whether no further sample has room.
    pub(super) fn is_full(&self) -> bool {
        self.all.len() == self.most
    }

    /// The drawn slots.
    pub(super) fn slots(&self) -> &[u32] {
        &self.slots
    }

    /// The mentor transitions drawn with them.
    #[cfg(test)]
    pub(super) fn drawn(&self) -> &[u32] {
        &self.drawn
    }

    /// Makes the entry in `slot` a sample, to which mentor transition `j` belongs. There must be room.
    pub(super) fn add(&mut self, slot: usize, j: Option<usize>, from: &Sources<'_>) {
        let own = from.replay.get(slot);
        let row = self.x.push(from.encoding, from.replay.obs(slot));
        let with_loss = from.mentor.zip(j).and_then(|(mentor, j)| {
            let (rule, transitions) = (&from.settings.rule, &mentor.transitions);
            let term = mentor_term(rule, j, &mentor.annotations, transitions, own.reward)?;
            Some(WithLoss { j, row: self.x.push(from.encoding, Row::F32(transitions.state(j))), term })
        });
        self.all.push(Sample { slot, row, action: own.action, mentor: j, with_loss });
    }

    /// Puts the first states of `view` in the place of those of the samples, none of which has a mentor transition.
    pub(super) fn look(&mut self, view: &View, encoding: &Encoding) {
        self.x.clear();
        for at in 0..self.all.len() {
            self.x.push(encoding, Row::F32(view.from(at)));
        }
    }

    /// Q(s_o, a; θ) and Q(s_m, a; θ) of all samples and actions a, kept in `workspace` for the gradient.
    pub(super) fn forward(
        &mut self,
        network: &QNetwork,
        workspace: &mut Workspace,
    ) -> Result<(), AgentError> {
        let rows = self.x.len();
        if rows > 0 {
            let (x, q) = (self.x.all(), self.q.first(rows));
            network.with_params(|theta, _| {
                forward_train(network.layout(), theta, x, rows, workspace, q);
            })?;
        }
        Ok(())
    }

    /// A sample as a selection rule sees it, once [`Samples::forward`] has run.
    pub(super) fn seen(&self, sample: &Sample) -> (Own, Option<Candidate<'_>>) {
        let candidate = sample.with_loss.map(|WithLoss { j, row, term }| Candidate {
            j,
            kind: term.kind,
            action: term.action,
            e_kl: term.e_kl,
            q: self.q.of(row),
        });
        let q = self.q.at(sample.row, sample.action);
        (Own { slot: sample.slot, action: sample.action, q }, candidate)
    }

    /// Calls `see` with each sample that has a mentor transition, and with that transition if it has an L_m.
    pub(super) fn each_with_mentor(&self, mut see: impl FnMut(&Own, Option<&Candidate<'_>>)) {
        for sample in self.all.iter().filter(|sample| sample.mentor.is_some()) {
            let (own, candidate) = self.seen(sample);
            see(&own, candidate.as_ref());
        }
    }

    /// Adds the samples to `stats`.
    pub(super) fn count(&self, stats: &mut TrainStats) {
        stats.samples += self.all.len() as u64;
        for sample in &self.all {
            stats.with_mentor += u64::from(sample.mentor.is_some());
            match sample.with_loss.map(|with_loss| with_loss.term.kind) {
                Some(MentorKind::Feasible) => stats.feasible += 1,
                Some(MentorKind::Bridged) => stats.bridged += 1,
                None => {}
            }
        }
    }
}
