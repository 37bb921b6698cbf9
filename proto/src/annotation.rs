//! Annotations: what the observer has found out about each mentor transition.
//!
//! The mentor-server owns the table; the learner keeps a mirror, brought up to date by the changed records of every
//! answer. A record travels as [`record_words`] 32-bit words: mentor index, a_est, e_KL (`f32`), start KL (`f32`), r_est
//! (`f32`), l_feas, a_feas, r_feas (`f32`), end KL (`f32`), bridge flags, then the `obs_dim` features of s_feas (`f32`).
//!
//! Where whole bridges are kept, a bridge has up to a number of *further* steps, fixed for the run: `mentor.k` - 1. The states that
//! the bridge has behind each of its steps but the last follow upon s_feas, which is the first of them. Then come the actions that
//! are taken in these states. What is behind the bridge's end is 0, or [`NONE`] for actions.

use crate::NONE;
use bytemuck::{cast_slice, cast_slice_mut};

const FIXED_WORDS: usize = 10;
/// The bridge's first step ended its episode in a terminal state, so s_feas has no value.
const FEAS_TERMINATED: u32 = 1;
/// Where in the flags the mentor state is that the bridge reaches, 8 bits.
const AHEAD_SHIFT: u32 = 8;
const AHEAD: u32 = 0xff << AHEAD_SHIFT;

/// Words of one record for observations of `obs_dim` features and bridges of which up to `further` steps after the first are kept.
pub const fn record_words(obs_dim: usize, further: usize) -> usize {
    FIXED_WORDS + states_of(further) * obs_dim + further
}

/// States of a record: s_feas, and those behind it.
const fn states_of(further: usize) -> usize {
    if further > 1 { further } else { 1 }
}

/// The best estimate of the mentor's action (paper, Fig. 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// a_est: the observer's action whose transition came closest.
    pub action: u32,
    /// e_KL of that transition, not negative.
    pub e_kl: f32,
    /// KL between the state that it began in and s_m, not negative: 0 if it began in s_m itself.
    pub start_kl: f32,
    /// r_est: the reward that the observer got for it (between equally good ones from the same state the highest).
    pub reward: f32,
}

/// The shortest bridge so far (paper, Fig. 4).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bridge<'a> {
    /// a_feas: its first action.
    pub action: u32,
    /// l_feas: its length in observer steps, at least 1.
    pub length: u32,
    /// r_feas: the reward of its first step.
    pub reward: f32,
    /// KL between its last state and the mentor state that it reached: among equally long ones the smaller wins.
    pub end_kl: f32,
    /// s_feas: the state after its first step, `obs_dim` features.
    pub next_obs: &'a [f32],
    /// Whether s_feas is terminal.
    pub terminated: bool,
    /// How many mentor steps after s_m the mentor state is that it reached, 1 to 64; 0 where a run of an earlier version has not
    /// noted it. For people: nothing is decided by it.
    pub ahead: u32,
}

/// The steps of a bridge after its first one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Further<'a> {
    /// Their actions, 1 or more.
    pub actions: &'a [u32],
    /// The states in which they are taken, where the step before ended: row-major, `obs_dim` features each. The first is s_feas.
    pub states: &'a [f32],
}

/// A record of a peer that cannot be right.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AnnotationError {
    /// The words are not a whole number of records.
    #[error("{found} words of annotations are not a multiple of {record} (one record)")]
    Size {
        /// Words received.
        found: usize,
        /// Words of a record.
        record: usize,
    },
    /// Index, action, length or a number is out of range.
    #[error("annotation of mentor transition {mentor}: {what} is {value}; accepted: {accepted}")]
    Field {
        /// Index of the mentor transition.
        mentor: u32,
        /// Which field.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What is accepted.
        accepted: String,
    },
}

/// The annotations of all mentor transitions, one array a field.
#[derive(Clone, Debug, PartialEq)]
pub struct AnnotationTable {
    obs_dim: usize,
    n_actions: usize,
    /// Steps of a bridge after its first one that are kept, at most.
    further: usize,
    a_est: Vec<u32>,
    e_kl: Vec<f32>,
    start_kl: Vec<f32>,
    r_est: Vec<f32>,
    l_feas: Vec<u32>,
    a_feas: Vec<u32>,
    r_feas: Vec<f32>,
    end_kl: Vec<f32>,
    flags: Vec<u32>,
    /// For each mentor transition as many states as a record has.
    s_feas: Vec<f32>,
    /// For each mentor transition `further` actions.
    a_further: Vec<u32>,
}

