//! The terms of a gradient step: Q-values that are regressed, each with its weight and its target.
//!
//! A sample has a term for each loss that it trains with. Which these are is known after one forward pass of its states; only
//! then are the next states collected, so that a loss that is not used costs no target.

use super::rows::{Rows, Values};
use super::samples::{Sample, Samples, Sources, WithLoss};
use super::{AgentError, Settings, TrainStats};
use crate::losses::{Weights, acts, n_step, next_value, target_value};
use trestle_proto::row::Row;
use trestle_qnet::autodiff::{self, loss_and_gradient};
use trestle_qnet::{Layout, QNetwork, RowGrad, Workspace, forward};

/// One Q-value that is regressed: w ℓ(Q(s, a; θ), y).
#[derive(Clone, Copy, Debug)]
struct Term {
    /// Row of s among those of the samples.
    row: usize,
    /// a.
    action: u32,
    /// w, 0 to 1.
    weight: f32,
    /// The mentor transition whose L_m this is; the term before it is its sample's L_o. None for an L_o.
    mentor: Option<usize>,
    /// r, or the discounted sum of n steps' rewards.
    reward: f32,
    /// The weight of V(s'): γ, or γ^m after m steps.
    discount: f32,
    /// Row of s' among the next states; none where that is terminal.
    next: Option<usize>,
    /// y = r + discount V(s').
    target: f32,
}

/// The terms of a step, in memory that is allocated once.
#[derive(Debug)]
pub(super) struct Terms {
    all: Vec<Term>,
    next: Rows,
    q_target: Values,
    q_online: Values,
    row_grads: Vec<RowGrad>,
}

impl Terms {
    /// Memory for the terms of up to `samples` samples of a network with `layout`.
    pub(super) fn new(layout: &Layout, samples: usize) -> Self {
        let most = 2 * samples;
        Self {
            all: Vec::with_capacity(most),
            next: Rows::new(layout.input(), most),
            q_target: Values::new(layout.output(), most),
            q_online: Values::new(layout.output(), most),
            row_grads: Vec::with_capacity(most),
        }
    }

    /// Decides which losses each sample trains with, and collects the terms and their next states.
    pub(super) fn choose(&mut self, samples: &Samples, from: &Sources<'_>) {
        self.all.clear();
        self.next.clear();
        for (at, sample) in samples.all.iter().enumerate() {
            let phi = match (from.mentor, samples.seen(sample)) {
                (Some(mentor), (own, Some(candidate))) => mentor.selection.weight(&own, &candidate),
                _ => 0.0,
            };
            let weights = Weights::of(from.settings.combine, phi);
            // A one-sided L_m may yet leave its weight to L_o.
            if weights.own > 0.0 || from.settings.one_sided {
                self.add_own((at, sample), weights.own, from);
            }
            if let Some(with_loss) = sample.with_loss.filter(|_| weights.mentor > 0.0) {
                self.add_mentors(&with_loss, weights.mentor, from);
            }
        }
    }

    /// L_o of (2), n steps ahead, of the sample with this number.
    fn add_own(&mut self, (at, sample): (usize, &Sample), weight: f32, from: &Sources<'_>) {
        let Sources { settings, replay, shown, .. } = *from;
        let mut last = sample.slot;
        let path = replay.path(sample.slot, settings.learner.n_step).inspect(|&slot| last = slot);
        let reward = |slot| replay.get(slot).reward + shown.added.map_or(0.0, |added| added[slot]);
        let (mut reward, discount) = n_step(settings.gamma, path.map(reward));
        let mut next_obs = replay.next_obs(last);
        if let Some(view) = shown.view {
            reward += view.added(at);
            next_obs = Row::F32(view.to(at));
        }
        let next = (!replay.get(last).terminated()).then(|| self.next.push(from.encoding, next_obs));
        let Sample { row, action, .. } = *sample;
        self.all.push(Term { row, action, weight, mentor: None, reward, discount, next, target: 0.0 });
    }

