//! The mentor's transitions as the learner sees them: states only, fetched once from the mentor-server.

use crate::batch::{FIRST, TERMINATED};
use bytemuck::cast_slice;

/// Words of one mentor transition in an answer: s_m, s'_m, flags.
pub const fn transition_words(obs_dim: usize) -> usize {
    2 * obs_dim + 1
}

/// All transitions (s_m, s'_m) of a demonstration, in its order. The last state of a trajectory begins none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MentorTransitions {
    obs_dim: usize,
    s: Vec<f32>,
    next: Vec<f32>,
    flags: Vec<u32>,
    /// What the next transition's flags begin with.
    pending: u32,
}

/// Words of a peer that are no mentor transitions.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MentorTransitionsError {
    /// Not a whole number of transitions.
    #[error("{found} words of mentor transitions are not a multiple of {each} (one transition)")]
    Size {
        /// Words received.
        found: usize,
        /// Words of a transition.
        each: usize,
    },
    /// A feature that is NaN or infinite.
    #[error("mentor transition {0} has a feature that is not finite")]
    NotFinite(usize),
}

impl MentorTransitions {
    /// No transition yet, of states with `obs_dim` features.
    pub fn new(obs_dim: usize) -> Self {
        Self { obs_dim, ..Self::default() }
    }

    /// The next transition begins a trajectory.
    pub fn begin_trajectory(&mut self) {
        self.pending = FIRST;
    }

    /// Appends (s_m, s'_m); `terminal` where s'_m ended the mentor's episode in a terminal state.
    pub fn push(&mut self, s: &[f32], next: &[f32], terminal: bool) {
        debug_assert!(s.len() == self.obs_dim && next.len() == self.obs_dim);
        self.s.extend_from_slice(s);
        self.next.extend_from_slice(next);
        let first = std::mem::take(&mut self.pending);
        self.flags.push(first | if terminal { TERMINATED } else { 0 });
    }

    /// Number of transitions.
    pub fn len(&self) -> usize {
        self.flags.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.flags.is_empty()
    }

    /// Features of a state.
    pub fn obs_dim(&self) -> usize {
        self.obs_dim
    }

    /// s_m of transition `j`.
    pub fn state(&self, j: usize) -> &[f32] {
        &self.s[j * self.obs_dim..][..self.obs_dim]
    }

    /// s'_m of transition `j`.
    pub fn next_state(&self, j: usize) -> &[f32] {
        &self.next[j * self.obs_dim..][..self.obs_dim]
    }

    /// Whether s'_m of transition `j` is terminal and so has no value.
    pub fn terminal(&self, j: usize) -> bool {
        self.flags[j] & TERMINATED != 0
    }

    /// Whether transition `j` is the first of its trajectory.
    pub fn first(&self, j: usize) -> bool {
        j == 0 || self.flags[j] & FIRST != 0
    }

    /// Appends transition `j` to `out` as [`transition_words`] words.
    pub fn encode(&self, j: usize, out: &mut Vec<u32>) {
        out.extend_from_slice(cast_slice(self.state(j)));
        out.extend_from_slice(cast_slice(self.next_state(j)));
        out.push(self.flags[j]);
    }

    /// Appends the transitions that a peer sent.
    ///
    /// # Errors
    /// A size that does not fit, or a feature that is not finite; nothing from there on is appended.
    pub fn decode(&mut self, words: &[u32]) -> Result<(), MentorTransitionsError> {
        let (each, d) = (transition_words(self.obs_dim), self.obs_dim);
        if !words.len().is_multiple_of(each) {
            return Err(MentorTransitionsError::Size { found: words.len(), each });
        }
        for w in words.chunks_exact(each) {
            let states: &[f32] = cast_slice(&w[..2 * d]);
            if !states.iter().all(|x| x.is_finite()) {
                return Err(MentorTransitionsError::NotFinite(self.len()));
            }
            let (s, next) = states.split_at(d);
            self.pending = w[2 * d] & FIRST;
            self.push(s, next, w[2 * d] & TERMINATED != 0);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn transitions_survive_the_journey() {
        let mut sent = MentorTransitions::new(2);
        sent.push(&[0.0, 1.0], &[1.0, 1.0], false);
        sent.push(&[1.0, 1.0], &[2.0, 1.0], true);
        sent.begin_trajectory();
        sent.push(&[5.0, 1.0], &[6.0, 1.0], false);
        let mut words = Vec::new();
        (0..3).for_each(|j| sent.encode(j, &mut words));
        let mut got = MentorTransitions::new(2);
        got.decode(&words).unwrap();
        assert_eq!(got, sent);
        assert!(!got.terminal(0) && got.terminal(1));
        assert_eq!([0, 1, 2].map(|j| got.first(j)), [true, false, true]);
        assert!(got.decode(&words[1..]).is_err());
        words[1] = f32::NAN.to_bits();
        assert_eq!(got.decode(&words), Err(MentorTransitionsError::NotFinite(3)));
    }
}