impl AnnotationTable {
    /// `len` mentor transitions of which nothing is known.
    pub fn new(len: usize, obs_dim: usize, n_actions: usize) -> Self {
        Self {
            obs_dim,
            n_actions,
            further: 0,
            a_est: vec![NONE; len],
            e_kl: vec![f32::INFINITY; len],
            start_kl: vec![f32::INFINITY; len],
            r_est: vec![0.0; len],
            l_feas: vec![0; len],
            a_feas: vec![NONE; len],
            r_feas: vec![0.0; len],
            end_kl: vec![f32::INFINITY; len],
            flags: vec![0; len],
            s_feas: vec![0.0; len * obs_dim],
            a_further: Vec::new(),
        }
    }

    /// The same, before anything is known, with room for up to `further` steps of each bridge after the first.
    pub fn keeping(mut self, further: usize) -> Self {
        self.further = further;
        self.s_feas = vec![0.0; self.len() * states_of(further) * self.obs_dim];
        self.a_further = vec![NONE; self.len() * further];
        self
    }

    /// Steps of a bridge after its first one that are kept, at most; 0 where whole bridges are of no use.
    pub fn further_at_most(&self) -> usize {
        self.further
    }

    /// Words of a record.
    pub fn record_words(&self) -> usize {
        record_words(self.obs_dim, self.further)
    }

    /// Number of mentor transitions.
    pub fn len(&self) -> usize {
        self.a_est.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.a_est.is_empty()
    }

    /// e_KL of every mentor transition; infinite where nothing is known.
    pub fn errors(&self) -> &[f32] {
        &self.e_kl
    }

    /// The best estimate of mentor transition `j`'s action; none before the first observer transition.
    pub fn estimate(&self, j: usize) -> Option<Estimate> {
        (self.a_est[j] != NONE).then(|| Estimate {
            action: self.a_est[j],
            e_kl: self.e_kl[j],
            start_kl: self.start_kl[j],
            reward: self.r_est[j],
        })
    }

