//! One gradient step as a sequence of plain stages over memory that is allocated once.
//!
//! A sample is one row of the network's input (s_o) and, where its mentor transition has something to say, a
//! second one behind it (s_m). Which loss a sample trains with is known after one forward pass of these rows; only
//! then are the next states collected, so that a loss that is not used costs no target. A *term* is one Q-value
//! with its weight, reward and next state: one for each loss that is used.

use super::{AgentError, MentorSide, Settings, TrainStats};
use crate::losses::{MentorKind, MentorRule, Weights, acts, mentor_term, n_step, next_value, target_value};
use crate::replay::Replay;
use crate::rivals::Shown;
use crate::rivals::dshape::View;
use crate::selection::{self, Own};
use rand::{Rng, RngCore};
use trestle_proto::config::{Backend, DrawKind};
use trestle_qnet::autodiff::{Samples, loss_and_gradient};
use trestle_qnet::{
    AlignedBuffer, Encoding, Kernels, Layout, QNetwork, RowGrad, Workspace, backward, forward, forward_train,
};

/// A replay entry and where its rows are.
#[derive(Clone, Copy, Debug)]
struct Sample {
    slot: usize,
    /// Row of s_o.
    row: usize,
    action: u32,
    /// The mentor transition that belongs to it.
    mentor: Option<usize>,
    /// That, if it has something to say.
    candidate: Option<Candidate>,
}

/// A sample's mentor transition that has something to say.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    j: usize,
    /// Row of s_m.
    row: usize,
    kind: MentorKind,
    action: u32,
    e_kl: f32,
}

/// One Q-value that is regressed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Term {
    /// Row of the state.
    pub(super) row: usize,
    /// The action whose value it is.
    pub(super) action: u32,
    /// Weight of its loss, 0 to 1.
    pub(super) weight: f32,
    /// Whether this is an L_m; the term before it is its sample's L_o.
    mentor: bool,
    /// The reward, or the discounted sum of n steps' rewards.
    reward: f32,
    /// The weight of the next state's value: γ, or γ^m after m steps.
    discount: f32,
    /// Row of the next state; none where that is terminal.
    next: Option<usize>,
    /// reward + discount * V(s').
    pub(super) target: f32,
}

/// The memory of a gradient step. Stages are to be called in the order of the methods.
#[derive(Debug)]
pub(super) struct Step {
    pub(super) workspace: Workspace,
    /// The gradient, once [`Step::differentiate`] has run.
    pub(super) grad: AlignedBuffer,
    /// What is regressed, once [`Step::choose`] has run.
    pub(super) terms: Vec<Term>,
    /// The mentor transitions whose L_m is among the terms, one entry a sample; a one-sided one may yet not act.
    used: Vec<u32>,
    /// Most samples.
    batch: usize,
    n_actions: usize,
    slots: Vec<u32>,
    /// The mentor transitions drawn with them; empty where a stored transition keeps its own.
    drawn: Vec<u32>,
    samples: Vec<Sample>,
    x: Rows,
    q: Vec<f32>,
    next: Rows,
    q_target: Vec<f32>,
    q_online: Vec<f32>,
    row_grads: Vec<RowGrad>,
}

/// Rows of network input.
#[derive(Debug)]
pub(super) struct Rows {
    width: usize,
    len: usize,
    x: Vec<f32>,
}

impl Rows {
    fn new(width: usize, most: usize) -> Self {
        Self { width, len: 0, x: vec![0.0; width * most] }
    }

    /// Encodes `obs` into a new row and returns its number.
    fn push(&mut self, encoding: &Encoding, obs: &[f32]) -> usize {
        let row = self.len;
        encoding.encode(obs, &mut self.x[row * self.width..][..self.width]);
        self.len += 1;
        row
    }

    /// Row `row`.
    pub(super) fn get(&self, row: usize) -> &[f32] {
        &self.x[row * self.width..][..self.width]
    }

    fn all(&self) -> &[f32] {
        &self.x[..self.len * self.width]
    }
}

