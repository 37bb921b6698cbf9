//! The loss whose Q-value moved less since the entry was last looked at, (4) and (5) of the paper.

use super::{Candidate, Need, Own, Rule, SelectionError, of_length};
use trestle_proto::config::{Choice, CombineKind, DrawKind, RewardKind, SelectionRule};

pub(super) const RULE: SelectionRule = SelectionRule {
    name: "min-distance",
    about: "The loss whose Q-value moved less, (4) and (5).",
    remembers: "Q_o^past and Q_m^past of each stored transition",
    // Past values belong to a stored pair of transitions.
    draws: &[DrawKind::Similar],
    combines: CombineKind::VALUES,
    rewards: RewardKind::VALUES,
};

/// Past values by slot. They are set when a transition is stored and renewed whenever it is sampled (our choice). NaN stands
/// for a value that was never computed.
#[derive(Debug)]
pub(super) struct MinDistance {
    /// Q_o^past.
    past_o: Vec<f32>,
    /// Q_m^past, of the mentor's state and action. NaN where the mentor transition had nothing to say.
    past_m: Vec<f32>,
}

pub(super) fn make(need: &Need<'_>) -> Result<Box<dyn Rule>, SelectionError> {
    let room = || {
        let mut room = Vec::new();
        let fault = |_| SelectionError::Memory { rule: RULE.name, replay: need.replay };
        room.try_reserve_exact(need.replay).map_err(fault)?;
        Ok::<Vec<f32>, SelectionError>(room)
    };
    Ok(Box::new(MinDistance { past_o: room()?, past_m: room()? }))
}

impl Rule for MinDistance {
    /// 1 if D_m < D_o, else 0.
    ///
    /// A tie goes to L_o, and so does a past value that is NaN. The paper does not say what the past value of an entry is whose
    /// mentor transition had nothing to say before (our choice: NaN, so that it trains with L_o once, and with a past value
    /// from then on).
    fn weight(&self, own: &Own, mentor: &Candidate<'_>) -> f32 {
        let (move_o, move_m) = (own.q - self.past_o[own.slot], mentor.q_m() - self.past_m[own.slot]);
        f32::from(u8::from(move_m * move_m < move_o * move_o))
    }

    /// The present values become the past ones. An entry that was drawn twice has been compared with the same past value both
    /// times.
    ///
    /// Where the mentor's action of an entry has changed since (a better estimate, a bridge), the old past value is of the old
    /// action: (5) does not say which is meant, and the newest one that was looked at is kept (our choice).
    fn trained(&mut self, own: &Own, mentor: Option<&Candidate<'_>>) {
        self.past_o[own.slot] = own.q;
        if let Some(mentor) = mentor {
            self.past_m[own.slot] = mentor.q_m();
        }
    }

    fn stored(&mut self, slot: usize) {
        for past in [&mut self.past_o, &mut self.past_m] {
            match past.get_mut(slot) {
                Some(past) => *past = f32::NAN,
                None => past.push(f32::NAN),
            }
        }
    }

    fn values_stored(&self) -> bool {
        true
    }

    fn valued(&mut self, own: &Own, mentor: Option<&Candidate<'_>>) {
        self.trained(own, mentor);
    }

    fn save(&self) -> Vec<u8> {
        [bytemuck::cast_slice(&self.past_o), bytemuck::cast_slice(&self.past_m)].concat()
    }

    fn restore(&mut self, bytes: &[u8], stored: usize) -> Result<(), SelectionError> {
        of_length(bytes, 8 * stored)?;
        let (past_o, past_m) = bytes.split_at(4 * stored);
        for (past, bytes) in [(&mut self.past_o, past_o), (&mut self.past_m, past_m)] {
            past.clear();
            past.extend(bytes.as_chunks::<4>().0.iter().map(|word| f32::from_le_bytes(*word)));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::losses::MentorKind;

    fn candidate(q: &[f32]) -> Candidate<'_> {
        Candidate { j: 0, kind: MentorKind::Feasible, action: 0, e_kl: 0.0, q }
    }

    #[test]
    fn the_value_that_moved_less_wins_and_ties_are_the_observers() {
        let mentors = |q_o: f32, past_o: f32, q_m: f32, past_m: f32| {
            let rule = MinDistance { past_o: vec![past_o], past_m: vec![past_m] };
            rule.weight(&Own { slot: 0, action: 0, q: q_o }, &candidate(&[q_m])) == 1.0
        };
        // D_o = 1, D_m = 0.25.
        assert!(mentors(2.0, 1.0, 0.5, 1.0));
        // D_o = 0.25, D_m = 1.
        assert!(!mentors(0.5, 1.0, 2.0, 1.0));
        // Equal distances in opposite directions.
        assert!(!mentors(2.0, 1.0, 0.0, 1.0));
        assert!(!mentors(2.0, 1.0, 0.5, f32::NAN));
        assert!(!mentors(f32::NAN, 1.0, 0.5, 0.5));
    }

    #[test]
    fn past_values_are_the_newest_that_were_looked_at() {
        let mut rule = MinDistance { past_o: Vec::new(), past_m: Vec::new() };
        rule.stored(0);
        rule.stored(1);
        rule.valued(&Own { slot: 1, action: 0, q: 2.0 }, None);
        assert!(rule.past_o[1] == 2.0 && rule.past_m[1].is_nan() && rule.past_o[0].is_nan());
        rule.trained(&Own { slot: 1, action: 0, q: 3.0 }, Some(&candidate(&[4.0])));
        assert_eq!((rule.past_o[1], rule.past_m[1]), (3.0, 4.0));
        let mut again = MinDistance { past_o: Vec::new(), past_m: Vec::new() };
        again.restore(&rule.save(), 2).unwrap();
        assert_eq!(again.save(), rule.save());
        assert!(again.restore(&rule.save(), 3).is_err());
        // Another transition takes the slot.
        rule.stored(1);
        assert!(rule.past_o[1].is_nan() && rule.past_m[1].is_nan());
    }
}
