//! What the weight Φ of L_m makes of a sample's two losses.

use trestle_proto::config::CombineKind;

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

#[cfg(test)]
mod tests {
    use super::*;

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
}
