//! GAIfO: a network D(s, s') learns to tell the observer's steps from the mentor's, and its doubt is added to the rewards.
//!
//! As in generative adversarial imitation from observation (Torabi, Warnell and Stone 2019). With D the probability that a step is
//! the observer's, an update is one step of Adam on
//!
//! ```text
//! -mean ln D(s_o, s'_o) - mean ln(1 - D(s_m, s'_m))
//! ```
//!
//! over as many steps from the replay as of the mentor's, all drawn uniformly. To a reward is added, with a weight, -ln D(s, s')
//! or ln(1 - D(s, s')), under the D of the moment at which its transition is drawn.

use crate::learned_bridges::Goal;
use crate::replay::Replay;
use rand::Rng;
use serde::{Deserialize, Serialize};
use trestle_proto::NONE;
use trestle_proto::config::AdversarialKind;
use trestle_proto::experiment::Experiment;
use trestle_proto::rng::{Purpose, Stream, stream};
use trestle_qnet::{
    Adam, AdamConfig, AlignedBuffer, Layout, PlanError, Workspace, backward_outputs, forward, forward_train,
    init, kernels_of, network_of,
};

/// All that a checkpoint has to keep of [`Gaifo`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GaifoState {
    params: Vec<f32>,
    adam: Adam,
    rng: Stream,
}

/// The discriminator, and all that learns it.
#[derive(Debug)]
pub struct Gaifo {
    weight: f32,
    reward: AdversarialKind,
    batch: usize,
    adam: AdamConfig,
    /// How a step becomes the network's input: s, and the way to s'.
    goal: Goal,
    layout: Layout,
    state: GaifoState,
    /// The mentor's steps as input.
    mentor: Vec<f32>,
    /// What is added to the reward of the transition in each slot: up to date for those that were drawn last.
    added: Vec<f32>,
    slots: Vec<u32>,
    rows: Vec<usize>,
    place: Vec<f32>,
    workspace: Workspace,
    x: Vec<f32>,
    /// Outputs of the network, then the loss's derivatives by them.
    outputs: Vec<f32>,
    grad: AlignedBuffer,
}

impl Gaifo {
    /// For `experiment`; none without the mentor's states.
    ///
    /// # Errors
    /// Settings that give no network.
    pub fn new(experiment: &Experiment) -> Result<Option<Self>, PlanError> {
        let Some(waypoints) = &experiment.waypoints else { return Ok(None) };
        let (_, encoding) = network_of(experiment)?;
        let (seed, settings, spec) =
            (experiment.config.run.seed, &experiment.config.rival.gaifo, &experiment.spec);
        let dim = spec.obs_dim();
        let features: Vec<usize> = (0..dim).collect();
        let goal = Goal::new(encoding, &features, &spec.scale);
        let goal = goal.with_categories(spec, &experiment.one_hot_sizes());
        let layout = Layout::new(&[&[goal.input_dim()], &settings.hidden[..], &[1]].concat())?;
        let state = |m: usize| &waypoints.states[m * dim..][..dim];
        let (mut mentor, mut place, mut row) = (Vec::new(), Vec::new(), vec![0.0; layout.input()]);
        for m in (0..waypoints.transition_of.len()).filter(|&m| waypoints.transition_of[m] != NONE) {
            place.clear();
            goal.place(state(m + 1), &mut place);
            goal.encode(state(m), &place, &mut row);
            mentor.extend_from_slice(&row);
        }
        let rows = 2 * settings.batch;
        Ok(Some(Self {
            weight: settings.weight as f32,
            reward: settings.reward,
            batch: settings.batch,
            adam: AdamConfig { lr: settings.lr, ..AdamConfig::default() },
            state: GaifoState {
                params: init(&layout, &mut stream(seed, Purpose::RivalWeights, 0)),
                adam: Adam::new(layout.n_params()),
                rng: stream(seed, Purpose::RivalReplay, 0),
            },
            mentor,
            added: vec![0.0; experiment.config.learner.replay],
            slots: Vec::with_capacity(settings.batch),
            rows: Vec::with_capacity(rows),
            place,
            workspace: Workspace::with_kernels(&layout, rows, kernels_of(experiment)?),
            x: vec![0.0; rows * layout.input()],
            outputs: vec![0.0; rows],
            grad: AlignedBuffer::new(layout.n_params()),
            goal,
            layout,
        }))
    }