    /// The shortest bridge from mentor transition `j`'s state, if one has been found.
    pub fn bridge(&self, j: usize) -> Option<Bridge<'_>> {
        (self.l_feas[j] != 0).then(|| Bridge {
            action: self.a_feas[j],
            length: self.l_feas[j],
            reward: self.r_feas[j],
            end_kl: self.end_kl[j],
            next_obs: &self.states(j)[..self.obs_dim],
            terminated: self.flags[j] & FEAS_TERMINATED != 0,
            ahead: (self.flags[j] & AHEAD) >> AHEAD_SHIFT,
        })
    }

    /// The length of that bridge.
    pub fn bridge_length(&self, j: usize) -> Option<u32> {
        (self.l_feas[j] != 0).then_some(self.l_feas[j])
    }

    /// The steps of mentor transition `j`'s bridge after its first one; none where there are none, or they are not known.
    pub fn further(&self, j: usize) -> Option<Further<'_>> {
        let actions = &self.a_further[j * self.further..][..self.further];
        let count = actions.iter().position(|&action| action == NONE).unwrap_or(self.further);
        let (actions, states) = (&actions[..count], &self.states(j)[..count * self.obs_dim]);
        (count > 0).then_some(Further { actions, states })
    }

    /// s_feas of mentor transition `j`, and what is kept of the states behind it.
    fn states(&self, j: usize) -> &[f32] {
        let width = states_of(self.further) * self.obs_dim;
        &self.s_feas[j * width..][..width]
    }

    fn states_mut(&mut self, j: usize) -> &mut [f32] {
        let width = states_of(self.further) * self.obs_dim;
        &mut self.s_feas[j * width..][..width]
    }

    /// Replaces the estimate of mentor transition `j`.
    pub fn set_estimate(&mut self, j: usize, estimate: &Estimate) {
        self.a_est[j] = estimate.action;
        self.e_kl[j] = estimate.e_kl;
        self.start_kl[j] = estimate.start_kl;
        self.r_est[j] = estimate.reward;
    }

    /// Replaces the bridge of mentor transition `j`. Nothing is known of its further steps then.
    pub fn set_bridge(&mut self, j: usize, bridge: &Bridge<'_>) {
        self.l_feas[j] = bridge.length;
        self.a_feas[j] = bridge.action;
        self.r_feas[j] = bridge.reward;
        self.end_kl[j] = bridge.end_kl;
        let terminated = if bridge.terminated { FEAS_TERMINATED } else { 0 };
        self.flags[j] = terminated | (bridge.ahead << AHEAD_SHIFT) & AHEAD;
        let dim = self.obs_dim;
        let states = self.states_mut(j);
        states.fill(0.0);
        states[..dim].copy_from_slice(bridge.next_obs);
        self.a_further[j * self.further..][..self.further].fill(NONE);
    }

    /// Says what the steps of mentor transition `j`'s bridge after its first one are: each action, and the state in which it is taken.
    /// The first of these states is s_feas. More than are kept are left out.
    pub fn set_further<'a>(&mut self, j: usize, steps: impl Iterator<Item = (u32, &'a [f32])>) {
        let (dim, further) = (self.obs_dim, self.further);
        for (at, (action, state)) in steps.take(further).enumerate() {
            self.a_further[j * further + at] = action;
            self.states_mut(j)[at * dim..][..dim].copy_from_slice(state);
        }
    }

    /// Appends the record of mentor transition `j` to `out`.
    pub fn encode(&self, j: usize, out: &mut Vec<u32>) {
        out.extend_from_slice(&[
            j as u32,
            self.a_est[j],
            self.e_kl[j].to_bits(),
            self.start_kl[j].to_bits(),
            self.r_est[j].to_bits(),
            self.l_feas[j],
            self.a_feas[j],
            self.r_feas[j].to_bits(),
            self.end_kl[j].to_bits(),
            self.flags[j],
        ]);
        out.extend_from_slice(cast_slice(self.states(j)));
        out.extend_from_slice(&self.a_further[j * self.further..][..self.further]);
    }

    /// Takes over the records that a peer sent, each checked before it is written.
    ///
    /// # Errors
    /// The first record that cannot be right; those before it have been taken over.
    pub fn apply(&mut self, words: &[u32]) -> Result<(), AnnotationError> {
        let record = self.record_words();
        if !words.len().is_multiple_of(record) {
            return Err(AnnotationError::Size { found: words.len(), record });
        }
        for r in words.chunks_exact(record) {
            self.check(r)?;
            let j = r[0] as usize;
            self.a_est[j] = r[1];
            self.e_kl[j] = f32::from_bits(r[2]);
            self.start_kl[j] = f32::from_bits(r[3]);
            self.r_est[j] = f32::from_bits(r[4]);
            self.l_feas[j] = r[5];
            self.a_feas[j] = r[6];
            self.r_feas[j] = f32::from_bits(r[7]);
            self.end_kl[j] = f32::from_bits(r[8]);
            self.flags[j] = r[9];
            let (states, actions) = r[FIXED_WORDS..].split_at(states_of(self.further) * self.obs_dim);
            cast_slice_mut::<f32, u32>(self.states_mut(j)).copy_from_slice(states);
            self.a_further[j * self.further..][..self.further].copy_from_slice(actions);
        }
        Ok(())
    }

    fn check(&self, r: &[u32]) -> Result<(), AnnotationError> {
        let refuse = |what, value: f64, accepted: String| {
            Err(AnnotationError::Field { mentor: r[0], what, value, accepted })
        };
        if r[0] as usize >= self.len() {
            return refuse("index", f64::from(r[0]), format!("below {}", self.len()));
        }
        for (what, action) in [("a_est", r[1]), ("a_feas", r[6])] {
            if action != NONE && action as usize >= self.n_actions {
                return refuse(what, f64::from(action), format!("below {}, or none", self.n_actions));
            }
        }
        for (what, word) in [("e_KL", r[2]), ("start KL", r[3]), ("end KL", r[8])] {
            let kl = f32::from_bits(word);
            if kl.is_nan() || kl < 0.0 {
                return refuse(what, f64::from(kl), "0 or more".into());
            }
        }
        for (what, word) in [("r_est", r[4]), ("r_feas", r[7])] {
            let reward = f32::from_bits(word);
            if !reward.is_finite() {
                return refuse(what, f64::from(reward), "finite numbers".into());
            }
        }
        if (r[5] == 0) != (r[6] == NONE) {
            return refuse("l_feas", f64::from(r[5]), "0 exactly where a_feas is none".into());
        }
        if r[9] & !(FEAS_TERMINATED | AHEAD) != 0 {
            return refuse("flags", f64::from(r[9]), "bits 0 and 8 to 15".into());
        }
        let (states, actions) = r[FIXED_WORDS..].split_at(states_of(self.further) * self.obs_dim);
        if let Some(x) = states.iter().map(|&w| f32::from_bits(w)).find(|x| !x.is_finite()) {
            return refuse("s_feas", f64::from(x), "finite numbers".into());
        }
        let count = actions.iter().position(|&action| action == NONE).unwrap_or(actions.len());
        if count != 0 && r[5] as usize != count + 1 {
            return refuse("l_feas", f64::from(r[5]), format!("{}, one more than further steps", count + 1));
        }
        if let Some(&action) = actions[..count].iter().find(|&&action| action as usize >= self.n_actions) {
            let accepted = format!("below {}", self.n_actions);
            return refuse("a further action", f64::from(action), accepted);
        }
        let behind = &states[states_of(count) * self.obs_dim..];
        match behind.iter().find(|&&word| word != 0) {
            Some(&word) => refuse("a state behind a bridge", f64::from(f32::from_bits(word)), "0".into()),
            None if actions[count..].iter().any(|&action| action != NONE) => {
                refuse("an action behind a bridge", count as f64, "none".into())
            }
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn records_survive_the_journey() {
        let mut table = AnnotationTable::new(3, 2, 4);
        assert_eq!(table.estimate(1), None);
        assert_eq!(table.bridge(1), None);
        table.set_estimate(1, &Estimate { action: 2, e_kl: 0.25, start_kl: 0.125, reward: -0.04 });
        let bridge = Bridge {
            action: 3,
            length: 4,
            reward: 1.0,
            end_kl: 0.125,
            next_obs: &[5.0, 6.0],
            terminated: true,
            ahead: 64,
        };
        table.set_bridge(1, &bridge);
        let mut words = Vec::new();
        table.encode(1, &mut words);
        assert_eq!((words.len(), table.further(1)), (record_words(2, 0), None));
        let mut mirror = AnnotationTable::new(3, 2, 4);
        mirror.apply(&words).unwrap();
        assert_eq!(mirror, table);
        assert_eq!(mirror.bridge(1), Some(bridge));
    }

    /// Two mentor transitions of which the second has a bridge of `length` steps; up to three after the first are kept.
    fn bridged(length: u32) -> AnnotationTable {
        let mut table = AnnotationTable::new(2, 2, 4).keeping(3);
        let next_obs = &[5.0, 6.0];
        let bridge =
            Bridge { action: 3, length, reward: 1.0, end_kl: 0.0, next_obs, terminated: false, ahead: 1 };
        table.set_bridge(1, &bridge);
        table
    }

    #[test]
    fn whole_bridges_survive_the_journey() {
        let states = [[5.0, 6.0], [7.0, 8.0], [9.0, 10.0]];
        let steps = || [2, 0, 1].into_iter().zip(states.iter().map(|state| &state[..]));
        for length in 1..=4 {
            let (mut table, further) = (bridged(length), length as usize - 1);
            assert_eq!(table.further(1), None);
            table.set_further(1, steps().take(further));
            let (actions, all) = (&[2, 0, 1][..further], &states.concat()[..2 * further]);
            let expected = (further > 0).then_some(Further { actions, states: all });
            assert_eq!(table.further(1), expected);
            let mut words = Vec::new();
            table.encode(1, &mut words);
            assert_eq!((words.len(), table.record_words()), (record_words(2, 3), 10 + 3 * 2 + 3));
            let mut mirror = AnnotationTable::new(2, 2, 4).keeping(3);
            mirror.apply(&words).unwrap();
            assert_eq!((&mirror, mirror.further(1), mirror.further(0)), (&table, expected, None));
            // Another bridge takes the place of all of it.
            table.set_bridge(1, &bridged(1).bridge(1).unwrap());
            assert_eq!(table, bridged(1));
        }
    }

    #[test]
    fn further_steps_that_cannot_be_are_refused() {
        let refused = |length, changes: &[(usize, u32)]| {
            let mut table = bridged(length);
            table.set_further(1, [(2, &[5.0, 6.0][..]), (0, &[7.0, 8.0])].into_iter());
            let mut words = Vec::new();
            table.encode(1, &mut words);
            changes.iter().for_each(|&(at, word)| words[at] = word);
            table.apply(&words).err().map(|error| error.to_string())
        };
        assert_eq!(refused(3, &[]), None);
        // Two further steps, and the numbers behind them: words 10 to 15 are states, 16 to 18 actions.
        for (length, changes, what) in [
            (2, &[][..], "l_feas is 2; accepted: 3"),
            (4, &[], "l_feas is 4; accepted: 3"),
            (3, &[(17, 4)], "a further action is 4; accepted: below 4"),
            (3, &[(13, f32::NAN.to_bits())], "s_feas is NaN"),
            (3, &[(15, 1.5f32.to_bits())], "a state behind a bridge is 1.5; accepted: 0"),
            (3, &[(16, NONE)], "a state behind a bridge is 7; accepted: 0"),
            (3, &[(16, NONE), (12, 0), (13, 0)], "an action behind a bridge is 0; accepted: none"),
        ] {
            let error = refused(length, changes).unwrap();
            assert!(error.contains(what), "{error}");
        }
    }

    proptest! {
        #[test]
        fn arbitrary_records_are_refused_or_sound(
            words in proptest::collection::vec(any::<u32>(), 0..40),
            further in 0usize..4,
        ) {
            let mut table = AnnotationTable::new(5, 2, 4).keeping(further);
            if table.apply(&words).is_ok() {
                for j in 0..5 {
                    prop_assert!(table.estimate(j).is_none_or(|e| e.action < 4 && e.e_kl >= 0.0 && e.start_kl >= 0.0));
                    prop_assert!(table.bridge(j).is_none_or(|b| b.action < 4 && b.length > 0));
                    prop_assert!(table.further(j).is_none_or(|f| f.states.len() == 2 * f.actions.len()));
                }
            }
        }
    }
}
