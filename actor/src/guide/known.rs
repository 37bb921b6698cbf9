//! A guide that takes the action which is known for the mentor state nearest to where the actor is.
//!
//! The mentor's states come with the experiment and never change. What the observer has found out about them does, and is
//! published with the weights: a table with one entry for each mentor transition, the action that the mentor's loss of
//! it would use, or none.

use trestle_algorithm::similarity::metric::{Metric, MetricError};
use trestle_algorithm::similarity::{Hit, Similarity};
use trestle_proto::NONE;
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
        }))
    }

    /// The entry in `known` of the mentor state nearest to `obs` among the similar ones that have one; the first of
    /// equally near ones. None without any.
    pub fn action(&mut self, obs: &[f32], known: &[u32]) -> Option<u32> {
        self.whitened.clear();
        self.metric.whiten(obs, &mut self.scratch, &mut self.whitened);
        self.similarity.states(&self.whitened, &mut self.stack, &mut self.hits);
        let nearby = self.hits.iter().filter_map(|hit| {
            let j = self.transition_of[hit.state as usize];
            let action = *known.get(j as usize).filter(|_| j != NONE)?;
            (action != NONE).then_some((hit.kl, action))
        });
        nearby.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, action)| action)
    }
}