/// The values of row `row`, one an action.
fn values(q: &[f32], row: usize, n_actions: usize) -> &[f32] {
    &q[row * n_actions..][..n_actions]
}

impl Step {
    /// Memory for batches of up to `batch` samples.
    pub(super) fn new(layout: &Layout, batch: usize, kernels: Kernels) -> Self {
        let rows = 2 * batch;
        let values = || vec![0.0; rows * layout.output()];
        Self {
            workspace: Workspace::with_kernels(layout, rows, kernels),
            grad: AlignedBuffer::new(layout.n_params()),
            terms: Vec::with_capacity(rows),
            used: Vec::with_capacity(batch),
            batch,
            n_actions: layout.output(),
            slots: Vec::with_capacity(batch),
            drawn: Vec::with_capacity(batch),
            samples: Vec::with_capacity(batch),
            x: Rows::new(layout.input(), rows),
            q: values(),
            next: Rows::new(layout.input(), rows),
            q_target: values(),
            q_online: values(),
            row_grads: Vec::with_capacity(rows),
        }
    }

    /// Forgets all samples.
    pub(super) fn clear(&mut self) {
        self.samples.clear();
        self.x.len = 0;
    }

    /// Whether no further sample has room.
    pub(super) fn is_full(&self) -> bool {
        self.samples.len() == self.batch
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

    /// Draws `n` slots, and with `uniform` a mentor transition for each.
    pub(super) fn draw(
        &mut self,
        replay: &Replay,
        mentor: Option<&MentorSide>,
        kind: DrawKind,
        rng: &mut impl RngCore,
        n: usize,
    ) {
        replay.sample(rng, n, &mut self.slots);
        self.drawn.clear();
        if let (DrawKind::Uniform, Some(mentor)) = (kind, mentor) {
            let len = mentor.transitions.len() as u32;
            self.drawn.extend((0..n).map(|_| rng.random_range(0..len)));
        }
    }

    /// Makes the drawn slots the samples.
    pub(super) fn collect(
        &mut self,
        replay: &Replay,
        mentor: Option<&MentorSide>,
        rule: &MentorRule,
        encoding: &Encoding,
    ) {
        self.clear();
        for at in 0..self.slots.len() {
            let slot = self.slots[at] as usize;
            let j = self.drawn.get(at).map_or(replay.get(slot).mentor, |&j| Some(j as usize));
            self.add(slot, j, replay, mentor, rule, encoding);
        }
    }

    /// Puts the first states of `view` in the place of those of the samples, none of which has a mentor transition.
    pub(super) fn look(&mut self, view: &View, encoding: &Encoding) {
        self.x.len = 0;
        for at in 0..self.samples.len() {
            self.x.push(encoding, view.from(at));
        }
    }

    /// Makes the entry in `slot` a sample, to which mentor transition `j` belongs. There must be room.
    pub(super) fn add(
        &mut self,
        slot: usize,
        j: Option<usize>,
        replay: &Replay,
        mentor: Option<&MentorSide>,
        rule: &MentorRule,
        encoding: &Encoding,
    ) {
        let entry = replay.get(slot);
        let row = self.x.push(encoding, entry.transition.obs);
        let candidate = mentor.zip(j).and_then(|(mentor, j)| {
            let r_o = entry.transition.reward;
            let term = mentor_term(rule, j, &mentor.annotations, &mentor.transitions, r_o)?;
            let row = self.x.push(encoding, mentor.transitions.state(j));
            Some(Candidate { j, row, kind: term.kind, action: term.action, e_kl: term.e_kl })
        });
        let action = entry.transition.action;
        self.samples.push(Sample { slot, row, action, mentor: j, candidate });
    }

    /// Q-values of all rows under the online network, kept for the gradient.
    pub(super) fn forward_values(&mut self, network: &QNetwork) -> Result<(), AgentError> {
        let rows = self.x.len;
        if rows > 0 {
            let q = &mut self.q[..rows * network.layout().output()];
            network.with_params(|online, _| {
                forward_train(network.layout(), online, self.x.all(), rows, &mut self.workspace, q);
            })?;
        }
        Ok(())
    }

    /// Decides which losses each sample trains with, and collects the terms and their next states. `shown` is what a rival adds
    /// to rewards, or puts in the place of the samples.
    pub(super) fn choose(
        &mut self,
        replay: &Replay,
        mentor: Option<&MentorSide>,
        shown: Shown<'_>,
        settings: &Settings,
        encoding: &Encoding,
        stats: &mut TrainStats,
    ) {
        self.terms.clear();
        self.used.clear();
        self.next.len = 0;
        stats.samples += self.samples.len() as u64;
        for (at, sample) in self.samples.iter().enumerate() {
            let entry = replay.get(sample.slot);
            stats.with_mentor += u64::from(sample.mentor.is_some());
            match sample.candidate.map(|candidate| candidate.kind) {
                Some(MentorKind::Feasible) => stats.feasible += 1,
                Some(MentorKind::Bridged) => stats.bridged += 1,
                None => {}
            }
            let phi = self.mentor_weight(sample, mentor);
            let weights = Weights::of(settings.combine, phi);
            let own = &entry.transition;
            // A one-sided L_m may yet leave its weight to L_o.
            if weights.own > 0.0 || settings.one_sided {
                let mut last = sample.slot;
                let path = replay.path(sample.slot, settings.learner.n_step).inspect(|&slot| last = slot);
                let reward =
                    |slot| replay.get(slot).transition.reward + shown.added.map_or(0.0, |added| added[slot]);
                let (mut reward, discount) = n_step(settings.gamma, path.map(reward));
                let end = replay.get(last).transition;
                let mut next_obs = end.next_obs;
                if let Some(view) = shown.view {
                    reward += view.added(at);
                    next_obs = view.to(at);
                }
                let next = (!end.terminated()).then(|| self.next.push(encoding, next_obs));
                self.terms.push(Term {
                    row: sample.row,
                    action: sample.action,
                    weight: weights.own,
                    mentor: false,
                    reward,
                    discount,
                    next,
                    target: 0.0,
                });
            }
            let (Some(mentor), Some(candidate)) = (mentor.filter(|_| weights.mentor > 0.0), sample.candidate)
            else {
                continue;
            };
            let (annotations, transitions) = (&mentor.annotations, &mentor.transitions);
            if let Some(term) = mentor_term(&settings.rule, candidate.j, annotations, transitions, own.reward)
            {
                let next = (!term.terminal).then(|| self.next.push(encoding, term.next_obs));
                self.used.push(candidate.j as u32);
                self.terms.push(Term {
                    row: candidate.row,
                    action: term.action,
                    weight: weights.mentor,
                    mentor: true,
                    reward: term.reward,
                    discount: settings.gamma,
                    next,
                    target: 0.0,
                });
            }
        }
    }

    /// The weight Φ of a sample's L_m.
    fn mentor_weight(&self, sample: &Sample, mentor: Option<&MentorSide>) -> f32 {
        match (mentor, self.seen(sample)) {
            (Some(mentor), (own, Some(candidate))) => mentor.selection.weight(&own, &candidate),
            _ => 0.0,
        }
    }

    /// A sample as a selection rule sees it, once [`Step::forward_values`] has run.
    fn seen(&self, sample: &Sample) -> (Own, Option<selection::Candidate<'_>>) {
        let q = values(&self.q, sample.row, self.n_actions)[sample.action as usize];
        let candidate = sample.candidate.map(|candidate| selection::Candidate {
            j: candidate.j,
            kind: candidate.kind,
            action: candidate.action,
            e_kl: candidate.e_kl,
            q: values(&self.q, candidate.row, self.n_actions),
        });
        (Own { slot: sample.slot, action: sample.action, q }, candidate)
    }

    /// Calls `see` with each sample that has a mentor transition, and with that transition if it has an L_m.
    pub(super) fn each_with_mentor(&self, mut see: impl FnMut(&Own, Option<&selection::Candidate<'_>>)) {
        for sample in self.samples.iter().filter(|sample| sample.mentor.is_some()) {
            let (own, candidate) = self.seen(sample);
            see(&own, candidate.as_ref());
        }
    }

    /// Counts the samples whose loss has a share of a mentor's, by mentor transition.
    pub(super) fn count_used(&self, used: &mut [u64]) {
        self.used.iter().for_each(|&j| used[j as usize] += 1);
    }

    /// The targets of all terms.
    pub(super) fn forward_targets(
        &mut self,
        network: &QNetwork,
        settings: &Settings,
    ) -> Result<(), AgentError> {
        let (rows, layout) = (self.next.len, network.layout());
        let n_actions = layout.output();
        let double = settings.learner.double;
        if rows > 0 {
            let (x, ws) = (self.next.all(), &mut self.workspace);
            let (q_target, q_online) = (&mut self.q_target, &mut self.q_online);
            network.with_params(|online, target| {
                forward(layout, target, x, rows, ws, &mut q_target[..rows * n_actions]);
                if double {
                    forward(layout, online, x, rows, ws, &mut q_online[..rows * n_actions]);
                }
            })?;
        }
        for term in &mut self.terms {
            let next = term.next.map(|row| {
                let online = double.then(|| values(&self.q_online, row, n_actions));
                next_value(values(&self.q_target, row, n_actions), online)
            });
            term.target = target_value(term.reward, term.discount, next);
        }
        if settings.one_sided {
            self.drop_lower_targets();
        }
        Ok(())
    }

    /// Takes the weight of every L_m whose target is not above the present value, and gives its sample's L_o the whole.
    fn drop_lower_targets(&mut self) {
        for at in 1..self.terms.len() {
            let term = self.terms[at];
            let q = values(&self.q, term.row, self.n_actions)[term.action as usize];
            if term.mentor && !acts(q, term.target) {
                self.terms[at].weight = 0.0;
                self.terms[at - 1].weight = 1.0;
            }
        }
    }

    /// The gradient of the mean loss of the samples.
    pub(super) fn differentiate(
        &mut self,
        network: &QNetwork,
        settings: &Settings,
        stats: &mut TrainStats,
    ) -> Result<(), AgentError> {
        let (layout, n_actions) = (network.layout(), settings.n_actions);
        let scale = 1.0 / self.samples.len() as f32;
        self.row_grads.clear();
        let mut loss = 0.0;
        for term in &self.terms {
            let q = values(&self.q, term.row, n_actions)[term.action as usize];
            loss += f64::from(term.weight) * f64::from(settings.loss.value(q, term.target));
            stats.td_abs_sum += f64::from(term.weight) * f64::from((term.target - q).abs());
            if term.mentor {
                stats.mentor_weight_sum += f64::from(term.weight);
            }
            let dq = scale * term.weight * settings.loss.derivative(q, term.target);
            self.row_grads.push(RowGrad { row: term.row as u32, action: term.action, dq });
        }
        stats.loss_sum += loss * f64::from(scale);
        match settings.learner.backend {
            Backend::Kernels => {
                let (ws, grads, grad) = (&mut self.workspace, &self.row_grads, &mut self.grad);
                network.with_params(|online, _| backward(layout, online, ws, grads, grad))?;
            }
            Backend::Candle => {
                let gradient = self.autodiff(network, settings, scale)?;
                self.grad.copy_from_slice(&gradient);
            }
        }
        Ok(())
    }

    /// The same gradient by candle's automatic differentiation.
    pub(super) fn autodiff(
        &self,
        network: &QNetwork,
        settings: &Settings,
        scale: f32,
    ) -> Result<Vec<f32>, AgentError> {
        let x: Vec<f32> = self.terms.iter().flat_map(|term| self.x.get(term.row)).copied().collect();
        let actions: Vec<u32> = self.terms.iter().map(|term| term.action).collect();
        let targets: Vec<f32> = self.terms.iter().map(|term| term.target).collect();
        let weights: Vec<f32> = self.terms.iter().map(|term| term.weight).collect();
        let samples = Samples { x: &x, actions: &actions, targets: &targets, weights: &weights, scale };
        let (_, gradient) = loss_and_gradient(network.layout(), network.online(), &samples, settings.loss)?;
        Ok(gradient)
    }
}
