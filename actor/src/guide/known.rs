//! A guide that takes the action which is known for the mentor state nearest to where the actor is.
//!
//! The mentor's states come with the experiment and never change. What the observer has found out about them does, and is
//! published with the weights: a table with one entry for each mentor transition, the action that the mentor's loss of
//! it would use, or none.
//!
//! With whole bridges, what follows upon the first action of a bridge is published, too. A step that takes such an action begins an
//! *option* (Sutton, Precup and Singh 1999): the next steps of the episode take the bridge's other actions, without a decision in between.
//! It ends with the bridge, with the episode, or in a state that is not similar to the one that the bridge had there.

use serde::{Deserialize, Serialize};
use trestle_algorithm::similarity::metric::{Metric, MetricError, kl};
use trestle_algorithm::similarity::{Hit, Similarity};
use trestle_proto::NONE;
use trestle_proto::acting::{Acting, OptionRoom};
use trestle_proto::annotation::Further;
use trestle_proto::config::GuideKind;
use trestle_proto::experiment::Experiment;

/// The mentor's states, indexed as the mentor-server does it.
pub struct Known {
    metric: Metric,
    similarity: Similarity,
    transition_of: Vec<u32>,
    whitened: Vec<f32>,
    scratch: Vec<f64>,
    stack: Vec<u32>,
    hits: Vec<Hit>,
    /// How many options there may be.
    room: OptionRoom,
    under_way: UnderWay,
}

/// What is left of the option that an actor follows; nothing where it follows none. It belongs to a snapshot.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct UnderWay {
    /// The actions, the next one last.
    actions: Vec<u32>,
    /// The states in which they are to be taken, row-major, the next one last.
    states: Vec<f32>,
}

impl UnderWay {
    fn clear(&mut self) {
        self.actions.clear();
        self.states.clear();
    }

    /// Begins the option of `steps`, between states of `dim` features.
    fn begin(&mut self, steps: Further<'_>, dim: usize) {
        self.clear();
        self.actions.extend(steps.actions.iter().rev());
        steps.states.chunks_exact(dim).rev().for_each(|state| self.states.extend_from_slice(state));
    }
}

impl Known {
    /// The guide of `experiment`'s run; none unless exploration is guided by known actions.
    ///
    /// # Errors
    /// Settings that give no state distance.
    pub fn new(experiment: &Experiment) -> Result<Option<Self>, MetricError> {
        let mentor = &experiment.config.mentor;
        let (Some(waypoints), Some(e_th)) = (&experiment.waypoints, mentor.e_th.known()) else {
            return Ok(None);
        };
        if experiment.config.guide() != Some(GuideKind::Known) {
            return Ok(None);
        }
        let metric = Metric::of(mentor, &experiment.spec, &waypoints.states)?;
        let whitened = metric.whiten_all(&waypoints.states);
        Ok(Some(Self {
            similarity: Similarity::new(whitened, metric.dim(), e_th as f32),
            metric,
            transition_of: waypoints.transition_of.clone(),
            whitened: Vec::new(),
            scratch: Vec::new(),
            stack: Vec::new(),
            hits: Vec::new(),
            room: experiment.rooms().options,
            under_way: UnderWay::default(),
        }))
    }

    /// The known action of the mentor state nearest to `obs` among the similar ones that have one; the first of equally near
    /// ones. None without any. Its option is under way then, if it has one.
    pub fn action(&mut self, obs: &[f32], acting: &Acting) -> Option<u32> {
        self.whitened.clear();
        self.metric.whiten(obs, &mut self.scratch, &mut self.whitened);
        self.similarity.states(&self.whitened, &mut self.stack, &mut self.hits);
        let nearby = self.hits.iter().filter_map(|hit| {
            let j = self.transition_of[hit.state as usize];
            let action = *acting.known.get(j as usize).filter(|_| j != NONE)?;
            (action != NONE).then_some((hit.kl, j, action))
        });
        let (_, j, action) = nearby.min_by(|a, b| a.0.total_cmp(&b.0))?;
        if let Some(steps) = acting.options.get(j) {
            self.under_way.begin(steps, obs.len());
        }
        Some(action)
    }

    /// The next action of the option under way, in `obs`. Where that is not similar to the state in which the action is to be taken, the
    /// option is abandoned, and there is none.
    pub fn go_on(&mut self, obs: &[f32]) -> Option<u32> {
        let action = self.under_way.actions.pop()?;
        let expected = self.under_way.states.len() - obs.len();
        self.whitened.clear();
        for state in [obs, &self.under_way.states[expected..]] {
            self.metric.whiten(state, &mut self.scratch, &mut self.whitened);
        }
        self.under_way.states.truncate(expected);
        let (there, bridge) = self.whitened.split_at(self.metric.dim());
        if kl(there, bridge) <= self.similarity.e_th() {
            return Some(action);
        }
        self.under_way.clear();
        None
    }

    /// No option is under way.
    pub fn leave(&mut self) {
        self.under_way.clear();
    }

    /// What belongs to a snapshot; none where there are no options.
    pub fn under_way(&self) -> Option<&UnderWay> {
        (self.room.mentor > 0).then_some(&self.under_way)
    }

    /// Whether `under_way` can be of this guide.
    pub fn fits(&self, under_way: &UnderWay) -> bool {
        let UnderWay { actions, states } = under_way;
        actions.len() <= self.room.steps
            && actions.iter().all(|&action| (action as usize) < self.room.n_actions)
            && states.len() == actions.len() * self.room.obs_dim
            && states.iter().all(|x| x.is_finite())
    }

    /// Goes on from `under_way`, which [`Known::fits`].
    pub fn restore(&mut self, under_way: UnderWay) {
        self.under_way = under_way;
    }
}
