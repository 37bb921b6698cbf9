//! Both losses, weighted by the confidence Φ in the mentor: L = Φ L_m + (1 - Φ) L_o (arXiv 2511.03616).

use super::{Candidate, Need, Own, Rule, SelectionError, of_length};
use crate::losses::MentorKind;
use trestle_proto::config::{Choice, CombineKind, DrawKind, RewardKind, SelectionRule};

pub(super) const RULE: SelectionRule = SelectionRule {
    name: "confidence",
    about: "Both, weighted by the confidence Φ in the mentor (arXiv 2511.03616).",
    remembers: "c, the samples that each mentor transition has had an L_m in",
    draws: DrawKind::VALUES,
    combines: CombineKind::VALUES,
    rewards: RewardKind::VALUES,
};

#[derive(Debug)]
pub(super) struct Confidence {
    /// Steepness of the sigmoid.
    beta: f64,
    /// Training count at which a mentor state is fully trusted, at least 1.
    c_max: u64,
    /// e_KL at which trust is gone, above 0.
    e_max: f64,
    /// c: for each mentor transition, which stands for its state s_m, the samples drawn with an L_m of it.
    trained: Vec<u32>,
}

pub(super) fn make(need: &Need<'_>) -> Result<Box<dyn Rule>, SelectionError> {
    let mentor = need.mentor;
    let (beta, c_max, e_max) = (mentor.beta, mentor.c_max, mentor.e_max);
    Ok(Box::new(Confidence { beta, c_max, e_max, trained: vec![0; need.mentor_len] }))
}

impl Rule for Confidence {
    /// Feasible: min(ΔQ δ, ζ); bridged: ΔQ δ; with ΔQ = sigmoid(β (Q(s_m, a_m) - Q(s_m, a_o)));
    /// δ = ln(1 + min(c, c_max)) / ln(1 + c_max); ζ = 1 - e_KL / e_max, and 0 beyond e_max (our choice: `diiqn` also meets
    /// larger errors). A NaN in a value gives 0.
    fn weight(&self, own: &Own, mentor: &Candidate<'_>) -> f32 {
        let difference = f64::from(mentor.q_m()) - f64::from(mentor.q[own.action as usize]);
        let better = 1.0 / (1.0 + libm::exp(-self.beta * difference));
        let trained = u64::from(self.trained[mentor.j]);
        let known = libm::log1p(trained.min(self.c_max) as f64) / libm::log1p(self.c_max as f64);
        let phi = match mentor.kind {
            MentorKind::Feasible => {
                (better * known).min((1.0 - f64::from(mentor.e_kl) / self.e_max).max(0.0))
            }
            MentorKind::Bridged => better * known,
        };
        if difference.is_nan() { 0.0 } else { phi as f32 }
    }

    fn trained(&mut self, _: &Own, mentor: Option<&Candidate<'_>>) {
        if let Some(mentor) = mentor {
            self.trained[mentor.j] = self.trained[mentor.j].saturating_add(1);
        }
    }

    fn save(&self) -> Vec<u8> {
        bytemuck::cast_slice(&self.trained).to_vec()
    }

    fn restore(&mut self, bytes: &[u8], _stored: usize) -> Result<(), SelectionError> {
        of_length(bytes, 4 * self.trained.len())?;
        let words = bytes.as_chunks::<4>().0;
        self.trained.iter_mut().zip(words).for_each(|(count, word)| *count = u32::from_le_bytes(*word));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    /// Φ of mentor transition 1 after `c` samples, with a_m = 0 and a_o = 1.
    fn phi(kind: MentorKind, q_m: f32, q_m_of_a_o: f32, c: u32, e_kl: f32) -> f32 {
        let rule = Confidence { beta: 2.0, c_max: 99, e_max: 0.5, trained: vec![7, c] };
        let q = [q_m, q_m_of_a_o];
        rule.weight(&Own { slot: 3, action: 1, q: 0.0 }, &Candidate { j: 1, kind, action: 0, e_kl, q: &q })
    }

    #[test]
    fn confidence_by_hand() {
        let close = |got: f32, expected: f64| assert!((f64::from(got) - expected).abs() < 1e-6, "{got}");
        // sigmoid(0) = 1/2; ln 10 / ln 100 = 1/2.
        close(phi(MentorKind::Bridged, 1.0, 1.0, 9, 9.0), 0.25);
        // sigmoid(2 * 0.5) = 0.731058...; fully trained; ζ = 1 - 0.1 / 0.5 = 0.8 does not bind.
        close(phi(MentorKind::Feasible, 1.5, 1.0, 99, 0.1), 0.731_058_578_6);
        close(phi(MentorKind::Feasible, 1.5, 1.0, 500, 0.1), 0.731_058_578_6);
        // ζ = 0.2 binds.
        close(phi(MentorKind::Feasible, 1.5, 1.0, 99, 0.4), 0.2);
        assert_eq!(phi(MentorKind::Feasible, 1.5, 1.0, 99, 0.6), 0.0);
        assert_eq!(phi(MentorKind::Feasible, 1.5, 1.0, 0, 0.0), 0.0);
        assert_eq!(phi(MentorKind::Bridged, f32::NAN, 1.0, 9, 0.0), 0.0);
    }

    #[test]
    fn samples_with_a_mentors_loss_are_counted_and_kept() {
        let new = || Confidence { beta: 2.0, c_max: 99, e_max: 0.5, trained: vec![0; 3] };
        let (mut rule, own) = (new(), Own { slot: 0, action: 0, q: 0.0 });
        let mentor = Candidate { j: 2, kind: MentorKind::Bridged, action: 0, e_kl: 0.0, q: &[0.0] };
        [Some(&mentor), None, Some(&mentor)].into_iter().for_each(|mentor| rule.trained(&own, mentor));
        assert_eq!(rule.trained, [0, 0, 2]);
        let mut again = new();
        again.restore(&rule.save(), 9).unwrap();
        assert_eq!(again.trained, rule.trained);
        assert!(again.restore(&[0; 11], 9).is_err());
    }

    proptest! {
        #[test]
        fn confidence_is_a_share_and_grows_with_training(
            q_m in -1e6f32..1e6, q_o in -1e6f32..1e6, c in 0u32..200, e_kl in 0f32..2.0,
        ) {
            for kind in [MentorKind::Feasible, MentorKind::Bridged] {
                let weight = phi(kind, q_m, q_o, c, e_kl);
                prop_assert!((0.0..=1.0).contains(&weight));
                prop_assert!(weight <= phi(kind, q_m, q_o, c + 1, e_kl));
            }
        }
    }
}
