//! The mentor's path with learned bridges: which of its states the observer has come to, and what the policy that leads along it
//! would do in each.

use super::moment::Moment;
use super::{steps, uncounted};
use trestle_algorithm::agent::Agent;
use trestle_algorithm::learned_bridges::{Goal, Path, path_of, policy_of, softmax};
use trestle_algorithm::similarity::Hit;
use trestle_proto::experiment::Experiment;
use trestle_qnet::{Layout, Workspace, argmax, forward};

/// The path, and where the observer has been on it.
#[derive(Debug)]
pub(super) struct Way {
    goal: Goal,
    path: Path,
    layout: Layout,
    /// The mentor states that a moment tells of: each begins a step.
    shown: Vec<usize>,
    /// The policy's input in each of them, on its way to the state that it would aim at.
    inputs: Vec<f32>,
    /// Steps of the observer near each mentor state.
    visited: Vec<u64>,
    /// Transitions that have been looked at, by their number in the history.
    counted: u64,
    place: Vec<f32>,
    stack: Vec<u32>,
    hits: Vec<Hit>,
}

impl Way {
    /// That of `experiment`'s run, of every `stride`th step; none without learned bridges.
    pub(super) fn new(experiment: &Experiment, stride: usize) -> Option<Self> {
        let (goal, layout) = policy_of(experiment).ok()??;
        let path = path_of(experiment, &goal)?;
        let shown: Vec<usize> = steps(experiment).step_by(stride).collect();
        let mut inputs = vec![0.0; shown.len() * layout.input()];
        let lookahead = experiment.config.mentor.learned.lookahead as f32;
        let (states, dim) = (&experiment.waypoints.as_ref()?.states, experiment.spec.obs_dim());
        for (input, &m) in inputs.chunks_exact_mut(layout.input()).zip(&shown) {
            goal.encode(&states[m * dim..][..dim], path.place(path.ahead(m, lookahead)), input);
        }
        let visited = vec![0; path.len()];
        let (place, stack, hits) = (Vec::new(), Vec::new(), Vec::new());
        Some(Self { goal, path, layout, shown, inputs, visited, counted: 0, place, stack, hits })
    }

    /// Tells `moment` of each step.
    pub(super) fn tell(&mut self, agent: &Agent, moment: &mut Moment) {
        self.count(agent);
        let (count, n) = (self.shown.len(), self.layout.output());
        let mut outputs = vec![0.0; count * n];
        let mut workspace = Workspace::new(&self.layout, count);
        forward(&self.layout, &agent.acting().policy, &self.inputs, count, &mut workspace, &mut outputs);
        for (row, &m) in outputs.chunks_exact_mut(n).zip(&self.shown) {
            softmax(row);
            let action = argmax(row);
            moment.push_led(self.visited[m], action, row[action]);
        }
    }

    fn count(&mut self, agent: &Agent) {
        let replay = agent.replay();
        let mut wide = Vec::new();
        for index in uncounted(replay, self.counted) {
            self.place.clear();
            self.goal.place(replay.next_obs(replay.slot(index)).wide(&mut wide), &mut self.place);
            self.path.near(&self.place, &mut self.stack, &mut self.hits);
            self.hits.iter().for_each(|hit| self.visited[hit.state as usize] += 1);
        }
        self.counted = replay.next_index();
    }
}