    /// Writes the transition in `slot` as input into row `row`.
    fn encode(&mut self, replay: &Replay, slot: usize, row: usize) {
        let (mut a, mut b) = (Vec::new(), Vec::new());
        let (obs, next_obs) = (replay.obs(slot).wide(&mut a), replay.next_obs(slot).wide(&mut b));
        self.place.clear();
        self.goal.place(next_obs, &mut self.place);
        let width = self.layout.input();
        self.goal.encode(obs, &self.place, &mut self.x[row * width..][..width]);
    }

    /// One update from what `replay` holds. Returns the loss, in nats; none where nothing is stored.
    pub fn update(&mut self, replay: &Replay) -> Option<f64> {
        let loss = self.differentiate(replay)?;
        let (kernels, threads) = (self.workspace.kernels(), self.workspace.threads());
        self.state.adam.step(&self.adam, kernels, threads, &mut self.state.params, &self.grad);
        Some(loss)
    }

    /// Draws samples, and computes the gradient of their loss and the loss itself.
    fn differentiate(&mut self, replay: &Replay) -> Option<f64> {
        let (batch, width) = (self.batch, self.layout.input());
        let steps = self.mentor.len() / width;
        let mut slots = std::mem::take(&mut self.slots);
        replay.sample(&mut self.state.rng, batch, &mut slots);
        for (row, &slot) in slots.iter().enumerate() {
            self.encode(replay, slot as usize, row);
        }
        let drawn = slots.len();
        self.slots = slots;
        if drawn < batch || steps == 0 {
            return None;
        }
        for x in self.x[batch * width..].chunks_exact_mut(width) {
            let step = self.state.rng.random_range(0..steps);
            x.copy_from_slice(&self.mentor[step * width..][..width]);
        }
        let (layout, params) = (&self.layout, &self.state.params);
        forward_train(layout, params, &self.x, 2 * batch, &mut self.workspace, &mut self.outputs);
        let (mut loss, scale) = (0.0, 1.0 / batch as f32);
        for (row, output) in self.outputs.iter_mut().enumerate() {
            // ln D = -softplus(-f) and ln(1 - D) = -softplus(f), whose derivatives by f are 1 - D and -D.
            let (own, d) = (row < batch, sigmoid(*output));
            loss += f64::from(softplus(if own { -*output } else { *output }));
            *output = scale * if own { d - 1.0 } else { d };
        }
        backward_outputs(layout, params, &mut self.workspace, &self.outputs, &mut self.grad);
        Some(loss / batch as f64)
    }

    /// Renews what is added to the rewards of the transitions in `slots`, and of up to `steps` - 1 after each of them.
    pub fn refresh(&mut self, replay: &Replay, slots: &[u32], steps: usize) {
        let most = self.outputs.len();
        let mut rows = std::mem::take(&mut self.rows);
        for &slot in slots {
            for slot in replay.path(slot as usize, steps) {
                self.encode(replay, slot, rows.len());
                rows.push(slot);
                if rows.len() == most {
                    self.judge(&mut rows);
                }
            }
        }
        self.judge(&mut rows);
        self.rows = rows;
    }

    /// The rewards of the transitions in the slots `rows`, whose inputs stand in the first rows; forgets them.
    fn judge(&mut self, rows: &mut Vec<usize>) {
        let (n, width) = (rows.len(), self.layout.input());
        if n > 0 {
            let (x, outputs) = (&self.x[..n * width], &mut self.outputs[..n]);
            forward(&self.layout, &self.state.params, x, n, &mut self.workspace, outputs);
        }
        for (slot, output) in rows.drain(..).zip(&self.outputs) {
            self.added[slot] = self.weight
                * match self.reward {
                    AdversarialKind::Observer => softplus(-*output),
                    AdversarialKind::Mentor => -softplus(*output),
                };
        }
    }

    /// What is added to the reward of the transition in each slot that was refreshed last.
    pub fn added(&self) -> &[f32] {
        &self.added
    }

    /// What a checkpoint keeps.
    pub fn state(&self) -> &GaifoState {
        &self.state
    }

