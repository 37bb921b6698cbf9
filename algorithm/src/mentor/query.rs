//! What a [`Mentor`] answers when it is asked (`mentor/query`). Nothing here changes it.

use super::{Mentor, MentorError};
use crate::demonstration::transitions;
use crate::similarity::Hit;
use crate::similarity::metric::kl;
use trestle_proto::annotation::AnnotationTable;
use trestle_proto::limits::MAX_QUERY_ROWS;
use trestle_proto::mentor::MentorTransitions;
use trestle_proto::query::Stats;

impl Mentor {
    /// The mentor transitions that begin in a state similar to `state`, with their KL, nearest first (equally near ones
    /// by number), `limit` of them at most.
    ///
    /// # Errors
    /// Not as many features as the run's states have, or numbers that are not finite.
    pub fn similar(&self, state: &[f32], limit: usize) -> Result<Vec<(u32, f32)>, MentorError> {
        let whitened = self.whitened(state)?;
        let mut hits: Vec<Hit> = Vec::new();
        self.similarity.states(&whitened, &mut Vec::new(), &mut hits);
        let mut found: Vec<(u32, f32)> =
            transitions(&hits, &self.order).map(|(j, kl)| (j as u32, kl)).collect();
        found.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        found.truncate(limit);
        Ok(found)
    }

    /// Appends the annotation of mentor transition `j` to `out` if it has a bridge and `state` is similar to its
    /// beginning; nothing otherwise.
    ///
    /// # Errors
    /// A state or a number that cannot be.
    pub fn bridge(&self, state: &[f32], j: u32, out: &mut Vec<u32>) -> Result<(), MentorError> {
        let whitened = self.whitened(state)?;
        self.check_range(j, 1)?;
        let j = j as usize;
        let distance = kl(&whitened, self.similarity.state(self.order.state_of(j)));
        if distance <= self.similarity.e_th() && self.table.bridge(j).is_some() {
            self.table.encode(j, out);
        }
        Ok(())
    }

    /// Appends the annotations of `count` mentor transitions from `first` on to `out`.
    ///
    /// # Errors
    /// A range beyond what there is, or of more than [`MAX_QUERY_ROWS`].
    pub fn annotations(&self, first: u32, count: u32, out: &mut Vec<u32>) -> Result<(), MentorError> {
        self.check_range(first, count)?;
        (first..first + count).for_each(|j| self.table.encode(j as usize, out));
        Ok(())
    }

    /// Appends `count` mentor transitions from `first` on to `out` ([`trestle_proto::mentor`]).
    ///
    /// # Errors
    /// As for [`Mentor::annotations`].
    pub fn transitions(&self, first: u32, count: u32, out: &mut Vec<u32>) -> Result<(), MentorError> {
        self.check_range(first, count)?;
        (first..first + count).for_each(|j| self.transitions.encode(j as usize, out));
        Ok(())
    }

    /// All mentor transitions, for a learner in the same process.
    pub fn mentor_transitions(&self) -> &MentorTransitions {
        &self.transitions
    }

    /// All annotations.
    pub fn table(&self) -> &AnnotationTable {
        &self.table
    }

    /// Counters.
    pub fn stats(&self) -> Stats {
        let count = self.table.len();
        let infeasible = |j: &usize| self.table.errors()[*j] >= self.rule.e_infeas;
        let lengths = || (0..count).filter_map(|j| self.table.bridge(j)).map(|b| b.length as f32);
        let errors = || (0..count).filter_map(|j| self.table.estimate(j)).map(|e| e.e_kl);
        Stats {
            mentor: count as u32,
            feasible: (count - self.infeasible) as u32,
            bridged: (0..count).filter(infeasible).filter(|&j| self.table.bridge(j).is_some()).count() as u32,
            stored: self.history.len() as u32,
            bridge_len_mean: lengths().sum::<f32>() / lengths().count().max(1) as f32,
            e_kl_mean: errors().sum::<f32>() / errors().count().max(1) as f32,
        }
    }

    /// Bridge searches that met their limit ([`crate::bridge::search::MAX_LOOKS`]) since this mentor-server began.
    pub fn searches_cut_short(&self) -> u64 {
        self.search.cut_short()
    }

    fn whitened(&self, state: &[f32]) -> Result<Vec<f32>, MentorError> {
        let refuse = |what, value, accepted| Err(MentorError::Value { what, value, accepted });
        if state.len() != self.metric.dim() {
            return refuse("the number of features", state.len() as f64, self.metric.dim().to_string());
        }
        match state.iter().find(|x| !x.is_finite()) {
            Some(&x) => refuse("a feature", f64::from(x), "finite numbers".into()),
            None => Ok(self.metric.whiten_all(state)),
        }
    }

    fn check_range(&self, first: u32, count: u32) -> Result<(), MentorError> {
        let len = self.table.len();
        let fits = first.checked_add(count).is_some_and(|end| end as usize <= len);
        if count > MAX_QUERY_ROWS || !fits { Err(MentorError::Range { first, count, len }) } else { Ok(()) }
    }
}
