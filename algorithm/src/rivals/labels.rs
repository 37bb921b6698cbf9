//! Labels of an inverse model: what the observer itself did where it went from a state like the mentor's to one like its next.
//!
//! As in behavioural cloning from observation (Torabi, Warnell and Stone 2018), p(a | s, s') is learnt from the observer's own
//! transitions, and the likeliest action of each mentor transition is its label. Here labels take the place of a_est in the mentor's
//! loss (3). All else stays what it is: the error e_KL that feasibility is judged by, the reward, and bridges.
//!
//! The inverse model is the policy of learned bridges with a horizon of one step, whose goal is the whole next state.

use crate::learned_bridges::{Goal, Hindsight, HindsightConfig, HindsightState};
use crate::replay::Replay;
use serde::{Deserialize, Serialize};
use trestle_proto::NONE;
use trestle_proto::annotation::AnnotationTable;
use trestle_proto::experiment::Experiment;
use trestle_proto::mentor::MentorTransitions;
use trestle_proto::rng::{Purpose, stream};
use trestle_qnet::{
    AdamConfig, Kernels, Layout, PlanError, Workspace, argmax, forward, init, kernels_of, network_of,
};

/// Mentor transitions that are labelled in one pass.
const ROWS: usize = 64;

/// The inverse model and its labels.
#[derive(Debug)]
pub struct Labels {
    goal: Goal,
    model: Hindsight,
    /// Updates from one labelling to the next.
    every: u64,
    state: Counted,
    workspace: Workspace,
    place: Vec<f32>,
    x: Vec<f32>,
    outputs: Vec<f32>,
}

/// What follows from the model of the past.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Counted {
    /// Updates so far.
    updates: u64,
    /// The label of each mentor transition; [`NONE`] before the first labelling.
    labels: Vec<u32>,
}

/// All that a checkpoint has to keep of [`Labels`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LabelsState {
    model: HindsightState,
    counted: Counted,
}

impl Labels {
    /// For `experiment`, without labels yet.
    ///
    /// # Errors
    /// Settings that give no network.
    pub fn new(experiment: &Experiment) -> Result<Self, PlanError> {
        let (_, encoding) = network_of(experiment)?;
        let (seed, settings, spec) =
            (experiment.config.run.seed, &experiment.config.rival.inverse, &experiment.spec);
        let features: Vec<usize> = (0..spec.obs_dim()).collect();
        let goal = Goal::new(encoding, &features, &spec.scale);
        let goal = goal.with_categories(spec, &experiment.one_hot_sizes());
        let ends = [goal.input_dim(), spec.n_actions()];
        let sizes = [&ends[..1], &settings.hidden, &ends[1..]].concat();
        let layout = Layout::new(&sizes)?;
        let kernels: Kernels = kernels_of(experiment)?;
        let params = init(&layout, &mut stream(seed, Purpose::RivalWeights, 0));
        let config = HindsightConfig {
            batch: settings.batch,
            horizon: 1,
            adam: AdamConfig { lr: settings.lr, ..AdamConfig::default() },
        };
        let rng = stream(seed, Purpose::RivalReplay, 0);
        Ok(Self {
            workspace: Workspace::with_kernels(&layout, ROWS, kernels),
            place: Vec::with_capacity(goal.dim()),
            x: vec![0.0; ROWS * layout.input()],
            outputs: vec![0.0; ROWS * layout.output()],
            model: Hindsight::new(goal.clone(), layout, params, config, rng, kernels),
            goal,
            every: settings.every,
            state: Counted { updates: 0, labels: vec![NONE; experiment.mentor_len()] },
        })
    }

    /// One update of the model from what `replay` holds. Whether labels are due.
    pub fn update(&mut self, replay: &Replay) -> bool {
        self.model.update(replay);
        self.state.updates += 1;
        self.state.updates.is_multiple_of(self.every)
    }

