//! How much of L_o and of L_m a sample trains with.

use super::mentor::MentorKind;
use trestle_proto::config::{CombineKind, Mentor};

/// What (4) and (5) compare.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distances {
    /// Q(s_o, a_o; θ).
    pub q_o: f32,
    /// Q_o^past.
    pub past_o: f32,
    /// Q(s_m, a_m; θ).
    pub q_m: f32,
    /// Q_m^past.
    pub past_m: f32,
}

/// Whether L_m is the loss whose Q-value moved less since the entry was last looked at: D_m < D_o, (4) and (5).
///
/// A tie goes to L_o, and so does a past value that is NaN. The paper does not say what the past value of an entry
/// is whose mentor transition had nothing to say before (our choice: NaN, so that it trains with L_o once, and
/// with a past value from then on).
pub fn min_distance(d: &Distances) -> bool {
    let (move_o, move_m) = (d.q_o - d.past_o, d.q_m - d.past_m);
    move_m * move_m < move_o * move_o
}

/// The weights of a sample's two losses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// Of L_o, 0 to 1.
    pub own: f32,
    /// Of L_m, 0 to 1.
    pub mentor: f32,
}

impl Weights {
    /// `phi`, 0 to 1, is the weight of L_m: L_o has the rest where one takes the other's place, and keeps its own where
    /// they stand beside each other (our choice).
    pub fn of(combine: CombineKind, phi: f32) -> Self {
        match combine {
            CombineKind::Instead => Self { own: 1.0 - phi, mentor: phi },
            CombineKind::Beside => Self { own: 1.0, mentor: phi },
        }
    }
}

/// Whether a one-sided L_m acts: only where its `target` is above the present value `q`.
///
/// A mentor can raise the value of what it did and never lower it, as the maximum in the augmented backup of Price and
/// Boutilier (2003) and the clipped advantage of self-imitation (Oh et al. 2018). Not the paper's.
pub fn acts(q: f32, target: f32) -> bool {
    target > q
}

/// The confidence Φ in the mentor's loss, L = Φ L_m + (1 - Φ) L_o (arXiv 2511.03616).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Confidence {
    /// Steepness of the sigmoid.
    pub beta: f64,
    /// Training count at which a mentor state is fully trusted, at least 1.
    pub c_max: u64,
    /// e_KL at which trust is gone, above 0.
    pub e_max: f64,
}

impl Confidence {
    /// The settings of a configuration.
    pub fn new(mentor: &Mentor) -> Self {
        Self { beta: mentor.beta, c_max: mentor.c_max, e_max: mentor.e_max }
    }

    /// Φ, from 0 to 1, of a mentor transition that `trained` samples have used before.
    ///
    /// Feasible: min(ΔQ δ, ζ); bridged: ΔQ δ; with ΔQ = sigmoid(β (`q_m` - `q_m_of_a_o`)), where both are values
    /// of s_m, of the mentor's action and of the observer's; δ = ln(1 + min(c, c_max)) / ln(1 + c_max);
    /// ζ = 1 - e_KL / e_max, and 0 beyond e_max (our choice: `diiqn` also meets larger errors). Φ is a constant of
    /// the sample: no gradient flows through it. A NaN in a value gives 0.
    pub fn weight(&self, kind: MentorKind, q_m: f32, q_m_of_a_o: f32, trained: u64, e_kl: f32) -> f32 {
        let difference = f64::from(q_m) - f64::from(q_m_of_a_o);
        let better = 1.0 / (1.0 + libm::exp(-self.beta * difference));
        let known = libm::log1p(trained.min(self.c_max) as f64) / libm::log1p(self.c_max as f64);
        let phi = match kind {
            MentorKind::Feasible => (better * known).min((1.0 - f64::from(e_kl) / self.e_max).max(0.0)),
            MentorKind::Bridged => better * known,
        };
        if difference.is_nan() { 0.0 } else { phi as f32 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_value_that_moved_less_wins_and_ties_are_the_observers() {
        let d = |q_o, past_o, q_m, past_m| min_distance(&Distances { q_o, past_o, q_m, past_m });
        // D_o = 1, D_m = 0.25.
        assert!(d(2.0, 1.0, 0.5, 1.0));
        // D_o = 0.25, D_m = 1.
        assert!(!d(0.5, 1.0, 2.0, 1.0));
        // Equal distances in opposite directions.
        assert!(!d(2.0, 1.0, 0.0, 1.0));
        assert!(!d(2.0, 1.0, 0.5, f32::NAN));
        assert!(!d(f32::NAN, 1.0, 0.5, 0.5));
    }

    const RULE: Confidence = Confidence { beta: 2.0, c_max: 99, e_max: 0.5 };

    #[test]
    fn confidence_by_hand() {
        let close = |got: f32, expected: f64| assert!((f64::from(got) - expected).abs() < 1e-6, "{got}");
        // sigmoid(0) = 1/2; ln 10 / ln 100 = 1/2.
        close(RULE.weight(MentorKind::Bridged, 1.0, 1.0, 9, 9.0), 0.25);
        // sigmoid(2 * 0.5) = 0.731058...; fully trained; ζ = 1 - 0.1 / 0.5 = 0.8 does not bind.
        close(RULE.weight(MentorKind::Feasible, 1.5, 1.0, 99, 0.1), 0.731_058_578_6);
        close(RULE.weight(MentorKind::Feasible, 1.5, 1.0, 500, 0.1), 0.731_058_578_6);
        // ζ = 0.2 binds.
        close(RULE.weight(MentorKind::Feasible, 1.5, 1.0, 99, 0.4), 0.2);
        assert_eq!(RULE.weight(MentorKind::Feasible, 1.5, 1.0, 99, 0.6), 0.0);
        assert_eq!(RULE.weight(MentorKind::Feasible, 1.5, 1.0, 0, 0.0), 0.0);
        assert_eq!(RULE.weight(MentorKind::Bridged, f32::NAN, 1.0, 9, 0.0), 0.0);
    }

    #[test]
    fn the_observers_loss_keeps_its_weight_beside_the_mentors() {
        assert_eq!(Weights::of(CombineKind::Instead, 0.25), Weights { own: 0.75, mentor: 0.25 });
        assert_eq!(Weights::of(CombineKind::Beside, 0.25), Weights { own: 1.0, mentor: 0.25 });
    }

    #[test]
    fn a_one_sided_loss_only_raises() {
        assert!(acts(-1.0, -0.5));
        assert!(!acts(-0.5, -0.5) && !acts(-0.5, -1.0) && !acts(f32::NAN, 1.0) && !acts(1.0, f32::NAN));
    }

    proptest! {
        #[test]
        fn confidence_is_a_share_and_grows_with_training(
            q_m in -1e6f32..1e6, q_o in -1e6f32..1e6, c in 0u64..200, e_kl in 0f32..2.0,
        ) {
            for kind in [MentorKind::Feasible, MentorKind::Bridged] {
                let phi = RULE.weight(kind, q_m, q_o, c, e_kl);
                prop_assert!((0.0..=1.0).contains(&phi));
                prop_assert!(phi <= RULE.weight(kind, q_m, q_o, c + 1, e_kl));
            }
        }
    }
}