    /// Goes on as another one of the same layout did. Whether the state is one of this layout.
    #[must_use]
    pub fn restore(&mut self, state: &GaifoState) -> bool {
        let n = self.layout.n_params();
        let fits = [state.params.len(), state.adam.m.len(), state.adam.v.len()].iter().all(|&len| len == n);
        if fits {
            self.state.clone_from(state);
        }
        fits
    }
}

/// 1 / (1 + e^-x).
fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + libm::expf(-x))
}

/// ln(1 + e^x), without an overflow.
fn softplus(x: f32) -> f32 {
    x.max(0.0) + libm::log1pf(libm::expf(-x.abs()))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::testing::experiment;
    use trestle_proto::batch::Transition;
    use trestle_proto::waypoints::Waypoints;

    /// A mentor that goes right from 0 to 3, and an observer of whose steps a share does the same and the others go up.
    fn world(sets: &[&str], right: usize) -> (Gaifo, Replay) {
        let mut experiment =
            experiment(&[&["run.algo=dqn", "rival.kind=gaifo", "rival.gaifo.weight=1"], sets].concat());
        experiment.waypoints = Some(Waypoints {
            states: (0..4).flat_map(|x| [x as f32, 0.0]).collect(),
            transition_of: vec![0, 1, 2, NONE],
            progress: vec![0.0, 0.25, 0.5, 1.0],
        });
        let mut replay = Replay::new(48, 2).unwrap();
        for i in 0..48 {
            let obs = [(i % 3) as f32, 0.0];
            let next = if i / 3 % 4 < right { [obs[0] + 1.0, 0.0] } else { [obs[0], 1.0] };
            replay.push(
                &Transition { obs: &obs, next_obs: &next, action: 0, reward: 0.0, flags: 0 },
                0,
                NONE,
            );
        }
        (Gaifo::new(&experiment).unwrap().unwrap(), replay)
    }

    /// The best D is p / (p + q), with p the observer's share of a step and q the mentor's (Goodfellow et al. 2014): 1 where
    /// the mentor never goes, and where a share of 1/4 of the observer's steps is the mentor's only kind, 1/4 / (1/4 + 1) = 1/5.
    #[test]
    fn the_best_discriminator_is_found() {
        for (right, expected) in [(1, 0.2f32), (2, 1.0 / 3.0)] {
            let (mut gaifo, replay) = world(&["rival.gaifo.lr=0.003", "rival.gaifo.reward=observer"], right);
            for _ in 0..1500 {
                gaifo.update(&replay).unwrap();
            }
            gaifo.refresh(&replay, &(0..48).collect::<Vec<u32>>(), 1);
            for slot in 0..48 {
                let d = (-gaifo.added()[slot]).exp();
                let best = if slot / 3 % 4 < right { expected } else { 1.0 };
                assert!((d - best).abs() < 0.06, "{slot}: {d} {best}");
            }
        }
    }

    #[test]
    fn either_reward_is_of_the_same_discriminator() {
        let [observer, mentor] = ["observer", "mentor"].map(|kind| {
            let (mut gaifo, replay) = world(&[&format!("rival.gaifo.reward={kind}")], 2);
            gaifo.refresh(&replay, &[0, 7], 1);
            gaifo.added()[7]
        });
        assert!(((-observer).exp() + mentor.exp() - 1.0).abs() < 1e-6, "{observer} {mentor}");
    }

    /// Against differences of the loss of the same draws.
    #[test]
    fn the_gradient_is_that_of_the_loss() {
        let (mut gaifo, replay) = world(&["rival.gaifo.hidden=[5]", "rival.gaifo.batch=16"], 2);
        let start = gaifo.state().clone();
        gaifo.differentiate(&replay).unwrap();
        let grad = gaifo.grad.to_vec();
        for (at, &grad) in grad.iter().enumerate() {
            let mut at_offset = |by: f32| {
                assert!(gaifo.restore(&start));
                gaifo.state.params[at] += by;
                gaifo.differentiate(&replay).unwrap()
            };
            let by = 1e-2;
            let slope = (at_offset(by) - at_offset(-by)) / f64::from(2.0 * by);
            // Kinks of the rectifier lie within a step now and then.
            assert!((slope - f64::from(grad)).abs() < 2e-2, "{at}: {slope} {grad}");
        }
    }
}