    /// L_m of (3) or (6).
    fn add_mentors(&mut self, with_loss: &WithLoss, weight: f32, from: &Sources<'_>) {
        let Some(mentor) = from.mentor else { return };
        let WithLoss { j, row, term } = *with_loss;
        let next_obs = term.next_obs(j, &mentor.annotations, &mentor.transitions);
        let next = (!term.terminal).then(|| self.next.push(from.encoding, Row::F32(next_obs)));
        self.all.push(Term {
            row,
            action: term.action,
            weight,
            mentor: Some(j),
            reward: term.reward,
            discount: from.settings.gamma,
            next,
            target: 0.0,
        });
    }

    /// Counts each L_m in `used`, by mentor transition; a one-sided one may yet not act.
    pub(super) fn count_used(&self, used: &mut [u64]) {
        self.all.iter().filter_map(|term| term.mentor).for_each(|j| used[j] += 1);
    }

    /// y of all terms, by the values of the next states under θ⁻.
    pub(super) fn targets(
        &mut self,
        samples: &Samples,
        network: &QNetwork,
        settings: &Settings,
        workspace: &mut Workspace,
    ) -> Result<(), AgentError> {
        let (rows, layout, double) = (self.next.len(), network.layout(), settings.learner.double);
        if rows > 0 {
            let (x, q_target, q_online) = (self.next.all(), &mut self.q_target, &mut self.q_online);
            network.with_params(|theta, theta_minus| {
                forward(layout, theta_minus, x, rows, workspace, q_target.first(rows));
                if double {
                    forward(layout, theta, x, rows, workspace, q_online.first(rows));
                }
            })?;
        }
        for term in &mut self.all {
            let next =
                term.next.map(|row| next_value(self.q_target.of(row), double.then(|| self.q_online.of(row))));
            term.target = target_value(term.reward, term.discount, next);
        }
        if settings.one_sided {
            self.drop_lower_targets(samples);
        }
        Ok(())
    }

    /// Takes the weight of every L_m whose target is not above the present value, and gives its sample's L_o the whole.
    fn drop_lower_targets(&mut self, samples: &Samples) {
        for at in 1..self.all.len() {
            let term = self.all[at];
            if term.mentor.is_some() && !acts(samples.q.at(term.row, term.action), term.target) {
                self.all[at].weight = 0.0;
                self.all[at - 1].weight = 1.0;
            }
        }
    }

    /// w ∂ℓ/∂Q of each term, a share of the mean over the samples; the loss itself goes into `stats`.
    pub(super) fn row_gradients(
        &mut self,
        samples: &Samples,
        settings: &Settings,
        stats: &mut TrainStats,
    ) -> &[RowGrad] {
        let scale = scale(samples);
        self.row_grads.clear();
        let mut loss = 0.0;
        for term in &self.all {
            let q = samples.q.at(term.row, term.action);
            let weight = f64::from(term.weight);
            loss += weight * f64::from(settings.loss.value(q, term.target));
            if term.mentor.is_some() {
                stats.mentor_weight_sum += weight;
            }
            let dq = scale * term.weight * settings.loss.derivative(q, term.target);
            self.row_grads.push(RowGrad { row: term.row as u32, action: term.action, dq });
        }
        stats.loss_sum += loss * f64::from(scale);
        &self.row_grads
    }

    /// The gradient of the same loss by candle's automatic differentiation, flat in the order of the layout.
    pub(super) fn autodiff(
        &self,
        samples: &Samples,
        network: &QNetwork,
        settings: &Settings,
    ) -> Result<Vec<f32>, AgentError> {
        let x: Vec<f32> = self.all.iter().flat_map(|term| samples.x.get(term.row)).copied().collect();
        let actions: Vec<u32> = self.all.iter().map(|term| term.action).collect();
        let targets: Vec<f32> = self.all.iter().map(|term| term.target).collect();
        let weights: Vec<f32> = self.all.iter().map(|term| term.weight).collect();
        let (x, actions, targets, weights) = (&x, &actions, &targets, &weights);
        let of_terms = autodiff::Samples { x, actions, targets, weights, scale: scale(samples) };
        let (_, gradient) = loss_and_gradient(network.layout(), network.online(), &of_terms, settings.loss)?;
        Ok(gradient)
    }
}

/// The share of a sample in the mean.
fn scale(samples: &Samples) -> f32 {
    1.0 / samples.all.len() as f32
}