    /// Labels all of the mentor's transitions anew.
    pub fn label(&mut self, transitions: &MentorTransitions) {
        let (width, n_actions) = (self.model.layout().input(), self.model.layout().output());
        for (block, labels) in self.state.labels.chunks_mut(ROWS).enumerate() {
            for (at, x) in self.x.chunks_exact_mut(width).take(labels.len()).enumerate() {
                let j = block * ROWS + at;
                self.place.clear();
                self.goal.place(transitions.next_state(j), &mut self.place);
                self.goal.encode(transitions.state(j), &self.place, x);
            }
            let rows = labels.len();
            let outputs = &mut self.outputs[..rows * n_actions];
            let (layout, params) = (self.model.layout(), self.model.params());
            forward(layout, params, &self.x[..rows * width], rows, &mut self.workspace, outputs);
            for (label, row) in labels.iter_mut().zip(outputs.chunks_exact(n_actions)) {
                *label = argmax(row) as u32;
            }
        }
    }

    /// Puts the label of mentor transition `j` in the place of its a_est, if it has both.
    pub fn put(&self, j: usize, annotations: &mut AnnotationTable) {
        let label = self.state.labels[j];
        if let Some(mut estimate) = annotations.estimate(j).filter(|_| label != NONE) {
            estimate.action = label;
            annotations.set_estimate(j, &estimate);
        }
    }

    /// What a checkpoint keeps.
    pub fn state(&self) -> LabelsState {
        LabelsState { model: self.model.state().clone(), counted: self.state.clone() }
    }

    /// Goes on as another one of the same run did. Whether the state is one of this run.
    #[must_use]
    pub fn restore(&mut self, state: &LabelsState) -> bool {
        let n_actions = self.model.layout().output() as u32;
        let counted = &state.counted;
        let known = |&label: &u32| label < n_actions || label == NONE;
        let fits = counted.labels.len() == self.state.labels.len() && counted.labels.iter().all(known);
        if !fits || !self.model.restore(&state.model) {
            return false;
        }
        self.state.clone_from(counted);
        true
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::testing::{demonstration, experiment};
    use trestle_proto::annotation::Estimate;
    use trestle_proto::batch::Transition;

    /// An observer whose action 0 leads right, 1 up, and 2 left, where the mentor of [`demonstration`] goes right and a little up.
    #[test]
    fn the_action_that_leads_where_the_mentor_went_is_its_label() {
        let experiment =
            experiment(&["run.algo=diiqn", "rival.kind=inverse-dynamics", "rival.inverse.every=400"]);
        let mut labels = Labels::new(&experiment).unwrap();
        let transitions = demonstration(&experiment).unwrap();
        let mut replay = Replay::new(50, 2).unwrap();
        for i in 0..50u32 {
            let obs = [(i % 7) as f32 - 3.0, (i % 5) as f32 - 2.0];
            let action = i % 3;
            let by = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]][action as usize];
            let next_obs = [obs[0] + by[0], obs[1] + by[1]];
            replay.push(
                &Transition { obs: &obs, next_obs: &next_obs, action, reward: 0.0, flags: 0 },
                0,
                NONE,
            );
        }
        let mut annotations = AnnotationTable::new(transitions.len(), 2, 3);
        let estimate = Estimate { action: 2, e_kl: 0.5, start_kl: 0.0, reward: 0.25 };
        annotations.set_estimate(1, &estimate);
        labels.put(1, &mut annotations);
        assert_eq!(annotations.estimate(1), Some(estimate), "there is no label yet");
        let due: Vec<bool> = (0..400).map(|_| labels.update(&replay)).collect();
        assert_eq!(due.iter().position(|&due| due), Some(399));
        labels.label(&transitions);
        assert_eq!(labels.state.labels, [0; 6]);
        (0..6).for_each(|j| labels.put(j, &mut annotations));
        assert_eq!(annotations.estimate(1), Some(Estimate { action: 0, ..estimate }));
        assert_eq!(annotations.estimate(0), None, "what nothing is known of stays so");

        let mut other = Labels::new(&experiment).unwrap();
        assert!(other.restore(&labels.state()));
        assert_eq!(other.state(), labels.state());
        let mut foreign = labels.state();
        foreign.counted.labels[0] = 3;
        assert!(!other.restore(&foreign));
    }
}
